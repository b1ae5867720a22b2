//! The judge renderer.

//! Bounding boxes, vectors and transforms.
//!
//! Positions are `f64`, in world space or in the local space of an object (the space of its input
//! file).

#[cfg(feature = "internals")]
#[doc(hidden)]
pub use rayset_base::geometry::*;
pub use rayset_base::geometry::{Aabb, DAffine3, DMat3, DQuat, DVec3};

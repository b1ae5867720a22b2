//! Boxes, rays and space-filling curves: what every later module measures with.
//!
//! Positions are `f64` in world space (the space of the input file). Nothing here knows about points,
//! pages or pictures.

mod beam;
mod bounds;
#[cfg(feature = "internals")]
#[doc(hidden)]
pub mod curve;
#[cfg(not(feature = "internals"))]
pub(crate) mod curve;
mod ray;

#[cfg(feature = "internals")]
#[doc(hidden)]
pub use beam::Beam;
#[cfg(not(feature = "internals"))]
pub(crate) use beam::Beam;
pub use bounds::Aabb;
pub use glam::{DAffine3, DMat3, DQuat, DVec3};
#[cfg(feature = "internals")]
#[doc(hidden)]
pub use ray::Ray;
#[cfg(not(feature = "internals"))]
pub(crate) use ray::Ray;

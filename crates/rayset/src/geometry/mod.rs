//! Bounding boxes, rays, beams of rays and space-filling curves, on which the other modules build.
//!
//! Positions are `f64`, in world space or in the local space of an object (the space of its input file). Nothing here
//! depends on points, pages or pictures.

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

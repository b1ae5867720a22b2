//! Bounding boxes, rays, beams of rays, shapes of points and space-filling curves, on which the
//! other modules build.
//!
//! Positions are `f64`, in world space or in the local space of an object (the space of its input
//! file). Nothing here depends on points, pages or pictures.

mod beam;
mod bounds;
pub mod curve;
mod ray;
mod shape;
mod symmetric;

pub use beam::Beam;
pub use bounds::Aabb;
pub use glam::{DAffine3, DMat3, DQuat, DVec3};
pub use ray::Ray;
pub use shape::Shape;
pub use symmetric::eigenvectors;

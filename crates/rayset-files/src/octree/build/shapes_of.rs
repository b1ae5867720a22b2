//! What the shapes of points are measured of.

use super::fluid;
use super::neighbourhood::{self, Suggested};
use crate::octree::shape::StoredShape;

/// What shapes are measured of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ShapesOf {
    /// They are not measured.
    Nothing,
    /// Surfaces and wires that were scanned.
    Surfaces,
    /// A fluid.
    Fluid,
}

impl ShapesOf {
    #[cfg(feature = "parts")]
    pub(super) const ALL: [Self; 3] = [Self::Nothing, Self::Surfaces, Self::Fluid];

    /// Whether they are measured.
    pub(super) fn are_measured(self) -> bool {
        self != Self::Nothing
    }

    /// The shape that the nearest neighbours of a place suggest, itself among them.
    pub(super) fn by_neighbours(self, offsets: &[[f32; 3]]) -> Suggested {
        match self {
            Self::Nothing => Suggested::NOTHING,
            Self::Surfaces => Suggested::by_neighbours(offsets),
            Self::Fluid => fluid::by_neighbours(offsets),
        }
    }

    /// The radius of a point of such a shape, of one that would have the radius 1 as a ball.
    pub(super) fn radius_of(self, shape: StoredShape) -> f64 {
        match self {
            Self::Nothing => 1.0,
            Self::Surfaces => neighbourhood::radius_of(shape),
            Self::Fluid => fluid::radius_of(shape),
        }
    }
}

//! The columns that say which shapes points have: semi-axes and rotations, or normals of the
//! surface on which they lie.

use super::roles;
use super::source::Schema;

/// The columns by which points are ellipsoids, if a source has all of them: the lengths of three
/// semi-axes, in any order and unit, for the radius says how large a point is; and the quaternion,
/// of any length, of the rotation that takes x, y and z to their directions.
pub const SHAPE_COLUMNS: [&str; 7] =
    ["semi_axis_1", "semi_axis_2", "semi_axis_3", "rotation_x", "rotation_y", "rotation_z", "rotation_w"];

/// Of points with shapes, a column that may say the radius of each where points are to be round.
pub const ROUND_RADIUS: &str = "round_radius";

/// Where the shapes of a source come from: columns of its schema.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ShapeOrigin {
    /// Those of [`SHAPE_COLUMNS`].
    Axes([usize; SHAPE_COLUMNS.len()]),
    /// Those of a normal of any length, of which either end may be outside.
    Normal([usize; 3]),
}

impl ShapeOrigin {
    /// The same by other numbers of the columns.
    pub(crate) fn map(self, mut column: impl FnMut(usize) -> usize) -> Self {
        match self {
            Self::Axes(columns) => Self::Axes(columns.map(&mut column)),
            Self::Normal(columns) => Self::Normal(columns.map(&mut column)),
        }
    }
}

impl Schema {
    /// The columns of semi-axes and rotations, if there are all of them.
    pub(crate) fn axes_of_shapes(&self) -> Option<ShapeOrigin> {
        let found = SHAPE_COLUMNS.map(|name| self.find(name));
        let all = found.iter().all(Option::is_some).then(|| found.map(Option::unwrap_or_default));
        all.map(ShapeOrigin::Axes)
    }

    /// The columns of the normal of a surface, if there are all three: `nx`, `ny` and `nz`, or
    /// other usual names.
    #[must_use]
    pub fn normals(&self) -> Option<[usize; 3]> {
        let names: Vec<&str> = self.names().collect();
        roles::normals(&names)
    }
}

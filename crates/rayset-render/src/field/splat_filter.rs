//! The low-pass filters that splats are trained with: none is seen smaller than about a pixel.

use super::gaussian_splat::MOST_DEVIATIONS;
use super::sight::Sight;
use rayset_base::geometry::Aabb;
use rayset_base::parse::ParseError;

/// What renderers of splats add to the projection of each, as it was trained.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum SplatFilter {
    /// Nothing.
    #[default]
    None,
    /// 0.3 square pixels, as Kerbl et al. (*3D Gaussian Splatting*, 2023) do.
    Dilated,
    /// 0.1 square pixels, and splats are as much less opaque as their area grows: the mip filter of
    /// Yu et al. (*Mip-Splatting*, 2024).
    Mip,
}

impl SplatFilter {
    /// All filters, in the order of the documentation.
    pub const ALL: &[Self] = &[Self::None, Self::Dilated, Self::Mip];

    /// The name used on the command line and in scene files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Dilated => "3dgs",
            Self::Mip => "mip",
        }
    }

    /// What is added to covariances, in square pixels.
    pub(super) fn variance(self) -> f64 {
        match self {
            Self::None => 0.0,
            Self::Dilated => 0.3,
            Self::Mip => 0.1,
        }
    }

    /// No splat in a box reaches farther by more than this.
    #[must_use]
    pub fn reach_in(self, bounds: &Aabb, sight: &Sight) -> f64 {
        match self {
            Self::None => 0.0,
            _ => MOST_DEVIATIONS * self.variance().sqrt() * sight.largest_pixel_in(bounds) * (1.0 + 1e-5),
        }
    }
}

impl std::fmt::Display for SplatFilter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl std::str::FromStr for SplatFilter {
    type Err = ParseError;

    fn from_str(s: &str) -> Result<Self, Self::Err> {
        let known = Self::ALL.iter().copied().find(|filter| filter.name() == s);
        known.ok_or_else(|| {
            ParseError::new(s, |s| format!("unknown filter `{s}`; expected one of none, 3dgs, mip"))
        })
    }
}

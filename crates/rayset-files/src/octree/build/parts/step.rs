//! The steps of a build in parts.

use std::fmt;
use std::str::FromStr;

use rayset_base::parse::ParseError;

/// A step of a build in parts: all parts of one step are done, in any order or at once, before any
/// of the next begins.
///
/// The steps of spacing are for radii that are measured, and for points of which many seem to be
/// copies of others. Otherwise they have nothing to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[non_exhaustive]
pub enum BuildStep {
    /// Reads and checks a share of the input.
    Read,
    /// Counts the records of a share along the curve, so that its neighbourhoods can be divided.
    SpacingCount,
    /// Distributes the records of a share to the stretches of the curve.
    SpacingScatter,
    /// Sorts a stretch of the curve.
    SpacingSort,
    /// Measures the spacing of the points of a stretch, with those of others near it.
    SpacingMeasure,
    /// Counts the records of a share by octree cells, by which the octree is divided.
    Count,
    /// Distributes the records of a share to the ranges of the octree.
    Scatter,
    /// Sorts a range of the octree, and encodes its points and nodes.
    Order,
}

impl BuildStep {
    /// All steps, in their order.
    pub const ALL: [Self; 8] = [
        Self::Read,
        Self::SpacingCount,
        Self::SpacingScatter,
        Self::SpacingSort,
        Self::SpacingMeasure,
        Self::Count,
        Self::Scatter,
        Self::Order,
    ];

    /// The name: `read`, `spacing-count` and so on.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Read => "read",
            Self::SpacingCount => "spacing-count",
            Self::SpacingScatter => "spacing-scatter",
            Self::SpacingSort => "spacing-sort",
            Self::SpacingMeasure => "spacing-measure",
            Self::Count => "count",
            Self::Scatter => "scatter",
            Self::Order => "order",
        }
    }

    /// Whether the step is for radii that are measured, or for copies.
    #[must_use]
    pub fn is_of_spacing(self) -> bool {
        matches!(self, Self::SpacingCount | Self::SpacingScatter | Self::SpacingSort | Self::SpacingMeasure)
    }

    /// The step whose parts must all be done before this one.
    pub(super) fn before(self, follows_curve: bool) -> Option<Self> {
        let steps = Self::ALL.into_iter().take_while(|step| *step != self);
        steps.filter(|step| follows_curve || !step.is_of_spacing()).last()
    }
}

impl fmt::Display for BuildStep {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for BuildStep {
    type Err = ParseError;

    fn from_str(s: &str) -> Result<Self, Self::Err> {
        Self::ALL.into_iter().find(|step| step.name() == s).ok_or_else(|| {
            ParseError::new(s, |s| {
                let names = Self::ALL.map(Self::name).join(", ");
                format!("unknown step `{s}`; expected one of {names}")
            })
        })
    }
}

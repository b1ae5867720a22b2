//! What voxels hold, by their values.

use super::statistics::percentile;

/// What the reader of OpenVDB says of a level set begins like this.
const LEVEL_SET: &str = "a level set";

/// What voxels hold.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Content {
    /// X-ray absorption in Hounsfield units: air is -1000, water 0.
    Hounsfield,
    /// Distances to a surface, negative inside, in units of the file.
    LevelSet,
    /// Anything else of a body.
    Body,
    /// A field of a simulation or a measurement.
    Field,
    /// Nothing below 0, and values over several orders of magnitude, of which the largest are rare:
    /// densities.
    Density,
    /// As far below 0 as above, most of it near 0: waves, differences.
    Signed,
    /// The same value everywhere.
    Constant,
}

impl Content {
    /// What voxels hold, of a sample of their values in ascending order, what their reader says,
    /// and whether they are of a body.
    pub(super) fn of(sorted: &[f64], sources: &[String], is_body: bool) -> Self {
        let (least, largest) = (percentile(sorted, 0.0), percentile(sorted, 1.0));
        if sources.iter().any(|about| about.starts_with(LEVEL_SET)) {
            Self::LevelSet
        } else if least == largest {
            Self::Constant
        } else if (-9000.0..=-900.0).contains(&least)
            && (600.0..70_000.0).contains(&largest)
            && has_air(sorted)
        {
            Self::Hounsfield
        } else if is_body {
            Self::Body
        } else if is_density(sorted) {
            Self::Density
        } else if is_signed(sorted) {
            Self::Signed
        } else {
            Self::Field
        }
    }
}

/// The values that are not shown.
#[derive(Clone, Copy, Debug)]
pub(super) enum Background {
    /// Up to a value.
    Below(f64),
    /// From a value on.
    Above(f64),
    /// As far from 0 as this, at most; nothing, if it is negative.
    Within(f64),
}

impl Background {
    /// The background of a sample of values in ascending order.
    pub(super) fn of(content: Content, sorted: &[f64]) -> Self {
        match content {
            Content::Hounsfield => Self::Below(-300.0),
            Content::LevelSet => Self::Above(0.0),
            Content::Constant => Self::Within(-1.0),
            Content::Signed => {
                let mut sizes: Vec<f64> = sorted.iter().map(|v| v.abs()).collect();
                sizes.sort_by(f64::total_cmp);
                Self::Within(percentile(&sizes, 0.7))
            }
            Content::Density => {
                let positive = &sorted[sorted.partition_point(|&v| v <= 0.0)..];
                // Where most voxels are empty, those that are not are shown; else those above the
                // median.
                let is_sparse = 2 * positive.len() < sorted.len();
                Self::Below(if is_sparse { 0.0 } else { percentile(positive, 0.5) })
            }
            Content::Body | Content::Field => {
                let mode = mode(sorted);
                let (least, largest) = (percentile(sorted, 0.0), percentile(sorted, 1.0));
                let edge = threshold(sorted, mode);
                let is_low = mode <= percentile(sorted, 0.5).max(0.5 * (least + largest));
                if is_low { Self::Below(edge) } else { Self::Above(edge) }
            }
        }
    }

    pub(super) fn has(self, value: f64) -> bool {
        match self {
            Self::Below(edge) => value <= edge,
            Self::Above(edge) => value >= edge,
            Self::Within(edge) => value.abs() <= edge,
        }
    }
}

impl std::fmt::Display for Background {
    /// What is shown.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Below(edge) => write!(f, "values above {}", number(*edge)),
            Self::Above(edge) => write!(f, "values below {}", number(*edge)),
            Self::Within(edge) => write!(f, "values below -{0} and above {0}", number(*edge)),
        }
    }
}

/// A value as people read it: of very small and very large ones the first digits and a power of
/// ten.
pub(super) fn number(value: f64) -> String {
    let is_plain = value == 0.0 || (1e-3..1e6).contains(&value.abs());
    if is_plain { format!("{value:.4}") } else { format!("{value:.3e}") }
}

/// The part of sorted values from `low` to `high`.
fn part(sorted: &[f64], low: f64, high: f64) -> f64 {
    let below = |end: f64| sorted.partition_point(|&v| v < end) as f64;
    (below(high) - below(low)) / sorted.len().max(1) as f64
}

/// Whether there is air among Hounsfield units: more of it than of what is between air and tissue,
/// of which bodies have little.
fn has_air(sorted: &[f64]) -> bool {
    let air = part(sorted, -1100.0, -900.0);
    air > 0.005 && air > part(sorted, -700.0, -500.0)
}

/// Whether most of what is above 0 is far below the largest values, and these are rare. Pictures of
/// bodies and of things have more of one brightness.
fn is_density(sorted: &[f64]) -> bool {
    let positive = &sorted[sorted.partition_point(|&v| v <= 0.0)..];
    let [half, rare, rarest] = [0.5, 0.99, 0.999].map(|part| percentile(positive, part));
    let has_negative = sorted.first().is_some_and(|&least| least < 0.0);
    !has_negative && positive.len() >= 1000 && rarest > 30.0 * half && rarest > 2.5 * rare
}

/// Whether values lie about 0, as many and as far on one side as on the other.
fn is_signed(sorted: &[f64]) -> bool {
    let [low, quarter, half, upper, high] =
        [0.001, 0.25, 0.5, 0.75, 0.999].map(|part| percentile(sorted, part));
    let reach = high.max(-low);
    low < 0.0
        && high > 0.0
        && (low + high).abs() < 0.3 * reach
        && half.abs() < 0.05 * reach
        && (quarter + upper).abs() < 0.1 * reach
        && upper - quarter < 0.7 * reach
}

/// The middle of the most frequent of 256 ranges of values.
fn mode(sorted: &[f64]) -> f64 {
    let (low, high) = (percentile(sorted, 0.001), percentile(sorted, 0.999));
    if !(high > low) {
        return low;
    }
    let mut counts = [0_u32; 256];
    for v in sorted {
        let place = ((v - low) / (high - low) * 256.0).clamp(0.0, 255.0);
        counts[place as usize] += 1;
    }
    let most = (0..256).max_by_key(|&i| counts[i]).unwrap_or(0);
    low + (most as f64 + 0.5) / 256.0 * (high - low)
}

/// The value that parts the background from the rest: Otsu's (1979), which makes both parts as
/// uniform as possible, moved toward the background, so that faint tissue shows.
fn threshold(sorted: &[f64], mode: f64) -> f64 {
    let (n, total): (f64, f64) = (sorted.len() as f64, sorted.iter().sum());
    let (mut below, mut best) = (0.0, (0.0, mode));
    for (i, v) in sorted.iter().enumerate().take(sorted.len().saturating_sub(1)) {
        below += v;
        let (weight, rest) = ((i + 1) as f64, n - (i + 1) as f64);
        let difference = below / weight - (total - below) / rest;
        let between = weight * rest * difference * difference;
        if between > best.0 && sorted[i + 1] > *v {
            best = (between, *v);
        }
    }
    mode + 0.6 * (best.1 - mode)
}

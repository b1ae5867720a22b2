//! Which octree node comes next: Algorithm 1 of the paper and its variants.
//!
//! The prose of section 4.3 and the printed listing disagree in two places. By the prose, a sample
//! on the line of the last two tries again where the last attempt did not succeed, one off the line
//! starts a new line from the last two samples, and the last two are renewed at each access. As
//! printed, an attempt is made only *off* the line, and the two samples are renewed only while they
//! are not yet set.

use std::fmt;
use std::str::FromStr;

use rayset::geometry::DVec3;

/// A way to predict.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub enum Variant {
    /// Not at all.
    None,
    /// By the prose.
    Line,
    /// By the listing.
    LineAsPrinted,
    /// By the prose, and the place where a ray starts counts as its first sample: the extension
    /// that the paper describes.
    LineOrigins,
}

impl Variant {
    /// Every variant.
    pub const ALL: [Self; 4] = [Self::None, Self::Line, Self::LineAsPrinted, Self::LineOrigins];
}

impl fmt::Display for Variant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::None => "none",
            Self::Line => "line",
            Self::LineAsPrinted => "line-as-printed",
            Self::LineOrigins => "line+origins",
        })
    }
}

impl FromStr for Variant {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let known = Self::ALL.into_iter().find(|v| v.to_string() == text);
        known.ok_or_else(|| format!("`{text}`: expected none, line, line-as-printed or line+origins"))
    }
}

/// How a ray tracer looks ahead.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Foresight {
    /// Which way.
    pub variant: Variant,
    /// Leaves that an attempt is to bring in, one behind the other.
    pub depth: u32,
}

impl From<Variant> for Foresight {
    /// The paper's: the next leaf.
    fn from(variant: Variant) -> Self {
        Self { variant, depth: 1 }
    }
}

/// Sines of angles below this are none.
const STRAIGHT: f64 = 1e-6;

/// What is known of past samples.
#[derive(Clone, Debug)]
pub struct Predictor {
    variant: Variant,
    /// s₁ and s₂, the last two samples.
    last: [Option<DVec3>; 2],
    /// c: whether the next cell is cached, for the leaf below.
    cached: bool,
    leaf: Option<u64>,
    /// Where the current ray starts.
    origin: Option<DVec3>,
    /// The sample before, whatever the variant remembers of it.
    previous: Option<DVec3>,
    /// Least distance between samples that follow each other: that of a ray's samples.
    spacing: f64,
}

impl Predictor {
    /// Without any past.
    #[must_use]
    pub fn new(variant: Variant) -> Self {
        Self {
            variant,
            last: [None; 2],
            cached: false,
            leaf: None,
            origin: None,
            previous: None,
            spacing: f64::INFINITY,
        }
    }

    /// A ray starts. Only [`Variant::LineOrigins`] takes note.
    pub fn ray(&mut self, origin: DVec3) {
        if self.variant == Variant::LineOrigins {
            self.origin = Some(origin);
        }
    }

    /// A sample was taken in a leaf. Returns the way from it to the sample that is expected next,
    /// where an attempt is to be made to bring in what comes behind the leaf.
    pub fn access(&mut self, s: DVec3, leaf: u64) -> Option<DVec3> {
        if self.leaf != Some(leaf) {
            (self.leaf, self.cached) = (Some(leaf), false);
        }
        if let Some(previous) = self.previous.replace(s)
            && previous != s
        {
            self.spacing = self.spacing.min(previous.distance(s));
        }
        let attempt = match (self.variant, self.last) {
            (Variant::None, _) => return None,
            (Variant::LineAsPrinted, [Some(s1), Some(s2)]) => {
                return (!on_line(s1, s2, s)).then(|| self.paced(s - s2)).flatten();
            }
            (Variant::LineAsPrinted, _) => {
                self.cached = false;
                None
            }
            (_, [Some(s1), Some(s2)]) if on_line(s1, s2, s) => (!self.cached).then_some(s - s2),
            (Variant::Line, [_, Some(s2)]) => {
                self.cached = false;
                // From the last two samples.
                Some(s - s2)
            }
            (Variant::LineOrigins, [_, last]) => {
                self.cached = false;
                self.origin.or(last).map(|from| s - from)
            }
            (Variant::Line, [_, None]) => None,
        };
        self.last = [self.last[1], Some(s)];
        attempt.and_then(|way| self.paced(way))
    }

    /// A way as long as from one sample to the next.
    fn paced(&self, way: DVec3) -> Option<DVec3> {
        let length = if self.spacing.is_finite() { self.spacing } else { way.length() };
        way.try_normalize().map(|way| way * length)
    }

    /// What came of the attempt.
    pub fn attempted(&mut self, cached: bool) {
        self.cached = cached;
    }
}

/// Regular accesses of an array: what the point controller predicts while points are streamed in to
/// be processed.
#[derive(Clone, Debug, Default)]
pub struct Regular {
    last: Option<u64>,
    stride: Option<i64>,
    /// Accesses to come that have been asked for.
    asked: u64,
}

impl Regular {
    /// Accesses that it looks ahead.
    pub const AHEAD: u64 = 4096;

    /// A record was used. Returns those to ask for: where three in a row are as far apart from each
    /// other, those that follow as regularly, half of [`AHEAD`](Self::AHEAD) at a time.
    pub fn access(&mut self, record: u64) -> Vec<u64> {
        let stride = self.last.replace(record).map(|last| record.wrapping_sub(last) as i64);
        let is_regular = stride.is_some() && stride == self.stride && stride != Some(0);
        self.stride = stride;
        let Some(stride) = stride.filter(|_| is_regular) else {
            self.asked = 0;
            return Vec::new();
        };
        self.asked = self.asked.saturating_sub(1);
        if self.asked > Self::AHEAD / 2 {
            return Vec::new();
        }
        let from = self.asked;
        self.asked += Self::AHEAD / 2;
        let at = |step: u64| record.checked_add_signed(stride.checked_mul(step as i64)?);
        (from + 1..=self.asked).map_while(at).collect()
    }
}

/// Whether a third sample goes on the way of two.
fn on_line(s1: DVec3, s2: DVec3, s: DVec3) -> bool {
    let (before, after) = (s2 - s1, s - s2);
    let product = before.length() * after.length();
    product > 0.0 && before.dot(after) > 0.0 && before.cross(after).length() <= STRAIGHT * product
}

#[cfg(test)]
mod tests {
    use super::*;

    fn attempts(variant: Variant, samples: &[(f64, u64)], cached_after: usize) -> Vec<bool> {
        let mut predictor = Predictor::new(variant);
        predictor.ray(DVec3::ZERO);
        let mut made = 0;
        let of = |&(x, leaf): &(f64, u64)| {
            let attempt = predictor.access(DVec3::new(x, 1.0, 0.0), leaf).is_some();
            if attempt {
                made += 1;
                predictor.attempted(made >= cached_after);
            }
            attempt
        };
        samples.iter().map(of).collect()
    }

    const STRAIGHT_ON: [(f64, u64); 6] = [(0.0, 1), (1.0, 1), (2.0, 1), (3.0, 1), (4.0, 1), (5.0, 2)];

    #[test]
    fn on_the_line_the_prose_tries_until_the_next_cell_is_cached_and_again_in_the_next_leaf() {
        assert_eq!(attempts(Variant::Line, &STRAIGHT_ON, 3), [false, true, true, true, false, true]);
    }

    #[test]
    fn the_printed_listing_never_tries_on_the_line() {
        assert_eq!(attempts(Variant::LineAsPrinted, &STRAIGHT_ON, 3), [false; 6]);
    }

    #[test]
    fn nothing_is_predicted_where_nothing_is_asked() {
        assert_eq!(attempts(Variant::None, &STRAIGHT_ON, 1), [false; 6]);
    }

    #[test]
    fn with_origins_the_first_sample_of_a_second_ray_is_enough() {
        let mut predictor = Predictor::new(Variant::LineOrigins);
        let origin = DVec3::new(0.0, 0.0, -5.0);
        predictor.ray(origin);
        for z in 0..4 {
            predictor.access(DVec3::new(0.0, 0.0, f64::from(z)), 1);
        }
        predictor.ray(origin);
        let s = DVec3::new(1.0, 0.0, 0.0);
        let way = predictor.access(s, 2).expect("an attempt");
        assert!((way - (s - origin).normalize()).length() < 1e-12, "{way}");
    }

    #[test]
    fn regular_accesses_are_predicted_once_each_and_irregular_ones_are_not() {
        for stride in [1_i64, 3, -2] {
            let mut predictor = Regular::default();
            let start = 20_000_u64;
            let mut asked = std::collections::HashSet::new();
            for i in 0..6000_i64 {
                let record = start.saturating_add_signed(stride * i);
                assert!(i < 3 || asked.contains(&record), "{record} was not foreseen");
                for record in predictor.access(record) {
                    assert!(asked.insert(record), "{record} twice");
                }
            }
        }
        let mut predictor = Regular::default();
        assert!([5, 9, 2, 7, 30, 31, 33].into_iter().all(|record| predictor.access(record).is_empty()));
    }
}

//! Which radii are usual in a cloud, from counts of the radii that were measured.

use super::error::{BuildError, Quantity};
use super::neighbourhood::OfPlace;
use super::shapes_of::ShapesOf;
use super::survey::{LIMIT, Survey};
use crate::octree::shape::StoredShape;

/// Counts of the radii of places: 128 for each power of two.
pub(super) struct Measured {
    counts: Vec<u64>,
    known: u64,
    unknown: u64,
    /// Those of them that are of a surface or a wire.
    flat: u64,
    least: f64,
    most: f64,
}

/// Bits of an `f32` that a count leaves out.
const LEFT_OUT: u32 = 16;

impl Default for Measured {
    fn default() -> Self {
        let counts = vec![0; 1 << (31 - LEFT_OUT)];
        Self { counts, known: 0, unknown: 0, flat: 0, least: f64::INFINITY, most: 0.0 }
    }
}

impl Measured {
    /// Counts some places, before what was measured of them is stored.
    pub(super) fn count(&mut self, place: &OfPlace, places: u64) {
        let OfPlace { radius, suggested } = *place;
        self.flat += if suggested.is_flat { places } else { 0 };
        if radius > 0.0 {
            self.known += places;
            (self.least, self.most) = (self.least.min(radius), self.most.max(radius));
            let stored = radius.clamp(1.0 / LIMIT, LIMIT) as f32;
            self.counts[(stored.to_bits() >> LEFT_OUT) as usize] += places;
        } else {
            self.unknown += places;
        }
    }

    /// An error if a radius cannot be stored.
    pub(super) fn check_range(&self, length_scale: f64, survey: &Survey) -> Result<(), BuildError> {
        for (quantity, farthest) in [(Quantity::SmallRadius, self.least), (Quantity::Radius, self.most)] {
            let out = if quantity == Quantity::Radius { farthest > LIMIT } else { farthest < 1.0 / LIMIT };
            if self.known > 0 && out {
                let (count, records) = (self.known, survey.count);
                let factor = quantity.factor(farthest, length_scale);
                return Err(BuildError::OutOfRange { quantity, count, records, farthest, factor });
            }
        }
        Ok(())
    }

    /// Whether the points lie on surfaces, so far as shapes were asked for: else none has a shape,
    /// for in a cloud that fills space all are scattered. So many of them have `normals`.
    pub(super) fn has_surfaces(&self, normals: u64) -> bool {
        let flat = self.flat.max(normals);
        flat > 0 && flat as f64 >= LEAST_FLAT * (self.known + self.unknown) as f64
    }

    /// The radius than which a part of all radii is smaller, rounded down to the beginning of its
    /// count.
    fn quantile(&self, part: f64) -> f64 {
        let mut before = (part * self.known as f64) as u64;
        let at = self.counts.iter().position(|&count| {
            let found = before < count;
            before = before.saturating_sub(count);
            found
        });
        f64::from(f32::from_bits((at.unwrap_or(0) as u32) << LEFT_OUT))
    }

    /// What is usual in a cloud.
    pub(super) fn typical(&self, survey: &Survey) -> Typical {
        self.usual().unwrap_or_else(|| Typical::alone(self.fallback(survey)))
    }

    /// The range of the radii if all of them stay as they are.
    pub(super) fn unchanged(&self, typical: &Typical) -> Option<(f32, f32)> {
        let (least, most) = (self.least as f32, self.most as f32);
        (self.unknown == 0 && most <= typical.limit).then_some((least, most))
    }

    /// Includes the counts of other radii.
    #[cfg(feature = "parts")]
    pub(super) fn merge(&mut self, other: &Self) {
        self.known += other.known;
        self.unknown += other.unknown;
        self.flat += other.flat;
        (self.least, self.most) = (self.least.min(other.least), self.most.max(other.most));
        self.counts.iter_mut().zip(&other.counts).for_each(|(count, more)| *count += more);
    }

    /// All of it, as numbers.
    #[cfg(feature = "parts")]
    pub(super) fn to_words(&self) -> Vec<u64> {
        let mut words = vec![self.known, self.unknown, self.flat, self.least.to_bits(), self.most.to_bits()];
        words.extend_from_slice(&self.counts);
        words
    }

    /// From the numbers of [`to_words`](Self::to_words); `None` if there are not as many.
    #[cfg(feature = "parts")]
    pub(super) fn from_words(words: &[u64]) -> Option<Self> {
        let (&[known, unknown, flat, least, most], counts) = words.split_first_chunk()?;
        let counts = counts.to_vec();
        let (least, most) = (f64::from_bits(least), f64::from_bits(most));
        (counts.len() == Self::default().counts.len()).then_some(Self {
            counts,
            known,
            unknown,
            flat,
            least,
            most,
        })
    }

    /// `None` if no radius is known.
    fn usual(&self) -> Option<Typical> {
        let [lower, median, upper] = [0.25, 0.5, 0.75].map(|part| self.quantile(part));
        let spread = upper / lower;
        let limit = (upper * spread * spread.sqrt()).max(LEAST_LIMIT * median);
        (self.known > 0).then_some(Typical { radius: median as f32, limit: limit.min(LIMIT) as f32 })
    }

    /// The radius for a cloud that is too small or too degenerate to measure: from the spacing of a
    /// surface of its extent, so that neighbours touch but do not hide each other, or 1.
    fn fallback(&self, survey: &Survey) -> f64 {
        let (extent, places) = (survey.bounds.size().max_element(), self.known + self.unknown);
        let spacing = extent / (places as f64).sqrt().max(1.0);
        let radius = if spacing > 0.0 && spacing.is_finite() { 0.75 * spacing } else { 1.0 };
        radius * survey.auto_scale
    }
}

/// Where fewer places are flat, a cloud has no surfaces: of points at random in space, one in a
/// hundred is.
const LEAST_FLAT: f64 = 0.1;

/// The limit is at least this multiple of the median: clouds that are sampled evenly have sparse
/// edges, too.
const LEAST_LIMIT: f64 = 3.0;

/// What radii are usual in a cloud.
///
/// With quartiles Q₁ and Q₃ of the radii, those beyond Q₃ (Q₃/Q₁)^1.5, and beyond three times the
/// median, belong to stray points. In logarithms this is the customary fence of 1.5 times the
/// interquartile range, so a scan whose spacing varies widely has a wide limit.
pub(super) struct Typical {
    radius: f32,
    limit: f32,
}

impl Typical {
    /// The radius of a record of which this was measured: 0 if none is known.
    pub(super) fn settled(&self, measured: f32) -> f32 {
        if measured <= 0.0 || measured > self.limit { self.radius } else { measured }
    }

    /// The radius and the shape of a record of which these were measured. Stray points are balls.
    pub(super) fn settled_with_shape(
        &self,
        measured: f32,
        shape: StoredShape,
        shapes_of: ShapesOf,
    ) -> (f32, StoredShape) {
        let radius = self.settled(measured);
        if radius != measured {
            return (radius, StoredShape::BALL);
        }
        let radius = f64::from(radius) * shapes_of.radius_of(shape);
        (radius.clamp(1.0 / LIMIT, LIMIT) as f32, shape)
    }

    fn alone(radius: f64) -> Self {
        Self { radius: radius.clamp(1.0 / LIMIT, LIMIT) as f32, limit: LIMIT as f32 }
    }
}

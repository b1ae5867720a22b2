//! The knot of a piecewise linear function that a value follows, found exactly and without a
//! search, however the knots are spaced.

use rayset_base::bytes::list_bytes;

/// Places of an index: several times the number of knots of most functions.
const MOST_PLACES: u32 = 1024;
/// Fewest places.
const FEWEST_PLACES: u32 = 16;
/// Of so many knots in a place each is compared with a value: a search would take branches, which
/// nothing could foresee.
const FEW: usize = 4;

/// Ascending knots, indexed.
pub(super) struct Knots {
    /// For each knot, the least value that is not before it, ascending; and [`FEW`] NaNs.
    from: Vec<f32>,
    /// For each place, the first knot that is not before it; and one final entry.
    index: Vec<u32>,
    places: Places,
    /// Whether no place holds more than [`FEW`] knots.
    has_few: bool,
}

/// How values are divided among the places of an index. Places never descend as values ascend.
#[derive(Clone, Copy)]
enum Places {
    /// Evenly, as the knots of most functions are.
    Even { low: f32, per_value: f32, last: u32 },
    /// As many to each doubling of the value, as the knots of logarithmic maps are: by the first
    /// bits of values that are above 0.
    ByOctave { low_bits: u32, shift: u32, last: u32 },
}

impl Places {
    /// For values from `low` to `high`.
    fn even(low: f64, high: f64, last: u32) -> Self {
        Self::Even { low: low as f32, per_value: (f64::from(last) / (high - low)) as f32, last }
    }

    /// The same; `None` if not all of them are above 0.
    fn by_octave(low: f64, high: f64, last: u32) -> Option<Self> {
        let (low_bits, high_bits) = ((low as f32).to_bits(), (high as f32).to_bits());
        let is_positive = low as f32 > 0.0 && high_bits > low_bits;
        let shift = (high_bits.checked_sub(low_bits)? / last + 1).next_power_of_two().ilog2();
        is_positive.then_some(Self::ByOctave { low_bits, shift, last })
    }

    /// The place of a value.
    #[inline(always)]
    fn of(self, value: f32) -> u32 {
        match self {
            // NaN becomes 0.
            Self::Even { low, per_value, last } => {
                ((value - low) * per_value).max(0.0).min(last as f32) as i32 as u32
            }
            Self::ByOctave { low_bits, shift, last } => {
                (value.max(0.0).to_bits().saturating_sub(low_bits) >> shift).min(last)
            }
        }
    }

    /// For each place, the first of some ascending values that is not before it; and one final
    /// entry.
    fn index(self, from: &[f32]) -> Vec<u32> {
        let (Self::Even { last, .. } | Self::ByOctave { last, .. }) = self;
        let mut knot = 0;
        let firsts = (0..=last).map(|number| {
            while from.get(knot).is_some_and(|&from| self.of(from) < number) {
                knot += 1;
            }
            knot as u32
        });
        let mut index: Vec<u32> = firsts.collect();
        index.push(from.len() as u32);
        index
    }
}

impl Knots {
    /// For each knot, the least value that is not before it, ascending; most values are from `low`
    /// to `high`.
    pub(super) fn new(from: Vec<f32>, low: f64, high: f64) -> Self {
        let last = (4 * from.len() as u32).next_power_of_two().clamp(FEWEST_PLACES, MOST_PLACES);
        let even = Places::even(low, high, last);
        let (mut places, mut index) = (even, even.index(&from));
        if let Some(by_octave) = Places::by_octave(low, high, last) {
            let other = by_octave.index(&from);
            if most_in_place(&other) < most_in_place(&index) {
                (places, index) = (by_octave, other);
            }
        }
        let has_few = most_in_place(&index) <= FEW as u32;
        let from = from.into_iter().chain([f32::NAN; FEW]).collect();
        Self { from, index, places, has_few }
    }

    /// Bytes of its lists.
    pub(super) fn bytes(&self) -> usize {
        list_bytes(&self.from) + list_bytes(&self.index)
    }

    /// The number of knots that are not above a value.
    #[inline(always)]
    pub(super) fn not_above(&self, value: f32) -> usize {
        let place = self.places.of(value) as usize;
        // Knots before `first` are not above the value; those from `end` on are.
        let (mut first, mut end) = (self.index[place] as usize, self.index[place + 1] as usize);
        if self.has_few {
            let [a, b, c, d] = std::array::from_fn(|i| u32::from(self.from[first + i] <= value));
            return first + (a + b + c + d) as usize;
        }
        while first < end {
            let middle = (first + end) / 2;
            if self.from[middle] <= value { first = middle + 1 } else { end = middle }
        }
        first
    }

    /// The most knots between which a search has to decide.
    #[cfg(test)]
    pub(super) fn most_in_place(&self) -> u32 {
        most_in_place(&self.index)
    }
}

/// The most knots of one place.
fn most_in_place(index: &[u32]) -> u32 {
    index.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap_or(0)
}

/// The least value whose place is at least `at`, for places that never descend as values ascend.
pub(super) fn least_value(at: f64, place: impl Fn(f32) -> f64) -> f32 {
    // Floating-point numbers in ascending order: negative ones from the largest bit pattern to the
    // smallest, then the others.
    let number = |order: u32| f32::from_bits(if order >> 31 == 1 { order & 0x7fff_ffff } else { !order });
    let (mut low, mut high) = (0x007f_ffff_u32, 0xff80_0000_u32);
    while low < high {
        let middle = low + (high - low) / 2;
        if place(number(middle)) >= at { high = middle } else { low = middle + 1 }
    }
    number(low)
}

/// A curve, prepared for values in single precision: piecewise linear, constant beyond the ends. If
/// several points share one place, the last applies at it. What it is at a value is what
/// [`curve_at`](crate::scene::curve_at) says, bit for bit.
pub(super) struct Curve {
    points: Vec<(f64, f64)>,
    knots: Knots,
    /// It is 0 at all values up to this one, which most samples of a cloud have.
    zero_until: f32,
}

impl Curve {
    /// Through (value, height) pairs in ascending order of values.
    pub(super) fn new(points: &[(f64, f64)]) -> Self {
        let from = points.iter().map(|&(at, _)| least_value(at, f64::from)).collect();
        let ends = (points.first().map_or(0.0, |p| p.0), points.last().map_or(1.0, |p| p.0));
        let zeros = points.iter().take_while(|p| p.1 == 0.0).count();
        let zero_until = match zeros.checked_sub(1) {
            None => f32::NEG_INFINITY,
            Some(_) if zeros == points.len() => f32::INFINITY,
            // At the place itself a step may have risen.
            Some(last) => (points[last].0 as f32).next_down().next_down(),
        };
        Self { points: points.to_vec(), knots: Knots::new(from, ends.0, ends.1), zero_until }
    }

    /// Bytes of its lists.
    pub(super) fn bytes(&self) -> usize {
        list_bytes(&self.points) + self.knots.bytes()
    }

    /// It is 0 at all values up to this one.
    pub(super) fn zero_until(&self) -> f32 {
        self.zero_until
    }

    /// Its height at a value that is not NaN.
    #[inline(always)]
    pub(super) fn at(&self, value: f32) -> f64 {
        if value <= self.zero_until {
            return 0.0;
        }
        let above = self.knots.not_above(value);
        match (above.checked_sub(1).map(|i| self.points[i]), self.points.get(above)) {
            (None, Some(&(_, o))) | (Some((_, o)), None) => o,
            (Some((d0, o0)), Some(&(d1, o1))) => o0 + (o1 - o0) * (f64::from(value) - d0) / (d1 - d0),
            (None, None) => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::curve_at;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_curve_is_what_its_definition_says_bit_for_bit(
            places in prop::collection::vec(0_u32..60, 1..40),
            heights in prop::collection::vec(prop_oneof![1 => Just(0.0), 2 => 0.0_f64..=1.0], 40),
            (low, ratio) in prop::sample::select(vec![(0.0, 1.0), (1e-12, 2.0), (-3.0, 1.0), (1e-3, 1.1)]),
            values in prop::collection::vec(-0.2_f64..1.2, 64),
        ) {
            let mut places = places;
            places.sort_unstable();
            let at = |place: u32| if ratio > 1.0 { low * f64::powi(ratio, place as i32) } else { low + f64::from(place) };
            let points: Vec<(f64, f64)> = places.iter().map(|&p| at(p)).zip(heights).collect();
            let curve = Curve::new(&points);
            let (first, last) = (points[0].0, points[points.len() - 1].0);
            let anywhere = values.iter().map(|v| first + v * (last - first));
            for value in anywhere.chain(points.iter().map(|p| p.0)).map(|v| v as f32) {
                for value in [value.next_down(), value, value.next_up()] {
                    prop_assert_eq!(curve.at(value).to_bits(), curve_at(&points, f64::from(value)).to_bits());
                }
            }
        }
    }
}

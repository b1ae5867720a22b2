//! How the mass of a cell's points is distributed over densities: what a transfer function makes of
//! it, whatever that is.
//!
//! Densities are counted in half octaves. A record has twelve bins of half an octave, one, two or
//! four: of the finest width of which hardly any mass lies below the last bin, which holds all that
//! does. Small fractions matter where a transfer function shows low densities alone, which take the
//! most space: so fractions are stored by their square roots.

use super::scale::{exponent_and_mantissa, power_of_two};

/// Bins of a record.
pub const BINS: usize = 12;
/// Most of the mass that may lie in the last bin, if wider ones could tell it apart.
const MOST_IN_LAST: f64 = 0.005;

/// Masses by density: the half octave of the first, and the masses of the following.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Masses {
    first: i32,
    masses: Vec<f64>,
}

/// The half octave of a density above 0: 2·log₂, rounded down.
pub(super) fn half_octave(density: f64) -> Option<i32> {
    (density >= f64::MIN_POSITIVE && density.is_finite()).then(|| {
        let (exponent, mantissa) = exponent_and_mantissa(density);
        2 * exponent + i32::from(mantissa >= std::f64::consts::SQRT_2)
    })
}

impl Masses {
    /// Whether no mass has been added.
    pub(super) fn is_empty(&self) -> bool {
        self.masses.is_empty()
    }

    /// Adds mass in a half octave.
    pub(super) fn add(&mut self, half_octave: i32, mass: f64) {
        self.reach(half_octave);
        self.masses[(half_octave - self.first) as usize] += mass;
    }

    /// Adds what another has.
    pub(super) fn merge(&mut self, other: &Self) {
        for (at, &mass) in (other.first..).zip(&other.masses) {
            if mass > 0.0 {
                self.add(at, mass);
            }
        }
    }

    fn reach(&mut self, half_octave: i32) {
        if self.masses.is_empty() {
            self.first = half_octave;
        }
        if half_octave < self.first {
            let more = (self.first - half_octave) as usize;
            self.masses.splice(0..0, std::iter::repeat_n(0.0, more));
            self.first = half_octave;
        }
        let needed = (half_octave - self.first) as usize + 1;
        if needed > self.masses.len() {
            self.masses.resize(needed, 0.0);
        }
    }

    /// The bins of a record; `None` if there is no mass.
    pub(super) fn bins(&self) -> Option<DensityBins> {
        let total: f64 = self.masses.iter().sum();
        if !(total > 0.0 && total.is_finite()) {
            return None;
        }
        Width::ALL.into_iter().find_map(|width| {
            let (top, masses) = self.of_width(width);
            let fits = masses[BINS - 1] < MOST_IN_LAST * total || width == Width::FourOctaves;
            fits.then(|| DensityBins { width, top, roots: roots(masses.map(|mass| mass / total)) })
        })
    }

    /// The number of the highest bin of a width, and the masses from that one down.
    fn of_width(&self, width: Width) -> (i16, [f64; BINS]) {
        let highest = self.masses.iter().rposition(|&mass| mass > 0.0).unwrap_or(0) as i32 + self.first;
        let top = highest >> width.code();
        let mut masses = [0.0; BINS];
        for (at, mass) in (self.first..).zip(&self.masses) {
            let below = (top - (at >> width.code())).clamp(0, BINS as i32 - 1);
            masses[below as usize] += mass;
        }
        (top as i16, masses)
    }
}

/// The square roots of fractions, in parts of the largest.
fn roots(fractions: [f64; BINS]) -> [u8; BINS] {
    let largest = fractions.into_iter().fold(0.0, f64::max);
    fractions.map(|fraction| ((fraction / largest).sqrt() * 255.0).round() as u8)
}

/// The width of bins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Width {
    /// Half an octave.
    HalfOctave,
    /// One octave.
    Octave,
    /// Two octaves.
    TwoOctaves,
    /// Four octaves.
    FourOctaves,
}

impl Width {
    const ALL: [Self; 4] = [Self::HalfOctave, Self::Octave, Self::TwoOctaves, Self::FourOctaves];

    pub(super) fn code(self) -> u8 {
        self as u8
    }

    pub(super) fn of_code(code: u8) -> Self {
        Self::ALL[usize::from(code & 3)]
    }

    /// In half octaves.
    #[must_use]
    pub fn half_octaves(self) -> i32 {
        1 << self.code()
    }
}

/// The bins of a record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DensityBins {
    /// Their width.
    pub width: Width,
    /// The number of the first, of the highest densities: bin n is from 2^(n·w/2) to
    /// 2^((n + 1)·w/2), with w half octaves.
    pub top: i16,
    /// The square roots of the fractions of the mass whose densities lie in each, in parts of 255
    /// of the largest, from the highest densities down; the last bin also has what lies below it.
    pub roots: [u8; BINS],
}

impl DensityBins {
    /// The fractions of the mass, which sum to one; none if all roots are 0.
    #[must_use]
    #[inline]
    pub fn fractions(&self) -> [f64; BINS] {
        let squares = self.roots.map(|root| f64::from(u32::from(root) * u32::from(root)));
        let sum: f64 = squares.iter().sum();
        squares.map(|square| square / sum)
    }

    /// The lower bound of a bin's densities.
    #[must_use]
    pub fn lower_bound(&self, bin: usize) -> f64 {
        let half_octaves = (i32::from(self.top) - bin as i32) * self.width.half_octaves();
        let octaves = power_of_two((half_octaves >> 1).clamp(-1022, 1023));
        if half_octaves & 1 == 0 { octaves } else { octaves * std::f64::consts::SQRT_2 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn bins_hold_the_masses_to_a_part_of_each(
            of in prop::collection::vec((-60..60_i32, 0.001..1.0_f64), 1..40),
        ) {
            let mut masses = Masses::default();
            of.iter().for_each(|&(half_octave, mass)| masses.add(half_octave, mass));
            let bins = masses.bins().unwrap();
            let fractions = bins.fractions();
            prop_assert!((fractions.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            let total: f64 = of.iter().map(|(_, mass)| mass).sum();
            for bin in 0..BINS - 1 {
                let from = bins.lower_bound(bin);
                let to = from * 0.5 * f64::from(bins.width.half_octaves()).exp2().sqrt() * 2.0;
                let middle = |half_octave: i32| ((f64::from(half_octave) + 0.5) * 0.5).exp2();
                let within: f64 = of.iter().filter(|(at, _)| (from..to).contains(&middle(*at))).map(|(_, m)| m).sum();
                let (is, was) = (fractions[bin], within / total);
                prop_assert!((is - was).abs() <= 0.01 * was + 0.005 * was.sqrt() + 1e-5, "bin {bin}: {is} and {was}");
            }
        }

        #[test]
        fn merged_masses_are_those_of_all(
            first in prop::collection::vec((-60..60_i32, 0.01..1.0_f64), 0..10),
            second in prop::collection::vec((-60..60_i32, 0.01..1.0_f64), 1..10),
        ) {
            let (mut a, mut b, mut all) = (Masses::default(), Masses::default(), Masses::default());
            first.iter().for_each(|&(at, mass)| { a.add(at, mass); all.add(at, mass); });
            second.iter().for_each(|&(at, mass)| b.add(at, mass));
            second.iter().for_each(|&(at, mass)| all.add(at, mass));
            a.merge(&b);
            let (a, all) = (a.bins().unwrap(), all.bins().unwrap());
            prop_assert_eq!((a.top, a.width), (all.top, all.width));
            prop_assert!(a.roots.iter().zip(all.roots).all(|(a, b)| a.abs_diff(b) <= 1));
        }
    }

    #[test]
    fn half_octaves_begin_at_powers_of_the_root_of_two() {
        let root = std::f64::consts::SQRT_2;
        assert_eq!(
            [1.0, 1.41, root, 1.99, 2.0, 0.5, 0.7].map(half_octave).map(Option::unwrap),
            [0, 0, 1, 1, 2, -2, -2]
        );
        assert_eq!([0.0, -1.0, f64::NAN, f64::INFINITY].map(half_octave), [None; 4]);
        assert_eq!(Masses::default().bins(), None);
    }

    #[test]
    fn one_density_is_one_full_bin_of_half_an_octave() {
        let mut masses = Masses::default();
        masses.add(-7, 3.0);
        let bins = masses.bins().unwrap();
        let mut full = [0; BINS];
        full[0] = 255;
        assert_eq!((bins.width, bins.top, bins.roots), (Width::HalfOctave, -7, full));
        assert_eq!(bins.fractions()[..2], [1.0, 0.0]);
        assert_eq!((bins.lower_bound(0), bins.lower_bound(1)), (0.5_f64.powf(3.5), 0.5_f64.powi(4)));
    }
}

//! The coefficients of the spherical harmonics of a Gaussian, by which its colour changes with the
//! direction from which it is seen.

use crate::points::{ColumnInfo, ColumnType, HARMONIC, HARMONIC_CONSTANTS};
use rayset_files::points::harmonics::{CHANNELS, CONSTANT, MOST_COEFFICIENTS, MOST_DEGREE, coefficients};

/// Most coefficients besides the constant ones.
pub(super) const MOST_REST: usize = CHANNELS * (MOST_COEFFICIENTS - 1);

/// The coefficients of a Gaussian.
#[derive(Clone, Copy, Debug)]
pub(super) struct Harmonics {
    /// Of the constant harmonic, for each channel.
    pub(super) constant: [f64; CHANNELS],
    /// The others: first those of red, then of green and blue.
    pub(super) rest: [f32; MOST_REST],
}

impl Harmonics {
    pub(super) const NONE: Self = Self { constant: [0.0; CHANNELS], rest: [0.0; MOST_REST] };

    /// Those of which a colour from 0 to 1 is the constant part.
    pub(super) fn of_color(color: [f64; CHANNELS]) -> Self {
        Self { constant: color.map(|v| (v - 0.5) / CONSTANT), ..Self::NONE }
    }

    /// The value in column `index` of [`columns`].
    pub(super) fn value(&self, index: usize) -> f64 {
        match index.checked_sub(CHANNELS) {
            None => self.constant[index],
            Some(rest) => self.rest[rest].into(),
        }
    }
}

/// Coefficients of all channels besides the constant ones.
pub(super) const fn rest(degree: u8) -> usize {
    CHANNELS * (coefficients(degree) - 1)
}

/// The degree of a file with so many coefficients a channel besides the constant one, of which no
/// more than [`MOST_DEGREE`] is kept.
pub(super) fn degree(coefficients_of_channel: usize) -> u8 {
    (0..=MOST_DEGREE).rev().find(|degree| coefficients(*degree) <= coefficients_of_channel + 1).unwrap_or(0)
}

/// The columns of coefficients: none of degree 0, which is the colour.
pub(super) fn columns(degree: u8) -> impl Iterator<Item = ColumnInfo> {
    let names = HARMONIC_CONSTANTS.into_iter().map(str::to_owned);
    let names = names.chain((0..rest(degree)).map(|i| format!("{HARMONIC}{i}")));
    names.filter(move |_| degree > 0).map(|name| ColumnInfo::new(name, ColumnType::F32))
}

/// What to say of coefficients that are not read.
pub(super) fn left_out(degree: u8) -> String {
    format!("Of the harmonics of colours, those beyond degree {degree} are left out")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_degree_is_that_of_the_coefficients_that_are_all_there() {
        let expected = [(0, 0), (2, 0), (3, 1), (7, 1), (8, 2), (14, 2), (15, 3), (24, 3), (1000, 3)];
        for (coefficients, of) in expected {
            assert_eq!(degree(coefficients), of, "{coefficients}");
        }
        assert_eq!([0, 1, 2, 3].map(|degree| columns(degree).count()), [0, 12, 27, 48]);
    }
}

//! The columns of colours that change with the direction from which points are seen: coefficients
//! of real spherical harmonics.

use super::source::Schema;

/// Largest degree.
pub const MOST_DEGREE: u8 = 3;
/// Most coefficients of a channel.
pub const MOST_COEFFICIENTS: usize = coefficients(MOST_DEGREE);
/// The constant harmonic, ½·√(1/π).
pub const CONSTANT: f64 = 0.282_094_791_773_878_14;
/// Channels of a colour.
pub const CHANNELS: usize = 3;

/// Coefficients of a channel up to a degree, the first among them.
#[must_use]
pub const fn coefficients(degree: u8) -> usize {
    let orders = degree as usize + 1;
    orders * orders
}

/// How the columns begin of the coefficients of spherical harmonics by which colours change with
/// the direction, besides the constant one: `f_rest_0` and so on, as INRIA's trainer writes them.
/// 9, 24 or 45 of them, of degree 1, 2 or 3: first all of red, then all of green, then all of blue.
pub const HARMONIC: &str = "f_rest_";

/// The coefficients of the constant harmonic, ½·√(1/π), for red, green and blue. They say what a
/// colour is besides what is stored of it, which ends at 0 and 1.
pub const HARMONIC_CONSTANTS: [&str; CHANNELS] = ["f_dc_0", "f_dc_1", "f_dc_2"];

impl Schema {
    /// The degree of the spherical harmonics by which colours change with the direction, 0 to 3,
    /// and the columns of their coefficients, the [constant ones](HARMONIC_CONSTANTS) and the
    /// [others](HARMONIC); none of degree 0.
    #[must_use]
    pub fn harmonics(&self) -> (u8, Vec<usize>) {
        let place = |name: String| self.columns.iter().position(|column| column.name == name);
        let of_degree = |degree: u8| {
            let count = CHANNELS * (coefficients(degree) - 1);
            let names = HARMONIC_CONSTANTS.into_iter().map(str::to_owned);
            let names = names.chain((0..count).map(|i| format!("{HARMONIC}{i}")));
            Some((degree, names.map(place).collect::<Option<Vec<_>>>()?))
        };
        (1..=MOST_DEGREE).rev().find_map(of_degree).unwrap_or_default()
    }
}

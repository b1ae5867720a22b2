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

/// The values of the harmonics in a direction of length one: first 1, by which what is left of a
/// stored colour is multiplied, then those of degree 1, 2 and 3. The signs are those of INRIA's
/// trainer (Kerbl et al., 2023).
#[inline]
#[must_use]
pub fn harmonics([x, y, z]: [f64; 3]) -> [f64; MOST_COEFFICIENTS] {
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        1.0,
        -0.488_602_511_902_919_9 * y,
        0.488_602_511_902_919_9 * z,
        -0.488_602_511_902_919_9 * x,
        1.092_548_430_592_079_2 * x * y,
        -1.092_548_430_592_079_2 * y * z,
        0.315_391_565_252_520_05 * (2.0 * zz - xx - yy),
        -1.092_548_430_592_079_2 * x * z,
        0.546_274_215_296_039_6 * (xx - yy),
        -0.590_043_589_926_643_5 * y * (3.0 * xx - yy),
        2.890_611_442_640_554 * x * y * z,
        -0.457_045_799_464_465_8 * y * (4.0 * zz - xx - yy),
        0.373_176_332_590_115_4 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -0.457_045_799_464_465_8 * x * (4.0 * zz - xx - yy),
        1.445_305_721_320_277 * z * (xx - yy),
        -0.590_043_589_926_643_5 * x * (xx - 3.0 * yy),
    ]
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

#[cfg(test)]
mod tests {
    use super::*;
    use rayset_base::geometry::DVec3;

    /// The associated Legendre function of degree l and order m ≥ 0, with the phase (−1)ᵐ.
    fn legendre(l: i32, m: i32, x: f64) -> f64 {
        let odd = (1..=m).map(|k| f64::from(1 - 2 * k)).product::<f64>();
        let (mut below, mut value) = (0.0, odd * (1.0 - x * x).sqrt().powi(m));
        for k in m + 1..=l {
            let next = (f64::from(2 * k - 1) * x * value - f64::from(k + m - 1) * below) / f64::from(k - m);
            (below, value) = (value, next);
        }
        value
    }

    #[test]
    fn harmonics_are_those_of_legendre_functions_with_their_phase_in_the_order_of_m() {
        let factorial = |n: i32| (1..=n).map(f64::from).product::<f64>();
        for direction in [DVec3::new(0.3, -0.5, 0.8), DVec3::new(-0.9, 0.2, -0.1), DVec3::new(0.1, 0.7, 0.4)]
        {
            let direction = direction.normalize();
            let found = harmonics(direction.to_array());
            let (turn, mut k) = (direction.y.atan2(direction.x), 1);
            for l in 1..=3_i32 {
                for m in -l..=l {
                    let order = m.abs();
                    let part = factorial(l - order) / factorial(l + order);
                    let size = (f64::from(2 * l + 1) / (4.0 * std::f64::consts::PI) * part).sqrt();
                    let around = match m {
                        0 => 1.0,
                        _ if m < 0 => std::f64::consts::SQRT_2 * (f64::from(order) * turn).sin(),
                        _ => std::f64::consts::SQRT_2 * (f64::from(order) * turn).cos(),
                    };
                    let expected = size * legendre(l, order, direction.z) * around;
                    assert!((found[k] - expected).abs() < 1e-12, "{l}, {m}: {} and {expected}", found[k]);
                    k += 1;
                }
            }
        }
    }

    #[test]
    fn harmonics_are_orthogonal_and_of_the_right_size() {
        // Points of a Fibonacci lattice stand for equal areas.
        const POINTS: usize = 20_000;
        let golden = std::f64::consts::PI * (5_f64.sqrt() - 1.0);
        let mut sums = [[0.0; MOST_COEFFICIENTS]; MOST_COEFFICIENTS];
        for i in 0..POINTS {
            let z = 1.0 - (2.0 * i as f64 + 1.0) / POINTS as f64;
            let (sin, cos) = (golden * i as f64).sin_cos();
            let across = (1.0 - z * z).sqrt();
            let values = harmonics([across * cos, across * sin, z]);
            for (row, a) in sums.iter_mut().zip(values) {
                row.iter_mut().zip(values).for_each(|(sum, b)| *sum += a * b);
            }
        }
        for (i, row) in sums.iter().enumerate() {
            for (j, sum) in row.iter().enumerate() {
                let integral = sum / POINTS as f64 * 4.0 * std::f64::consts::PI;
                // The constant one is 1, and not ½·√(1/π).
                let expected = match (i == j, i) {
                    (true, 0) => 4.0 * std::f64::consts::PI,
                    (true, _) => 1.0,
                    (false, _) => 0.0,
                };
                assert!((integral - expected).abs() < 2e-3, "{i}, {j}: {integral}");
            }
        }
    }
}

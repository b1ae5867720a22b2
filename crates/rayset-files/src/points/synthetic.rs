//! Generated clouds: the standard workloads of tests, benchmarks and documents, and some decorative
//! ones.
//!
//! Random numbers are splitmix64 from state 42, u = (next >> 40) / 2²⁴ in draw order, so that the
//! points can be reproduced elsewhere.

use std::f64::consts::{PI, TAU};
use std::fmt;
use std::str::FromStr;

use super::{ColorDepth, ColumnInfo, ColumnType, PointBatch, PointSource, ReadError, Schema};
use rayset_base::geometry::DVec3;
use rayset_base::parse::ParseError;

/// The shape over which a workload's points are distributed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Shape {
    Sphere,
    Cube,
    Knot,
    Galaxy,
    Vase,
}

impl Shape {
    /// Random numbers that a point takes.
    fn numbers_per_point(self) -> u64 {
        match self {
            Self::Sphere | Self::Knot | Self::Vase => 2,
            Self::Cube => 3,
            Self::Galaxy => 8,
        }
    }
}

/// A generated cloud: `sphere-100k`, `cube-1m`, `knot-2m`, `galaxy-500k`, with any number of
/// points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Workload {
    shape: Shape,
    points: u64,
}

/// A suitable viewpoint for a workload.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WorkloadView {
    /// Eye position.
    pub position: DVec3,
    /// The point that the eye looks at.
    pub look_at: DVec3,
    /// Up direction.
    pub up: DVec3,
    /// Vertical field of view in degrees.
    pub fovy_degrees: f64,
}

impl Workload {
    /// The standard workloads of the benchmark.
    pub const STANDARD: [&str; 4] = ["sphere-100k", "sphere-1m", "sphere-10m", "cube-1m"];

    /// Number of points.
    #[must_use]
    pub fn points(&self) -> u64 {
        self.points
    }

    /// The radius that all points share, or `None` if each has its own (column `radius`).
    #[must_use]
    pub fn radius(&self) -> Option<f64> {
        let n = self.points.max(1) as f64;
        match self.shape {
            // About 40 supports overlap at the surface.
            Shape::Sphere => Some((160.0 / n).sqrt()),
            Shape::Cube => Some((30.0 * 3.0 / (4.0 * PI * n)).cbrt()),
            Shape::Knot | Shape::Galaxy | Shape::Vase => None,
        }
    }

    /// The viewpoint of the standard benchmark, or a good one for a decorative cloud.
    #[must_use]
    pub fn view(&self) -> WorkloadView {
        let (position, up) = match self.shape {
            Shape::Sphere | Shape::Cube => (DVec3::new(0.0, 0.0, 3.0), DVec3::Y),
            Shape::Knot => (DVec3::new(-1.5, -6.2, 4.4), DVec3::Z),
            Shape::Galaxy => (DVec3::new(0.0, -2.1, 1.5), DVec3::Z),
            Shape::Vase => (DVec3::new(0.3, 1.1, 1.7), DVec3::Y),
        };
        let look_at = if self.shape == Shape::Vase { DVec3::Y * 0.5 } else { DVec3::ZERO };
        WorkloadView { position, look_at, up, fovy_degrees: 45.0 }
    }

    /// The stream of points.
    #[must_use]
    pub fn source(&self) -> Box<dyn PointSource> {
        let attributes: &[&str] = match self.shape {
            Shape::Sphere | Shape::Cube => &[],
            Shape::Knot | Shape::Galaxy | Shape::Vase => &["radius", "weight", "red", "green", "blue"],
        };
        Box::new(SyntheticSource {
            workload: *self,
            schema: Schema::new(
                attributes.iter().map(|&a| ColumnInfo::new(a, ColumnType::F32)).collect(),
                ColorDepth::Unit,
            ),
            selected: Vec::new(),
            random: SplitMix(42),
            next: 0,
        })
    }
}

impl fmt::Display for Workload {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let shape = match self.shape {
            Shape::Sphere => "sphere",
            Shape::Cube => "cube",
            Shape::Knot => "knot",
            Shape::Galaxy => "galaxy",
            Shape::Vase => "vase",
        };
        match self.points {
            n if n >= 1_000_000 && n % 1_000_000 == 0 => write!(f, "{shape}-{}m", n / 1_000_000),
            n if n >= 1000 && n % 1000 == 0 => write!(f, "{shape}-{}k", n / 1000),
            n => write!(f, "{shape}-{n}"),
        }
    }
}

impl FromStr for Workload {
    type Err = ParseError;

    fn from_str(s: &str) -> Result<Self, Self::Err> {
        let unknown = || {
            ParseError::new(s, |s| {
                format!(
                    "unknown workload `{s}`; expected sphere-N, cube-N, knot-N, galaxy-N or vase-N, N as 5000, 100k or 1m"
                )
            })
        };
        let (shape, count) = s.split_once('-').ok_or_else(unknown)?;
        let shape = match shape {
            "sphere" => Shape::Sphere,
            "cube" => Shape::Cube,
            "knot" => Shape::Knot,
            "galaxy" => Shape::Galaxy,
            "vase" => Shape::Vase,
            _ => return Err(unknown()),
        };
        let (digits, unit) = match count.strip_suffix('k') {
            Some(d) => (d, 1000),
            None => count.strip_suffix('m').map_or((count, 1), |d| (d, 1_000_000)),
        };
        let points = digits.parse::<u64>().ok().and_then(|n| n.checked_mul(unit)).ok_or_else(unknown)?;
        Ok(Self { shape, points })
    }
}

#[derive(Debug)]
pub(super) struct SplitMix(pub(super) u64);

impl SplitMix {
    /// Uniform in [0, 1), 24 bits.
    pub(super) fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^= z >> 31;
        (z >> 40) as f64 / f64::from(1 << 24)
    }

    /// Passes over the next `count` numbers.
    fn skip(&mut self, count: u64) {
        self.0 = self.0.wrapping_add(count.wrapping_mul(0x9e37_79b9_7f4a_7c15));
    }

    /// Normally distributed with mean 0 and standard deviation 1 (Box–Muller, one of the pair).
    fn normal(&mut self) -> f64 {
        let (u, v) = (1.0 - self.unit(), self.unit());
        (-2.0 * u.ln()).sqrt() * (TAU * v).cos()
    }
}

#[derive(Debug)]
struct SyntheticSource {
    workload: Workload,
    schema: Schema,
    selected: Vec<usize>,
    random: SplitMix,
    next: u64,
}

impl SyntheticSource {
    /// Position and the five columns of the next point.
    fn point(&mut self) -> ([f64; 3], [f64; 5]) {
        let random = &mut self.random;
        match self.workload.shape {
            Shape::Sphere => {
                let (z, phi) = (2.0 * random.unit() - 1.0, TAU * random.unit());
                let ring = (1.0 - z * z).max(0.0).sqrt();
                ([ring * phi.cos(), ring * phi.sin(), z], [0.0; 5])
            }
            Shape::Cube => ([random.unit() - 0.5, random.unit() - 0.5, random.unit() - 0.5], [0.0; 5]),
            Shape::Knot => knot(random, self.workload.points),
            Shape::Galaxy => galaxy(random, self.workload.points),
            Shape::Vase => vase(random, self.workload.points),
        }
    }
}

/// A (2, 3) torus knot: a fluted tube whose colour runs along its length.
fn knot(random: &mut SplitMix, points: u64) -> ([f64; 3], [f64; 5]) {
    let (u, v) = (TAU * random.unit(), TAU * random.unit());
    let curve = |u: f64| {
        let ring = 2.0 + (3.0 * u).cos();
        DVec3::new(ring * (2.0 * u).cos(), ring * (2.0 * u).sin(), (3.0 * u).sin())
    };
    let center = curve(u);
    let tangent = (curve(u + 1e-4) - curve(u - 1e-4)).normalize();
    let side = tangent.cross(DVec3::Z).normalize();
    let across = tangent.cross(side);
    let flute = 0.06 * (8.0 * v + 24.0 * u).sin();
    let tube = 0.42 + flute;
    let p = center + (side * v.cos() + across * v.sin()) * tube;
    // The square of the spacing is the tube's area over the number of points. The radius covers
    // about five spacings, and the weight places half opacity well inside the shell of overlapping
    // kernels, where many points contribute: both hide the noise of random points.
    let radius = 5.0 * (2.7 * TAU * TAU * 0.42 / points.max(1) as f64).sqrt();
    let shade = 0.75 + 3.0 * flute;
    let [r, g, b] = hue(2.0 * u / TAU);
    (p.to_array(), [radius, 0.4, r * shade, g * shade, b * shade])
}

/// A two-armed spiral with a bulge: translucent, with radii over two orders of magnitude.
fn galaxy(random: &mut SplitMix, points: u64) -> ([f64; 3], [f64; 5]) {
    let scale = (2e5 / points.max(1) as f64).cbrt();
    if random.unit() < 0.25 {
        let p = DVec3::new(random.normal(), random.normal(), 0.6 * random.normal()) * 0.13;
        let radius = scale * (0.008 + 0.02 * random.unit());
        return (p.to_array(), [radius, 1.0, 1.0, 0.82, 0.55]);
    }
    let along = -(1.0 - 0.98 * random.unit()).ln() / 3.0;
    let arm = if random.unit() < 0.5 { 0.0 } else { PI };
    let angle = arm + 4.0 * (along + 0.1).ln() + 0.35 * random.normal();
    let z = 0.02 * random.normal();
    let young = random.unit();
    let radius = scale * (0.004 + 0.06 * along * young.powi(4));
    let p = [along * angle.cos(), along * angle.sin(), z];
    (p, [radius, 0.7, 0.45 + 0.5 * young, 0.6 + 0.2 * young, 1.0 - 0.2 * young])
}

/// A lobed vase of height 1 on the ground: a solid object, like a scan of a statue.
fn vase(random: &mut SplitMix, points: u64) -> ([f64; 3], [f64; 5]) {
    let (h, angle) = (random.unit(), TAU * random.unit());
    // A foot, a belly, a neck and a lip.
    let profile = 0.17 + 0.12 * (1.25 * PI * h).sin() + 0.08 * h.powi(8);
    let lobes = 1.0 + 0.07 * (7.0 * angle + 5.0 * h).sin();
    let p = [profile * lobes * angle.cos(), h, profile * lobes * angle.sin()];
    // As for the knot; the area of the surface is about 1.4.
    let radius = 5.0 * (1.4 / points.max(1) as f64).sqrt();
    let glaze = 0.5 + 0.5 * (7.0 * angle + 5.0 * h).sin();
    (p, [radius, 0.4, 0.75 + 0.1 * glaze, 0.62 + 0.1 * h, 0.45 + 0.15 * glaze])
}

/// A saturated colour of the colour wheel; the hue `turn` is in turns.
fn hue(turn: f64) -> [f64; 3] {
    [0.0, 1.0 / 3.0, 2.0 / 3.0].map(|shift| 0.55 + 0.4 * (TAU * (turn - shift)).cos())
}

impl PointSource for SyntheticSource {
    fn schema(&self) -> &Schema {
        &self.schema
    }

    fn count_hint(&self) -> Option<u64> {
        Some(self.workload.points)
    }

    fn select(&mut self, columns: &[usize]) {
        self.selected = columns.to_vec();
    }

    fn can_skip(&self) -> bool {
        true
    }

    fn skip(&mut self, count: u64) -> Result<(), ReadError> {
        let skipped = count.min(self.workload.points - self.next);
        self.next += skipped;
        self.random.skip(skipped.wrapping_mul(self.workload.shape.numbers_per_point()));
        Ok(())
    }

    fn fill(&mut self, batch: &mut PointBatch, limit: usize) -> Result<(), ReadError> {
        batch.reset(&self.schema, &self.selected);
        let count = (self.workload.points - self.next).min(limit as u64);
        for _ in 0..count {
            let (position, columns) = self.point();
            batch.position.push(position);
            for (column, &attribute) in batch.columns.iter_mut().zip(&self.selected) {
                column.push(columns[attribute]);
            }
        }
        self.next += count;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_generator_is_the_published_one() {
        // splitmix64 from state 42: 13679457532755275413 is the first output.
        let mut random = SplitMix(42);
        assert_eq!(random.unit(), (13_679_457_532_755_275_413_u64 >> 40) as f64 / f64::from(1 << 24));
    }

    #[test]
    fn points_that_are_skipped_are_those_that_would_have_come() {
        for name in ["sphere-100", "cube-100", "knot-100", "galaxy-100", "vase-100"] {
            let workload: Workload = name.parse().expect("a workload");
            let (mut all, mut rest) = (PointBatch::default(), PointBatch::default());
            workload.source().fill(&mut all, 100).expect("points");
            let mut source = workload.source();
            source.skip(63).expect("points");
            source.fill(&mut rest, 100).expect("points");
            assert_eq!(all.position[63..], rest.position[..], "{name}");
        }
    }

    #[test]
    fn names_round_trip() {
        for name in ["sphere-100k", "cube-1m", "knot-1234", "galaxy-2m"] {
            assert_eq!(name.parse::<Workload>().map(|w| w.to_string()).ok().as_deref(), Some(name));
        }
        assert!("sphere".parse::<Workload>().is_err());
        assert!("sphere-99999999999999999m".parse::<Workload>().is_err());
    }
}

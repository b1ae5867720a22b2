//! Longitudes and latitudes in degrees become metres, so that heights, which are metres already,
//! are as large as they look.

use std::path::{Path, PathBuf};

use super::{Place, PointBatch, PointSource, ReadError, Schema};
use rayset_base::cancel::CancelToken;
use rayset_base::geometry::DVec3;

/// EPSG codes of the usual systems of longitudes and latitudes.
const CODES: [&str; 8] = ["4326", "4258", "4269", "4283", "4617", "4979", "4171", "6318"];
/// Degrees from the middle of a zone, within which a transverse projection is usable.
const FARTHEST_DEGREES: f64 = 30.0;
/// Metres of a degree along the equator: the most that a degree is.
const METRES_OF_DEGREE: f64 = 111_320.0;

/// Whether a reference system, WKT or `EPSG:` and a code, is of longitudes and latitudes.
fn is_geographic(crs: &str) -> bool {
    let upper = crs.to_ascii_uppercase();
    let has = |words: &[&str]| words.iter().any(|word| upper.contains(word));
    let code = upper.strip_prefix("EPSG:").is_some_and(|code| CODES.contains(&code));
    code || has(&["GEOGCS[", "GEOGCRS[", "GEODCRS["])
        && !has(&["PROJCS[", "PROJCRS[", "GEOCCS[", "CARTESIAN"])
}

/// Half the long axis of the ellipsoid of WGS 84 in metres, and its flattening.
const EQUATOR: f64 = 6_378_137.0;
const FLATTENING: f64 = 1.0 / 298.257_223_563;

/// A projection onto a plane, in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Projection {
    Zone(Zone),
    Pole(Pole),
}

impl Projection {
    /// The one for a place in degrees; `None` if it is none on the globe.
    fn of(longitude: f64, latitude: f64) -> Option<Self> {
        Pole::of(longitude, latitude)
            .map(Self::Pole)
            .or_else(|| Zone::of(longitude, latitude).map(Self::Zone))
    }

    fn epsg(self) -> u32 {
        match self {
            Self::Zone(zone) => zone.epsg(),
            Self::Pole(pole) => pole.epsg(),
        }
    }

    /// Whether a place is near enough to the projection's middle to be projected by it.
    fn reaches(self, longitude: f64, latitude: f64) -> bool {
        match self {
            // What is no number stays none, and is skipped.
            Self::Zone(zone) => {
                !((longitude - zone.middle()).abs() > FARTHEST_DEGREES || latitude.abs() > 90.0)
            }
            Self::Pole(pole) => {
                let north = if pole.is_south { -latitude } else { latitude };
                let off = (north - 90.0).abs();
                !(off > FARTHEST_DEGREES || north.abs() > 90.0 || longitude.abs() > 360.0)
            }
        }
    }

    fn project(self, longitude: f64, latitude: f64) -> [f64; 2] {
        match self {
            Self::Zone(zone) => zone.project(longitude, latitude),
            Self::Pole(pole) => pole.project(longitude, latitude),
        }
    }
}

impl std::fmt::Display for Projection {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Zone(zone) => {
                write!(f, "UTM zone {}{}", zone.number, if zone.is_south { "S" } else { "N" })
            }
            Self::Pole(pole) => {
                let name = if pole.is_south { "south" } else { "north" };
                write!(f, "the polar stereographic projection of the {name} (UPS)")
            }
        }
    }
}

/// The Universal Polar Stereographic projection, where there are no zones.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Pole {
    is_south: bool,
}

impl Pole {
    /// The pole that a place in degrees is near.
    fn of(longitude: f64, latitude: f64) -> Option<Self> {
        let is_place = longitude.abs() <= 360.0 && latitude.abs() <= 90.0;
        (is_place && latitude.abs() > 84.0).then_some(Self { is_south: latitude < 0.0 })
    }

    fn epsg(self) -> u32 {
        if self.is_south { 5042 } else { 5041 }
    }

    /// Easting and northing in metres on the ellipsoid of WGS 84 (Snyder 1987, equations 15-9,
    /// 21-30 to 21-33).
    fn project(self, longitude: f64, latitude: f64) -> [f64; 2] {
        const SCALE: f64 = 0.994;
        const MIDDLE: f64 = 2e6;
        let e = (FLATTENING * (2.0 - FLATTENING)).sqrt();
        let north = if self.is_south { -latitude } else { latitude }.to_radians();
        let sine = e * north.sin();
        let t =
            (0.25 * std::f64::consts::PI - 0.5 * north).tan() * ((1.0 + sine) / (1.0 - sine)).powf(0.5 * e);
        let circle = ((1.0 + e).powf(1.0 + e) * (1.0 - e).powf(1.0 - e)).sqrt();
        let distance = 2.0 * EQUATOR * SCALE * t / circle;
        let (across, along) = longitude.to_radians().sin_cos();
        let along = if self.is_south { along } else { -along };
        [MIDDLE + distance * across, MIDDLE + distance * along]
    }
}

/// A zone of the Universal Transverse Mercator projection.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Zone {
    number: u32,
    is_south: bool,
}

impl Zone {
    /// The zone of a place in degrees; `None` if it is none on the globe, or near a pole.
    fn of(longitude: f64, latitude: f64) -> Option<Self> {
        let is_place = (-180.0..=180.0).contains(&longitude) && latitude.abs() <= 84.0;
        let number = (((longitude + 180.0) / 6.0).floor() as u32 + 1).min(60);
        is_place.then_some(Self { number, is_south: latitude < 0.0 })
    }

    /// The longitude in its middle.
    fn middle(self) -> f64 {
        6.0 * f64::from(self.number) - 183.0
    }

    fn epsg(self) -> u32 {
        if self.is_south { 32700 + self.number } else { 32600 + self.number }
    }

    /// Easting and northing in metres on the ellipsoid of WGS 84, by Krüger's series to the third
    /// order: exact to a millimetre within the zone.
    fn project(self, longitude: f64, latitude: f64) -> [f64; 2] {
        const SCALE: f64 = 0.9996;
        let n = FLATTENING / (2.0 - FLATTENING);
        let circle = EQUATOR / (1.0 + n) * (1.0 + n * n / 4.0 + n.powi(4) / 64.0);
        let series = [
            n / 2.0 - 2.0 / 3.0 * n * n + 5.0 / 16.0 * n.powi(3),
            13.0 / 48.0 * n * n - 3.0 / 5.0 * n.powi(3),
            61.0 / 240.0 * n.powi(3),
        ];
        let (sine, off) = (latitude.to_radians().sin(), (longitude - self.middle()).to_radians());
        let eccentricity = 2.0 * n.sqrt() / (1.0 + n);
        let t = (sine.atanh() - eccentricity * (eccentricity * sine).atanh()).sinh();
        let (xi, eta) = (t.atan2(off.cos()), (off.sin() / (1.0 + t * t).sqrt()).atanh());
        let (mut north, mut east) = (xi, eta);
        for (term, factor) in (1..).map(|j| 2.0 * f64::from(j)).zip(series) {
            north += factor * (term * xi).sin() * (term * eta).cosh();
            east += factor * (term * xi).cos() * (term * eta).sinh();
        }
        let south = if self.is_south { 10_000_000.0 } else { 0.0 };
        [500_000.0 + SCALE * circle * east, south + SCALE * circle * north]
    }
}

/// Points whose positions are longitude, latitude and height, in metres.
struct InMetres {
    degrees: Box<dyn PointSource>,
    projection: Projection,
    schema: Schema,
}

/// The same points in metres if their reference system has degrees and the first of them, which
/// `open` reads, is a place on the globe; otherwise as they are.
pub(super) fn in_metres(
    path: &Path,
    source: Box<dyn PointSource>,
    open: impl FnOnce() -> Result<Box<dyn PointSource>, ReadError>,
) -> Result<Box<dyn PointSource>, ReadError> {
    if !is_geographic(&source.schema().crs) || !rayset_store::storage::input_file::is_file(path) {
        return Ok(source);
    }
    let mut batch = PointBatch::default();
    let mut first = open()?;
    first.select(&[]);
    first.fill(&mut batch, 1)?;
    let projection = batch.position.first().and_then(|p| Projection::of(p[0], p[1]));
    let Some(projection) = projection else { return Ok(source) };
    let mut schema = source.schema().clone();
    schema.crs = format!("EPSG:{}", projection.epsg());
    schema.up = schema.up.or(Some(DVec3::Z));
    schema.step = schema.step.map(|[x, y, z]| [x * METRES_OF_DEGREE, y * METRES_OF_DEGREE, z]);
    schema.warnings.push(format!(
        "degrees of longitude and latitude are made metres, of {projection} (EPSG:{})",
        projection.epsg()
    ));
    Ok(Box::new(InMetres { degrees: source, projection, schema }))
}

impl PointSource for InMetres {
    fn schema(&self) -> &Schema {
        &self.schema
    }

    fn count_hint(&self) -> Option<u64> {
        self.degrees.count_hint()
    }

    fn path(&self) -> Option<&Path> {
        self.degrees.path()
    }

    fn files(&self) -> Vec<PathBuf> {
        self.degrees.files()
    }

    fn memory_needed(&self) -> u64 {
        self.degrees.memory_needed()
    }

    fn select(&mut self, columns: &[usize]) {
        self.degrees.select(columns);
    }

    fn watch(&mut self, cancel: &CancelToken) {
        self.degrees.watch(cancel);
    }

    fn can_skip(&self) -> bool {
        self.degrees.can_skip()
    }

    fn skip(&mut self, count: u64) -> Result<(), ReadError> {
        self.degrees.skip(count)
    }

    fn fill(&mut self, batch: &mut PointBatch, limit: usize) -> Result<(), ReadError> {
        self.degrees.fill(batch, limit)?;
        for position in &mut batch.position {
            let [longitude, latitude, _] = *position;
            if !self.projection.reaches(longitude, latitude) {
                let what = format!(
                    "longitude {longitude}, latitude {latitude}: points in degrees are read if they lie within \
                     {FARTHEST_DEGREES} degrees of each other, or of a pole, which others on the globe do not; `--columns x,y,z` takes the \
                     columns of a text as they are, and `pdal translate` with filters.reprojection makes metres of LAS"
                );
                let path = self.degrees.path().unwrap_or(Path::new("")).to_owned();
                return Err(ReadError::malformed(&path, Place::Byte(0), what));
            }
            let [east, north] = self.projection.project(longitude, latitude);
            (position[0], position[1]) = (east, north);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metres_are_those_of_utm() {
        // By PROJ 9.
        for ([longitude, latitude], epsg, [east, north]) in [
            ([11.5, 48.1], 32632, [686_121.756, 5_330_438.130]),
            ([-70.65, -33.45], 32719, [346_642.695, 6_297_606.832]),
            ([179.99, 0.01], 32660, [832_864.270, 1_106.817]),
        ] {
            let zone = Zone::of(longitude, latitude).expect("a place");
            assert_eq!(zone.epsg(), epsg);
            let [x, y] = zone.project(longitude, latitude);
            assert!((x - east).abs() < 2e-3 && (y - north).abs() < 2e-3, "{x} {y}");
        }
        assert_eq!(Zone::of(500_000.0, 48.0), None);
        assert_eq!(Zone::of(f64::NAN, 48.0), None);
    }

    #[test]
    fn near_a_pole_metres_are_those_of_the_polar_projection() {
        let project = |longitude, latitude| {
            let projection = Projection::of(longitude, latitude).expect("a place");
            (projection.epsg(), projection.project(longitude, latitude))
        };
        // By PROJ: where the zones end, and a place away from the axes.
        let (epsg, [x, y]) = project(0.0, 84.000_000_001);
        assert!(epsg == 5041 && (x - 2e6).abs() < 1e-6 && (y - 1_333_272.296).abs() < 0.01, "{x} {y}");
        let (epsg, [x, y]) = project(30.0, -85.5);
        assert!(
            epsg == 5042 && (x - 2_249_926.882).abs() < 0.01 && (y - 2_432_886.057).abs() < 0.01,
            "{x} {y}"
        );
        let (epsg, [x, y]) = project(90.0, -90.0);
        assert!(epsg == 5042 && (x - 2e6).abs() < 1e-6 && (y - 2e6).abs() < 1e-6, "{x} {y}");
        // A metre on the ground is a metre: a hundredth of a degree along a meridian, at the scale
        // of the pole.
        let ([_, a], [_, b]) = (project(180.0, 89.0).1, project(180.0, 88.99).1);
        assert!((b - a - 0.994 * 1116.94).abs() < 0.5, "{}", b - a);
        let ([x, _], [_, y]) = (project(90.0, 89.0).1, project(0.0, -89.0).1);
        assert!((x - y).abs() < 1e-6, "{x} {y}");
        assert!(matches!(Projection::of(11.5, 48.1), Some(Projection::Zone(_))));
        assert_eq!(Projection::of(0.0, 91.0), None);
    }

    #[test]
    fn systems_of_degrees_are_told_from_others() {
        assert!(is_geographic("EPSG:4326") && is_geographic("GEOGCS[\"WGS 84\",DATUM[\"x\"]]"));
        for other in ["", "EPSG:32632", "PROJCS[\"a\",GEOGCS[\"b\"]]", "GEOCCS[\"WGS 84\"]"] {
            assert!(!is_geographic(other), "{other}");
        }
    }
}

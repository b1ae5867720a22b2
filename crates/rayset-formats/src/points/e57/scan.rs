//! The scans of a file: where their coordinates are, and what its columns are made of in each of
//! them.

use e57::{PointCloud, RecordName, Transform};

use super::number::Number;
use crate::points::{ColorDepth, ColumnInfo, ColumnType, Schema, roles};
use rayset_base::geometry::DVec3;

/// Most fields of a record; each takes memory of its own while points are read.
const FIELD_LIMIT: usize = 256;
/// Largest product of the numbers of scans and columns, for each of which something is held in
/// memory.
const ORIGIN_LIMIT: usize = 1 << 20;

/// The ranges of red, green and blue.
type Ranges = [(f64, f64); 3];

/// Where the coordinates of a point are.
#[derive(Clone, Copy)]
pub(super) struct Coordinates {
    /// x, y, z, or range, azimuth and elevation.
    pub(super) fields: [usize; 3],
    /// The field that is not 0 where they are no place: a direction alone, or nothing.
    pub(super) invalid: Option<usize>,
}

/// A rotation and a translation.
#[derive(Clone, Copy)]
pub(super) struct Pose {
    axes: [DVec3; 3],
    translation: DVec3,
}

impl Pose {
    fn new(pose: Option<&Transform>) -> Self {
        let Some(Transform { rotation: q, translation: t }) = pose else {
            return Self { axes: [DVec3::X, DVec3::Y, DVec3::Z], translation: DVec3::ZERO };
        };
        let q = [q.w, q.x, q.y, q.z];
        let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
        // Rotations must be unit quaternions. Zeros, from writers that have none to state, are no
        // rotation.
        let [w, x, y, z] = if length > 0.0 { q.map(|v| v / length) } else { [1.0, 0.0, 0.0, 0.0] };
        Self {
            axes: [
                DVec3::new(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
                DVec3::new(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
                DVec3::new(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
            ],
            translation: DVec3::new(t.x, t.y, t.z),
        }
    }

    pub(super) fn rotate(&self, v: DVec3) -> DVec3 {
        self.axes[0] * v.x + self.axes[1] * v.y + self.axes[2] * v.z
    }

    pub(super) fn place(&self, p: DVec3) -> DVec3 {
        self.rotate(p) + self.translation
    }
}

/// What a column is made of in a scan.
#[derive(Clone, Copy, Debug)]
pub(super) enum Origin {
    /// The scan has nothing of it, which is NaN.
    Missing,
    /// The index of the scan.
    ScanIndex,
    /// The numbers of a field, or NaN where `invalid` is not 0.
    Field { field: usize, invalid: Option<usize> },
    /// The same, from a range to 0 to 1.
    Color { field: usize, invalid: Option<usize>, range: (f64, f64) },
    /// A component of a vector that turns with the scan.
    Vector { fields: [usize; 3], axis: usize },
}

/// A scan of a file.
pub(super) struct Scan {
    pub(super) records: u64,
    /// Byte of the file at which its section begins.
    pub(super) section: u64,
    pub(super) fields: Vec<Number>,
    pub(super) cartesian: Option<Coordinates>,
    pub(super) spherical: Option<Coordinates>,
    pub(super) pose: Pose,
    /// For each column of the schema.
    pub(super) origins: Vec<Origin>,
}

impl Scan {
    /// Bits of a record.
    pub(super) fn record_bits(&self) -> usize {
        self.fields.iter().map(|field| field.bits()).sum()
    }
}

/// The name of the column of a field; `None` for coordinates, and for what says that others are
/// invalid.
fn column_name(name: &RecordName) -> Option<&str> {
    Some(match name {
        RecordName::Intensity => "intensity",
        RecordName::ColorRed => "red",
        RecordName::ColorGreen => "green",
        RecordName::ColorBlue => "blue",
        RecordName::RowIndex => "row",
        RecordName::ColumnIndex => "column",
        RecordName::ReturnIndex => "return_index",
        RecordName::ReturnCount => "return_count",
        RecordName::TimeStamp => "timestamp",
        RecordName::Unknown { name, .. } => name,
        _ => return None,
    })
}

/// The field that says where a field is invalid.
fn invalid_name(name: &RecordName) -> Option<RecordName> {
    Some(match name {
        RecordName::Intensity => RecordName::IsIntensityInvalid,
        RecordName::ColorRed | RecordName::ColorGreen | RecordName::ColorBlue => RecordName::IsColorInvalid,
        RecordName::TimeStamp => RecordName::IsTimeStampInvalid,
        _ => return None,
    })
}

fn find(scan: &PointCloud, name: &RecordName) -> Option<usize> {
    scan.prototype.iter().position(|record| record.name == *name)
}

fn coordinates(scan: &PointCloud, names: [RecordName; 3], invalid: &RecordName) -> Option<Coordinates> {
    let [a, b, c] = names.map(|name| find(scan, &name));
    Some(Coordinates { fields: [a?, b?, c?], invalid: find(scan, invalid) })
}

/// The scans, and the schema of all of them together: a column for each field that any of them has.
pub(super) fn all(clouds: &[PointCloud]) -> Result<(Vec<Scan>, Schema), String> {
    let scans: Result<Vec<Scan>, String> =
        clouds.iter().enumerate().map(|(index, cloud)| scan(cloud, index)).collect();
    let mut scans = scans?;
    let mut names: Vec<&str> = Vec::new();
    for name in clouds.iter().flat_map(|cloud| cloud.prototype.iter().filter_map(|r| column_name(&r.name))) {
        if !names.contains(&name) {
            names.push(name);
        }
        if names.len() > FIELD_LIMIT {
            return Err(format!("more than {FIELD_LIMIT} different fields"));
        }
    }
    if names.len() * scans.len() > ORIGIN_LIMIT {
        let (scans, names) = (scans.len(), names.len());
        return Err(format!("{scans} scans with {names} different fields; write the scans to several files"));
    }
    let (depth, ranges) = color_ranges(clouds, &scans);
    let mut schema = Schema::new(Vec::new(), depth);
    for name in names {
        let mut kind: Option<ColumnType> = None;
        for (index, (scan, cloud)) in scans.iter_mut().zip(clouds).enumerate() {
            let (origin, own) = origin(name, scan, cloud, ranges.as_ref().map(|ranges| ranges[index]));
            kind = Some(kind.map_or(own, |kind| kind.common(own)));
            scan.origins.push(origin);
        }
        let mut info = ColumnInfo::new(name, kind.unwrap_or(ColumnType::F64));
        if name == "timestamp" {
            info = info.with_unit("s");
        }
        schema.columns.push(if roles::is_class(name) { info.of_classes() } else { info });
    }
    if scans.len() > 1 {
        let kind = if scans.len() > 1 << 16 { ColumnType::U32 } else { ColumnType::U16 };
        if schema.columns.iter().all(|column| column.name != "scan") {
            schema.columns.push(ColumnInfo::new("scan", kind).of_classes());
            scans.iter_mut().for_each(|scan| scan.origins.push(Origin::ScanIndex));
        }
    }
    Ok((scans, schema))
}

fn scan(cloud: &PointCloud, index: usize) -> Result<Scan, String> {
    if cloud.prototype.len() > FIELD_LIMIT {
        let fields = cloud.prototype.len();
        return Err(format!("scan {index} has {fields} fields; up to {FIELD_LIMIT} are read"));
    }
    let cartesian = [RecordName::CartesianX, RecordName::CartesianY, RecordName::CartesianZ];
    let spherical =
        [RecordName::SphericalRange, RecordName::SphericalAzimuth, RecordName::SphericalElevation];
    let cartesian = coordinates(cloud, cartesian, &RecordName::CartesianInvalidState);
    let spherical = coordinates(cloud, spherical, &RecordName::SphericalInvalidState);
    if cartesian.is_none() && spherical.is_none() {
        return Err(format!(
            "scan {index} has neither all of cartesianX, cartesianY and cartesianZ nor all of sphericalRange, \
             sphericalAzimuth and sphericalElevation"
        ));
    }
    Ok(Scan {
        records: cloud.records,
        section: cloud.file_offset,
        fields: cloud.prototype.iter().map(|record| Number::new(&record.data_type)).collect(),
        cartesian,
        spherical,
        pose: Pose::new(cloud.transform.as_ref()),
        origins: Vec::new(),
    })
}

/// What column `name` is made of in a scan, and the type that it takes there.
fn origin(name: &str, scan: &Scan, cloud: &PointCloud, ranges: Option<Ranges>) -> (Origin, ColumnType) {
    let place = cloud.prototype.iter().position(|record| column_name(&record.name) == Some(name));
    let color = ["red", "green", "blue"].iter().position(|color| *color == name);
    let Some(field) = place else {
        return (Origin::Missing, ColumnType::F32);
    };
    let number = scan.fields[field];
    let invalid = invalid_name(&cloud.prototype[field].name).and_then(|name| find(cloud, &name));
    if let Some(channel) = color {
        let origin = match ranges {
            Some(ranges) => Origin::Color { field, invalid, range: ranges[channel] },
            None => Origin::Field { field, invalid },
        };
        let kind = if ranges.is_some() { ColumnType::F32 } else { number.column_type() };
        return (origin, if invalid.is_some() { kind.common(ColumnType::F32) } else { kind });
    }
    // Surface normals, as an extension of the standard names them.
    const NORMAL: [&str; 3] = ["normalX", "normalY", "normalZ"];
    let normal = NORMAL.map(|n| cloud.prototype.iter().position(|r| column_name(&r.name) == Some(n)));
    if let (Some(axis), [Some(x), Some(y), Some(z)]) = (NORMAL.iter().position(|n| *n == name), normal) {
        let kind = if matches!(number, Number::Single) { ColumnType::F32 } else { ColumnType::F64 };
        return (Origin::Vector { fields: [x, y, z], axis }, kind);
    }
    let kind = number.column_type();
    let kind = if invalid.is_some() { kind.common(ColumnType::F32) } else { kind };
    (Origin::Field { field, invalid }, kind)
}

/// The depth of the colours of all scans, and the ranges by which they become 0 to 1 if that is
/// needed.
fn color_ranges(clouds: &[PointCloud], scans: &[Scan]) -> (ColorDepth, Option<Vec<Ranges>>) {
    let ranges = clouds.iter().zip(scans).map(|(cloud, scan)| limits(cloud, scan));
    let ranges: Option<Vec<Ranges>> = ranges.collect();
    let Some(ranges) = ranges else { return (ColorDepth::Guess, None) };
    let have_colors =
        || clouds.iter().zip(&ranges).filter(|(cloud, _)| cloud.has_color()).map(|(_, range)| range);
    for (depth, most) in [(ColorDepth::Byte, 255.0), (ColorDepth::Word, 65535.0)] {
        if have_colors().all(|ranges| ranges.iter().all(|range| *range == (0.0, most))) {
            return (depth, None);
        }
    }
    (ColorDepth::Unit, Some(ranges))
}

/// The limits of the colours of a scan, or else the ranges of their types; `None` if it has colours
/// without either.
fn limits(cloud: &PointCloud, scan: &Scan) -> Option<Ranges> {
    let stated = cloud.color_limits.as_ref();
    let channels = [
        (RecordName::ColorRed, stated.map(|l| (&l.red_min, &l.red_max))),
        (RecordName::ColorGreen, stated.map(|l| (&l.green_min, &l.green_max))),
        (RecordName::ColorBlue, stated.map(|l| (&l.blue_min, &l.blue_max))),
    ];
    let mut ranges = [(0.0, 1.0); 3];
    for (range, (name, stated)) in ranges.iter_mut().zip(channels) {
        let Some(field) = find(cloud, &name) else { continue };
        let number = scan.fields[field];
        let stated = stated.and_then(|(min, max)| Some((min.as_ref()?, max.as_ref()?)));
        let stated = stated.map(|(min, max)| (number.limit(min), number.limit(max)));
        let is_range = |(min, max): &(f64, f64)| min < max && (max - min).is_finite();
        *range = stated.filter(is_range).or_else(|| number.range().filter(is_range))?;
    }
    Some(ranges)
}

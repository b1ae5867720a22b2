//! E57 (ASTM E2807): the scans of a file as one cloud, in batches.
//!
//! The `e57` crate reads what a file says of its scans; their points are read here, because the
//! crate makes a list of the numbers of every point, trusts that all fields of a packet come
//! equally far, and lends out its reader. Each page of the file is checked before it is used.
//!
//! **Coordinates** are those of the file: the pose of its scan is applied to every point. Spherical
//! ones become Cartesian; if a scan has both, a point without valid Cartesian coordinates takes the
//! others. Points whose coordinates are said to be invalid, or to be a direction alone, are
//! delivered as NaN, so that they are counted as invalid.
//!
//! **Colours** are scaled by their limits, if these are not 0 to 255 or 0 to 65535 in all scans.
//! Invalid ones are black. Intensities keep their numbers. An invalid one, or one of a scan that
//! has none, is NaN. Columns of an extension of the format have the names that it gives them; its
//! surface normals turn with the scan. If there are several scans, the column `scan` has their
//! numbers, from 0.
//!
//! Not supported: pictures, and groups of points.

mod header;
mod number;
mod packets;
mod pages;
mod scan;

use std::path::Path;

use self::packets::{KEPT_LIMIT, Packets};
use self::pages::{BUFFER_BYTES, Pages};
use self::scan::{Coordinates, Origin, Scan};
use super::file_source::{FileSource, RecordReader, Request};
use super::{Place, PointBatch, ReadError, Values};
use rayset_base::geometry::DVec3;

/// Number of points that are decoded at a time.
const ROWS: usize = 1024;
/// Number of points of all scans whose fields all have a single value, which takes no bytes.
const CONSTANT_POINTS: u64 = 1 << 16;

/// The points of an E57 file.
pub(super) struct E57Reader {
    pages: Pages,
    xml_start: u64,
    scans: Vec<Scan>,
    /// Number of scans begun, and the packets and the number of points that are left of the last of
    /// them.
    begun: usize,
    packets: Option<Packets>,
    left: u64,
    /// The numbers of each field, as bits.
    raw: Vec<Vec<u64>>,
}

impl E57Reader {
    /// Opens a file, and checks what it says of its scans against its size.
    ///
    /// # Errors
    /// [`ReadError`] if the file cannot be read, violates its format, or has no scans.
    pub(super) fn open(path: &Path) -> Result<FileSource<Self>, ReadError> {
        let (contents, pages) = header::open(path)?;
        let bad = |what: String| ReadError::malformed(path, Place::Byte(contents.xml_start), what);
        if contents.scans.is_empty() {
            return Err(bad(
                "the XML that begins here lists no scans; there are no points in this file".into()
            ));
        }
        let (scans, mut schema) =
            scan::all(&contents.scans).map_err(|what| bad(format!("in the XML that begins here, {what}")))?;
        // All together: scans may claim the same bytes.
        let (mut bits, mut constant) = (0_u128, 0_u64);
        for (index, scan) in scans.iter().enumerate() {
            bits = bits.saturating_add(scan.record_bits() as u128 * u128::from(scan.records));
            constant = constant.saturating_add(if scan.record_bits() == 0 { scan.records } else { 0 });
            if bits > 8 * u128::from(pages.content_bytes()) || constant > CONSTANT_POINTS {
                return Err(bad(format!(
                    "the XML that begins here says that scan {index} has {} points of {} bits, which do not fit into \
                     the file; it is cut off or damaged",
                    scan.records,
                    scan.record_bits()
                )));
            }
        }
        schema.crs.clone_from(&contents.crs);
        schema.description = describe(&contents);
        let count = scans.iter().fold(0_u64, |sum, scan| sum.saturating_add(scan.records));
        let reader = Self {
            pages,
            xml_start: contents.xml_start,
            raw: vec![Vec::new(); scans.iter().map(|scan| scan.fields.len()).max().unwrap_or(0)],
            scans,
            begun: 0,
            packets: None,
            left: 0,
        };
        Ok(FileSource::new(path, schema, Some(count), reader))
    }

    /// Begins the next scan that has points. Returns false if there is none.
    fn next_scan(&mut self) -> Result<bool, ReadError> {
        while let Some(scan) = self.scans.get(self.begun) {
            self.begun += 1;
            if scan.records > 0 {
                let bits: Vec<usize> = scan.fields.iter().map(|field| field.bits()).collect();
                self.packets = Some(Packets::open(&mut self.pages, scan.section, &bits, self.xml_start)?);
                self.left = scan.records;
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Appends points of the current scan.
    fn append(&mut self, request: &Request<'_>, batch: &mut PointBatch) -> Result<(), ReadError> {
        let index = self.begun - 1;
        let (scan, Some(packets)) = (&self.scans[index], &mut self.packets) else { return Ok(()) };
        let most = request.most.min(ROWS).min(usize::try_from(self.left).unwrap_or(usize::MAX));
        let rows = packets.available(&mut self.pages, most)?;
        for field in wanted(scan, request.selected) {
            packets.numbers(field, rows, &mut self.raw[field]);
        }
        packets.pass(rows);
        self.left -= rows as u64;
        let decoded = Decoded { scan, raw: &self.raw };
        batch.position.extend((0..rows).map(|row| decoded.position(row)));
        for (column, &selected) in batch.columns.iter_mut().zip(request.selected) {
            decoded.append(scan.origins[selected], index, rows, column);
        }
        Ok(())
    }
}

/// The fields of a scan that the coordinates and the selected columns are made of.
fn wanted(scan: &Scan, selected: &[usize]) -> Vec<usize> {
    let coordinates = [scan.cartesian, scan.spherical];
    let coordinates = coordinates.iter().flatten().flat_map(|c| c.fields.into_iter().chain(c.invalid));
    let mut fields: Vec<usize> = coordinates.collect();
    for &column in selected {
        match scan.origins[column] {
            Origin::Missing | Origin::ScanIndex => {}
            Origin::Field { field, invalid } | Origin::Color { field, invalid, .. } => {
                fields.extend([Some(field), invalid].into_iter().flatten());
            }
            Origin::Vector { fields: vector, .. } => fields.extend(vector),
        }
    }
    fields.sort_unstable();
    fields.dedup();
    fields
}

/// The numbers of some points of a scan.
struct Decoded<'a> {
    scan: &'a Scan,
    raw: &'a [Vec<u64>],
}

impl Decoded<'_> {
    fn value(&self, field: usize, row: usize) -> f64 {
        self.scan.fields[field].value(self.raw[field][row])
    }

    /// Whether a field that says what is invalid does so. Some writers make it a float.
    fn is_invalid(&self, field: Option<usize>, row: usize) -> bool {
        field.is_some_and(|field| self.value(field, row) != 0.0)
    }

    fn three(&self, fields: [usize; 3], row: usize) -> DVec3 {
        DVec3::from_array(fields.map(|field| self.value(field, row)))
    }

    /// The place of a point in the coordinates of the file; NaN if it has none.
    fn position(&self, row: usize) -> [f64; 3] {
        let valid =
            |coordinates: &Option<Coordinates>| coordinates.filter(|c| !self.is_invalid(c.invalid, row));
        let place = if let Some(cartesian) = valid(&self.scan.cartesian) {
            self.three(cartesian.fields, row)
        } else if let Some(spherical) = valid(&self.scan.spherical) {
            let [range, azimuth, elevation] = self.three(spherical.fields, row).to_array();
            let (sin, cos) = elevation.sin_cos();
            range * DVec3::new(cos * azimuth.cos(), cos * azimuth.sin(), sin)
        } else {
            return [f64::NAN; 3];
        };
        self.scan.pose.place(place).to_array()
    }

    fn append(&self, origin: Origin, scan: usize, rows: usize, column: &mut Values) {
        match origin {
            Origin::Missing => (0..rows).for_each(|_| column.push(f64::NAN)),
            Origin::ScanIndex => (0..rows).for_each(|_| column.push(scan as f64)),
            Origin::Field { field, invalid } => {
                let number = self.scan.fields[field];
                for row in 0..rows {
                    if self.is_invalid(invalid, row) {
                        column.push(f64::NAN);
                    } else {
                        number.push(self.raw[field][row], column);
                    }
                }
            }
            Origin::Color { field, invalid, range: (min, max) } => {
                for row in 0..rows {
                    let share = (self.value(field, row) - min) / (max - min);
                    column.push(if self.is_invalid(invalid, row) { f64::NAN } else { share.clamp(0.0, 1.0) });
                }
            }
            Origin::Vector { fields, axis } => {
                (0..rows).for_each(|row| column.push(self.scan.pose.rotate(self.three(fields, row))[axis]));
            }
        }
    }
}

/// The program that wrote the file, and the instruments that it names.
fn describe(contents: &header::Contents) -> String {
    let mut words = "E57 1.0".to_owned();
    let mut add = |text: String| {
        let text = text.replace(char::is_control, " ");
        // Texts may be paths.
        if !text.trim().is_empty()
            && !text.contains(['/', '\\'])
            && !words.contains(&text)
            && words.len() < 512
        {
            words.push_str(", ");
            words.push_str(text.trim());
        }
    };
    add(contents.software.clone());
    if contents.scans.len() > 1 {
        add(format!("{} scans", contents.scans.len()));
    }
    for scan in &contents.scans {
        let parts = [&scan.sensor_vendor, &scan.sensor_model, &scan.sensor_serial];
        let parts: Vec<&str> = parts.into_iter().filter_map(|part| part.as_deref()).map(str::trim).collect();
        add(parts.join(" "));
    }
    words.truncate(words.floor_char_boundary(512));
    words
}

impl RecordReader for E57Reader {
    fn memory_needed(&self) -> u64 {
        // A buffer grows by doubling. A packet has at most 64 KiB.
        2 * (KEPT_LIMIT as u64 + (64 << 10)) + BUFFER_BYTES + (self.raw.len() * ROWS * 8) as u64
    }

    fn read(&mut self, request: &Request<'_>, batch: &mut PointBatch) -> Result<(), ReadError> {
        if self.left == 0 && !self.next_scan()? {
            return Ok(());
        }
        self.append(request, batch)
    }
}

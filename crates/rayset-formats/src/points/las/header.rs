//! The public header block.

use std::io::Read;
use std::path::Path;

use crate::points::stretch::Stretch;
use crate::points::{Place, ReadError};

/// Size in bytes of the header of LAS 1.4; LAS 1.5 adds times that do not affect the layout of the
/// points.
const KNOWN_BYTES: usize = 375;

/// Record size of each point format in bytes, without extra bytes.
const RECORD_BYTES: [u16; 11] = [20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67];

/// The contents of the header, as far as cheap checks allow consistent with itself and with the
/// length of the file.
#[derive(Debug)]
pub(super) struct Header {
    /// The minor version, such as 4 for LAS 1.4.
    pub(super) minor_version: u8,
    /// Point format, 0 to 10.
    pub(super) format: u8,
    pub(super) is_compressed: bool,
    /// Size of a point record in bytes, including extra bytes.
    pub(super) record_bytes: usize,
    pub(super) count: u64,
    /// Size of the header itself in bytes; the variable length records follow it.
    pub(super) header_bytes: u64,
    /// Byte offset of the points.
    pub(super) points_start: u64,
    /// Number of variable length records.
    pub(super) records: u32,
    /// Byte offset and number of the extended variable length records.
    pub(super) extended: (u64, u32),
    pub(super) scale: [f64; 3],
    pub(super) offset: [f64; 3],
    /// Whether the reference system is given as WKT rather than as GeoTIFF keys.
    pub(super) has_wkt: bool,
    pub(super) system: [u8; 32],
    pub(super) software: [u8; 32],
    /// Size of the file in bytes.
    pub(super) file_bytes: u64,
}

impl Header {
    /// Reads the header from a stretch that is the whole file.
    pub(super) fn read(path: &Path, file: &mut Stretch) -> Result<Self, ReadError> {
        let file_bytes = file.end();
        let bad = |byte: u64, what: String| ReadError::malformed(path, Place::Byte(byte), what);
        let mut bytes = [0; KNOWN_BYTES];
        let found = KNOWN_BYTES.min(usize::try_from(file_bytes).unwrap_or(KNOWN_BYTES));
        file.read_exact(&mut bytes[..found]).map_err(ReadError::io(path))?;
        if bytes[..4] != *b"LASF" {
            return Err(bad(0, "the file does not begin with `LASF`, so it is neither LAS nor LAZ".into()));
        }
        let (major, minor) = (bytes[24], bytes[25]);
        if major != 1 || minor > 5 {
            return Err(bad(24, format!("LAS {major}.{minor} is unknown; 1.0 to 1.5 can be read")));
        }
        let least = match minor {
            0..=2 => 227,
            3 => 235,
            _ => KNOWN_BYTES,
        };
        if found < least {
            let what = format!("the file ends within its header, which takes {least} bytes in LAS 1.{minor}");
            return Err(bad(file_bytes, what));
        }
        let [u16_at, u32_at, u64_at] = [2, 4, 8].map(|size| {
            let bytes = &bytes;
            move |at: usize| bytes[at..at + size].iter().rev().fold(0_u64, |v, &b| v << 8 | u64::from(b))
        });
        let three = |at: usize| [0, 8, 16].map(|step| f64::from_bits(u64_at(at + step)));
        let header_bytes = u16_at(94);
        if header_bytes < least as u64 {
            let what = format!("a header of {header_bytes} bytes, where LAS 1.{minor} has {least} or more");
            return Err(bad(94, what));
        }
        let points_start = u32_at(96);
        if points_start < header_bytes || points_start > file_bytes {
            let what = format!(
                "points are said to begin at byte {points_start}, and must after the header of {header_bytes} bytes \
                 and before the end of the file of {file_bytes} bytes; the file is cut off or damaged"
            );
            return Err(bad(96, what));
        }
        let format = bytes[104] & 0x3f;
        let Some(&record_least) = RECORD_BYTES.get(usize::from(format)) else {
            return Err(bad(104, format!("point format {format} is unknown; 0 to 10 can be read")));
        };
        let record_bytes = u16_at(105);
        if record_bytes < u64::from(record_least) {
            let what = format!(
                "points of {record_bytes} bytes, where point format {format} has {record_least} or more"
            );
            return Err(bad(105, what));
        }
        let (scale, offset) = (three(131), three(155));
        for (at, numbers) in [(131, scale), (155, offset)] {
            if let Some(axis) = numbers.iter().position(|v| !v.is_finite()) {
                let byte = at + 8 * axis as u64;
                return Err(bad(byte, format!("a scale or offset of {}, which is no number", numbers[axis])));
            }
        }
        // A nonzero legacy count takes precedence over the 64-bit one, as the specification
        // requires if they differ.
        let (legacy, is_14) = (u32_at(107), minor >= 4);
        Ok(Self {
            minor_version: minor,
            format,
            is_compressed: bytes[104] & 0xc0 != 0,
            record_bytes: record_bytes as usize,
            count: if is_14 && legacy == 0 { u64_at(247) } else { legacy },
            header_bytes,
            points_start,
            records: u32_at(100) as u32,
            extended: if is_14 { (u64_at(235), u32_at(243) as u32) } else { (0, 0) },
            scale,
            offset,
            has_wkt: is_14 && u16_at(6) & 16 != 0,
            system: std::array::from_fn(|i| bytes[26 + i]),
            software: std::array::from_fn(|i| bytes[58 + i]),
            file_bytes,
        })
    }

    /// Number of bytes of a point beyond those of its format.
    pub(super) fn extra_bytes(&self) -> usize {
        self.record_bytes - usize::from(RECORD_BYTES[usize::from(self.format)])
    }

    /// Upper bound on the byte offset of the end of the points: extended records come after all
    /// points.
    pub(super) fn points_end(&self) -> u64 {
        let (start, number) = self.extended;
        if number > 0 && start >= self.points_start { start.min(self.file_bytes) } else { self.file_bytes }
    }
}

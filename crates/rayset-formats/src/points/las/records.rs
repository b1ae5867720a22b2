//! Variable length records, and extended ones: the few that are needed are read, and all others are
//! skipped.

use std::io::Read;
use std::path::Path;

use super::header::Header;
use crate::points::stretch::Stretch;
use crate::points::{Place, ReadError};
use rayset_store::storage::input_file::Shared;

/// Longest record that is read, in bytes. Ordinary records cannot be longer.
const LONGEST: u64 = 64 << 10;
/// Largest number of extended records that are examined; points need none of them, and files have
/// only a few.
const EXTENDED_LOOKED_AT: u32 = 100_000;
/// Size in bytes of the head of a record: of an ordinary one, and of an extended one.
const PREFIX: [u64; 2] = [54, 60];

/// The contents of the records that are needed, each from the first record of its kind.
#[derive(Default)]
pub(super) struct Records {
    /// How points are compressed.
    pub(super) laszip: Option<Vec<u8>>,
    /// The descriptors of the extra bytes of points.
    pub(super) extra_bytes: Option<Vec<u8>>,
    /// The reference system as WKT.
    pub(super) wkt: Option<Vec<u8>>,
    /// The reference system as the key directory of GeoTIFF.
    pub(super) geo_keys: Option<Vec<u8>>,
}

impl Records {
    /// Reads the records of a file.
    pub(super) fn read(path: &Path, file: &Shared, header: &Header) -> Result<Self, ReadError> {
        let mut records = Self::default();
        let ordinary = (header.header_bytes, header.records);
        records.walk(path, file, ordinary, header.points_start, false)?;
        let (start, number) = header.extended;
        if number > 0 {
            records.walk(path, file, (start, number), header.file_bytes, true)?;
        }
        Ok(records)
    }

    /// Visits `number` records from byte `start` on, which must all end by byte `end`.
    fn walk(
        &mut self,
        path: &Path,
        file: &Shared,
        (start, number): (u64, u32),
        end: u64,
        extended: bool,
    ) -> Result<(), ReadError> {
        let prefix = PREFIX[usize::from(extended)];
        let bad = |byte: u64, what: String| {
            let what = format!("{what}; the file is cut off or damaged");
            ReadError::malformed(path, Place::Byte(byte), what)
        };
        let kind = if extended { "extended variable length records" } else { "variable length records" };
        let least = prefix * u64::from(number);
        if start.checked_add(least).is_none_or(|least_end| least_end > end) {
            let byte = if extended { 235 } else { 100 };
            let what = format!(
                "{number} {kind} from byte {start} take at least {least} bytes and must end before byte {end}"
            );
            return Err(bad(byte, what));
        }
        let mut input = Stretch::new(file, start, end).buffered();
        let mut at = start;
        let looked_at = if extended { number.min(EXTENDED_LOOKED_AT) } else { number };
        for index in 0..looked_at {
            let mut bytes = [0; PREFIX[1] as usize];
            let contents_start = at + prefix;
            if contents_start > end {
                return Err(bad(
                    at,
                    format!("record {} of {number} {kind} goes beyond byte {end}", index + 1),
                ));
            }
            input.read_exact(&mut bytes[..prefix as usize]).map_err(ReadError::io(path))?;
            let length_bytes = if extended { 8 } else { 2 };
            let length = bytes[20..20 + length_bytes].iter().rev().fold(0_u64, |v, &b| v << 8 | u64::from(b));
            let Some(next) = contents_start.checked_add(length).filter(|&next| next <= end) else {
                let what = format!(
                    "record {} of {number} {kind} claims {length} bytes, and must end before byte {end}",
                    index + 1
                );
                return Err(bad(at, what));
            };
            let id = u16::from_le_bytes([bytes[18], bytes[19]]);
            let user = bytes[2..18].split(|&b| b == 0).next().unwrap_or_default();
            match self.wanted(user, id, extended).filter(|_| length <= LONGEST) {
                Some(contents) => {
                    let mut read = vec![0; length as usize];
                    input.read_exact(&mut read).map_err(ReadError::io(path))?;
                    *contents = Some(read);
                }
                // A length is less than that of the file, which fits.
                None => input.seek_relative(length as i64).map_err(ReadError::io(path))?,
            }
            at = next;
        }
        Ok(())
    }

    /// Where to store the contents of a record; `None` if it is not needed.
    fn wanted(&mut self, user: &[u8], id: u16, extended: bool) -> Option<&mut Option<Vec<u8>>> {
        let place = match (user, id) {
            (b"laszip encoded", 22204) if !extended => &mut self.laszip,
            (b"LASF_Spec", 4) => &mut self.extra_bytes,
            (b"LASF_Projection", 2112) => &mut self.wkt,
            (b"LASF_Projection", 34735) => &mut self.geo_keys,
            _ => return None,
        };
        place.is_none().then_some(place)
    }
}

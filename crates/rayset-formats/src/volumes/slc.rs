//! SLC, of the volume visualization group at Stony Brook (`.slc`): a header in text, a picture,
//! slices of bytes that are plain or run-length encoded.
//!
//! The layout is that of VTK's `vtkSLCReader`. As there, encoded slices may end one voxel early if
//! all of them do; the last voxel of a slice is then as the one before it.

use std::io::{self, BufRead, BufReader, Read};
use std::path::Path;

use super::data::{VoxelSpan, data_at, regular_file_bytes};
use rayset_base::geometry::{DAffine3, DVec3};
use rayset_base::numbers::Stored;
use rayset_files::grid::VolumeError;
use rayset_files::grid::{Described, VolumeSource, Voxels};

const MAGIC: &str = "11111";
/// Longest header in bytes.
const MOST_HEADER_BYTES: u64 = 1024;
/// Words before the mark: the magic number, sizes, bits, spacings, unit, origin, changes,
/// compression, size of the picture.
const HEADER_WORDS: usize = 14;
/// Ends the header, and the length of each compressed slice.
const MARK: u8 = b'X';
/// Largest number of characters of the length of a slice.
const MOST_DIGITS: usize = 20;
/// A code encodes at most 127 bytes in two.
const MOST_RATIO: u64 = 64;

/// Whether a file begins with a whole header. Other files of numbers may begin with the first of
/// them.
pub(super) fn is_slc(head: &[u8]) -> bool {
    let header = head.split(|byte| *byte == MARK).next().filter(|header| header.len() < head.len());
    let text = header.map(String::from_utf8_lossy).unwrap_or_default();
    let mut words = text.split_ascii_whitespace();
    words.next() == Some(MAGIC)
        && words.clone().count() == HEADER_WORDS - 1
        && words.all(|w| w.parse::<f64>().is_ok())
}

pub(super) fn open(path: &Path) -> Result<VolumeSource, VolumeError> {
    let wrong = |what: &str| VolumeError::header(path, "its header", what);
    let mut head = Vec::new();
    let mut file = data_at(path, 0)?.take(MOST_HEADER_BYTES);
    file.read_until(MARK, &mut head).map_err(super::data::io_error(path))?;
    let text = head.strip_suffix(&[MARK]).ok_or_else(|| wrong("expected numbers that end with an X"))?;
    let text = String::from_utf8_lossy(text);
    let words: Vec<&str> = text.split_ascii_whitespace().collect();
    if words.len() != HEADER_WORDS || words[0] != MAGIC {
        return Err(wrong("expected 11111 and 13 numbers that end with an X"));
    }
    let count = |at: usize, name: &str| {
        let what = format!("number {}, {name}: expected a whole number, and found `{}`", at + 1, words[at]);
        words[at].parse::<u64>().map_err(|_| wrong(&what))
    };
    let size = [count(1, "size")?, count(2, "size")?, count(3, "size")?];
    if words[4] != "8" {
        return Err(wrong(&format!("voxels of {} bits; those of 8 are read", words[4])));
    }
    let mut spacing = [0.0; 3];
    for (axis, one) in spacing.iter_mut().enumerate() {
        let number = words[5 + axis].parse().ok().filter(|v: &f64| v.is_finite());
        *one = number.ok_or_else(|| wrong(&format!("number {}, spacing: expected a number", 6 + axis)))?;
    }
    let described = Described {
        size,
        stored: Stored::U8,
        big_endian: false,
        scale: 1.0,
        offset: 0.0,
        space_from_voxel: DAffine3::from_scale(DVec3::from_array(spacing)),
        size_place: "its header, size".into(),
        axes_place: "its header, spacing".into(),
    };
    let bytes = described.check(path)?;
    // Red, green and blue of a small picture.
    let picture = count(12, "width")?.saturating_mul(count(13, "height")?).saturating_mul(3);
    let start = picture.saturating_add(head.len() as u64);
    let place = VoxelSpan { path, start, bytes, rest: None };
    let (voxels, missing) = match words[11] {
        "0" => (place.plain()?, 0),
        "1" => encoded(&place, size)?,
        other => return Err(wrong(&format!("compression {other}; 0 (none) and 1 (run-length) are read"))),
    };
    let source = VolumeSource::new(&described, bytes, voxels);
    if missing == 0 {
        return Ok(source);
    }
    Ok(source.with_about("every slice ends one voxel early: its last voxel is as the one before it".into()))
}

/// Opens slices that are run-length encoded; also returns by how many voxels each of them ends
/// early.
fn encoded(place: &VoxelSpan<'_>, size: [u64; 3]) -> Result<(Voxels, u64), VolumeError> {
    let (path, bytes) = (place.path.to_owned(), place.bytes);
    let left = regular_file_bytes(&path)?.saturating_sub(place.start);
    if bytes / MOST_RATIO > left {
        let what =
            format!("the file ends before all voxels are there: {left} compressed bytes cannot hold {bytes}");
        return Err(VolumeError::Data { path, offset: 0, what });
    }
    let slice = size[0] * size[1];
    // The first slice says of all whether they end early. Where it is damaged, reading it says how.
    let mut first = Slices::new(data_at(&path, place.start)?, slice - 1, 1, 0);
    let is_short = io::copy(&mut first, &mut io::sink()).is_ok_and(|voxels| voxels == slice - 1);
    let missing = u64::from(is_short);
    let slices = Slices::new(data_at(&path, place.start)?, slice, size[2], missing);
    Ok((Voxels { path, data: Box::new(slices), rest: Some(0) }, missing))
}

/// What the next bytes of a slice are.
#[derive(Clone, Copy)]
enum Run {
    /// So many times a byte.
    Same(u8, u8),
    /// So many bytes of the file.
    Copy(u8),
}

/// Slices that are run-length encoded, each after its length in text. A code is a count in seven
/// bits; with the eighth, so many bytes follow, and else one that is repeated. A count of 0 ends a
/// slice.
struct Slices<R> {
    data: BufReader<R>,
    slice_bytes: u64,
    /// Slices still to begin.
    slices: u64,
    /// Bytes still to come of this slice, and the encoded ones.
    left: u64,
    packed: u64,
    run: Run,
    /// By how many voxels each slice ends early, and its last voxel so far.
    missing: u64,
    last: u8,
}

fn invalid(what: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, what)
}

impl<R: Read> Slices<BufReader<R>> {
    fn new(data: BufReader<R>, slice_bytes: u64, slices: u64, missing: u64) -> Self {
        let (data, run) = (BufReader::new(data), Run::Copy(0));
        Self { data, slice_bytes, slices, left: 0, packed: 0, run, missing, last: 0 }
    }
}

impl<R: Read> Slices<R> {
    fn byte(&mut self) -> io::Result<u8> {
        let mut byte = [0];
        self.data.read_exact(&mut byte)?;
        Ok(byte[0])
    }

    /// A byte of the encoded slice.
    fn packed_byte(&mut self) -> io::Result<u8> {
        self.packed =
            self.packed.checked_sub(1).ok_or_else(|| invalid("a slice goes on behind its length".into()))?;
        self.byte()
    }

    /// Reads the length of the next slice; false behind the last.
    fn begin(&mut self) -> io::Result<bool> {
        if self.slices == 0 {
            return Ok(false);
        }
        let mut text = Vec::new();
        loop {
            match self.byte()? {
                MARK => break,
                letter if text.len() < MOST_DIGITS => text.push(letter),
                _ => return Err(invalid("expected the length of a slice and an X".into())),
            }
        }
        let length = std::str::from_utf8(&text).ok().and_then(|text| text.trim().parse().ok());
        let wrong =
            || invalid(format!("expected the length of a slice, and found `{}`", text.escape_ascii()));
        self.packed = length.ok_or_else(wrong)?;
        (self.left, self.slices) = (self.slice_bytes, self.slices - 1);
        Ok(true)
    }

    /// Reads the next code; false behind the last slice.
    fn refill(&mut self) -> io::Result<bool> {
        if self.left == 0 && self.packed == 0 && !self.begin()? {
            return Ok(false);
        }
        let code = self.packed_byte()?;
        let count = code & 0x7f;
        match (u64::from(count), self.left) {
            (0, 0) if self.packed == 0 => self.run = Run::Copy(0),
            (0, 0) => return Err(invalid("a slice ends before its length".into())),
            (0, left) if left == self.missing && self.packed == 0 => {
                (self.run, self.left) = (Run::Same(left as u8, self.last), 0);
                return Ok(true);
            }
            (0, left) => return Err(invalid(format!("a slice ends {left} voxels early"))),
            (count, left) if count > left => return Err(invalid("a slice has too many voxels".into())),
            _ if code & 0x80 != 0 => self.run = Run::Copy(count),
            _ => self.run = Run::Same(count, self.packed_byte()?),
        }
        self.left -= u64::from(count);
        Ok(true)
    }
}

impl<R: Read> Read for Slices<R> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let mut written = 0;
        while written < out.len() {
            let (Run::Same(count, _) | Run::Copy(count)) = self.run;
            if count == 0 {
                if !self.refill()? {
                    break;
                }
                continue;
            }
            let now = usize::from(count).min(out.len() - written);
            let to = &mut out[written..written + now];
            match &mut self.run {
                Run::Same(count, byte) => {
                    to.fill(*byte);
                    *count -= now as u8;
                }
                Run::Copy(count) => {
                    self.packed = self
                        .packed
                        .checked_sub(now as u64)
                        .ok_or_else(|| invalid("a slice goes on behind its length".into()))?;
                    self.data.read_exact(to)?;
                    *count -= now as u8;
                }
            }
            self.last = to.last().copied().unwrap_or(self.last);
            written += now;
        }
        Ok(written)
    }
}

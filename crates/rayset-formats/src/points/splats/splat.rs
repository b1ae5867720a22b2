//! Gaussian splats as `.splat` (antimatter15): records of 32 bytes without a header. Positions and
//! deviations are floats, colours and opacity bytes, and so is the rotation, which is not read.

use std::io::{self, Read, Seek};
use std::path::{Path, PathBuf};

use super::gaussian::{Gaussian, GaussianColumns};
use super::ply::UP;
use crate::points::{ColorDepth, Place, PointBatch, PointSource, ReadError, Schema};
use rayset_store::storage::input_file::InputFile;

const RECORD_BYTES: usize = 32;
/// Gaussians decoded at a time.
const CHUNK: usize = 4096;
/// Records by which a file is taken for one of splats.
const EXAMINED: usize = 256;

/// The Gaussians of a `.splat` file.
#[derive(Debug)]
pub(in crate::points) struct SplatSource {
    path: PathBuf,
    file: InputFile,
    count: u64,
    next: u64,
    columns: GaussianColumns,
    buffer: Vec<u8>,
}

impl SplatSource {
    /// Opens a file.
    ///
    /// # Errors
    /// [`ReadError`] if it cannot be read, or its size or its first records are not those of
    /// splats.
    pub(in crate::points) fn open(path: &Path) -> Result<Self, ReadError> {
        let io = |source| ReadError::Io { path: path.to_owned(), source };
        let fail = |byte: u64, what: String| ReadError::malformed(path, Place::Byte(byte), what);
        let mut file = InputFile::open(path).map_err(io)?;
        let bytes = file.length().map_err(io)?;
        if bytes == 0 || bytes % RECORD_BYTES as u64 != 0 {
            let what =
                format!("{bytes} bytes are no whole number of splats, which have {RECORD_BYTES} bytes each");
            return Err(fail(bytes - bytes % RECORD_BYTES as u64, what));
        }
        let mut start = Vec::new();
        (&mut file).take((EXAMINED * RECORD_BYTES) as u64).read_to_end(&mut start).map_err(io)?;
        file.rewind().map_err(io)?;
        let records = start.chunks_exact(RECORD_BYTES);
        let (examined, wrong) = (records.len(), records.filter(|record| !is_plausible(record)).count());
        if 2 * wrong > examined {
            let what = format!(
                "not a file of splats: {wrong} of its first {examined} records have no finite position, or no deviations"
            );
            return Err(fail(0, what));
        }
        let columns = GaussianColumns::new("splat", ColorDepth::Byte, false, UP);
        let count = bytes / RECORD_BYTES as u64;
        Ok(Self { path: path.to_owned(), file, count, next: 0, columns, buffer: Vec::new() })
    }

    /// Reads the next `count` records into the buffer.
    fn read(&mut self, count: usize) -> Result<(), ReadError> {
        self.buffer.resize(count * RECORD_BYTES, 0);
        self.file.read_exact(&mut self.buffer).map_err(|source| {
            if source.kind() == io::ErrorKind::UnexpectedEof {
                let what =
                    format!("the file has become shorter: it had {} splats when it was opened", self.count);
                return ReadError::malformed(&self.path, Place::Byte(self.next * RECORD_BYTES as u64), what);
            }
            ReadError::Io { path: self.path.clone(), source }
        })
    }
}

/// The float at the beginning of some bytes.
pub(super) fn float(bytes: &[u8]) -> f64 {
    f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]).into()
}

/// Three floats.
pub(super) fn floats(bytes: &[u8]) -> [f64; 3] {
    [0, 4, 8].map(|at| float(&bytes[at..]))
}

fn is_plausible(record: &[u8]) -> bool {
    let sane = |v: &f64| v.is_finite() && v.abs() < 1e18;
    floats(record).iter().all(sane) && floats(&record[12..]).iter().all(|v| sane(v) && *v >= 0.0)
}

impl PointSource for SplatSource {
    fn schema(&self) -> &Schema {
        &self.columns.schema
    }

    fn count_hint(&self) -> Option<u64> {
        Some(self.count)
    }

    fn path(&self) -> Option<&Path> {
        Some(&self.path)
    }

    fn memory_needed(&self) -> u64 {
        (CHUNK * RECORD_BYTES) as u64
    }

    fn select(&mut self, columns: &[usize]) {
        self.columns.selected = columns.to_vec();
    }

    fn fill(&mut self, batch: &mut PointBatch, limit: usize) -> Result<(), ReadError> {
        batch.reset(&self.columns.schema, &self.columns.selected);
        while batch.len() < limit && self.next < self.count {
            let chunk = (self.count - self.next).min(CHUNK.min(limit - batch.len()) as u64);
            self.read(chunk as usize)?;
            for record in self.buffer.chunks_exact(RECORD_BYTES) {
                let gaussian = Gaussian {
                    position: floats(record),
                    deviations: floats(&record[12..]),
                    color: [24, 25, 26].map(|at| f64::from(record[at])),
                    opacity: f64::from(record[27]) / 255.0,
                };
                self.columns.append(&gaussian, batch);
            }
            self.next += chunk;
        }
        Ok(())
    }
}

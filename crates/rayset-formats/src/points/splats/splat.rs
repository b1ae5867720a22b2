//! Gaussian splats as `.splat` (antimatter15): records of 32 bytes without a header. Positions and
//! deviations are floats, colours and opacity bytes, and so is the rotation, which is not read.

use std::io::{Read, Seek};
use std::path::Path;

use super::gaussian::{self, COLUMNS, Gaussian};
use super::harmonics::Harmonics;
use super::ply::UP;
use crate::points::file_source::{FileSource, RecordReader, Request, unreadable};
use crate::points::{ColorDepth, Place, PointBatch, ReadError};
use rayset_store::storage::input_file::InputFile;

const RECORD_BYTES: usize = 32;
/// Gaussians decoded at a time.
const CHUNK: usize = 4096;
/// Records by which a file is taken for one of splats.
const EXAMINED: usize = 256;

/// The Gaussians of a `.splat` file.
pub(in crate::points) struct SplatReader {
    file: InputFile,
    buffer: Vec<u8>,
}

impl SplatReader {
    /// Opens a file.
    ///
    /// # Errors
    /// [`ReadError`] if it cannot be read, or its size or its first records are not those of
    /// splats.
    pub(in crate::points) fn open(path: &Path) -> Result<FileSource<Self>, ReadError> {
        let fail = |byte: u64, what: String| ReadError::malformed(path, Place::Byte(byte), what);
        let mut file = InputFile::open(path).map_err(ReadError::io(path))?;
        let bytes = file.length().map_err(ReadError::io(path))?;
        if bytes == 0 || bytes % RECORD_BYTES as u64 != 0 {
            let what =
                format!("{bytes} bytes are no whole number of splats, which have {RECORD_BYTES} bytes each");
            return Err(fail(bytes - bytes % RECORD_BYTES as u64, what));
        }
        let mut start = Vec::new();
        (&mut file)
            .take((EXAMINED * RECORD_BYTES) as u64)
            .read_to_end(&mut start)
            .map_err(ReadError::io(path))?;
        file.rewind().map_err(ReadError::io(path))?;
        let records = start.chunks_exact(RECORD_BYTES);
        let (examined, wrong) = (records.len(), records.filter(|record| !is_plausible(record)).count());
        if 2 * wrong > examined {
            let what = format!(
                "not a file of splats: {wrong} of its first {examined} records have no finite position, or no deviations"
            );
            return Err(fail(0, what));
        }
        let schema = gaussian::schema("splat", ColorDepth::Byte, 0, UP);
        let reader = Self { file, buffer: Vec::new() };
        Ok(FileSource::new(path, schema, Some(bytes / RECORD_BYTES as u64), reader))
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

impl RecordReader for SplatReader {
    fn memory_needed(&self) -> u64 {
        (CHUNK * RECORD_BYTES) as u64
    }

    fn read(&mut self, request: &Request<'_>, batch: &mut PointBatch) -> Result<(), ReadError> {
        self.buffer.resize(request.most.min(CHUNK) * RECORD_BYTES, 0);
        let read = self.file.read_exact(&mut self.buffer);
        read.map_err(|e| unreadable(request.path(), request.first * RECORD_BYTES as u64, e))?;
        for record in self.buffer.chunks_exact(RECORD_BYTES) {
            let gaussian = Gaussian {
                position: floats(record),
                deviations: floats(&record[12..]),
                color: [24, 25, 26].map(|at| f64::from(record[at])),
                opacity: f64::from(record[27]) / 255.0,
                // w comes first.
                harmonics: Harmonics::NONE,
                rotation: [29, 30, 31, 28].map(|at| (f64::from(record[at]) - 128.0) / 128.0),
            };
            gaussian.append(COLUMNS, request.selected, batch);
        }
        Ok(())
    }
}

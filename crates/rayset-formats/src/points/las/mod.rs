//! LAS 1.0 to 1.5 and LAZ, in batches.
//!
//! Follows the ASPRS LAS Specification 1.4 R15 and, for compressed points, LASzip as its authors
//! describe it (M. Isenburg, "LASzip: lossless compression of LiDAR data", 2013, and the layout of
//! its record and tables in LASzip itself). The `laz` crate decompresses the records, except for
//! the items with GPS times, for which a few bytes could make it recurse until its stack overflows.
//! Everything around the records is read here, because a length in a file is only a claim: each is
//! checked against the file before it is used to allocate or to skip. Memory does not grow with the
//! file, its extended records or its number of chunks. Only a chunk of points compressed in layers
//! (point formats 6 to 10) is held as a whole, which
//! [`memory_needed`](super::PointSource::memory_needed) includes.
//!
//! Not supported: waveforms, the hierarchy of COPC files (their points are read in file order), and
//! LASzip's compatibility mode, in which points of formats 6 to 10 are stored as other formats;
//! they are read in the format in which they are stored.

mod chunk_table;
mod compressed;
mod fields;
mod gps_time;
mod header;
mod method;
mod point14;
mod records;
mod trouble;
mod words;

use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use laz::DecompressionSelection as Layers;

use self::compressed::CompressedPoints;
use self::fields::Field;
use self::header::Header;
use self::method::Method;
use self::records::Records;
use self::trouble::Trouble;
use super::file_source::{FileSource, RecordReader, Request};
use super::stretch::Stretch;
use super::{ColorDepth, Place, PointBatch, PointSource, ReadError, Schema, quiet};
use rayset_store::storage::input_file::Shared;

/// Bytes of records that are decoded at a time; a longer record is decoded on its own.
const BLOCK_BYTES: usize = 128 << 10;

/// Opens a LAS or LAZ file, whatever its coordinates are.
///
/// # Errors
/// [`ReadError`] if the file cannot be opened, is truncated, or violates its format.
pub fn open_las(path: &Path) -> Result<impl PointSource + use<>, ReadError> {
    LasReader::open(path)
}

/// The records of a LAS or LAZ file.
pub(super) struct LasReader {
    header: Header,
    fields: Vec<Field>,
    points: Points,
    block: Vec<u8>,
    /// The decompressor has panicked, and its state is unusable.
    is_broken: bool,
}

enum Points {
    Plain(Stretch),
    Compressed(Box<CompressedPoints>),
}

impl LasReader {
    /// Opens a file, reads its header and variable length records, and checks them against the
    /// file.
    ///
    /// # Errors
    /// [`ReadError`] if the file cannot be opened, is truncated, or violates its format.
    pub(super) fn open(path: &Path) -> Result<FileSource<Self>, ReadError> {
        let file = Shared::open(path).map_err(ReadError::io(path))?;
        let file_bytes = file.length().map_err(ReadError::io(path))?;
        let header = Header::read(path, &mut Stretch::new(&file, 0, file_bytes))?;
        let records = Records::read(path, &file, &header)?;
        let points = if header.is_compressed {
            let bad = |byte, what| ReadError::malformed(path, Place::Byte(byte), what);
            let record = records.laszip.as_deref().ok_or_else(|| {
                bad(header.header_bytes, "points are compressed, and no LASzip record says how".to_owned())
            })?;
            let method = Method::read(&header, record).map_err(|what| bad(header.header_bytes, what))?;
            let opened = quiet::catch(|| CompressedPoints::open(&file, &header, method));
            match opened {
                Some(Ok(points)) => Points::Compressed(Box::new(points)),
                Some(Err(Trouble::Io(source))) => return Err(ReadError::io(path)(source)),
                Some(Err(Trouble::Damaged { byte, what })) => return Err(bad(byte, what)),
                None => return Err(bad(header.points_start, "the table of chunks is damaged".to_owned())),
            }
        } else {
            Points::Plain(plain_points(path, &file, &header)?)
        };
        let fields = fields::of_file(&header, records.extra_bytes.as_deref());
        // The specification requires 16-bit colours, but many writers store 8-bit ones.
        let schema = Schema {
            crs: match words::reference_system(&header, &records) {
                crs if crs.is_empty() && is_in_degrees(&header) => "EPSG:4326".to_owned(),
                crs => crs,
            },
            description: words::description(&header),
            step: Some(header.scale.map(f64::abs)).filter(|step| step.iter().all(|&v| v > 0.0)),
            ..Schema::new(fields.iter().map(|f| f.info.clone()).collect(), ColorDepth::Guess)
        };
        let count = header.count;
        let reader = Self { header, fields, points, block: Vec::new(), is_broken: false };
        Ok(FileSource::new(path, schema, Some(count), reader))
    }

    /// Fills the block with the next `points` points.
    fn read_block(&mut self, request: &Request<'_>, points: usize) -> Result<(), ReadError> {
        let record_bytes = self.header.record_bytes;
        self.block.resize(points * record_bytes, 0);
        let mut done = 0;
        let trouble = match &mut self.points {
            Points::Plain(stretch) => {
                let byte = self.header.points_start + request.first * record_bytes as u64;
                let what = "the points end here, since the file was made shorter while it was read";
                let read = stretch.read_exact(&mut self.block);
                read.map_err(|e| Trouble::from_io(e, byte, what)).err()
            }
            Points::Compressed(compressed) if !self.is_broken => {
                match quiet::catch(|| compressed.read(&mut self.block, &mut done)) {
                    Some(result) => result.err(),
                    None => {
                        self.is_broken = true;
                        Some(damaged(compressed))
                    }
                }
            }
            Points::Compressed(compressed) => Some(damaged(compressed)),
        };
        trouble.map_or(Ok(()), |trouble| Err(failed(request, trouble, done as u64)))
    }
}

/// The error of a request of which `done` points were read.
fn failed(request: &Request<'_>, trouble: Trouble, done: u64) -> ReadError {
    match trouble {
        Trouble::Io(source) => ReadError::Io { path: request.path().to_owned(), source },
        Trouble::Damaged { byte, what } => ReadError::Las {
            path: request.path().to_owned(),
            byte,
            what,
            read: request.first + done,
            count: request.count,
        },
    }
}

fn damaged(points: &CompressedPoints) -> Trouble {
    Trouble::at(points.chunk_start(), "the compressed points of the chunk that begins here are damaged")
}

/// The points of an uncompressed file, after a check that the file is long enough for them.
fn plain_points(path: &Path, file: &Shared, header: &Header) -> Result<Stretch, ReadError> {
    let (start, end) = (header.points_start, header.points_end());
    let most = (end - start) / header.record_bytes as u64;
    if header.count > most {
        let what = format!(
            "the header counts {} points of {} bytes, and the file holds at most {most} between bytes {start} and \
             {end}; it is cut off or damaged",
            header.count, header.record_bytes
        );
        return Err(ReadError::malformed(path, Place::Byte(end), what));
    }
    Ok(Stretch::new(file, start, end))
}

/// Whether coordinates are degrees, though no reference system says so: they are stored in
/// millionths or less, and heights are not.
fn is_in_degrees(header: &Header) -> bool {
    let ([x, y, z], offset) = (header.scale, header.offset);
    x.max(y) <= 1e-6 && z >= 1e-5 && offset[0].abs() <= 180.0 && offset[1].abs() <= 90.0
}

impl RecordReader for LasReader {
    fn memory_needed(&self) -> u64 {
        let block = self.header.record_bytes.max(BLOCK_BYTES) as u64;
        block
            + match &self.points {
                Points::Plain(_) => 0,
                Points::Compressed(points) => points.memory_needed(),
            }
    }

    fn select(&mut self, columns: &[usize]) {
        if let Points::Compressed(points) = &mut self.points {
            let layers = columns.iter().map(|&column| self.fields[column].layers);
            points.select(layers.fold(Layers::Z, |all, layers| all | layers));
        }
    }

    fn can_skip(&self) -> bool {
        match &self.points {
            Points::Plain(_) => true,
            Points::Compressed(points) => points.can_skip(),
        }
    }

    fn skip(&mut self, request: &Request<'_>) -> Result<bool, ReadError> {
        let count = request.most as u64;
        let trouble = match &mut self.points {
            Points::Plain(stretch) => {
                let bytes = count.saturating_mul(self.header.record_bytes as u64) as i64;
                stretch.seek(SeekFrom::Current(bytes)).map_err(Trouble::Io).err()
            }
            Points::Compressed(points) => match quiet::catch(|| points.skip(count)) {
                Some(result) => result.err(),
                None => {
                    self.is_broken = true;
                    Some(damaged(points))
                }
            },
        };
        trouble.map_or(Ok(true), |trouble| Err(failed(request, trouble, count)))
    }

    fn read(&mut self, request: &Request<'_>, batch: &mut PointBatch) -> Result<(), ReadError> {
        let record_bytes = self.header.record_bytes;
        let points = request.most.min((BLOCK_BYTES / record_bytes).max(1));
        self.read_block(request, points)?;
        let (scale, offset) = (self.header.scale, self.header.offset);
        batch.position.extend(self.block.chunks_exact(record_bytes).map(|record| {
            std::array::from_fn(|axis| {
                let steps = i32::from_le_bytes(std::array::from_fn(|i| record[4 * axis + i]));
                scale[axis] * f64::from(steps) + offset[axis]
            })
        }));
        for (column, &index) in batch.columns.iter_mut().zip(request.selected) {
            self.fields[index].append(&self.block, record_bytes, column);
        }
        Ok(())
    }
}

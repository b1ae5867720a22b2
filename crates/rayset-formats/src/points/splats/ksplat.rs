//! Gaussian splats as `.ksplat`: sections of splats, at compression levels 1 and 2 in buckets that
//! their positions are relative to. Sizes and centres of buckets, and splats, are read side by
//! side.

use std::io::{self, BufReader, Read};
use std::path::Path;

use super::gaussian::{self, Gaussian};
use super::harmonics::{self, Harmonics, MOST_REST};
use super::ksplat_header::{KsplatHeader, Level, Section};
use super::ply::UP;
use super::splat::{float, floats};
use crate::points::file_source::{FileSource, RecordReader, Request, unreadable};
use crate::points::{ColorDepth, Place, PointBatch, ReadError};
use rayset_base::numbers::half;
use rayset_files::points::harmonics::CHANNELS;
use rayset_store::storage::input_file::InputFile;

const BUFFER_BYTES: usize = 64 << 10;

/// A reader of a part of a section.
struct Part {
    input: BufReader<InputFile>,
    at: u64,
}

impl Part {
    fn open(path: &Path) -> io::Result<Self> {
        Ok(Self { input: BufReader::with_capacity(BUFFER_BYTES, InputFile::open(path)?), at: 0 })
    }

    fn read(&mut self, path: &Path, at: u64, bytes: &mut [u8]) -> Result<(), ReadError> {
        let skip = at.wrapping_sub(self.at) as i64;
        let read = self.input.seek_relative(skip).and_then(|()| self.input.read_exact(bytes));
        self.at = at + bytes.len() as u64;
        read.map_err(|source| unreadable(path, at, source))
    }
}

/// The bucket of the next Gaussian of a section.
#[derive(Clone, Copy, Debug, Default)]
struct Bucket {
    /// The number of the bucket behind it.
    next: u64,
    /// Gaussians of it that are still to be read.
    left: u64,
    center: [f64; 3],
}

/// The Gaussians of a `.ksplat` file.
pub(in crate::points) struct KsplatReader {
    header: KsplatHeader,
    /// The first column of the file's own.
    own: usize,
    headers: InputFile,
    sizes: Part,
    centers: Part,
    records: Part,
    /// The section that is read, how many are begun, where the next one starts, and the Gaussians
    /// read of this one.
    section: Option<Section>,
    begun: u64,
    start: u64,
    done: u64,
    bucket: Bucket,
}

impl KsplatReader {
    /// Opens a file and checks its headers.
    ///
    /// # Errors
    /// [`ReadError`] if it cannot be read, or its headers do not agree with each other and its
    /// size.
    pub(in crate::points) fn open(path: &Path) -> Result<FileSource<Self>, ReadError> {
        let mut headers = InputFile::open(path).map_err(ReadError::io(path))?;
        let bytes = headers.length().map_err(ReadError::io(path))?;
        let header = KsplatHeader::read(path, &mut headers, bytes)?;
        let schema = gaussian::schema("ksplat 0.1", ColorDepth::Byte, header.degree, UP);
        let part = || Part::open(path).map_err(ReadError::io(path));
        let (count, own) = (header.count, schema.columns.len());
        let reader = Self {
            own,
            headers,
            sizes: part()?,
            centers: part()?,
            records: part()?,
            section: None,
            begun: 0,
            start: header.first(),
            done: 0,
            bucket: Bucket::default(),
            header,
        };
        Ok(FileSource::new(path, schema, Some(count), reader))
    }

    /// The section of the next Gaussian; `None` behind the last.
    fn section(&mut self, path: &Path) -> Result<Option<Section>, ReadError> {
        while self.section.is_none_or(|section| self.done == section.count) {
            if self.begun == self.header.sections {
                return Ok(None);
            }
            let section = self.header.section(path, &mut self.headers, self.begun, self.start)?;
            self.start = section.end;
            self.begun += 1;
            (self.section, self.done, self.bucket) = (Some(section), 0, Bucket::default());
        }
        Ok(self.section)
    }

    /// Moves on to the bucket of the next Gaussian.
    fn advance_bucket(&mut self, path: &Path, section: &Section) -> Result<(), ReadError> {
        while self.bucket.left == 0 {
            let index = self.bucket.next;
            if index == section.buckets {
                let what = format!(
                    "the buckets of a section have only {} of its {} splats",
                    self.done, section.count
                );
                return Err(ReadError::malformed(path, Place::Byte(section.sizes_at), what));
            }
            self.bucket.left = match index.checked_sub(section.full_buckets) {
                None => section.bucket_size,
                Some(partial) => {
                    let at = section.sizes_at + 4 * partial;
                    let mut size = [0; 4];
                    // Buckets without a size are none.
                    if at < section.centers_at {
                        self.sizes.read(path, at, &mut size)?;
                    }
                    u32::from_le_bytes(size).into()
                }
            };
            let mut center = [0; 12];
            self.centers.read(path, section.centers_at + section.center_stride * index, &mut center)?;
            self.bucket.center = floats(&center);
            self.bucket.next += 1;
        }
        self.bucket.left -= 1;
        Ok(())
    }

    /// The coefficients of a Gaussian whose section has so many of a channel.
    fn harmonics(&self, color: [f64; CHANNELS], bytes: &[u8], coefficients: usize) -> Harmonics {
        let mut harmonics = Harmonics::of_color(color.map(|v| v / 255.0));
        let per_channel = harmonics::rest(self.header.degree) / CHANNELS;
        // Band after band, and in each channel after channel.
        for (first, band) in [(0, 3), (3, 5), (8, 7)].into_iter().filter(|(first, _)| *first < coefficients) {
            for i in 0..CHANNELS * band {
                let to = i / band * per_channel + first + i % band;
                harmonics.rest[to] = self.header.coefficient(bytes, CHANNELS * first + i) as f32;
            }
        }
        harmonics
    }

    /// Reads the next Gaussian of a section.
    fn gaussian(&mut self, path: &Path, section: &Section) -> Result<Gaussian, ReadError> {
        let mut record = [0; 44 + 4 * MOST_REST];
        let record = &mut record[..section.record_stride as usize];
        self.records.read(path, section.records_at + section.record_stride * self.done, record)?;
        let (position, deviations, rotation) = if self.header.level == Level::Full {
            // w comes first.
            let rotation = [28, 32, 36, 24].map(|at| float(&record[at..]));
            (floats(record), floats(&record[12..]), rotation)
        } else {
            self.advance_bucket(path, section)?;
            let short = |at: usize| u16::from_le_bytes([record[at], record[at + 1]]);
            let steps = |axis: usize| f64::from(short(2 * axis)) - f64::from(section.range);
            (
                [0, 1, 2].map(|axis| self.bucket.center[axis] + section.step * steps(axis)),
                [0, 1, 2].map(|axis| f64::from(half::from_bits(short(6 + 2 * axis)))),
                [14, 16, 18, 12].map(|at| f64::from(half::from_bits(short(at)))),
            )
        };
        self.done += 1;
        let (record, rest) = record.split_at(self.header.level.record_bytes() as usize);
        let [red, green, blue, opacity] = [4, 3, 2, 1].map(|back| f64::from(record[record.len() - back]));
        let (color, opacity) = ([red, green, blue], opacity / 255.0);
        let harmonics = self.harmonics(color, rest, section.coefficients);
        Ok(Gaussian { position, color, opacity, deviations, rotation, harmonics })
    }
}

impl RecordReader for KsplatReader {
    fn memory_needed(&self) -> u64 {
        3 * BUFFER_BYTES as u64
    }

    fn read(&mut self, request: &Request<'_>, batch: &mut PointBatch) -> Result<(), ReadError> {
        for _ in 0..request.most {
            let Some(section) = self.section(request.path())? else { break };
            self.gaussian(request.path(), &section)?.append(self.own, request.selected, batch);
        }
        Ok(())
    }
}

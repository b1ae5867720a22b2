//! Compressed points: chunk by chunk, each within its own range of bytes.
//!
//! The `laz` crate decodes the records, except for the items that contain GPS times (`gps_time`,
//! `point14`). It knows nothing about the file: its input ends where the chunk ends, and the sizes
//! by which it allocates are checked before. The chunk table is decoded along with the points,
//! entry by entry, so that memory never depends on its number of entries.

use std::io::{self, Read, Seek, SeekFrom};

use laz::record::{LayeredPointRecordDecompressor, RecordDecompressor, SequentialPointRecordDecompressor};
use laz::{DecompressionSelection, LazItem, LazItemType};

use super::chunk_table::ChunkTable;
use super::gps_time::GpsTimes;
use super::header::Header;
use super::method::{Chunking, Method};
use super::point14::Point14;
use super::trouble::Trouble;
use crate::points::stretch::{BUFFER_BYTES, Input, Stretch};
use rayset_store::storage::input_file::Shared;
use rayset_store::storage::is_of_reading;

/// Memory in bytes of the models of a point without extra bytes: 2.7 MB were measured for points
/// that are compressed one by one (format 5), and 3.4 MB for layers (format 10, all four scanner
/// channels).
const MODELS_BYTES: u64 = 3 << 20;
const LAYERED_MODELS_BYTES: u64 = 5 << 20;
/// Memory in bytes of the model of an extra byte: 256 frequencies, their sums, a table and its
/// bookkeeping.
const EXTRA_BYTE_BYTES: u64 = 2816;

enum Decoder {
    Sequential(SequentialPointRecordDecompressor<'static, Input>),
    Layered(LayeredPointRecordDecompressor<'static, Input>),
}

impl Decoder {
    fn input(&mut self) -> &mut Input {
        match self {
            Self::Sequential(decoder) => decoder.get_mut(),
            Self::Layered(decoder) => decoder.get_mut(),
        }
    }

    /// Starts a chunk at the current position of the input.
    fn start(&mut self, items: &[LazItem], layers: u32) -> Result<(), laz::LasZipError> {
        match self {
            Self::Sequential(decoder) => {
                decoder.reset();
                for item in items {
                    match (item.item_type(), item.version()) {
                        (LazItemType::GpsTime, 2) => decoder.add_field_decompressor(GpsTimes::pointwise()),
                        _ => decoder.set_fields_from(&vec![*item])?,
                    }
                }
                Ok(())
            }
            Self::Layered(decoder) => {
                decoder.reset();
                for item in items {
                    match item.item_type() {
                        LazItemType::Point14 => {
                            decoder.add_field_decompressor(Point14::of_version(item.version()));
                        }
                        _ => decoder.set_fields_from(&vec![*item])?,
                    }
                }
                decoder.set_selection(DecompressionSelection(layers));
                Ok(())
            }
        }
    }

    fn next(&mut self, record: &mut [u8]) -> io::Result<()> {
        match self {
            Self::Sequential(decoder) => decoder.decompress_next(record),
            Self::Layered(decoder) => decoder.decompress_next(record),
        }
    }
}

/// A part of the compressed points that can be decoded independently, from its start.
#[derive(Clone, Copy)]
struct Chunk {
    start: u64,
    end: u64,
    points: u64,
}

/// The compressed points of a file, in file order.
pub(super) struct CompressedPoints {
    file: Shared,
    method: Method,
    record_bytes: usize,
    decoder: Decoder,
    /// `None` if the file has no table, and its points can be decoded without one.
    table: Option<ChunkTable>,
    /// The chunk that is being read.
    chunk: Chunk,
    /// Points of the chunk that are still to come.
    left: u64,
    /// Byte offset of the end of the last chunk.
    end: u64,
    /// The selected layers, and those with which the chunk was started.
    layers: u32,
    started_layers: u32,
    /// Buffer for points that are decoded only to be skipped.
    spare: Vec<u8>,
    memory: u64,
}

impl CompressedPoints {
    /// Reads and checks the chunk table, if there is one.
    pub(super) fn open(file: &Shared, header: &Header, method: Method) -> Result<Self, Trouble> {
        let (mut start, mut end) = (header.points_start, header.points_end());
        let mut table = None;
        let mut largest = 0;
        if method.chunking != Chunking::One {
            // The offset of the table is stored before the first chunk.
            start += 8;
            let variable = method.chunking == Chunking::Variable;
            if let Some(place) = ChunkTable::find(file, header)? {
                let survey = ChunkTable::survey(file, header, place, &method)?;
                (largest, end) = (survey.largest, place);
                table = Some(ChunkTable::open(file, place, header.file_bytes, variable)?);
            } else if variable && !method.is_layered {
                let what = "chunks of different numbers of points, and no table of chunks that says how many; the \
                            file is cut off, or its writer did not finish it";
                return Err(Trouble::at(header.points_start, what));
            }
        }
        let input = Stretch::new(file, start, end).buffered();
        let decoder = if method.is_layered {
            Decoder::Layered(LayeredPointRecordDecompressor::new(input))
        } else {
            Decoder::Sequential(SequentialPointRecordDecompressor::new(input))
        };
        let mut points = Self {
            file: file.clone(),
            record_bytes: header.record_bytes,
            decoder,
            table,
            chunk: Chunk { start, end: start, points: 0 },
            left: 0,
            end,
            layers: DecompressionSelection::Z,
            started_layers: 0,
            spare: vec![0; header.record_bytes],
            memory: 0,
            method,
        };
        if points.method.is_layered && points.table.is_none() {
            largest = points.largest_without_table(header.count)?;
        }
        let buffers = 2 * BUFFER_BYTES as u64;
        let extra = points.method.extra_bytes as u64 * EXTRA_BYTE_BYTES;
        points.memory = buffers
            + if points.method.is_layered {
                LAYERED_MODELS_BYTES + 4 * extra + largest + points.method.preamble_bytes() as u64
            } else {
                MODELS_BYTES + extra
            };
        Ok(points)
    }

    /// Upper bound on the memory in bytes. A layered chunk is held as a whole.
    pub(super) fn memory_needed(&self) -> u64 {
        self.memory
    }

    /// Selects the layers that are decoded; fields of the others are undefined.
    pub(super) fn select(&mut self, layers: u32) {
        self.layers = layers;
    }

    /// Byte offset in the file of the chunk that is being read.
    pub(super) fn chunk_start(&self) -> u64 {
        self.chunk.start
    }

    /// Fills `records` with the next points. `done` counts the points that were decoded, even if an
    /// error follows.
    pub(super) fn read(&mut self, records: &mut [u8], done: &mut usize) -> Result<(), Trouble> {
        if self.left > 0 && self.layers & !self.started_layers != 0 {
            self.restart()?;
        }
        for record in records.chunks_exact_mut(self.record_bytes) {
            while self.left == 0 {
                self.chunk = self.next_chunk()?;
                self.start()?;
            }
            let decoded = self.decoder.next(record);
            decoded.map_err(|e| self.trouble(e))?;
            self.left -= 1;
            *done += 1;
        }
        Ok(())
    }

    /// Whether whole chunks can be passed over.
    pub(super) fn can_skip(&self) -> bool {
        self.table.is_some()
    }

    /// Passes over the next `count` points, of which only those are decoded that are in a chunk
    /// with others.
    pub(super) fn skip(&mut self, mut count: u64) -> Result<(), Trouble> {
        while count > 0 {
            if self.left == 0 {
                self.chunk = self.next_chunk()?;
                if self.can_skip() && self.chunk.points <= count {
                    count -= self.chunk.points;
                    continue;
                }
                self.start()?;
            }
            for _ in 0..count.min(self.left) {
                let decoded = self.decoder.next(&mut self.spare);
                decoded.map_err(|e| self.trouble(e))?;
                self.left -= 1;
                count -= 1;
            }
        }
        Ok(())
    }

    /// Converts an error of decoding a point of the chunk.
    fn trouble(&self, error: io::Error) -> Trouble {
        if error.kind() == io::ErrorKind::InvalidData && !is_of_reading(&error) {
            let what = format!("in the chunk that begins here, {error}; the file is damaged");
            return Trouble::at(self.chunk.start, what);
        }
        let what = format!(
            "the compressed points of the chunk at byte {} go on beyond its end; the file is cut off or damaged",
            self.chunk.start
        );
        Trouble::from_io(error, self.chunk.end, &what)
    }

    /// Seeks to the start of the chunk, and starts decoding it.
    fn start(&mut self) -> Result<(), Trouble> {
        let Chunk { start, end, points } = self.chunk;
        let input = self.decoder.input();
        // Without a table of the ends of chunks, the next chunk continues in the buffered input.
        if input.get_ref().end() != end || input.stream_position().map_err(Trouble::Io)? != start {
            input.seek(SeekFrom::Start(start)).map_err(Trouble::Io)?;
            input.get_mut().set(start, end);
        }
        self.left = points;
        self.started_layers = self.layers;
        let started = self.decoder.start(&self.method.items, self.layers);
        started.map_err(|e| match e {
            laz::LasZipError::IoError(error) if is_of_reading(&error) => Trouble::Io(error),
            other => Trouble::at(start, other.to_string()),
        })
    }

    /// Restarts the chunk with the layers that are selected now, and decodes up to the current
    /// point.
    fn restart(&mut self) -> Result<(), Trouble> {
        let passed = self.chunk.points - self.left;
        self.start()?;
        for _ in 0..passed {
            let decoded = self.decoder.next(&mut self.spare);
            decoded.map_err(|e| self.trouble(e))?;
            self.left -= 1;
        }
        Ok(())
    }

    /// The chunk after the current one.
    fn next_chunk(&mut self) -> Result<Chunk, Trouble> {
        let start = self.chunk.end;
        let mut end = self.end;
        let mut points = match self.method.chunking {
            Chunking::One => u64::MAX,
            Chunking::Fixed(points) => points.into(),
            Chunking::Variable => 0,
        };
        if let Some(table) = &mut self.table {
            let Some(entry) = table.next()? else {
                return Err(Trouble::at(start, "there are fewer chunks than the points need"));
            };
            end = start + entry.bytes;
            if self.method.chunking == Chunking::Variable {
                points = entry.points;
            }
            if points == 0 {
                return Ok(Chunk { start, end, points });
            }
        } else if !self.method.is_layered {
            // The end of a chunk is where its last point was decoded.
            let at = self.decoder.input().stream_position().map_err(Trouble::Io)?;
            return Ok(Chunk { start: at, end, points });
        }
        if self.method.is_layered {
            let preamble = self.preamble(start, end)?;
            end = preamble.end;
            if self.table.is_none() && self.method.chunking == Chunking::Variable {
                points = preamble.points;
            }
        }
        Ok(Chunk { start, end, points })
    }

    /// Reads what precedes the layers of a layered chunk: the number of points, and the sizes of
    /// the layers, by which the decompressor allocates. The layers must lie within the chunk.
    fn preamble(&mut self, start: u64, end: u64) -> Result<Preamble, Trouble> {
        let mut bytes = vec![0; self.method.preamble_bytes()];
        let mut stretch = Stretch::new(&self.file, start, end);
        stretch.read_exact(&mut bytes).map_err(|e| {
            let what =
                format!("the chunk at byte {start} is too short for its first point; the file is damaged");
            Trouble::from_io(e, start, &what)
        })?;
        let mut numbers = (bytes[self.record_bytes..].chunks_exact(4))
            .map(|b| u64::from(u32::from_le_bytes([b[0], b[1], b[2], b[3]])));
        let points = numbers.next().unwrap_or(0);
        let layers: u64 = numbers.sum();
        let room = end - start - bytes.len() as u64;
        if layers > room {
            let what = format!(
                "the layers of a chunk claim {layers} bytes where {room} are left; the file is cut off or damaged"
            );
            return Err(Trouble::at(start, what));
        }
        // If there is a table, it gives the end. Otherwise the layers end the chunk: no writer
        // leaves a gap.
        let end = if self.table.is_some() { end } else { end - room + layers };
        Ok(Preamble { points, end })
    }

    /// Size in bytes of the largest chunk of a file with layered chunks but no chunk table.
    fn largest_without_table(&mut self, mut points: u64) -> Result<u64, Trouble> {
        let (first, mut largest) = (self.chunk, 0);
        while points > 0 {
            let chunk = self.next_chunk()?;
            largest = largest.max(chunk.end - chunk.start);
            points = points.saturating_sub(chunk.points);
            self.chunk = chunk;
        }
        self.chunk = first;
        Ok(largest)
    }
}

struct Preamble {
    points: u64,
    end: u64,
}

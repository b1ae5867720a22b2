//! The chunk table that follows compressed points, decoded entry by entry.

use std::io::Read;

use laz::decoders::ArithmeticDecoder;
use laz::decompressors::{IntegerDecompressor, IntegerDecompressorBuilder};

use super::header::Header;
use super::method::{Chunking, Method};
use super::trouble::Trouble;
use crate::points::stretch::{Input, Stretch};
use rayset_store::storage::input_file::Shared;

/// Size in bytes of the head of the table: version and number of entries.
const HEAD_BYTES: u64 = 8;
/// The entropy-coding contexts of the two numbers of an entry.
const POINTS: u32 = 0;
const BYTES: u32 = 1;

/// A chunk's entry in the table.
#[derive(Clone, Copy, Default)]
pub(super) struct ChunkEntry {
    /// Number of points if it varies between chunks, otherwise 0.
    pub(super) points: u64,
    pub(super) bytes: u64,
}

/// A chunk table that is being decoded.
pub(super) struct ChunkTable {
    coder: ArithmeticDecoder<Input>,
    numbers: IntegerDecompressor,
    has_points: bool,
    /// Byte offset in the file at which the table begins.
    place: u64,
    left: u32,
    last: ChunkEntry,
}

/// The result of reading the whole table.
pub(super) struct Survey {
    /// Bytes of the largest chunk.
    pub(super) largest: u64,
}

impl ChunkTable {
    /// Byte offset in the file at which the table begins; `None` if the file has no table, for
    /// example because it was written to a pipe.
    pub(super) fn find(file: &Shared, header: &Header) -> Result<Option<u64>, Trouble> {
        let (first, end) = (header.points_start, header.file_bytes);
        let read = |at: u64| {
            let mut bytes = [0; 8];
            let mut stretch = Stretch::new(file, at, end);
            stretch.read_exact(&mut bytes).map_err(|e| {
                Trouble::from_io(e, at, "the file ends before its compressed points; it is cut off")
            })?;
            Ok(i64::from_le_bytes(bytes))
        };
        let is_place =
            |place: u64| place >= first + 8 && place.checked_add(HEAD_BYTES).is_some_and(|e| e <= end);
        match u64::try_from(read(first)?) {
            Ok(place) if is_place(place) => Ok(Some(place)),
            Ok(place) if place > first => {
                let what = format!(
                    "the table of chunks is said to be at byte {place} of a file of {end} bytes; the file is cut off \
                     or damaged"
                );
                Err(Trouble::at(first, what))
            }
            // A writer that could not seek stores the place in the last bytes of the file.
            _ if end < first + 8 + HEAD_BYTES + 8 => Ok(None),
            _ => {
                let place = u64::try_from(read(end - 8)?).ok().filter(|&place| is_place(place));
                Ok(place.filter(|&place| read(place).is_ok_and(|head| head as u32 == 0)))
            }
        }
    }

    /// Reads the head of the table at the place returned by [`find`](Self::find).
    pub(super) fn open(file: &Shared, place: u64, end: u64, has_points: bool) -> Result<Self, Trouble> {
        let mut input = Stretch::new(file, place, end).buffered();
        let mut head = [0; HEAD_BYTES as usize];
        let short = "the table of chunks is cut off";
        input.read_exact(&mut head).map_err(|e| Trouble::from_io(e, place, short))?;
        let [version, left] = [0, 4].map(|i| u32::from_le_bytes(std::array::from_fn(|j| head[i + j])));
        if version != 0 {
            return Err(Trouble::at(place, format!("version {version} of the table of chunks is unknown")));
        }
        let mut coder = ArithmeticDecoder::new(input);
        if left > 0 {
            coder.read_init_bytes().map_err(|e| Trouble::from_io(e, place, short))?;
        }
        let numbers = IntegerDecompressorBuilder::new().bits(32).contexts(2).build_initialized();
        Ok(Self { coder, numbers, has_points, place, left, last: ChunkEntry::default() })
    }

    /// The next entry; `None` at the end.
    pub(super) fn next(&mut self) -> Result<Option<ChunkEntry>, Trouble> {
        if self.left == 0 {
            return Ok(None);
        }
        self.left -= 1;
        let mut number = |last: u64, context| {
            let decoded = self.numbers.decompress(&mut self.coder, last as u32 as i32, context);
            let what =
                format!("the table of chunks ends {} entries early; the file is cut off", self.left + 1);
            decoded.map(|n| u64::from(n as u32)).map_err(|e| Trouble::from_io(e, self.place, &what))
        };
        let points = if self.has_points { number(self.last.points, POINTS)? } else { 0 };
        self.last = ChunkEntry { points, bytes: number(self.last.bytes, BYTES)? };
        Ok(Some(self.last))
    }

    /// Reads the whole table, and checks it against the header and the length of the file.
    pub(super) fn survey(
        file: &Shared,
        header: &Header,
        place: u64,
        method: &Method,
    ) -> Result<Survey, Trouble> {
        let has_points = method.chunking == Chunking::Variable;
        let mut table = Self::open(file, place, header.file_bytes, has_points)?;
        let chunks = u64::from(table.left);
        let room = place - (header.points_start + 8);
        let bad = |what: String| Err(Trouble::at(place, format!("{what}; the file is cut off or damaged")));
        // Every chunk begins with an uncompressed point; only the chunk of a file without points
        // can be empty.
        let record_bytes = header.record_bytes as u64;
        if chunks > room / record_bytes + 1 {
            return bad(format!(
                "a table of {chunks} chunks for {room} bytes of points of {record_bytes} bytes"
            ));
        }
        if let Chunking::Fixed(points) = method.chunking {
            let points = u64::from(points);
            if header.count.div_ceil(points).max(1) != chunks.max(1) {
                return bad(format!(
                    "{chunks} chunks of {points} points, where the header counts {} points",
                    header.count
                ));
            }
        }
        let (mut largest, mut bytes, mut points) = (0, 0, 0);
        while let Some(entry) = table.next()? {
            largest = largest.max(entry.bytes);
            bytes += entry.bytes;
            points += entry.points;
        }
        if bytes > room {
            return bad(format!("the table of chunks claims {bytes} bytes where {room} are"));
        }
        if has_points && points != header.count {
            return bad(format!(
                "the table of chunks claims {points} points, and the header counts {}",
                header.count
            ));
        }
        Ok(Survey { largest })
    }
}

//! The points of a compressed file: all numbers of a field, then all of the next.
//!
//! Every field has a decoder of its own, which starts where the field begins. To find these places
//! all data are decoded once when the file is opened; memory then depends on the number of fields
//! alone.

use std::io::{BufReader, Read};
use std::path::Path;

use super::header::{Field, Header};
use crate::points::lzf::{self, Damage, MOST_FOR_A_BYTE};
use crate::points::stretch::Stretch;
use crate::points::{Place, ReadError};
use rayset_store::storage::input_file::Shared;

/// Buffer of the input of a decoder, in bytes.
const BUFFER_BYTES: usize = 8 << 10;
/// Memory in bytes of a decoder with its input.
const DECODER_BYTES: usize = lzf::DECODER_BYTES + BUFFER_BYTES;

type Lzf = lzf::Lzf<BufReader<Stretch>>;

/// The bytes of a file from `start` to `end`.
fn input(file: &Shared, start: u64, end: u64) -> BufReader<Stretch> {
    BufReader::with_capacity(BUFFER_BYTES, Stretch::new(file, start, end))
}

/// The numbers of a field.
struct Numbers {
    decoder: Lzf,
    /// Bytes of the field of a point.
    bytes: usize,
    /// Points that have been passed.
    passed: u64,
    /// Those of the points that are read now.
    now: Vec<u8>,
}

pub(super) struct Transposed {
    fields: Vec<Numbers>,
}

impl Transposed {
    /// Opens the data of a file, and decodes them once.
    pub(super) fn open(path: &Path, header: &Header) -> Result<Self, ReadError> {
        let bad = |byte: u64, what: String| ReadError::malformed(path, Place::Byte(byte), what);
        let file = Shared::open(path).map_err(ReadError::io(path))?;
        let file_bytes = file.length().map_err(ReadError::io(path))?;
        let start = header.bytes + 8;
        if start > file_bytes {
            return Err(bad(file_bytes, "the file ends before the sizes of its compressed points".into()));
        }
        let mut sizes = [0; 8];
        Stretch::new(&file, header.bytes, start).read_exact(&mut sizes).map_err(ReadError::io(path))?;
        let [packed, unpacked] =
            [0, 4].map(|at| u64::from(u32::from_le_bytes(std::array::from_fn(|i| sizes[at + i]))));
        let record: u64 = header.fields.iter().map(|field| field.bytes() as u64).sum();
        if header.points.checked_mul(record) != Some(unpacked) {
            let what = format!(
                "{unpacked} bytes of compressed points, where {} points of {record} bytes were expected",
                header.points
            );
            return Err(bad(header.bytes + 4, what));
        }
        if packed > file_bytes - start || unpacked > packed * MOST_FOR_A_BYTE {
            let what = format!(
                "{unpacked} bytes of points are said to be compressed to {packed}, of which the file has {}; it is cut \
                 off or damaged",
                file_bytes - start
            );
            return Err(bad(header.bytes, what));
        }
        let mut decoder = Lzf::new(input(&file, start, start + packed), start, start + packed);
        let mut fields = Vec::new();
        for field in &header.fields {
            let bytes = field.bytes();
            let fork = decoder.fork(input(&file, decoder.byte(), start + packed));
            fields.push(Numbers { decoder: fork, bytes, passed: 0, now: Vec::new() });
            let all = decoder.skip(header.points * bytes as u64);
            all.map_err(|damage| read_error(path, &decoder, damage))?;
        }
        if !decoder.is_at_end() {
            let what = "the compressed points are more than their size says; the file is damaged";
            return Err(bad(decoder.byte(), what.into()));
        }
        Ok(Self { fields })
    }

    /// Upper bound on the memory in bytes, where up to `rows` points are read at a time.
    pub(super) fn memory_needed(fields: &[Field], rows: usize) -> u64 {
        fields.iter().map(|field| (DECODER_BYTES + rows * field.bytes()) as u64).sum()
    }

    /// The bytes of a field of `rows` points from point `first` on. These are the points that were
    /// read last, or come after them.
    pub(super) fn read(
        &mut self,
        path: &Path,
        field: usize,
        first: u64,
        rows: usize,
    ) -> Result<&[u8], ReadError> {
        let numbers = &mut self.fields[field];
        if numbers.passed == first + rows as u64 && numbers.now.len() == rows * numbers.bytes {
            return Ok(&numbers.now);
        }
        let before = (first - numbers.passed) * numbers.bytes as u64;
        numbers.now.resize(rows * numbers.bytes, 0);
        let decoder = &mut numbers.decoder;
        let read = decoder.skip(before).and_then(|()| decoder.read(&mut numbers.now));
        read.map_err(|damage| read_error(path, decoder, damage))?;
        numbers.passed = first + rows as u64;
        Ok(&numbers.now)
    }
}

fn read_error(path: &Path, decoder: &Lzf, damage: Damage) -> ReadError {
    let what = match damage {
        Damage::Io(source) => return ReadError::Io { path: path.to_owned(), source },
        Damage::Ends => {
            "the compressed points end here, and are fewer than their size says; the file is damaged"
        }
        Damage::BeforeBeginning => {
            "the compressed points refer to what comes before their beginning; the file is damaged"
        }
    };
    ReadError::malformed(path, Place::Byte(decoder.byte()), what)
}

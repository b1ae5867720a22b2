//! A small writer of LAS and LAZ files, good ones and such as are to be broken.

use laz::{LasZipCompressor, LazVlr, LazVlrBuilder};

use crate::common::Random;

/// Bytes of a record of each point format without extra bytes.
pub(crate) const RECORD_BYTES: [usize; 11] = [20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67];
/// Byte of the file where the extended records' place and number are said.
pub(crate) const EXTENDED_AT: usize = 235;

/// User, number and contents of a record.
pub(crate) type Record = (&'static str, u16, Vec<u8>);

/// What a file is to hold.
#[derive(Clone)]
pub(crate) struct LasFile {
    pub(crate) minor: u8,
    pub(crate) format: u8,
    pub(crate) scale: [f64; 3],
    pub(crate) offset: [f64; 3],
    /// Points as they are stored, all of one length.
    pub(crate) points: Vec<Vec<u8>>,
    pub(crate) records: Vec<Record>,
    pub(crate) extended: Vec<Record>,
    pub(crate) global_encoding: u16,
}

/// How points are compressed.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Chunks {
    Fixed(u32),
    /// Chunks of these many points in turn.
    Variable(&'static [usize]),
    /// Fixed chunks without a table.
    NoTable(u32),
    /// Fixed chunks, and the table's place in the last bytes of the file, as if written to a pipe.
    Streamed(u32),
    /// One chunk without a table, LASzip's first method.
    One,
}

impl LasFile {
    /// Random points of a format: neighbours are alike, and every bit of every field is used
    /// somewhere.
    pub(crate) fn random(format: u8, count: usize, extra_bytes: usize, seed: u64) -> Self {
        let mut random = Random(seed);
        let mut byte = move || (random.unit() * 256.0) as u8;
        let length = RECORD_BYTES[usize::from(format)] + extra_bytes;
        let mut points: Vec<Vec<u8>> = Vec::new();
        for i in 0..count {
            let mut point: Vec<u8> = match points.last() {
                Some(last) => last.clone(),
                None => (0..length).map(|_| byte()).collect(),
            };
            for axis in 0..3 {
                let steps = (i as i32 * [7, -3, 1][axis] - 40_000).wrapping_add(i32::from(byte()));
                point[4 * axis..4 * axis + 4].copy_from_slice(&steps.to_le_bytes());
            }
            for _ in 0..3 {
                let at = 12 + (usize::from(byte()) << 8 | usize::from(byte())) % (length - 12);
                // Compressing wave packets overflows in debug builds of the crate; nothing reads
                // them.
                if !wave_packet(format).contains(&at) {
                    point[at] = byte();
                }
            }
            let time = if format >= 6 {
                Some(22)
            } else if matches!(format, 0 | 2) {
                None
            } else {
                Some(20)
            };
            if let Some(at) = time {
                let seconds = 1e5 + i as f64 * 0.01 + f64::from(byte());
                point[at..at + 8].copy_from_slice(&seconds.to_le_bytes());
            }
            points.push(point);
        }
        let minor = if format >= 6 { 4 } else { 3 };
        let (scale, offset) = ([0.001, 0.01, 0.25], [500_000.0, -3.5, 1e6]);
        let (records, extended) = (Vec::new(), Vec::new());
        Self { minor, format, scale, offset, points, records, extended, global_encoding: 0 }
    }

    /// The extra bytes of every point by number, and their record.
    pub(crate) fn with_extra(mut self, descriptors: &[Vec<u8>], extra: impl Fn(usize) -> Vec<u8>) -> Self {
        let length = RECORD_BYTES[usize::from(self.format)];
        for (i, point) in self.points.iter_mut().enumerate() {
            point.truncate(length);
            point.extend(extra(i));
        }
        self.records.push(("LASF_Spec", 4, descriptors.concat()));
        self
    }

    fn record_bytes(&self) -> usize {
        self.points.first().map_or(RECORD_BYTES[usize::from(self.format)], Vec::len)
    }

    /// Header and ordinary records.
    fn head(&self, compressed: bool, records: &[Record]) -> Vec<u8> {
        let header_bytes: u16 = match self.minor {
            0..=2 => 227,
            3 => 235,
            _ => 375,
        };
        let mut bytes = vec![0; header_bytes.into()];
        let body: usize = records.iter().map(|r| 54 + r.2.len()).sum();
        let start = (usize::from(header_bytes) + body) as u32;
        bytes[..4].copy_from_slice(b"LASF");
        bytes[6..8].copy_from_slice(&self.global_encoding.to_le_bytes());
        bytes[24..26].copy_from_slice(&[1, self.minor]);
        bytes[26..37].copy_from_slice(b"test system");
        bytes[58..71].copy_from_slice(b"rayset\x1b tests");
        bytes[94..96].copy_from_slice(&header_bytes.to_le_bytes());
        bytes[96..100].copy_from_slice(&start.to_le_bytes());
        bytes[100..104].copy_from_slice(&(records.len() as u32).to_le_bytes());
        bytes[104] = self.format | if compressed { 128 } else { 0 };
        bytes[105..107].copy_from_slice(&(self.record_bytes() as u16).to_le_bytes());
        if self.minor < 4 || self.format < 6 {
            bytes[107..111].copy_from_slice(&(self.points.len() as u32).to_le_bytes());
        }
        for (i, v) in self.scale.iter().chain(&self.offset).enumerate() {
            bytes[131 + 8 * i..139 + 8 * i].copy_from_slice(&v.to_le_bytes());
        }
        if self.minor >= 4 {
            bytes[247..255].copy_from_slice(&(self.points.len() as u64).to_le_bytes());
        }
        for (user, id, contents) in records {
            bytes.extend_from_slice(&[0, 0]);
            let mut name = user.as_bytes().to_vec();
            name.resize(16, 0);
            bytes.extend_from_slice(&name);
            bytes.extend_from_slice(&id.to_le_bytes());
            bytes.extend_from_slice(&(contents.len() as u16).to_le_bytes());
            bytes.extend_from_slice(&[0; 32]);
            bytes.extend_from_slice(contents);
        }
        bytes
    }

    fn with_extended(&self, mut bytes: Vec<u8>) -> Vec<u8> {
        if self.extended.is_empty() {
            return bytes;
        }
        let start = bytes.len() as u64;
        bytes[EXTENDED_AT..EXTENDED_AT + 8].copy_from_slice(&start.to_le_bytes());
        let number = self.extended.len() as u32;
        bytes[EXTENDED_AT + 8..EXTENDED_AT + 12].copy_from_slice(&number.to_le_bytes());
        for (user, id, contents) in &self.extended {
            bytes.extend_from_slice(&[0, 0]);
            let mut name = user.as_bytes().to_vec();
            name.resize(16, 0);
            bytes.extend_from_slice(&name);
            bytes.extend_from_slice(&id.to_le_bytes());
            bytes.extend_from_slice(&(contents.len() as u64).to_le_bytes());
            bytes.extend_from_slice(&[0; 32]);
            bytes.extend_from_slice(contents);
        }
        bytes
    }

    /// The file, not compressed.
    pub(crate) fn las(&self) -> Vec<u8> {
        let mut bytes = self.head(false, &self.records);
        self.points.iter().for_each(|p| bytes.extend_from_slice(p));
        self.with_extended(bytes)
    }

    /// The file, compressed.
    pub(crate) fn laz(&self, chunks: Chunks) -> Vec<u8> {
        let extra = self.record_bytes() - RECORD_BYTES[usize::from(self.format)];
        let builder =
            LazVlrBuilder::default().with_point_format(self.format, extra as u16).expect("a format");
        let vlr = match chunks {
            Chunks::Fixed(n) | Chunks::NoTable(n) | Chunks::Streamed(n) => builder.with_fixed_chunk_size(n),
            Chunks::Variable(_) => builder.with_variable_chunk_size(),
            Chunks::One => builder.with_fixed_chunk_size(u32::MAX - 1),
        };
        let vlr = vlr.build();
        let mut record = Vec::new();
        vlr.write_to(&mut record).expect("a record");
        if chunks == Chunks::One {
            record[..2].copy_from_slice(&1_u16.to_le_bytes());
        }
        let mut records = self.records.clone();
        records.push((LazVlr::USER_ID, LazVlr::RECORD_ID, record));
        let head = self.head(true, &records);
        let start = head.len();
        let mut output = std::io::Cursor::new(head);
        output.set_position(start as u64);
        let mut compressor = LasZipCompressor::new(output, vlr).expect("a compressor");
        if let Chunks::Variable(sizes) = chunks {
            let mut left = self.points.as_slice();
            for &size in sizes.iter().cycle() {
                let (chunk, rest) = left.split_at(size.min(left.len()));
                chunk.iter().for_each(|p| compressor.compress_one(p).expect("it compresses"));
                left = rest;
                if left.is_empty() {
                    break;
                }
                compressor.finish_current_chunk().expect("a chunk");
            }
        } else {
            self.points.iter().for_each(|p| compressor.compress_one(p).expect("it compresses"));
        }
        compressor.done().expect("it ends");
        let mut bytes = compressor.into_inner().into_inner();
        let table = place_of_table(&bytes);
        match chunks {
            Chunks::Fixed(_) | Chunks::Variable(_) => {}
            Chunks::One => {
                bytes.truncate(table);
                bytes.drain(start..start + 8);
            }
            Chunks::NoTable(_) => {
                bytes.truncate(table);
                bytes[start..start + 8].copy_from_slice(&(-1_i64).to_le_bytes());
            }
            Chunks::Streamed(_) => {
                bytes.extend_from_slice(&(table as u64).to_le_bytes());
                bytes[start..start + 8].copy_from_slice(&(-1_i64).to_le_bytes());
            }
        }
        self.with_extended(bytes)
    }
}

/// Bytes of a point that say where its wave packet is.
fn wave_packet(format: u8) -> std::ops::Range<usize> {
    let start = match format {
        4 => 28,
        5 => 34,
        9 => 30,
        10 => 38,
        _ => return 0..0,
    };
    start..start + 29
}

/// Byte of a file where its points begin.
pub(crate) fn points_start(file: &[u8]) -> usize {
    u32::from_le_bytes([file[96], file[97], file[98], file[99]]) as usize
}

/// Byte of a LAZ file where the table of chunks begins.
pub(crate) fn place_of_table(file: &[u8]) -> usize {
    let start = points_start(file);
    u64::from_le_bytes(file[start..start + 8].try_into().expect("eight bytes")) as usize
}

/// A descriptor of extra bytes; `numbers` are missing data, scale and offset, where given.
pub(crate) fn descriptor(
    kind: u8,
    name: &str,
    description: &str,
    (no_data, scale, offset): (Option<[u8; 8]>, Option<f64>, Option<f64>),
) -> Vec<u8> {
    let mut bytes = vec![0; 192];
    bytes[2] = kind;
    bytes[3] = u8::from(no_data.is_some()) | u8::from(scale.is_some()) << 3 | u8::from(offset.is_some()) << 4;
    bytes[4..4 + name.len()].copy_from_slice(name.as_bytes());
    for part in 0..3 {
        let mut put = |at: usize, v: [u8; 8]| bytes[at + 8 * part..at + 8 * part + 8].copy_from_slice(&v);
        put(40, no_data.unwrap_or_default());
        put(112, scale.unwrap_or_default().to_le_bytes());
        put(136, offset.unwrap_or_default().to_le_bytes());
    }
    bytes[160..160 + description.len()].copy_from_slice(description.as_bytes());
    bytes
}

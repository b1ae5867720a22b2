//! The LASzip record, which states how points are compressed.

use laz::{LazItem, LazVlr};

use super::header::Header;
use crate::points::quiet;

/// Size in bytes of the record before its items, and of an item.
const FIXED_BYTES: usize = 34;
const ITEM_BYTES: usize = 6;

/// How points are divided into chunks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Chunking {
    /// All points are in one chunk.
    One,
    /// Every chunk but the last has this number of points.
    Fixed(u32),
    /// Each chunk has its own number of points, which is in the chunk table.
    Variable,
}

/// How points are compressed.
pub(super) struct Method {
    pub(super) chunking: Chunking,
    /// Whether a chunk is stored field by field rather than point by point.
    pub(super) is_layered: bool,
    pub(super) items: Vec<LazItem>,
    /// Number of layers of a chunk, if it is layered.
    pub(super) layers: usize,
    pub(super) extra_bytes: usize,
    record_bytes: usize,
}

impl Method {
    /// Reads the record, and checks that its items match the point format of the header.
    pub(super) fn read(header: &Header, record: &[u8]) -> Result<Self, String> {
        let number = |at: usize| u16::from_le_bytes([record[at], record[at + 1]]);
        if record.len() < FIXED_BYTES {
            return Err(format!("a LASzip record of {} bytes, which has at least 34", record.len()));
        }
        let (compressor, coder, item_count) = (number(0), number(2), usize::from(number(32)));
        if coder != 0 {
            return Err(format!("LASzip's coder {coder} is unknown; 0 can be read"));
        }
        let Some(items) = record.get(FIXED_BYTES..FIXED_BYTES + item_count * ITEM_BYTES) else {
            return Err(format!("a LASzip record of {} bytes for {item_count} items", record.len()));
        };
        let found: Vec<[u16; 3]> = (items.chunks_exact(ITEM_BYTES))
            .map(|b| [0, 2, 4].map(|i| u16::from_le_bytes([b[i], b[i + 1]])))
            .collect();
        let expected = expected_items(header);
        let kinds: Vec<(u16, u16)> = found.iter().map(|&[kind, size, _]| (kind, size)).collect();
        if kinds != expected {
            return Err(format!(
                "LASzip compresses items of (type, bytes) {kinds:?}, and point format {} of {} bytes has {expected:?}",
                header.format, header.record_bytes
            ));
        }
        let is_layered = header.format >= 6;
        let versions = if is_layered { 3..=4 } else { 1..=2 };
        if let Some(item) = found.iter().find(|item| !versions.contains(&item[2])) {
            return Err(format!("version {} of LASzip's item {} is unknown", item[2], item[0]));
        }
        let chunk_points = u32::from_le_bytes([record[12], record[13], record[14], record[15]]);
        let chunking = match (compressor, is_layered) {
            (1, false) => Chunking::One,
            (2, false) | (3, true) if matches!(chunk_points, 0 | u32::MAX) => Chunking::Variable,
            (2, false) | (3, true) => Chunking::Fixed(chunk_points),
            _ => {
                return Err(format!(
                    "LASzip's compressor {compressor} is unknown for point format {}",
                    header.format
                ));
            }
        };
        let record = match quiet::catch(|| LazVlr::from_buffer(record)) {
            Some(Ok(record)) => record,
            Some(Err(e)) => return Err(e.to_string()),
            None => return Err("the LASzip record is damaged".into()),
        };
        let layers = |&(kind, size): &(u16, u16)| match kind {
            10 => 9,
            12 => 2,
            14 => usize::from(size),
            _ => 1,
        };
        Ok(Self {
            chunking,
            is_layered,
            items: record.items().clone(),
            layers: expected.iter().map(layers).sum(),
            extra_bytes: header.extra_bytes(),
            record_bytes: header.record_bytes,
        })
    }

    /// Size in bytes of what precedes the layers of a chunk: an uncompressed point, the number of
    /// points, and the sizes of the layers.
    pub(super) fn preamble_bytes(&self) -> usize {
        self.record_bytes + 4 + 4 * self.layers
    }
}

/// Type and size in bytes of the items that make up a point of the header's format.
fn expected_items(header: &Header) -> Vec<(u16, u16)> {
    let mut items: Vec<(u16, u16)> = match header.format {
        0 => vec![(6, 20)],
        1 => vec![(6, 20), (7, 8)],
        2 => vec![(6, 20), (8, 6)],
        3 => vec![(6, 20), (7, 8), (8, 6)],
        4 => vec![(6, 20), (7, 8), (9, 29)],
        5 => vec![(6, 20), (7, 8), (8, 6), (9, 29)],
        6 => vec![(10, 30)],
        7 => vec![(10, 30), (11, 6)],
        8 => vec![(10, 30), (12, 8)],
        9 => vec![(10, 30), (13, 29)],
        _ => vec![(10, 30), (12, 8), (13, 29)],
    };
    let extra = header.extra_bytes();
    if extra > 0 {
        items.push((if header.format >= 6 { 14 } else { 0 }, extra as u16));
    }
    items
}

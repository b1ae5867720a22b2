//! The values of a node or a leaf: compressed, without those that a mask tells, in half precision.

use super::blosc;
use super::stream::{Stream, Wrong};
use super::zip::inflate;
use rayset_base::numbers::half;

/// What a grid's compression may consist of.
const ZIP: u32 = 1;
const ACTIVE_MASK: u32 = 2;
const BLOSC: u32 = 4;

/// Compressed values may be this much longer than plain ones, by their own headers.
const MOST_OVERHEAD: u64 = 64;
const HALF_BYTES: usize = 2;

/// How all values of a grid are stored.
#[derive(Clone, Copy)]
pub(super) struct Coding {
    compression: u32,
    half: bool,
    /// Bytes of a value that is not in half precision: 4 or 8.
    pub(super) width: usize,
    /// The background value, in the first `width` bytes.
    pub(super) background: [u8; 8],
}

impl Coding {
    /// `compression` is read from a grid; `None` if it has an unknown part.
    pub(super) fn new(compression: u32, half: bool, width: usize) -> Option<Self> {
        let known = compression & !(ZIP | ACTIVE_MASK | BLOSC) == 0;
        known.then_some(Self { compression, half, width, background: [0; 8] })
    }

    /// Bytes of a value as it is stored in a node.
    fn stored_width(&self) -> usize {
        if self.half { HALF_BYTES } else { self.width }
    }
}

/// How many bits of a mask are set.
pub(super) fn count(mask: &[u8]) -> usize {
    mask.iter().map(|byte| byte.count_ones() as usize).sum()
}

pub(super) fn is_on(mask: &[u8], bit: usize) -> bool {
    mask[bit / 8] >> (bit % 8) & 1 != 0
}

/// Buffers that are used again.
#[derive(Default)]
pub(super) struct Decoder {
    packed: Vec<u8>,
    stored: Vec<u8>,
    plain: Vec<u8>,
}

/// What precedes the stored values: how the inactive ones follow from a mask.
struct Head {
    /// The two values of inactive voxels.
    inactive: [[u8; 8]; 2],
    /// Which of both an inactive voxel has; the first, if this is empty.
    second: Vec<u8>,
    /// Number of values that are stored, and whether they are the active ones alone.
    stored: usize,
    masked: bool,
}

/// Skips the values of a node or leaf, whose mask of active values has been read.
pub(super) fn skip(stream: &mut Stream, coding: &Coding, active: &[u8]) -> Result<(), Wrong> {
    let head = head(stream, coding, active)?;
    let bytes = (head.stored * coding.stored_width()) as u64;
    match packed_bytes(stream, coding, bytes)? {
        Some(packed) => stream.skip(packed),
        None => stream.skip(bytes),
    }
}

impl Decoder {
    /// Reads the values of a node or leaf, whose mask of active values has been read. They are
    /// little-endian, `coding.width` bytes each.
    pub(super) fn read(
        &mut self,
        stream: &mut Stream,
        coding: &Coding,
        active: &[u8],
    ) -> Result<&[u8], Wrong> {
        let head = head(stream, coding, active)?;
        self.stored.resize(head.stored * coding.stored_width(), 0);
        match packed_bytes(stream, coding, self.stored.len() as u64)? {
            None => stream.fill(&mut self.stored)?,
            Some(packed) => {
                let at = stream.at();
                self.packed.resize(packed as usize, 0);
                stream.fill(&mut self.packed)?;
                let done = if coding.compression & BLOSC != 0 {
                    blosc::decompress(&self.packed, &mut self.stored)
                } else {
                    inflate(&self.packed, &mut self.stored)
                };
                done.map_err(|what| Wrong { at, what })?;
            }
        }
        self.spread(coding, active, &head);
        Ok(&self.plain)
    }

    /// Fills `plain` from `stored`.
    fn spread(&mut self, coding: &Coding, active: &[u8], head: &Head) {
        let width = coding.width;
        self.plain.resize(8 * active.len() * width, 0);
        let mut stored = self.stored.chunks_exact(coding.stored_width());
        for (number, value) in self.plain.chunks_exact_mut(width).enumerate() {
            if head.masked && !is_on(active, number) {
                let second = !head.second.is_empty() && is_on(&head.second, number);
                value.copy_from_slice(&head.inactive[usize::from(second)][..width]);
                continue;
            }
            let Some(from) = stored.next() else { break };
            if coding.half {
                put_half([from[0], from[1]], value);
            } else {
                value.copy_from_slice(from);
            }
        }
    }
}

fn head(stream: &mut Stream, coding: &Coding, active: &[u8]) -> Result<Head, Wrong> {
    let at = stream.at();
    let kind = stream.u8()?;
    let mut negative = coding.background;
    negative[coding.width - 1] ^= 0x80;
    let mut inactive = [if kind == 0 { coding.background } else { negative }, coding.background];
    // 0: the background. 1: its negative. 2: a value. 3: one or the other of both. 4: a value or
    // the background. 5: either of two values. 6: all are stored.
    let values = match kind {
        0 | 1 | 3 | 6 => 0,
        2 | 4 => 1,
        5 => 2,
        _ => return Err(Wrong { at, what: format!("unknown kind {kind} of inactive values") }),
    };
    for value in &mut inactive[..values] {
        stream.fill(&mut value[..coding.width])?;
    }
    let mut second = vec![0; if (3..=5).contains(&kind) { active.len() } else { 0 }];
    stream.fill(&mut second)?;
    let masked = coding.compression & ACTIVE_MASK != 0 && kind != 6;
    let stored = if masked { count(active) } else { 8 * active.len() };
    Ok(Head { inactive, second, stored, masked })
}

/// Number of bytes of compressed values. `None` if `bytes` plain bytes follow.
fn packed_bytes(stream: &mut Stream, coding: &Coding, bytes: u64) -> Result<Option<u64>, Wrong> {
    let none = coding.half && bytes == 0;
    if coding.compression & (ZIP | BLOSC) == 0 || none {
        return Ok(None);
    }
    let at = stream.at();
    let said = stream.i64()?;
    let fits =
        if said > 0 { said.unsigned_abs() <= bytes + MOST_OVERHEAD } else { said.unsigned_abs() == bytes };
    if !fits {
        return Err(Wrong { at, what: format!("{bytes} bytes of values cannot be {said} compressed bytes") });
    }
    Ok((said > 0).then_some(said.unsigned_abs()))
}

/// Writes a number of half precision in single or double precision.
fn put_half(half: [u8; 2], value: &mut [u8]) {
    let single = half::from_le_bytes(half);
    if value.len() == 4 {
        value.copy_from_slice(&single.to_le_bytes());
    } else {
        value.copy_from_slice(&f64::from(single).to_le_bytes());
    }
}

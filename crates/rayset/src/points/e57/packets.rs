//! The binary records of a scan: packets with a piece of the numbers of every field, which are packed bit by bit.
//!
//! The pieces of a packet need not hold equally many numbers, so what one field is ahead of the others is kept until they
//! follow.

use super::pages::Pages;
use crate::points::ReadError;

/// Most bytes of a scan that are kept at a time. Ordinary writers put the same records of all fields into a packet of 64 KiB,
/// or nearly so.
pub(super) const KEPT_LIMIT: usize = 1 << 20;

/// The numbers of a field that have been read and not yet been used.
struct Stream {
    /// Size of a number in bits: 0 to 64.
    bits: usize,
    bytes: Vec<u8>,
    /// Bits of `bytes` that have been used.
    used: usize,
}

impl Stream {
    fn keep(&mut self, pages: &mut Pages, count: usize) -> Result<(), ReadError> {
        self.bytes.drain(..self.used / 8);
        self.used %= 8;
        let start = self.bytes.len();
        self.bytes.resize(start + count, 0);
        pages.read(&mut self.bytes[start..], "a packet of points")
    }

    /// Whole numbers that are kept; `None` if they take no bits, and there are as many as one likes.
    fn available(&self) -> Option<usize> {
        (8 * self.bytes.len() - self.used).checked_div(self.bits)
    }

    fn get(&self, index: usize) -> u64 {
        let bit = self.used + index * self.bits;
        let (from, shift) = (bit / 8, bit % 8);
        if self.bits == 0 {
            return 0;
        }
        let mut wide = [0; 16];
        let part = &self.bytes[from..self.bytes.len().min(from + 9)];
        wide[..part.len()].copy_from_slice(part);
        let number = u128::from_le_bytes(wide) >> shift;
        number as u64 & (u64::MAX >> (64 - self.bits))
    }
}

/// The packets of one scan.
pub(super) struct Packets {
    streams: Vec<Stream>,
    /// Byte of the file at which the scan's section begins.
    section: u64,
}

impl Packets {
    /// Goes to the section at byte `section` of the file, of fields of these sizes in bits.
    pub(super) fn open(
        pages: &mut Pages,
        section: u64,
        bits: &[usize],
        said_at: u64,
    ) -> Result<Self, ReadError> {
        pages.go_to(section, "a scan", said_at)?;
        let mut header = [0; 32];
        pages.read(&mut header, "the header of a scan")?;
        if header[0] != 1 {
            let what = format!("a section of kind {} where a scan, of kind 1, was expected", header[0]);
            return Err(pages.fail(what));
        }
        let data = header[16..24].iter().rev().fold(0, |value, &byte| value << 8 | u64::from(byte));
        pages.go_to(data, "the data of a scan", section)?;
        let streams = bits.iter().map(|&bits| Stream { bits, bytes: Vec::new(), used: 0 }).collect();
        Ok(Self { streams, section })
    }

    /// Number of whole records that can be used, up to `most`; reads packets until there is one.
    pub(super) fn available(&mut self, pages: &mut Pages, most: usize) -> Result<usize, ReadError> {
        loop {
            let whole = self.streams.iter().filter_map(Stream::available).min().unwrap_or(most);
            if whole > 0 || most == 0 {
                return Ok(whole.min(most));
            }
            self.read_packet(pages)?;
        }
    }

    /// The bits of `count` numbers of a field, into `out`.
    pub(super) fn numbers(&self, field: usize, count: usize, out: &mut Vec<u64>) {
        let stream = &self.streams[field];
        out.clear();
        let is_whole = stream.used.is_multiple_of(8);
        let whole = |size: usize| (is_whole && stream.bits == 8 * size).then_some(stream.used / 8);
        if let Some(from) = whole(8) {
            let bytes = stream.bytes[from..].chunks_exact(8).take(count);
            out.extend(bytes.map(|b| u64::from_le_bytes(std::array::from_fn(|i| b[i]))));
        } else if let Some(from) = whole(4) {
            let bytes = stream.bytes[from..].chunks_exact(4).take(count);
            out.extend(bytes.map(|b| u64::from(u32::from_le_bytes(std::array::from_fn(|i| b[i])))));
        } else if let Some(from) = whole(1) {
            out.extend(stream.bytes[from..].iter().take(count).map(|&byte| u64::from(byte)));
        } else {
            out.extend((0..count).map(|index| stream.get(index)));
        }
    }

    /// Passes `count` records.
    pub(super) fn pass(&mut self, count: usize) {
        self.streams.iter_mut().for_each(|stream| stream.used += count * stream.bits);
    }

    fn read_packet(&mut self, pages: &mut Pages) -> Result<(), ReadError> {
        let start = pages.byte();
        let mut head = [0; 6];
        pages.read(&mut head, "a packet of points")?;
        let length = 1 + usize::from(u16::from_le_bytes([head[2], head[3]]));
        let fields = usize::from(u16::from_le_bytes([head[4], head[5]]));
        let mut rest = length.saturating_sub(head.len());
        match head[0] {
            // An index of packets, or one to be ignored.
            0 | 2 => {}
            1 if fields == self.streams.len() => rest = self.keep_packet(pages, start, rest)?,
            1 => {
                let known = self.streams.len();
                let what =
                    format!("the packet at byte {start} has {fields} fields, and the XML names {known}");
                return Err(pages.fail(what));
            }
            kind => {
                let what = format!(
                    "a packet of kind {kind} at byte {start}, in the scan that begins at byte {}; expected 0 to 2: the \
                     file is damaged, or holds fewer points than its XML says",
                    self.section
                );
                return Err(pages.fail(what));
            }
        }
        pages.skip(rest as u64);
        Ok(())
    }

    /// Keeps the pieces of a packet of which `rest` bytes are left, and returns how many then are.
    fn keep_packet(&mut self, pages: &mut Pages, start: u64, rest: usize) -> Result<usize, ReadError> {
        let mut sizes = vec![0; 2 * self.streams.len()];
        let too_long = |pages: &Pages| {
            pages.fail(format!(
                "the packet at byte {start} has more in it than its length; the file is damaged"
            ))
        };
        let rest = rest.checked_sub(sizes.len()).ok_or_else(|| too_long(pages))?;
        pages.read(&mut sizes, "a packet of points")?;
        let sizes: Vec<usize> =
            sizes.chunks_exact(2).map(|b| usize::from(u16::from_le_bytes([b[0], b[1]]))).collect();
        let rest = rest.checked_sub(sizes.iter().sum()).ok_or_else(|| too_long(pages))?;
        for (stream, size) in self.streams.iter_mut().zip(sizes) {
            // Numbers of no bits are not stored.
            if stream.bits == 0 {
                pages.skip(size as u64);
            } else {
                stream.keep(pages, size)?;
            }
        }
        if self.streams.iter().map(|stream| stream.bytes.len()).sum::<usize>() > KEPT_LIMIT {
            let what = format!(
                "some fields of the scan at byte {} are more than {KEPT_LIMIT} bytes ahead of others; the file is \
                 damaged",
                self.section
            );
            return Err(pages.fail(what));
        }
        Ok(rest)
    }
}

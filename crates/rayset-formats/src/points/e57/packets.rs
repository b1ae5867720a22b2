//! The binary records of a scan: packets with a piece of the numbers of every field, which are
//! packed bit by bit.
//!
//! The pieces of a packet need not hold equally many numbers, so what one field is ahead of the
//! others is kept until they follow.

use super::pages::Pages;
use crate::points::ReadError;

/// Most bytes of a scan that are kept at a time. Ordinary writers put the same records of all
/// fields into a packet of 64 KiB, or nearly so.
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

    /// Whole numbers that are kept; `None` if they take no bits, and there are as many as one
    /// likes.
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
        let length = 1 + u64::from(u16::from_le_bytes([head[2], head[3]]));
        let fields = usize::from(u16::from_le_bytes([head[4], head[5]]));
        match head[0] {
            // An index of packets, or one to be ignored, which may have no more than its first four
            // bytes.
            0 | 2 if length >= 4 => {}
            1 if fields == self.streams.len() => {
                let rest = (length as usize).saturating_sub(head.len());
                self.keep_packet(pages, start, rest)?;
            }
            1 => {
                let known = self.streams.len();
                let what =
                    format!("the packet at byte {start} has {fields} fields, and the XML names {known}");
                return Err(pages.fail(what));
            }
            0 | 2 => {
                return Err(pages.fail(format!("the packet at byte {start} has a length of {length} bytes")));
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
        pages.skip_from(start, length)
    }

    /// Keeps the pieces of a packet of which `rest` bytes are left.
    fn keep_packet(&mut self, pages: &mut Pages, start: u64, rest: usize) -> Result<(), ReadError> {
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
        rest.checked_sub(sizes.iter().sum()).ok_or_else(|| too_long(pages))?;
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
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A page with a section of these packets, of one field of a byte.
    fn page(packets: &[u8]) -> Vec<u8> {
        let mut page = vec![0; 48];
        let mut header = [0; 32];
        (header[0], header[16]) = (1, 80);
        page.extend_from_slice(&header);
        page.extend_from_slice(packets);
        page.resize(1020, 0);
        let sum = crc32c::crc32c(&page);
        page.extend_from_slice(&sum.swap_bytes().to_le_bytes());
        page
    }

    fn numbers(packets: &[u8], count: usize) -> Result<Vec<u64>, ReadError> {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("p.e57");
        std::fs::write(&path, page(packets)).expect("a write");
        let mut pages = Pages::new(
            &path,
            rayset_store::storage::input_file::InputFile::open(&path).expect("a file"),
            1024,
        );
        let mut packets = Packets::open(&mut pages, 48, &[8], 0)?;
        let mut found = Vec::new();
        while found.len() < count {
            let rows = packets.available(&mut pages, count - found.len())?;
            let mut part = Vec::new();
            packets.numbers(0, rows, &mut part);
            packets.pass(rows);
            found.extend(part);
        }
        Ok(found)
    }

    #[test]
    fn packets_to_be_ignored_may_be_as_short_as_their_heads() {
        let data = |byte: u8| [1, 0, 9, 0, 1, 0, 1, 0, byte, 0];
        let ignored = [2, 0, 3, 0];
        let index = [0, 0, 7, 0, 9, 9, 9, 9];
        let packets = [&ignored[..], &data(5), &index, &data(6), &ignored, &ignored, &data(7)].concat();
        assert_eq!(numbers(&packets, 3).expect("three numbers"), [5, 6, 7]);
        let said = numbers(&[2, 0, 1, 0, 0, 0], 1).expect_err("shorter than its head").to_string();
        assert!(said.contains("a length of 2 bytes"), "{said}");
    }
}

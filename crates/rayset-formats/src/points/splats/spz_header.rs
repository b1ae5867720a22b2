//! What the header of an SPZ file says: how many Gaussians there are, how they are packed, and
//! where each attribute lies.
//!
//! Format: Niantic, *spz* (its README). Versions 1 to 3 are one stream of 16 bytes of header and
//! the attributes one after another, in gzip or as it is. Version 4 has 32 bytes of header,
//! extensions up to a table of contents, the sizes of the streams there, and behind them a zstd
//! frame for each attribute that is not empty.

use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use crate::points::{Place, ReadError};

/// What SPZ files begin with, inside of gzip if they are in gzip.
pub(super) const MAGIC: &[u8; 4] = b"NGSP";
/// Bytes of the header that all versions have.
pub(super) const HEADER_BYTES: usize = 16;
/// Bytes of the header of version 4.
const STREAMS_HEADER_BYTES: u64 = 32;
/// Bytes of an entry of the table of contents of version 4: packed and unpacked size.
const ENTRY_BYTES: usize = 16;
const NEWEST: u32 = 4;
/// The flag of splats that were trained with the mip filter.
const ANTIALIASED: u8 = 1;

/// The header, checked.
#[derive(Clone, Copy, Debug)]
pub(super) struct SpzHeader {
    pub(super) version: u32,
    pub(super) count: u64,
    /// Coefficients of view-dependent colours of a Gaussian.
    harmonics: u64,
    /// Coordinates are in units of two to minus this; `None` if they are in half precision.
    pub(super) fractional_bits: Option<u8>,
    /// Whether its splats were trained with the mip filter.
    pub(super) is_antialiased: bool,
    streams: u8,
}

/// A zstd stream of version 4.
#[derive(Clone, Copy, Debug)]
pub(super) struct StreamPlace {
    pub(super) offset: u64,
    pub(super) bytes: u64,
}

fn word(bytes: &[u8]) -> u32 {
    bytes.iter().rev().fold(0, |word, &byte| word << 8 | u32::from(byte))
}

fn long(bytes: &[u8]) -> u64 {
    u64::from(word(&bytes[..4])) | u64::from(word(&bytes[4..8])) << 32
}

impl SpzHeader {
    /// Reads a header from its first 16 bytes.
    pub(super) fn parse(bytes: &[u8; HEADER_BYTES]) -> Result<Self, String> {
        if !bytes.starts_with(MAGIC) {
            return Err("not an SPZ file: expected `NGSP` at its beginning, as it is or in gzip".into());
        }
        let (version, degree, bits) = (word(&bytes[4..8]), bytes[12], bytes[13]);
        if !(1..=NEWEST).contains(&version) {
            return Err(format!("SPZ of version {version}; versions 1 to {NEWEST} can be read"));
        }
        let harmonics = [0, 3, 8, 15, 24].get(usize::from(degree));
        let harmonics =
            *harmonics.ok_or_else(|| format!("spherical harmonics of degree {degree}; expected 0 to 4"))?;
        if version > 1 && bits > 24 {
            return Err(format!("{bits} fractional bits of coordinates that have 24"));
        }
        Ok(Self {
            version,
            count: word(&bytes[8..12]).into(),
            harmonics: 3 * harmonics,
            fractional_bits: (version > 1).then_some(bits),
            is_antialiased: bytes[14] & ANTIALIASED != 0,
            streams: bytes[15],
        })
    }

    /// Whether each attribute is a stream of its own.
    pub(super) fn has_streams(&self) -> bool {
        self.version >= 4
    }

    /// Coefficients of a channel of view-dependent colours.
    pub(super) fn coefficients(&self) -> usize {
        self.harmonics as usize / 3
    }

    /// The attributes that the file has, of those that files may have.
    pub(super) fn attributes(&self) -> usize {
        if self.harmonics > 0 { 6 } else { 5 }
    }

    /// Bytes of a Gaussian in each attribute: position, opacity, colour, deviations, rotation,
    /// spherical harmonics.
    pub(super) fn widths(&self) -> [u64; 6] {
        let position = if self.fractional_bits.is_some() { 9 } else { 6 };
        let rotation = if self.version >= 3 { 4 } else { 3 };
        [position, 1, 3, 3, rotation, self.harmonics]
    }

    /// Reads where the streams of version 4 lie; `None` for attributes without bytes.
    pub(super) fn streams(
        &self,
        path: &Path,
        file: &mut (impl Read + Seek),
        file_bytes: u64,
    ) -> Result<[Option<StreamPlace>; 6], ReadError> {
        let fail = |byte: u64, what: String| ReadError::malformed(path, Place::Byte(byte), what);
        let sizes = self.widths().map(|width| width * self.count);
        let expected = sizes.iter().filter(|size| **size > 0).count();
        if usize::from(self.streams) != expected {
            return Err(fail(15, format!("{} streams; expected {expected}", self.streams)));
        }
        let table = Self::table(path, file, file_bytes, expected)?;
        let first = table + (expected * ENTRY_BYTES) as u64;
        let mut entries = [0; 6 * ENTRY_BYTES];
        let entries = &mut entries[..expected * ENTRY_BYTES];
        file.seek(SeekFrom::Start(table))
            .and_then(|_| file.read_exact(entries))
            .map_err(ReadError::io(path))?;
        let (mut places, mut offset, mut entry) = ([None; 6], first, table);
        let mut left = entries.chunks_exact(ENTRY_BYTES);
        for (place, size) in places.iter_mut().zip(sizes).filter(|(_, size)| *size > 0) {
            let Some(words) = left.next() else { break };
            let (packed, unpacked) = (long(words), long(&words[8..]));
            if unpacked != size {
                return Err(fail(
                    entry + 8,
                    format!("a stream of {unpacked} bytes, where {} Gaussians have {size}", self.count),
                ));
            }
            if packed > file_bytes - offset {
                return Err(fail(
                    entry,
                    format!(
                        "a stream of {packed} packed bytes, of which the file has {}",
                        file_bytes - offset
                    ),
                ));
            }
            *place = Some(StreamPlace { offset, bytes: packed });
            (offset, entry) = (offset + packed, entry + ENTRY_BYTES as u64);
        }
        Ok(places)
    }

    /// Reads where the table of contents is, which has to be whole.
    fn table(
        path: &Path,
        file: &mut (impl Read + Seek),
        file_bytes: u64,
        entries: usize,
    ) -> Result<u64, ReadError> {
        let fail = |byte: u64, what: String| Err(ReadError::malformed(path, Place::Byte(byte), what));
        let ends = || fail(file_bytes, "the file ends within its header or its table of contents".into());
        if file_bytes < STREAMS_HEADER_BYTES {
            return ends();
        }
        let mut bytes = [0; 4];
        let read = file.seek(SeekFrom::Start(16)).and_then(|_| file.read_exact(&mut bytes));
        read.map_err(ReadError::io(path))?;
        let table = u64::from(word(&bytes));
        if table < STREAMS_HEADER_BYTES {
            let what = format!(
                "the table of contents is at byte {table}, within the header of {STREAMS_HEADER_BYTES} bytes"
            );
            return fail(16, what);
        }
        if table + (entries * ENTRY_BYTES) as u64 > file_bytes {
            return ends();
        }
        Ok(table)
    }
}

//! The header and the blocks of a file in GADGET's own binary format.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::points::plain::Plain;
use crate::points::{ColumnType, Place, ReadError};
use rayset_store::storage::Storage;
use rayset_store::storage::input_file::InputFile;

pub(super) const TYPES: usize = 6;
const HEADER_BYTES: u64 = 256;
/// Largest number of blocks that are looked at.
const MOST_BLOCKS: usize = 256;

/// What a file says about itself.
#[derive(Clone, Debug)]
pub(super) struct Header {
    pub(super) counts: [u64; TYPES],
    /// Mass of each particle of a type; 0 where each has its own.
    pub(super) masses: [f64; TYPES],
    pub(super) time: f64,
    pub(super) redshift: f64,
    pub(super) files: u64,
    pub(super) box_size: f64,
    pub(super) hubble: f64,
    has_cooling: bool,
}

/// A block: numbers of the particles of some types, one type after the other.
#[derive(Clone, Debug)]
pub(super) struct Block {
    pub(super) name: String,
    pub(super) plain: Plain,
    /// The first row of each type in the block. `None` for those that have none.
    pub(super) first: [Option<u64>; TYPES],
}

/// A file with its header and blocks.
pub(super) struct GadgetFile {
    pub(super) path: PathBuf,
    pub(super) file: Arc<dyn Storage>,
    pub(super) big_endian: bool,
    /// Whether blocks have names.
    pub(super) named: bool,
    pub(super) header: Header,
    pub(super) blocks: Vec<Block>,
    bytes: u64,
}

/// Which particles a block has rows for.
#[derive(Clone, Copy, PartialEq)]
enum Of {
    All,
    /// Those whose mass is not in the header.
    OwnMass,
    Gas,
    Stars,
    GasAndStars,
}

/// Blocks whose contents are known: name, particles, numbers in a row.
const KNOWN: [(&str, Of, usize); 16] = [
    ("POS", Of::All, 3),
    ("VEL", Of::All, 3),
    ("ID", Of::All, 1),
    ("MASS", Of::OwnMass, 1),
    ("U", Of::Gas, 1),
    ("RHO", Of::Gas, 1),
    ("NE", Of::Gas, 1),
    ("NH", Of::Gas, 1),
    ("HSML", Of::Gas, 1),
    ("SFR", Of::Gas, 1),
    ("AGE", Of::Stars, 1),
    ("Z", Of::GasAndStars, 1),
    ("POT", Of::All, 1),
    ("ACCE", Of::All, 3),
    ("ENDT", Of::Gas, 1),
    ("TSTP", Of::All, 1),
];

/// Whether a file begins as those of GADGET do, and in which byte order: with a record of 256
/// bytes, or one of 8 that holds `HEAD`. `None` if it does not.
pub(super) fn byte_order(head: &[u8]) -> Option<(bool, bool)> {
    let word = |at: usize| head.get(at..at + 4);
    for (big_endian, marks) in [(false, [[0, 1, 0, 0], [8, 0, 0, 0]]), (true, [[0, 0, 1, 0], [0, 0, 0, 8]])] {
        if word(0) == Some(&marks[0]) && word(260) == Some(&marks[0]) {
            return Some((big_endian, false));
        }
        if word(0) == Some(&marks[1]) && word(4) == Some(b"HEAD") && word(12) == Some(&marks[1]) {
            return Some((big_endian, true));
        }
    }
    None
}

impl GadgetFile {
    pub(super) fn open(path: &Path) -> Result<Self, ReadError> {
        let file = InputFile::open(path).map_err(ReadError::io(path))?.into_storage();
        let bytes = file.length().map_err(ReadError::io(path))?;
        let mut head = vec![0; bytes.min(280) as usize];
        file.read_exact_at(&mut head, 0).map_err(ReadError::io(path))?;
        let Some((big_endian, named)) = byte_order(&head) else {
            let what = "expected the header of a snapshot of GADGET: 256 bytes between two record marks of 256, or a record \
                        with the name HEAD";
            return Err(ReadError::malformed(path, Place::Byte(0), what));
        };
        let header = Header {
            counts: [0; TYPES],
            masses: [0.0; TYPES],
            time: 0.0,
            redshift: 0.0,
            files: 1,
            box_size: 0.0,
            hubble: 0.0,
            has_cooling: false,
        };
        let mut this =
            Self { path: path.to_owned(), file, big_endian, named, header, blocks: Vec::new(), bytes };
        let mut at = if named { 16 } else { 0 };
        let length = this.record(at, &[HEADER_BYTES], "the header")?;
        if length != HEADER_BYTES {
            let what = format!("the header has {length} bytes, expected {HEADER_BYTES}");
            return Err(this.wrong(at, what));
        }
        this.header = this.read_header(at + 4)?;
        at += length + 8;
        this.read_blocks(at)?;
        Ok(this)
    }

    fn wrong(&self, byte: u64, what: impl Into<String>) -> ReadError {
        ReadError::malformed(&self.path, Place::Byte(byte), what)
    }

    fn read<const N: usize>(&self, at: u64) -> Result<[u8; N], ReadError> {
        let mut bytes = [0; N];
        if at.checked_add(N as u64).is_none_or(|end| end > self.bytes) {
            return Err(self.wrong(
                at,
                format!("the file ends at byte {}, where {N} more bytes were expected", self.bytes),
            ));
        }
        let read = self.file.read_exact_at(&mut bytes, at);
        read.map_err(ReadError::io(&self.path))?;
        Ok(bytes)
    }

    fn word(&self, at: u64) -> Result<u64, ReadError> {
        let mut bytes = self.read::<4>(at)?;
        if self.big_endian {
            bytes.reverse();
        }
        Ok(u64::from(u32::from_le_bytes(bytes)))
    }

    fn double(&self, at: u64) -> Result<f64, ReadError> {
        let mut bytes = self.read::<8>(at)?;
        if self.big_endian {
            bytes.reverse();
        }
        Ok(f64::from_le_bytes(bytes))
    }

    /// The length of the record at a byte, whose marks before and behind must agree: one of the
    /// `expected` lengths, which may be so large that the marks have only their last 32 bits, or
    /// else what the marks say.
    fn record(&self, at: u64, expected: &[u64], name: &str) -> Result<u64, ReadError> {
        let mark = self.word(at)?;
        let long = expected.iter().copied().filter(|&length| length > u64::from(u32::MAX));
        let long = long.filter(|length| length % (1 << 32) == mark).find(|length| {
            let end = at.checked_add(4).and_then(|start| start.checked_add(*length));
            end.is_some_and(|end| self.word(end).is_ok_and(|behind| behind == mark))
        });
        let length = long.unwrap_or(mark);
        let end = at + 4 + length;
        if end.checked_add(4).is_none_or(|end| end > self.bytes) {
            return Err(self.wrong(
                at,
                format!("{name} is said to have {length} bytes, and the file ends at byte {}", self.bytes),
            ));
        }
        let behind = self.word(end)?;
        if behind != mark {
            return Err(self.wrong(
                end,
                format!(
                    "{name} has the record mark {behind}, where {mark} stands before it; the file is damaged"
                ),
            ));
        }
        Ok(length)
    }

    fn read_header(&self, at: u64) -> Result<Header, ReadError> {
        let mut header = Header { has_cooling: self.word(at + 120)? != 0, ..self.header.clone() };
        for kind in 0..TYPES as u64 {
            header.counts[kind as usize] = self.word(at + 4 * kind)?;
            header.masses[kind as usize] = self.double(at + 24 + 8 * kind)?;
        }
        (header.time, header.redshift) = (self.double(at + 72)?, self.double(at + 80)?);
        header.files = self.word(at + 124)?;
        (header.box_size, header.hubble) = (self.double(at + 128)?, self.double(at + 152)?);
        if let Some(kind) = header.masses.iter().position(|mass| !mass.is_finite() || *mass < 0.0) {
            return Err(self.wrong(
                at + 24 + 8 * kind as u64,
                "the mass of a type of particle is no number of 0 or more",
            ));
        }
        Ok(header)
    }

    /// The rows that a block has for the particles of each type.
    fn rows(&self, of: Of) -> [u64; TYPES] {
        let header = &self.header;
        std::array::from_fn(|kind| match of {
            Of::All => header.counts[kind],
            Of::OwnMass if header.masses[kind] == 0.0 => header.counts[kind],
            Of::Gas if kind == 0 => header.counts[kind],
            Of::Stars if kind == 4 => header.counts[kind],
            Of::GasAndStars if kind == 0 || kind == 4 => header.counts[kind],
            _ => 0,
        })
    }

    fn read_blocks(&mut self, mut at: u64) -> Result<(), ReadError> {
        let mut unnamed = self.order().into_iter();
        while at < self.bytes && self.blocks.len() < MOST_BLOCKS {
            let name = if self.named {
                let length = self.record(at, &[8], "the name of a block")?;
                if length != 8 {
                    return Err(self.wrong(at, format!("the name of a block has {length} bytes, expected 8")));
                }
                let name = String::from_utf8_lossy(&self.read::<4>(at + 4)?).trim().to_owned();
                at += 16;
                name
            } else {
                // Behind the blocks whose order is the same in all snapshots nothing says what
                // comes.
                let Some(name) = unnamed.next() else { break };
                name.to_owned()
            };
            let known = KNOWN.iter().find(|(known, ..)| *known == name);
            let lengths: Vec<u64> = known.map_or_else(Vec::new, |&(_, of, width)| {
                let rows: u64 = self.rows(of).iter().sum();
                [4, 8].map(|size| rows.saturating_mul(width as u64 * size)).to_vec()
            });
            let length = self.record(at, &lengths, &format!("the block {}", name.escape_debug()))?;
            match self.block(&name, at + 4, length) {
                Ok(block) => self.blocks.extend(block),
                // The order of blocks without names differs between codes from the fourth on.
                Err(_) if !self.named && self.blocks.len() >= 3 => break,
                Err(error) => return Err(error),
            }
            at += length + 8;
        }
        if self.blocks.first().is_none_or(|block| block.name != "POS") {
            return Err(self.wrong(at, "there is no block POS with positions"));
        }
        Ok(())
    }

    /// Names of the blocks of a file that does not have them: GADGET-2's order, in which codes with
    /// cooling put the abundances of electrons and neutral hydrogen before smoothing lengths.
    fn order(&self) -> Vec<&'static str> {
        let own_masses = self.rows(Of::OwnMass).iter().any(|&rows| rows > 0);
        let mut order = vec!["POS", "VEL", "ID"];
        if own_masses {
            order.push("MASS");
        }
        if self.header.counts[0] > 0 {
            order.extend(["U", "RHO"]);
            if self.header.has_cooling {
                order.extend(["NE", "NH"]);
            }
            order.push("HSML");
        }
        order
    }

    /// A block of `length` bytes. `None` if it is unknown for whose particles it is, or what its
    /// numbers are.
    fn block(&self, name: &str, start: u64, length: u64) -> Result<Option<Block>, ReadError> {
        let known = KNOWN.iter().find(|(known, ..)| *known == name);
        // Of others the length tells.
        let candidates: Vec<(Of, usize)> = match known {
            Some(&(_, of, width)) => vec![(of, width)],
            None => [Of::Gas, Of::Stars, Of::GasAndStars, Of::All]
                .into_iter()
                .flat_map(|of| [(of, 1), (of, 3)])
                .collect(),
        };
        for (of, width) in candidates {
            let rows = self.rows(of);
            let numbers = rows.iter().sum::<u64>().saturating_mul(width as u64);
            let size = length.checked_div(numbers).unwrap_or(0);
            let fits = numbers > 0 && size.checked_mul(numbers) == Some(length);
            let kind = match (name, size) {
                ("ID", 4) => ColumnType::U32,
                ("ID", 8) => ColumnType::U64,
                (_, 4) => ColumnType::F32,
                (_, 8) if known.is_some() => ColumnType::F64,
                _ => continue,
            };
            if !fits {
                continue;
            }
            let mut next = 0;
            let first = rows.map(|rows| {
                let first = (rows > 0).then_some(next);
                next += rows;
                first
            });
            let plain = Plain { start, kind, width, big_endian: self.big_endian };
            return Ok(Some(Block { name: name.to_owned(), plain, first }));
        }
        match known {
            Some((_, of, width)) if self.rows(*of).iter().any(|&rows| rows > 0) => {
                let rows: u64 = self.rows(*of).iter().sum();
                Err(self.wrong(
                    start,
                    format!("the block {name} has {length} bytes, expected {width} numbers of 4 or 8 bytes for each of {rows} particles"),
                ))
            }
            _ => Ok(None),
        }
    }
}

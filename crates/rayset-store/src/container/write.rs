//! Completing a file: the sections after its pages, the footer, and finally the header.

use std::collections::BTreeMap;
use std::io::{self, Seek, SeekFrom, Write};

use super::header::{BLOCK_BYTES, FileHeader, FileKind, Footer, Section, SectionKind};
use super::identity::Identity;
use rayset_base::geometry::DVec3;

/// Limit on the bytes of source descriptions that are kept: the first ones in sorted order.
const MAX_SOURCES_BYTES: usize = 128 << 10;

/// Longest description of a reference system that is kept, in bytes.
const MAX_CRS_BYTES: usize = 64 << 10;

/// The textual descriptions in a file. Anything else in the section is ignored.
#[derive(Clone, Debug, Default, PartialEq, serde::Deserialize, serde::Serialize)]
#[serde(default)]
pub struct Metadata {
    /// The coordinate reference system; empty if unknown.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub crs: String,
    /// Descriptions of the sources, sorted.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub sources: Vec<String>,
    /// The direction that is up, if the sources say so.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub up: Option<[f64; 3]>,
    /// The direction in which one looks at the front, if the sources say so.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub facing: Option<[f64; 3]>,
    /// The step of the coordinates along each axis, if the sources say so: the largest, of several.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub step: Option<[f64; 3]>,
    /// Points of the sources that were equal to others in everything, and became one with them.
    #[serde(skip_serializing_if = "is_zero")]
    pub copies: u64,
    /// Names of feature bits, by bit number.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub features: BTreeMap<String, String>,
    /// The required features of the file that it is written to.
    #[serde(skip)]
    pub required_features: u64,
}

fn is_zero(number: &u64) -> bool {
    *number == 0
}

impl Metadata {
    /// Sorts, deduplicates and limits the descriptions of the sources, so that their order and
    /// number do not show.
    pub fn new(crs: &str, mut sources: Vec<String>) -> Self {
        sources.sort();
        sources.dedup();
        let mut bytes = 0;
        sources.retain(|source| {
            bytes += source.len();
            bytes <= MAX_SOURCES_BYTES
        });
        let crs = if crs.len() <= MAX_CRS_BYTES { crs.to_owned() } else { String::new() };
        Self { crs, sources, ..Self::default() }
    }

    /// The steps of the coordinates of both of two sources; `None` if those of one are not known.
    pub fn common_step(a: Option<[f64; 3]>, b: Option<[f64; 3]>) -> Option<[f64; 3]> {
        let (a, b) = (a?, b?);
        Some(std::array::from_fn(|axis| a[axis].max(b[axis])))
    }

    /// The step of the coordinates along each axis; `None` if there is none.
    pub fn step(&self) -> Option<[f64; 3]> {
        self.step.filter(|step| step.iter().all(|v| v.is_finite() && *v > 0.0))
    }

    /// The direction that is up, of length one; `None` if there is none.
    pub fn up(&self) -> Option<DVec3> {
        self.up.and_then(|up| DVec3::from_array(up).try_normalize())
    }

    /// The direction in which one looks at the front, of length one; `None` if there is none.
    pub fn facing(&self) -> Option<DVec3> {
        self.facing.and_then(|facing| DVec3::from_array(facing).try_normalize())
    }

    fn encode(&self) -> io::Result<Vec<u8>> {
        Ok(serde_json::to_vec(self)?)
    }
}

/// Writes the sections after the pages, the footer, and finally the header, without which the file
/// does not open. Returns the header.
///
/// `pages` are the sections of pages (kind, number of pages, digest), which are already written one
/// after another behind the header block. `sections` are written here.
pub fn seal_file(
    output: &mut (impl Write + Seek),
    kind: FileKind,
    identity: Identity,
    page_bytes: u32,
    pages: &[(SectionKind, u32, u32)],
    sections: &[(SectionKind, Vec<u8>)],
    metadata: &Metadata,
) -> io::Result<FileHeader> {
    let mut end = BLOCK_BYTES as u64;
    let mut directory = Vec::new();
    for &(kind, pages, checksum) in pages.iter().filter(|(_, pages, _)| *pages > 0) {
        let bytes = u64::from(pages) * u64::from(page_bytes);
        directory.push(Section { kind, pages, offset: end, bytes, checksum });
        end += bytes;
    }
    output.seek(SeekFrom::Start(end))?;
    let meta = (SectionKind::META, metadata.encode()?);
    for (kind, bytes) in sections.iter().chain([&meta]) {
        let section = Section {
            kind: *kind,
            pages: 0,
            offset: end,
            bytes: bytes.len() as u64,
            checksum: crc32c::crc32c(bytes),
        };
        directory.push(section);
        output.write_all(bytes)?;
        let padded = bytes.len().next_multiple_of(BLOCK_BYTES);
        output.write_all(&vec![0; padded - bytes.len()])?;
        end += padded as u64;
    }
    let header = FileHeader {
        kind,
        identity,
        required_features: metadata.required_features,
        optional_features: 0,
        file_bytes: end + BLOCK_BYTES as u64,
        page_bytes,
        sections: directory,
    };
    let block = header.encode();
    output.write_all(&Footer::of(&block).encode())?;
    output.flush()?;
    output.seek(SeekFrom::Start(0))?;
    output.write_all(&block)?;
    Ok(header)
}

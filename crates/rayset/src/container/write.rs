//! The end of a file in the making: the sections behind its pages, the footer, and last of all the header.

use std::collections::BTreeMap;
use std::io::{self, Seek, SeekFrom, Write};

use super::header::{BLOCK_BYTES, FileHeader, FileKind, Footer, Section, SectionKind};
use super::identity::Identity;

/// Most bytes of descriptions of sources that are kept: those of the first in the order of their texts.
const MAX_SOURCES_BYTES: usize = 128 << 10;

/// Longest name of a reference system that is kept.
const MAX_CRS_BYTES: usize = 64 << 10;

/// What a file says in words, besides its numbers. Whatever else is in the section is ignored.
#[derive(Clone, Debug, Default, serde::Deserialize, serde::Serialize)]
#[serde(default)]
pub(crate) struct Metadata {
    /// The coordinate reference system; empty where none is known.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub(crate) crs: String,
    /// Descriptions of the sources, in the order of their texts.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(crate) sources: Vec<String>,
    /// Names of feature bits, by their numbers.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub(crate) features: BTreeMap<String, String>,
}

impl Metadata {
    /// What is kept of what sources say: neither their order nor their number shows.
    pub(crate) fn new(crs: &str, mut sources: Vec<String>) -> Self {
        sources.sort();
        sources.dedup();
        let mut bytes = 0;
        sources.retain(|source| {
            bytes += source.len();
            bytes <= MAX_SOURCES_BYTES
        });
        let crs = if crs.len() <= MAX_CRS_BYTES { crs.to_owned() } else { String::new() };
        Self { crs, sources, features: BTreeMap::new() }
    }

    fn encode(&self) -> io::Result<Vec<u8>> {
        Ok(serde_json::to_vec(self)?)
    }
}

/// Writes what stands behind the pages, and last of all the header, without which nothing opens; returns it.
///
/// `pages` are the sections of pages: kind, number, digest; they follow each other from the first block on, and are
/// written already. `sections` are written here.
pub(crate) fn seal_file(
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
        required_features: 0,
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

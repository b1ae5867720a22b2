//! The end of a file in the making: the sections behind its pages, the footer, and last of all the header.

use std::io::{self, Seek, SeekFrom, Write};

use super::header::{BLOCK_BYTES, FileHeader, FileKind, Footer, Section, SectionKind};
use super::identity::Identity;

/// Most bytes of descriptions of sources that are kept: those of the first in the order of their texts.
const MAX_SOURCES_BYTES: usize = 256 << 10;

/// What a file says in words, besides its numbers.
#[derive(Clone, Debug, Default)]
pub(crate) struct Metadata {
    /// The coordinate reference system; empty where none is known.
    pub(crate) crs: String,
    /// Descriptions of the sources.
    pub(crate) sources: Vec<String>,
}

impl Metadata {
    fn encode(&self) -> Vec<u8> {
        let mut sources = self.sources.clone();
        sources.sort();
        sources.dedup();
        let mut bytes = 0;
        sources.retain(|source| {
            bytes += source.len();
            bytes <= MAX_SOURCES_BYTES
        });
        let mut words = serde_json::Map::new();
        if !self.crs.is_empty() {
            words.insert("crs".into(), self.crs.clone().into());
        }
        if !sources.is_empty() {
            words.insert("sources".into(), sources.into());
        }
        serde_json::Value::Object(words).to_string().into_bytes()
    }

    /// What [`encode`](Self::encode) wrote; whatever is not understood is left out.
    pub(crate) fn decode(words: &serde_json::Value) -> Self {
        let text = |v: &serde_json::Value| v.as_str().map(str::to_owned);
        let sources = words.get("sources").and_then(serde_json::Value::as_array);
        Self {
            crs: words.get("crs").and_then(text).unwrap_or_default(),
            sources: sources.into_iter().flatten().filter_map(text).collect(),
        }
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
    let meta = (SectionKind::META, metadata.encode());
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

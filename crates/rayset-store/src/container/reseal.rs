//! Corrects the checksums of a mutated file, so that tests and fuzzers reach the code behind the
//! checks.

use super::checksum_around;
use super::header::{BLOCK_BYTES, CHECKSUM_AT, DIRECTORY_AT, FileHeader, FileKind, Footer, SECTION_BYTES};
use super::page::PAGE_CHECKSUM_AT;

/// Recomputes every checksum that can be reached from the file's header: of pages, sections, header
/// and footer. If the header is invalid, only its own checksum is corrected.
pub fn reseal(bytes: &mut [u8]) {
    if bytes.len() < 2 * BLOCK_BYTES {
        return;
    }
    let mut block = [0; BLOCK_BYTES];
    block.copy_from_slice(&bytes[..BLOCK_BYTES]);
    seal(&mut block);
    let decoded = FileKind::of(&block).and_then(|kind| FileHeader::decode(&block, kind).ok());
    let Some(header) = decoded.filter(|h| h.file_bytes == bytes.len() as u64) else {
        bytes[..BLOCK_BYTES].copy_from_slice(&block);
        return;
    };
    for (index, section) in header.sections.iter().enumerate() {
        let all = &mut bytes[section.offset as usize..(section.offset + section.bytes) as usize];
        let mut checksum = 0;
        if section.pages > 0 {
            for page in all.chunks_exact_mut(header.page_bytes as usize) {
                let own = checksum_around(header.identity.seed(), page, PAGE_CHECKSUM_AT).to_le_bytes();
                page[PAGE_CHECKSUM_AT..PAGE_CHECKSUM_AT + 4].copy_from_slice(&own);
                checksum = crc32c::crc32c_append(checksum, &own);
            }
        } else {
            checksum = crc32c::crc32c(all);
        }
        let at = DIRECTORY_AT + index * SECTION_BYTES + 24;
        block[at..at + 4].copy_from_slice(&checksum.to_le_bytes());
    }
    seal(&mut block);
    bytes[..BLOCK_BYTES].copy_from_slice(&block);
    let footer = bytes.len() - BLOCK_BYTES;
    bytes[footer..].copy_from_slice(&Footer::of(&block).encode());
}

fn seal(block: &mut [u8; BLOCK_BYTES]) {
    let checksum = checksum_around(0, block, CHECKSUM_AT);
    block[CHECKSUM_AT..CHECKSUM_AT + 4].copy_from_slice(&checksum.to_le_bytes());
}

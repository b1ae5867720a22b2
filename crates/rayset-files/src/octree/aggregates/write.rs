//! Writing a cloud again, with its aggregates.

use std::io::{self, Seek, Write};

use super::error::AggregateError;
use super::header::{AggregateHeader, LEVELS};
use super::options::AggregateOptions;
use super::records::move_children;
use super::store::StoredRecords;
use crate::octree::file::Cloud;
use crate::paged_file::HasPages;
use rayset_base::cancel::CancelToken;
use rayset_store::container::{
    BLOCK_BYTES, FileKind, PAGE_HEAD_BYTES, PageHead, PageKind, SectionKind, StreamHash, seal_file,
    stored_page_checksum,
};

/// Writes a file with the points and nodes of a cloud, which are checked on the way, and with these
/// records.
pub(super) fn write<W: Write + Seek>(
    cloud: &Cloud,
    made: &StoredRecords,
    options: &AggregateOptions,
    cancel: &CancelToken,
    output: &mut W,
) -> Result<(), AggregateError> {
    let header = cloud.header();
    let mut aggregates = made.header(options).ok_or_else(|| AggregateError::too_many(cloud.path()))?;
    let io = |source| AggregateError::Io { action: "write", path: None, source };
    output.write_all(&[0; BLOCK_BYTES]).map_err(io)?;
    let mut digests = [0_u32; 3];
    cloud.stored_file().try_for_each_page(|page, bytes| {
        if cancel.is_cancelled() {
            return Err(AggregateError::Cancelled);
        }
        if page >= header.point_pages + header.node_pages {
            return Ok(());
        }
        let section = usize::from(page >= header.point_pages);
        digests[section] = with_page(digests[section], bytes);
        output.write_all(bytes).map_err(io)
    })?;
    digests[2] = write_pages(cloud, made, &mut aggregates, cancel, output)?;
    let mut file = cloud.stored_file().reopened()?;
    let mut sections = Vec::new();
    for kind in [SectionKind::CLOUD, SectionKind::COLUMNS] {
        sections.push((kind, file.section(kind)?));
    }
    sections.push((SectionKind::AGGREGATE_HEADER, aggregates.encode()));
    let mut metadata = file.metadata()?;
    metadata.required_features = file.header().required_features;
    let pages = [
        (SectionKind::POINTS, header.point_pages, digests[0]),
        (SectionKind::NODES, header.node_pages, digests[1]),
        (SectionKind::AGGREGATES, aggregates.pages, digests[2]),
    ];
    let (identity, page_bytes) = (header.identity, header.page_bytes);
    seal_file(output, FileKind::Cloud, identity, page_bytes, &pages, &sections, &metadata).map_err(io)?;
    Ok(())
}

/// Writes the pages of records, and completes their header; returns the digest of the pages.
fn write_pages(
    cloud: &Cloud,
    made: &StoredRecords,
    aggregates: &mut AggregateHeader,
    cancel: &CancelToken,
    output: &mut impl Write,
) -> Result<u32, AggregateError> {
    let header = cloud.header();
    let (bytes, per_page) = (made.record_bytes, aggregates.records_per_page(header.page_bytes) as usize);
    let mut hash = StreamHash::new("aggregates");
    let mut digest = 0;
    let mut page = vec![0; header.page_bytes as usize];
    let mut in_page = 0;
    let mut finish = |page: &mut Vec<u8>, in_page: &mut usize, pages: &mut u32| -> io::Result<()> {
        let used = PAGE_HEAD_BYTES + *in_page * bytes;
        hash.update(&page[PAGE_HEAD_BYTES..used]);
        let number = header.point_pages + header.node_pages + *pages;
        let (kind, records, used_bytes) = (PageKind::Aggregates, *in_page as u32, used as u32);
        PageHead { kind, page: number, records, used_bytes }.seal(page, header.identity);
        digest = with_page(digest, page);
        output.write_all(page)?;
        page.fill(0);
        (*in_page, *pages) = (0, *pages + 1);
        Ok(())
    };
    let io = |source| AggregateError::Io { action: "write", path: None, source };
    let mut pages = 0;
    for level in 0..LEVELS {
        let (mut next, count) = (0, made.count(level));
        while next < count {
            if cancel.is_cancelled() {
                return Err(AggregateError::Cancelled);
            }
            let now = (count - next).min((per_page - in_page) as u64);
            let at = PAGE_HEAD_BYTES + in_page * bytes;
            let records = &mut page[at..at + now as usize * bytes];
            made.read(level, next, records)?;
            let below = aggregates.first_of_level.get(level + 1).copied().unwrap_or(0);
            move_children(records, bytes, below);
            (next, in_page) = (next + now, in_page + now as usize);
            if in_page == per_page {
                finish(&mut page, &mut in_page, &mut pages).map_err(io)?;
            }
        }
    }
    if in_page > 0 {
        finish(&mut page, &mut in_page, &mut pages).map_err(io)?;
    }
    aggregates.pages = pages;
    aggregates.digest = hash.identity().0;
    Ok(digest)
}

/// Extends a digest of pages by another page.
fn with_page(digest: u32, page: &[u8]) -> u32 {
    crc32c::crc32c_append(digest, &stored_page_checksum(page).to_le_bytes())
}

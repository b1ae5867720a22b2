//! Comparing the aggregates of a file with what its points make.

use super::error::AggregateError;
use super::header::AggregateHeader;
use super::records::{RecordSink, move_children};
use crate::octree::file::Cloud;
use crate::paged_file::HasPages;
use rayset_store::container::{OpenFile, PAGE_HEAD_BYTES, SectionKind, StreamHash};

/// The records of a file, as they are made again.
pub(super) struct Comparison<'a> {
    known: &'a AggregateHeader,
    file: OpenFile,
    per_page: u32,
    /// The page that was read last.
    page: Option<(u32, Vec<u8>)>,
    compared: u32,
}

impl<'a> Comparison<'a> {
    /// With those of a cloud, whose pages have been checked.
    pub(super) fn new(cloud: &Cloud, known: &'a AggregateHeader) -> Result<Self, AggregateError> {
        let per_page = known.records_per_page(cloud.header().page_bytes);
        Ok(Self { known, file: cloud.stored_file().reopened()?, per_page, page: None, compared: 0 })
    }

    /// How many were compared, which are all.
    pub(super) fn finish(self) -> Result<u32, AggregateError> {
        if self.compared != self.known.records() {
            return Err(self.differs(self.compared, self.known.level_of(self.compared).into()));
        }
        let mut hash = StreamHash::new("aggregates");
        let mut left = self.compared as usize;
        for page in 0..self.known.pages {
            let (_, page) = self.file.page(SectionKind::AGGREGATES, page)?;
            let here = left.min(self.per_page as usize);
            hash.update(&page[PAGE_HEAD_BYTES..][..here * self.known.record_bytes as usize]);
            left -= here;
        }
        if hash.identity().0 == self.known.digest { Ok(self.compared) } else { Err(AggregateError::Hash) }
    }

    fn differs(&self, number: u32, level: usize) -> AggregateError {
        AggregateError::Differs { number, level: level as u8 }
    }
}

impl RecordSink for Comparison<'_> {
    fn append(&mut self, level: usize, first: u32, mut records: Vec<u8>) -> Result<(), AggregateError> {
        let AggregateHeader { first_of_level, record_bytes, .. } = self.known;
        let bytes = *record_bytes as usize;
        move_children(&mut records, bytes, first_of_level[level + 1]);
        let begin = u64::from(first_of_level[level]) + u64::from(first);
        for (number, record) in (begin..).zip(records.chunks_exact(bytes)) {
            if number >= u64::from(first_of_level[level + 1]) {
                return Err(self.differs(number as u32, level));
            }
            let (page, at) = (number as u32 / self.per_page, number as usize % self.per_page as usize);
            if self.page.as_ref().is_none_or(|(read, _)| *read != page) {
                self.page = Some((page, self.file.page(SectionKind::AGGREGATES, page)?.1));
            }
            let stored = self.page.as_ref().map(|(_, page)| &page[PAGE_HEAD_BYTES + at * bytes..][..bytes]);
            if stored != Some(record) {
                return Err(self.differs(number as u32, level));
            }
            self.compared += 1;
        }
        Ok(())
    }
}

//! Pages of aggregates (section `AGGR`).

use super::header::AggregateHeader;
use super::record::{AGGREGATE_BYTES, Aggregate, CellPlace};
use crate::octree::format::Header;
use crate::octree::layout::RootCell;
use rayset_store::container::{PAGE_HEAD_BYTES, PageError, PageHead, PageKind};

/// A page of aggregates whose records have been checked.
#[derive(Clone, Copy, Debug)]
pub struct AggregatePage<'a> {
    bytes: &'a [u8],
    record_bytes: usize,
    len: usize,
    has_color: bool,
    root: RootCell,
}

impl<'a> AggregatePage<'a> {
    /// Checks a page, numbered over all pages of the file: its head, that every record has
    /// densities, and that its children are records one level below.
    ///
    /// # Errors
    /// [`PageError`], which says what is wrong.
    pub fn check(
        bytes: &'a [u8],
        page: u32,
        header: &Header,
        of: &AggregateHeader,
    ) -> Result<Self, PageError> {
        let head = PageHead::check(bytes, PageKind::Aggregates, page, header.identity)?;
        let wrong = |what| Err(PageError::Content { what });
        let per_page = of.records_per_page(header.page_bytes);
        let first = (page - header.point_pages - header.node_pages) * per_page;
        if head.records != per_page.min(of.records().saturating_sub(first)) {
            return wrong("not as many aggregates as belong to the page");
        }
        let this = Self::trusted(bytes, header, of);
        // No two records of a page have the same children. Those of two pages may: who walks has to
        // count.
        let mut next_child = 0;
        for index in 0..this.len {
            let number = first + index as u32;
            let level = usize::from(of.level_of(number));
            let Some(record) = this.get(index, level as u8) else {
                return wrong("an aggregate without densities");
            };
            let end = u64::from(record.first_child) + u64::from(record.children());
            let below = &of.first_of_level[level + 1..];
            let is_below = below.len() > 1 && record.first_child >= below[0] && end <= u64::from(below[1]);
            if record.children() != 0 && !(is_below && record.first_child >= next_child) {
                return wrong("an aggregate whose children are not one level below");
            }
            if record.children() != 0 {
                next_child = end as u32;
            }
        }
        Ok(this)
    }

    /// A page that has already passed [`check`](Self::check).
    #[must_use]
    pub fn trusted(bytes: &'a [u8], header: &Header, of: &AggregateHeader) -> Self {
        let len = u32::from_le_bytes([bytes[12], bytes[13], bytes[14], bytes[15]]) as usize;
        let record_bytes = of.record_bytes as usize;
        Self { bytes, record_bytes, len, has_color: header.has_color, root: header.root_cell() }
    }

    /// Number of records.
    #[must_use]
    #[expect(clippy::len_without_is_empty, reason = "no page is empty")]
    pub fn len(&self) -> usize {
        self.len
    }

    fn bytes_of(&self, index: usize) -> Option<&'a [u8]> {
        let at = PAGE_HEAD_BYTES + index * self.record_bytes;
        (index < self.len).then(|| &self.bytes[at..at + self.record_bytes])
    }

    /// The record of a cell at a level; `None` if it is beyond the page, or none.
    #[must_use]
    pub fn get(&self, index: usize, level: u8) -> Option<Aggregate> {
        Aggregate::decode(self.bytes_of(index)?, self.root, self.edge(level))
    }

    fn edge(&self, level: u8) -> f64 {
        self.root.size * 2_f64.powi(-i32::from(level))
    }

    /// Where the record of a cell at a level is, how far it extends, and what is below it: all that
    /// a walk reads.
    #[must_use]
    pub fn place(&self, index: usize, level: u8) -> Option<CellPlace> {
        CellPlace::decode(self.bytes_of(index)?, self.root, self.edge(level))
    }

    /// The colour of a record, as displays have it (sRGB).
    #[must_use]
    pub fn color(&self, index: usize) -> Option<[u8; 3]> {
        let bytes = self.bytes_of(index).filter(|_| self.has_color)?;
        Some([bytes[AGGREGATE_BYTES], bytes[AGGREGATE_BYTES + 1], bytes[AGGREGATE_BYTES + 2]])
    }

    /// An attribute of a record.
    #[must_use]
    pub fn attribute(&self, index: usize, attribute: usize) -> Option<f32> {
        let at = AGGREGATE_BYTES + 4 * (usize::from(self.has_color) + attribute);
        let bytes = self.bytes_of(index)?.get(at..at + 4)?;
        Some(f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
    }
}

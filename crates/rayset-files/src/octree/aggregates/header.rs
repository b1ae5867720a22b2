//! What a file says of its aggregates (section `AGGH`), and their pages (section `AGGR`).

use super::record::{AGGREGATE_BYTES, Aggregate};
use crate::octree::format::Header;
use crate::octree::layout::{DEEPEST_LEVEL, RootCell};
use rayset_base::kernel::Kernel;
use rayset_store::container::{PAGE_HEAD_BYTES, PageError, PageHead, PageKind, Reader, Writer};

/// Levels of cells, that of the root among them.
pub const LEVELS: usize = DEEPEST_LEVEL as usize + 1;

const NORMALISED: u32 = 1;

/// What a file says of its aggregates. Records are ordered by level, and in a level as the points
/// are.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AggregateHeader {
    /// Number of their pages, which follow those of nodes.
    pub pages: u32,
    /// Bytes of a record: [`AGGREGATE_BYTES`], four of the colour if points have colours, and four
    /// for each attribute.
    pub record_bytes: u32,
    /// The kernel of the densities.
    pub kernel: Kernel,
    /// Whether weights are divided by what the kernels integrate to.
    pub normalised: bool,
    /// Cells of at most so many points have no record.
    pub few_points: u32,
    /// The number of the first record of each level, and that of all records.
    pub first_of_level: [u32; LEVELS + 1],
    /// A hash of all records.
    pub digest: [u8; 16],
}

impl AggregateHeader {
    /// Number of records.
    #[must_use]
    pub fn records(&self) -> u32 {
        self.first_of_level[LEVELS]
    }

    /// Number of records in a page.
    #[must_use]
    pub fn records_per_page(&self, page_bytes: u32) -> u32 {
        (page_bytes - PAGE_HEAD_BYTES as u32) / self.record_bytes
    }

    /// The level of a record.
    #[must_use]
    pub fn level_of(&self, record: u32) -> u8 {
        (self.first_of_level.partition_point(|&first| first <= record).max(1) - 1) as u8
    }

    /// Bytes of a record of a cloud with colours or without, and with so many attributes.
    #[must_use]
    pub fn bytes_of_record(has_color: bool, attributes: usize) -> usize {
        AGGREGATE_BYTES + 4 * (usize::from(has_color) + attributes)
    }

    /// Encodes the section `AGGH`.
    #[must_use]
    pub fn encode(&self) -> Vec<u8> {
        let kernel = Kernel::OF_DENSITIES.iter().position(|&kernel| kernel == self.kernel);
        let mut w = Writer::default();
        w.u32(self.record_bytes);
        w.u32(self.few_points);
        w.u32(kernel.unwrap_or(0) as u32);
        w.u32(if self.normalised { NORMALISED } else { 0 });
        self.first_of_level.iter().for_each(|&first| w.u32(first));
        w.put(&self.digest);
        w.bytes
    }

    /// Decodes the section `AGGH` of a file with this many pages of aggregates.
    pub(in crate::octree) fn decode(bytes: &[u8], pages: u32, of: &Header) -> Result<Self, &'static str> {
        let read = || -> Option<_> {
            let mut r = Reader::new(bytes);
            let numbers = [r.u32()?, r.u32()?, r.u32()?, r.u32()?];
            let mut first_of_level = [0; LEVELS + 1];
            for first in &mut first_of_level {
                *first = r.u32()?;
            }
            Some((numbers, first_of_level, r.take()?))
        };
        let ([record_bytes, few_points, kernel, flags], first_of_level, digest) =
            read().ok_or("the numbers of the aggregates end early")?;
        let kernel = *Kernel::OF_DENSITIES.get(kernel as usize).ok_or("aggregates of an unknown kernel")?;
        if record_bytes as usize != Self::bytes_of_record(of.has_color, of.attributes.len()) {
            return Err("the records of aggregates are not as long as those of such points");
        }
        if first_of_level[0] != 0 || !first_of_level.is_sorted() || first_of_level[1] > 1 {
            return Err("the numbers of aggregates by level do not follow each other");
        }
        let normalised = flags & NORMALISED != 0;
        let header = Self { pages, record_bytes, kernel, normalised, few_points, first_of_level, digest };
        let per_page = header.records_per_page(of.page_bytes);
        if per_page == 0 || header.records().div_ceil(per_page.max(1)) != pages {
            return Err("the pages of aggregates are not as many as their records need");
        }
        Ok(header)
    }
}

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
        for index in 0..this.len {
            let number = first + index as u32;
            let level = usize::from(of.level_of(number));
            let Some(record) = this.get(index, level as u8) else {
                return wrong("an aggregate without densities");
            };
            let end = u64::from(record.first_child) + u64::from(record.child_mask.count_ones());
            let below = &of.first_of_level[level + 1..];
            let is_below = below.len() > 1 && record.first_child >= below[0] && end <= u64::from(below[1]);
            if record.child_mask != 0 && !is_below {
                return wrong("an aggregate whose children are not one level below");
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
        let edge = self.root.size * 2_f64.powi(-i32::from(level));
        Aggregate::decode(self.bytes_of(index)?, self.root, edge)
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

/// Which densities a file's aggregates are of, for messages.
impl std::fmt::Display for AggregateHeader {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "kernel {}{}", self.kernel, if self.normalised { ", normalised" } else { "" })
    }
}

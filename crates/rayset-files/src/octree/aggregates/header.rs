//! What a file says of its aggregates (section `AGGH`).

use super::record::AGGREGATE_BYTES;
use crate::octree::layout::DEEPEST_LEVEL;
use rayset_base::kernel::Kernel;
use rayset_store::container::{PAGE_HEAD_BYTES, Reader, Writer};

/// Levels of cells, that of the root among them.
pub const LEVELS: usize = DEEPEST_LEVEL as usize + 1;

const NORMALISED: u32 = 1;
/// The least number of points that may be few.
pub(super) const LEAST_FEW: u32 = 4;

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
    /// Cells of at most so many points are not divided.
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

    /// The page of a record, counted from the first of aggregates, and its place there, in pages of
    /// this size.
    #[must_use]
    pub fn place_of(&self, record: u32, page_bytes: u32) -> (u32, usize) {
        let per_page = self.records_per_page(page_bytes).max(1);
        (record / per_page, (record % per_page) as usize)
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

    /// Decodes the section `AGGH` of a file with this many pages of aggregates, of this size, whose
    /// records must have so many bytes.
    pub(in crate::octree) fn decode(
        bytes: &[u8],
        pages: u32,
        (page_bytes, expected): (u32, usize),
    ) -> Result<Self, &'static str> {
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
        if record_bytes as usize != expected {
            return Err("the records of aggregates are not as long as those of such points");
        }
        if flags & !NORMALISED != 0 || few_points < LEAST_FEW {
            return Err("aggregates of an unknown kind, or of cells of fewer than four points");
        }
        if first_of_level[..2] != [0, 1] || !first_of_level.is_sorted() {
            return Err("the numbers of aggregates by level do not follow each other");
        }
        let normalised = flags & NORMALISED != 0;
        let header = Self { pages, record_bytes, kernel, normalised, few_points, first_of_level, digest };
        let per_page = header.records_per_page(page_bytes);
        if per_page == 0 || header.records().div_ceil(per_page.max(1)) != pages {
            return Err("the pages of aggregates are not as many as their records need");
        }
        Ok(header)
    }
}

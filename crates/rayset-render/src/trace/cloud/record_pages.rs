//! Where the records of a cloud's aggregates are read from.

use super::lod::CloudLod;
use super::placement::CloudPlacement;
use crate::trace::access::{Access, Halt, Lacking};
use rayset_files::octree::aggregates::{Aggregate, AggregateHeader, AggregatePage, CellPlace};
use rayset_store::working_set::{PageClient, PageGuard};

/// Where pages come from.
#[derive(Clone, Copy)]
enum Source<'a> {
    /// They are brought in, or a reason to put the tile off.
    Retained(Access<'a>),
    /// They are in memory anyway, or lacking.
    InMemory(&'a PageClient),
}

/// The records of a cloud's aggregates, of which one page is held at a time.
pub(super) struct RecordPages<'a> {
    source: Source<'a>,
    cloud: &'a CloudPlacement,
    aggregates: &'a AggregateHeader,
    held: Option<(u32, PageGuard)>,
    /// Pages that were looked at, if they are in memory anyway.
    touched: Vec<u32>,
}

impl<'a> RecordPages<'a> {
    pub(super) fn new(access: Access<'a>, cloud: &'a CloudPlacement, lod: &'a CloudLod) -> Self {
        Self::from(Source::Retained(access), cloud, lod)
    }

    /// Those that are in memory: where one is not, what asks for it ends with
    /// [`Halt::Deferred`].
    pub(super) fn in_memory(client: &'a PageClient, cloud: &'a CloudPlacement, lod: &'a CloudLod) -> Self {
        Self::from(Source::InMemory(client), cloud, lod)
    }

    fn from(source: Source<'a>, cloud: &'a CloudPlacement, lod: &'a CloudLod) -> Self {
        Self { source, cloud, aggregates: &lod.aggregates, held: None, touched: Vec::new() }
    }

    /// The pages that were looked at since this was asked, if they are in memory anyway; some
    /// several times.
    pub(super) fn take_touched(&mut self) -> Vec<u32> {
        std::mem::take(&mut self.touched)
    }

    /// The page of a record, its number in the file, and the record's place in it.
    pub(super) fn page_of(&mut self, record: u32) -> Result<(AggregatePage<'_>, u32, usize), Halt> {
        let header = self.cloud.header();
        let (page, index) = self.aggregates.place_of(record, header.page_bytes);
        let page = header.point_pages + header.node_pages + page;
        if record >= self.aggregates.records() {
            return Err(self.cloud.broken(page.min(header.pages().saturating_sub(1))).into());
        }
        let is_held = self.held.as_ref().is_some_and(|(held, _)| *held == page);
        if !is_held {
            self.held = Some((page, self.bring(page)?));
        }
        if matches!(self.source, Source::InMemory(_)) && self.touched.last() != Some(&page) {
            self.touched.push(page);
        }
        let Some((_, bytes)) = &self.held else { return Err(self.cloud.broken(page).into()) };
        Ok((AggregatePage::trusted(bytes, header, self.aggregates), page, index))
    }

    fn bring(&self, page: u32) -> Result<PageGuard, Halt> {
        match self.source {
            Source::Retained(access) => access.retain(self.cloud, page),
            Source::InMemory(client) => {
                let object = &self.cloud.pages;
                let lacking = || Halt::Deferred(Lacking { object: object.clone(), page });
                client.peek(object, page).ok_or_else(lacking)
            }
        }
    }

    /// What a walk reads of the record of a cell at a level.
    pub(super) fn place(&mut self, record: u32, level: u8) -> Result<CellPlace, Halt> {
        let (page, number, index) = self.page_of(record)?;
        let place = page.place(index, level);
        place.ok_or_else(|| self.cloud.broken(number).into())
    }

    /// A whole record of a cell at a level.
    pub(super) fn record(&mut self, record: u32, level: u8) -> Result<Aggregate, Halt> {
        let (page, number, index) = self.page_of(record)?;
        let found = page.get(index, level);
        found.ok_or_else(|| self.cloud.broken(number).into())
    }

    /// Number of all records.
    pub(super) fn records(&self) -> u32 {
        self.aggregates.records()
    }

    /// How many records from one on are in its page.
    pub(super) fn left_in_page(&self, record: u32) -> u32 {
        let per_page = self.aggregates.records_per_page(self.cloud.header().page_bytes).max(1);
        per_page - record % per_page
    }
}

//! Opening a cloud: header, footer, length and descriptions are checked here; pages are checked
//! when they are read.

use std::sync::Arc;

use super::aggregates::page::AggregatePage;
use super::format::Header;
use super::node::NodePage;
use super::page::{PointPage, Run};
use crate::paged_file::{HasPages, PagedFile, PagedHeader, paged_file};
use rayset_store::container::{FileKind, Identity, OpenError, OpenFile, PageError, ScanError, SectionKind};
use rayset_store::storage::Storage;
use rayset_store::working_set::Kind;

/// Radii that points may be given; lengths in scenes have the same limits.
const RADII: std::ops::RangeInclusive<f64> = 1e-18..=1e18;

/// An open cloud: its checked header, and where its pages are read from.
pub struct Cloud {
    file: PagedFile<Header>,
    /// The cloud as it is stored, if this one has other radii.
    stored: Option<Arc<Self>>,
}

paged_file!(Cloud, "cloud", Header, |file| Self { file, stored: None });

#[doc(hidden)]
impl PagedHeader for Header {
    const FILE: FileKind = FileKind::Cloud;
    const SECTIONS: &[SectionKind] = &[SectionKind::POINTS, SectionKind::NODES, SectionKind::AGGREGATES];

    fn read(file: &mut OpenFile) -> Result<Self, OpenError> {
        Self::read(file)
    }

    fn identity(&self) -> Identity {
        self.identity
    }

    fn pages(&self) -> u32 {
        self.pages()
    }

    fn page_bytes(&self) -> usize {
        self.page_bytes as usize
    }

    fn page_offset(&self, page: u32) -> u64 {
        self.page_offset(page)
    }

    fn kind_of_page(&self, page: u32) -> Kind {
        if page < self.point_pages {
            Kind::Points
        } else if page < self.point_pages + self.node_pages {
            Kind::Octree
        } else {
            Kind::Aggregates
        }
    }

    fn check_page(&self, page: u32, bytes: &[u8]) -> Result<(), PageError> {
        match self.kind_of_page(page) {
            Kind::Points => PointPage::check(bytes, page, self).map(|_| ()),
            Kind::Aggregates => match &self.aggregates {
                Some(aggregates) => AggregatePage::check(bytes, page, self, aggregates).map(|_| ()),
                None => Err(PageError::Content { what: "a page beyond the last" }),
            },
            _ => NodePage::check(bytes, page, self).map(|_| ()),
        }
    }
}

#[doc(hidden)]
impl HasPages for Cloud {
    type Header = Header;

    fn stored_file(&self) -> &PagedFile<Header> {
        &self.as_stored().file
    }
}

impl Cloud {
    /// The same cloud with its points' radii multiplied by a factor. Both have the same pages in
    /// memory. `None` if the factor is not above 0, or a radius is then not from 1e-18 to 1e18.
    #[must_use]
    pub fn with_radius_scale(self: &Arc<Self>, factor: f32) -> Option<Self> {
        let stored = self.stored();
        let known = &stored.file.header;
        let radius = known.radius.scaled(factor);
        let is_length = |v: f32| RADII.contains(&f64::from(v));
        if !(factor > 0.0 && is_length(radius.min()) && is_length(radius.max())) {
            return None;
        }
        let radius_mean = known.radius_mean * f64::from(factor);
        let shape = known.shape.map(|(least, most)| (least * factor, most * factor));
        let header = Header { radius, radius_mean, radius_scale: factor, shape, ..known.clone() };
        let file = PagedFile { header, ..stored.file.clone() };
        Some(Self { file, stored: Some(stored.clone()) })
    }

    /// The same cloud once more.
    pub(super) fn again(&self) -> Self {
        Self { file: self.file.clone(), stored: self.stored.clone() }
    }

    /// The cloud as it is stored.
    pub(super) fn as_stored(&self) -> &Self {
        self.stored.as_deref().unwrap_or(self)
    }

    /// The cloud as it is stored, whose pages this one has.
    #[doc(hidden)]
    #[must_use]
    pub fn stored(self: &Arc<Self>) -> &Arc<Self> {
        self.stored.as_ref().unwrap_or(self)
    }

    /// Passes every run of points to `visit`, in file order, with the number of its page.
    ///
    /// # Errors
    /// [`ScanError`] at the first page that cannot be read or is damaged.
    #[doc(hidden)]
    pub fn for_each_run(&self, mut visit: impl FnMut(u32, Run<'_>)) -> Result<(), ScanError> {
        let header = self.header();
        self.stored_file().for_each_page(|page, bytes| {
            if header.kind_of_page(page) == Kind::Points {
                let runs = PointPage::trusted(bytes, header);
                (0..runs.len()).for_each(|index| visit(page, runs.run(index)));
            }
        })
    }
}

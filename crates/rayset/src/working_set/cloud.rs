//! Clouds as a source of pages.

use std::io;
use std::sync::Arc;

use super::read::{FileStorage, Storage};
use super::{Kind, Object, PageSource, WorkingSet};
use crate::octree::Cloud;
use crate::octree::format::PageKind;

/// The pages of a cloud file.
pub struct CloudPages {
    cloud: Arc<Cloud>,
    storage: Arc<dyn Storage>,
}

impl CloudPages {
    /// Pages of `cloud`, read from `storage` (the cloud's own file, or something that stands for it).
    #[must_use]
    pub fn new(cloud: Arc<Cloud>, storage: Arc<dyn Storage>) -> Self {
        Self { cloud, storage }
    }
}

impl PageSource for CloudPages {
    fn pages(&self) -> u32 {
        self.cloud.header().pages()
    }

    fn page_bytes(&self) -> usize {
        self.cloud.header().page_bytes as usize
    }

    fn kind(&self, page: u32) -> Kind {
        match self.cloud.page_kind(page) {
            PageKind::Octree => Kind::Octree,
            PageKind::Points => Kind::Points,
        }
    }

    fn offset(&self, page: u32) -> u64 {
        self.cloud.header().page_offset(page)
    }

    fn storage(&self) -> Arc<dyn Storage> {
        self.storage.clone()
    }

    fn check(&self, page: u32, bytes: &[u8]) -> Result<(), String> {
        self.cloud.check_page(page, bytes).map_err(|e| e.to_string())
    }

    fn name(&self) -> String {
        self.cloud.path().display().to_string()
    }
}

/// A working set, and which of its objects holds the pages of which cloud.
#[derive(Clone)]
pub struct PagedClouds {
    /// The working set.
    pub pages: WorkingSet,
    clouds: Vec<(Arc<Cloud>, Arc<Object>)>,
}

impl PagedClouds {
    /// Over a working set, without clouds.
    #[must_use]
    pub fn new(pages: WorkingSet) -> Self {
        Self { pages, clouds: Vec::new() }
    }

    /// Adds a cloud whose pages are read from `storage`. One that is there already stays as it is.
    pub fn add(&mut self, cloud: &Arc<Cloud>, storage: Arc<dyn Storage>) {
        if self.find(cloud).is_none() {
            let object = self.pages.add(Arc::new(CloudPages::new(cloud.clone(), storage)));
            self.clouds.push((cloud.clone(), object));
        }
    }

    /// Adds a cloud whose pages are read from its own file, past the system's page cache where `direct` says so.
    ///
    /// # Errors
    /// The system's, where the file does not open.
    pub fn open(&mut self, cloud: &Arc<Cloud>, direct: bool) -> io::Result<()> {
        if self.find(cloud).is_none() {
            let storage = FileStorage::open(cloud.path(), direct)?;
            self.add(cloud, Arc::new(storage));
        }
        Ok(())
    }

    /// The object of a cloud and its number.
    #[must_use]
    pub fn find(&self, cloud: &Arc<Cloud>) -> Option<(usize, &Arc<Object>)> {
        let at = self.clouds.iter().position(|(known, _)| Arc::ptr_eq(known, cloud))?;
        Some((at, &self.clouds[at].1))
    }

    /// Every cloud.
    pub fn clouds(&self) -> impl Iterator<Item = &Arc<Cloud>> {
        self.clouds.iter().map(|(cloud, _)| cloud)
    }
}

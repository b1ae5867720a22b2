//! Clouds as a source of pages.

use std::sync::Arc;

use crate::octree::Cloud;
use rayset_store::container::PageKind;
use rayset_store::storage::Storage;
use rayset_store::working_set::{Kind, PageSource};

/// The pages of a cloud file.
pub struct CloudPages {
    cloud: Arc<Cloud>,
    storage: Arc<dyn Storage>,
}

impl CloudPages {
    /// Pages of `cloud`, read from `storage` (the cloud's own file, or a substitute for it).
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
        if self.cloud.page_kind(page) == PageKind::Points { Kind::Points } else { Kind::Octree }
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

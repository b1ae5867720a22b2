//! Grids as a source of pages.

use std::sync::Arc;

use crate::grid::Grid;
use crate::grid::format::PAGE_BYTES;
use rayset_store::storage::Storage;
use rayset_store::working_set::{Kind, PageSource};

/// The pages of a grid file.
pub struct GridPages {
    grid: Arc<Grid>,
    storage: Arc<dyn Storage>,
}

impl GridPages {
    /// Pages of `grid`, read from `storage` (the grid's own file, or a substitute for it).
    #[must_use]
    pub fn new(grid: Arc<Grid>, storage: Arc<dyn Storage>) -> Self {
        Self { grid, storage }
    }
}

impl PageSource for GridPages {
    fn pages(&self) -> u32 {
        self.grid.header().pages() as u32
    }

    fn page_bytes(&self) -> usize {
        PAGE_BYTES
    }

    fn kind(&self, _: u32) -> Kind {
        Kind::Voxels
    }

    fn offset(&self, page: u32) -> u64 {
        self.grid.header().page_offset(u64::from(page))
    }

    fn storage(&self) -> Arc<dyn Storage> {
        self.storage.clone()
    }

    fn check(&self, page: u32, bytes: &[u8]) -> Result<(), String> {
        self.grid.check_page(page, bytes).map_err(|e| e.to_string())
    }

    fn name(&self) -> String {
        self.grid.path().display().to_string()
    }
}

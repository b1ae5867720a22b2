//! A working set together with the files whose pages it holds.

use std::io;
use std::sync::Arc;

use crate::grid::{Grid, GridPages};
use crate::octree::{Cloud, CloudPages};
use rayset_store::storage::{FileStorage, Storage};
use rayset_store::working_set::{Object, WorkingSet};

/// A working set, and which of its objects holds the pages of which file.
#[derive(Clone)]
pub struct PagedFiles {
    /// The working set.
    pub pages: WorkingSet,
    clouds: Vec<(Arc<Cloud>, Arc<Object>)>,
    grids: Vec<(Arc<Grid>, Arc<Object>)>,
}

impl PagedFiles {
    /// A working set, without files so far.
    #[must_use]
    pub fn new(pages: WorkingSet) -> Self {
        Self { pages, clouds: Vec::new(), grids: Vec::new() }
    }

    /// Adds a cloud whose pages are read from `storage`. A cloud that has been added already stays as it is.
    pub fn add(&mut self, cloud: &Arc<Cloud>, storage: Arc<dyn Storage>) {
        if self.find(cloud).is_none() {
            let stored = cloud.stored();
            let object = self.pages.add(Arc::new(CloudPages::new(stored.clone(), storage)));
            self.clouds.push((stored.clone(), object));
        }
    }

    /// Adds a cloud whose pages are read from its own storage or file, bypassing the system's page cache if `direct` is
    /// set.
    ///
    /// # Errors
    /// The system's error, if the file cannot be opened.
    pub fn open(&mut self, cloud: &Arc<Cloud>, direct: bool) -> io::Result<()> {
        if self.find(cloud).is_none() {
            let storage = match cloud.storage() {
                Some(storage) => storage.clone(),
                None => Arc::new(FileStorage::open(cloud.path(), direct)?),
            };
            self.add(cloud, storage);
        }
        Ok(())
    }

    /// Adds a grid whose pages are read from its own storage or file, bypassing the system's page cache if `direct` is
    /// set.
    ///
    /// # Errors
    /// The system's error, if the file cannot be opened.
    pub fn open_grid(&mut self, grid: &Arc<Grid>, direct: bool) -> io::Result<()> {
        if self.find_grid(grid).is_none() {
            let storage = match grid.storage() {
                Some(storage) => storage.clone(),
                None => Arc::new(FileStorage::open(grid.path(), direct)?),
            };
            let object = self.pages.add(Arc::new(GridPages::new(grid.clone(), storage)));
            self.grids.push((grid.clone(), object));
        }
        Ok(())
    }

    /// Closes the files that no scene refers to any more, and evicts their pages.
    pub fn drop_unused(&mut self) {
        // References of this list and of the source of the pages.
        const OWN: usize = 2;
        let pages = &self.pages;
        self.clouds.retain(|(cloud, object)| keep(Arc::strong_count(cloud) > OWN, pages, object));
        self.grids.retain(|(grid, object)| keep(Arc::strong_count(grid) > OWN, pages, object));
    }

    /// The object of a cloud. Clouds that differ in nothing but their radii have the same.
    #[must_use]
    pub fn find(&self, cloud: &Arc<Cloud>) -> Option<&Arc<Object>> {
        self.clouds.iter().find(|(known, _)| Arc::ptr_eq(known, cloud.stored())).map(|(_, object)| object)
    }

    /// The object of a grid.
    #[must_use]
    pub fn find_grid(&self, grid: &Arc<Grid>) -> Option<&Arc<Object>> {
        self.grids.iter().find(|(known, _)| Arc::ptr_eq(known, grid)).map(|(_, object)| object)
    }
}

/// Forgets the pages of an object that is not used; returns `used`.
fn keep(used: bool, pages: &WorkingSet, object: &Object) -> bool {
    if !used {
        pages.forget(object);
    }
    used
}

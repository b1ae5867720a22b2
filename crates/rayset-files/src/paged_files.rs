//! A working set together with the files whose pages it holds.

use std::io;
use std::sync::Arc;

use crate::grid::Grid;
use crate::octree::Cloud;
use crate::paged_file::{FilePages, HasPages};
use rayset_store::storage::{FileStorage, Storage};
use rayset_store::working_set::{Object, WorkingSet};

/// A working set, and which of its objects holds the pages of which file.
#[derive(Clone)]
pub struct PagedFiles {
    /// The working set.
    pub pages: WorkingSet,
    clouds: Known<Cloud>,
    grids: Known<Grid>,
}

impl PagedFiles {
    /// A working set, without files so far.
    #[must_use]
    pub fn new(pages: WorkingSet) -> Self {
        Self { pages, clouds: Known::new(), grids: Known::new() }
    }

    /// Adds a cloud whose pages are read from `storage`. A cloud that has been added already stays
    /// as it is.
    pub fn add(&mut self, cloud: &Arc<Cloud>, storage: Arc<dyn Storage>) {
        self.clouds.add(cloud.stored(), storage, &self.pages);
    }

    /// Adds a cloud whose pages are read from its own storage or file, bypassing the system's page
    /// cache if `direct` is set.
    ///
    /// # Errors
    /// The system's error, if the file cannot be opened.
    pub fn open(&mut self, cloud: &Arc<Cloud>, direct: bool) -> io::Result<()> {
        self.clouds.open(cloud.stored(), direct, &self.pages)
    }

    /// Adds a grid, as [`open`](Self::open) adds a cloud.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn open_grid(&mut self, grid: &Arc<Grid>, direct: bool) -> io::Result<()> {
        self.grids.open(grid, direct, &self.pages)
    }

    /// Closes the files that no scene refers to any more, and evicts their pages.
    pub fn drop_unused(&mut self) {
        self.clouds.drop_unused(&self.pages);
        self.grids.drop_unused(&self.pages);
    }

    /// The object of a cloud. Clouds that differ in nothing but their radii have the same.
    #[must_use]
    pub fn find(&self, cloud: &Arc<Cloud>) -> Option<&Arc<Object>> {
        self.clouds.find(cloud.stored())
    }

    /// The object of a grid.
    #[must_use]
    pub fn find_grid(&self, grid: &Arc<Grid>) -> Option<&Arc<Object>> {
        self.grids.find(grid)
    }
}

/// Open files of one kind, each with the object that holds its pages.
struct Known<T>(Vec<(Arc<T>, Arc<Object>)>);

impl<T> Clone for Known<T> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

impl<T: HasPages + 'static> Known<T> {
    fn new() -> Self {
        Self(Vec::new())
    }

    fn find(&self, file: &Arc<T>) -> Option<&Arc<Object>> {
        self.0.iter().find(|(known, _)| Arc::ptr_eq(known, file)).map(|(_, object)| object)
    }

    fn add(&mut self, file: &Arc<T>, storage: Arc<dyn Storage>, pages: &WorkingSet) {
        if self.find(file).is_none() {
            let object = pages.add(Arc::new(FilePages::new(file.clone(), storage)));
            self.0.push((file.clone(), object));
        }
    }

    fn open(&mut self, file: &Arc<T>, direct: bool, pages: &WorkingSet) -> io::Result<()> {
        if self.find(file).is_none() {
            let of = file.stored_file();
            let storage = match &of.storage {
                Some(storage) => storage.clone(),
                None => Arc::new(FileStorage::open(&of.path, direct)?),
            };
            self.add(file, storage, pages);
        }
        Ok(())
    }

    fn drop_unused(&mut self, pages: &WorkingSet) {
        // References of this list and of the source of the pages.
        const OWN: usize = 2;
        self.0.retain(|(file, object)| {
            let used = Arc::strong_count(file) > OWN;
            if !used {
                pages.forget(object);
            }
            used
        });
    }
}

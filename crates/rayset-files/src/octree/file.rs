//! Opening a cloud: header, footer, length and descriptions are checked here; pages are checked when they are read.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::format::Header;
use super::node::NodePage;
use super::page::{PointPage, Run};
use rayset_store::container::{FileKind, OpenError, OpenFile, PageError, PageKind, ScanError, SectionKind};
use rayset_store::storage::{MemoryStorage, Storage, address};

/// Radii that points may be given; lengths in scenes have the same limits.
const RADII: std::ops::RangeInclusive<f64> = 1e-18..=1e18;

/// An open cloud: its checked header, and where its pages are read from.
pub struct Cloud {
    /// The path of the file; only a name for messages if it is not a file on disk.
    path: PathBuf,
    address: PathBuf,
    /// `None` for a file on disk, which is opened by its path.
    storage: Option<Arc<dyn Storage>>,
    header: Header,
    /// The cloud as it is stored, if this one has other radii.
    stored: Option<Arc<Self>>,
}

impl std::fmt::Debug for Cloud {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Cloud")
            .field("path", &self.path)
            .field("header", &self.header)
            .finish_non_exhaustive()
    }
}

impl Cloud {
    /// Opens a cloud and checks its header, its length, its descriptions and its footer. The path may be an address
    /// ([`storage::open_addresses_with`](rayset_store::storage::open_addresses_with)).
    ///
    /// # Errors
    /// [`OpenError`] if the file cannot be read, or is not a complete cloud of this version.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, OpenError> {
        let path = path.as_ref();
        let (mut file, storage) = OpenFile::of_path(path, FileKind::Cloud)?;
        Ok(Self {
            path: address::without_secrets(path),
            address: path.to_owned(),
            storage,
            header: Header::read(&mut file)?,
            stored: None,
        })
    }

    /// Opens a cloud whose bytes are in memory, for example those of a file that was read. They are used in place.
    ///
    /// # Errors
    /// [`OpenError`] if they are not a complete cloud of this version.
    pub fn from_bytes(bytes: impl Into<Arc<[u8]>>) -> Result<Self, OpenError> {
        let bytes: Arc<[u8]> = bytes.into();
        Self::from_storage("memory", Arc::new(MemoryStorage::new(Arc::new(bytes))))
    }

    /// Opens a cloud whose bytes are read from any storage; `name` is for messages. The bytes must not change while the
    /// cloud is open.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn from_storage(name: &str, storage: Arc<dyn Storage>) -> Result<Self, OpenError> {
        let path = PathBuf::from(name);
        let mut file = OpenFile::over(&path, storage.clone(), FileKind::Cloud)?;
        let (storage, header) = (Some(storage), Header::read(&mut file)?);
        Ok(Self { address: path.clone(), path, storage, header, stored: None })
    }

    /// The same cloud with its points' radii multiplied by a factor. Both have the same pages in memory. `None` if the factor is not
    /// above 0, or a radius is then not from 1e-18 to 1e18.
    #[must_use]
    pub fn with_radius_scale(self: &Arc<Self>, factor: f32) -> Option<Self> {
        let stored = self.stored();
        let radius = stored.header.radius.scaled(factor);
        let is_length = |v: f32| RADII.contains(&f64::from(v));
        if !(factor > 0.0 && is_length(radius.min()) && is_length(radius.max())) {
            return None;
        }
        let radius_mean = stored.header.radius_mean * f64::from(factor);
        let header = Header { radius, radius_mean, radius_scale: factor, ..stored.header.clone() };
        let (path, address) = (stored.path.clone(), stored.address.clone());
        let storage = stored.storage.clone();
        Some(Self { path, address, storage, header, stored: Some(stored.clone()) })
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

    /// The storage that its pages are read from; `None` for a file on disk, which is opened by its path.
    #[doc(hidden)]
    #[must_use]
    pub fn storage(&self) -> Option<&Arc<dyn Storage>> {
        self.storage.as_ref()
    }

    pub(super) fn reopened(&self) -> Result<OpenFile, OpenError> {
        match &self.storage {
            Some(storage) => OpenFile::over(&self.path, storage.clone(), FileKind::Cloud),
            None => OpenFile::open(&self.path, FileKind::Cloud),
        }
    }

    /// The path of the file, an address without its query, or the name of the storage.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What opens it again: its path or address, with the query of a signed one, which grants access and is not to be shown; the
    /// name of the storage else.
    #[must_use]
    pub fn address(&self) -> &Path {
        &self.address
    }

    /// The checked header.
    #[must_use]
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// The kind of the page with this number.
    #[doc(hidden)]
    #[must_use]
    pub fn page_kind(&self, page: u32) -> PageKind {
        if page < self.header.point_pages { PageKind::Points } else { PageKind::Octree }
    }

    /// Checks a page that has just been read: checksum, kind, place, and every record in it.
    ///
    /// # Errors
    /// [`PageError`], which says what is wrong.
    #[doc(hidden)]
    pub fn check_page(&self, page: u32, bytes: &[u8]) -> Result<(), PageError> {
        if let Some(stored) = &self.stored {
            return stored.check_page(page, bytes);
        }
        if self.page_kind(page) == PageKind::Points {
            PointPage::check(bytes, page, &self.header).map(|_| ())
        } else {
            NodePage::check(bytes, page, &self.header).map(|_| ())
        }
    }
}

impl Cloud {
    /// Reads every page in order, one at a time, checks it, and passes it to `visit` with its number. Also checks the
    /// sections without pages, and the digests of all pages.
    ///
    /// # Errors
    /// [`ScanError`] at the first page that cannot be read or is damaged.
    #[doc(hidden)]
    pub fn for_each_page(&self, mut visit: impl FnMut(u32, &[u8])) -> Result<(), ScanError> {
        let mut file = self.reopened()?;
        if file.header().identity != self.header.identity {
            return Err(ScanError::Replaced { path: self.path.clone() });
        }
        file.check_sections()?;
        file.for_each_page([SectionKind::POINTS, SectionKind::NODES], |page, offset, bytes| {
            let damaged = |source| ScanError::Damaged { path: self.path.clone(), page, offset, source };
            self.check_page(page, bytes).map_err(damaged)?;
            visit(page, bytes);
            Ok(())
        })
    }

    /// Passes every run of points to `visit`, in file order, with the number of its page.
    ///
    /// # Errors
    /// [`ScanError`] at the first page that cannot be read or is damaged.
    #[doc(hidden)]
    pub fn for_each_run(&self, mut visit: impl FnMut(u32, Run<'_>)) -> Result<(), ScanError> {
        self.for_each_page(|page, bytes| {
            if self.page_kind(page) == PageKind::Points {
                let runs = PointPage::trusted(bytes, &self.header);
                (0..runs.len()).for_each(|index| visit(page, runs.run(index)));
            }
        })
    }
}

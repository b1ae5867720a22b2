//! What cloud and grid files have in common: a checked header, pages, and where they are read from.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use rayset_store::container::{FileKind, Identity, OpenError, OpenFile, PageError, ScanError, SectionKind};
use rayset_store::storage::{MemoryStorage, Storage, address};
use rayset_store::working_set::{Kind, PageSource};

/// The header of a kind of file with pages.
pub trait PagedHeader: Clone + Send + Sync + Sized {
    /// The kind of file.
    const FILE: FileKind;
    /// Its sections of pages, in the order of the file.
    const SECTIONS: &[SectionKind];

    /// Reads it.
    ///
    /// # Errors
    /// [`OpenError`] if the file is not a complete one of this version.
    fn read(file: &mut OpenFile) -> Result<Self, OpenError>;

    /// The identity of the file.
    fn identity(&self) -> Identity;

    /// Number of pages.
    fn pages(&self) -> u32;

    /// Size of each page in bytes.
    fn page_bytes(&self) -> usize;

    /// Where a page begins in the file.
    fn page_offset(&self, page: u32) -> u64;

    /// What the budget counts a page as.
    fn kind_of_page(&self, page: u32) -> Kind;

    /// Checks a page that has just been read: checksum, kind, place, and what is in it.
    ///
    /// # Errors
    /// [`PageError`], which says what is wrong.
    fn check_page(&self, page: u32, bytes: &[u8]) -> Result<(), PageError>;
}

/// An open file: its checked header, and where its pages are read from.
#[derive(Clone)]
pub struct PagedFile<H> {
    /// The path of the file, an address without its secrets; only a name for messages if it is not
    /// a file on disk.
    pub(crate) path: PathBuf,
    /// What opens it again: of a signed address with its query, which grants access and is not to
    /// be shown.
    pub(crate) address: PathBuf,
    /// `None` for a file on disk, which is opened by its path.
    pub(crate) storage: Option<Arc<dyn Storage>>,
    /// What the file says.
    pub(crate) header: H,
}

impl<H: PagedHeader> PagedFile<H> {
    /// Opens a file or an address.
    ///
    /// # Errors
    /// [`OpenError`] if it cannot be read, or is not a complete one of this version.
    pub fn open(path: &Path) -> Result<Self, OpenError> {
        let (mut file, storage) = OpenFile::of_path(path, H::FILE)?;
        let header = H::read(&mut file)?;
        Ok(Self { path: address::without_secrets(path), address: path.to_owned(), storage, header })
    }

    /// Opens what has these bytes in memory.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn from_bytes(bytes: Arc<[u8]>) -> Result<Self, OpenError> {
        Self::over("memory", Arc::new(MemoryStorage::new(Arc::new(bytes))))
    }

    /// Opens what is read from any storage; `name` is for messages.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn over(name: &str, storage: Arc<dyn Storage>) -> Result<Self, OpenError> {
        let path = PathBuf::from(name);
        let mut file = OpenFile::over(&path, storage.clone(), H::FILE)?;
        let (storage, header) = (Some(storage), H::read(&mut file)?);
        Ok(Self { address: path.clone(), path, storage, header })
    }

    /// Opens the same file once more, to read from it.
    ///
    /// # Errors
    /// [`ScanError`] if it cannot be opened, or another has taken its place.
    pub fn reopened(&self) -> Result<OpenFile, ScanError> {
        let file = match &self.storage {
            Some(storage) => OpenFile::over(&self.path, storage.clone(), H::FILE)?,
            None => OpenFile::open(&self.path, H::FILE)?,
        };
        if file.header().identity != self.header.identity() {
            return Err(ScanError::Replaced { path: self.path.clone() });
        }
        Ok(file)
    }

    /// Checks a page that was read from its place in the file.
    ///
    /// # Errors
    /// [`ScanError`], which names the page.
    pub fn check(&self, page: u32, offset: u64, bytes: &[u8]) -> Result<(), ScanError> {
        let damaged = |source| ScanError::Damaged { path: self.path.clone(), page, offset, source };
        self.header.check_page(page, bytes).map_err(damaged)
    }

    /// Reads every page in order, one at a time, checks it, and passes it to `visit` with its
    /// number. Also checks the sections without pages, and the digests of all pages.
    ///
    /// # Errors
    /// [`ScanError`] at the first page that cannot be read or is damaged.
    pub fn for_each_page(&self, mut visit: impl FnMut(u32, &[u8])) -> Result<(), ScanError> {
        self.try_for_each_page(|page, bytes| {
            visit(page, bytes);
            Ok::<(), ScanError>(())
        })
    }

    /// The same, until `visit` fails.
    ///
    /// # Errors
    /// Those of [`for_each_page`](Self::for_each_page), and of `visit`.
    pub fn try_for_each_page<E: From<ScanError> + From<OpenError>>(
        &self,
        mut visit: impl FnMut(u32, &[u8]) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut file = self.reopened()?;
        file.check_sections()?;
        file.for_each_page(H::SECTIONS, |page, offset, bytes| {
            self.check(page, offset, bytes)?;
            visit(page, bytes)
        })
    }
}

/// Something whose pages the working set can have.
pub trait HasPages: Send + Sync {
    /// The header of its file.
    type Header: PagedHeader;

    /// Its file, as it is stored.
    fn stored_file(&self) -> &PagedFile<Self::Header>;
}

/// The pages of an open file, for the working set.
pub struct FilePages<T> {
    of: Arc<T>,
    storage: Arc<dyn Storage>,
}

impl<T: HasPages> FilePages<T> {
    /// Pages read from `storage`: the file's own, or a substitute for it.
    #[must_use]
    pub fn new(of: Arc<T>, storage: Arc<dyn Storage>) -> Self {
        Self { of, storage }
    }
}

impl<T: HasPages> PageSource for FilePages<T> {
    fn pages(&self) -> u32 {
        self.of.stored_file().header.pages()
    }

    fn page_bytes(&self) -> usize {
        self.of.stored_file().header.page_bytes()
    }

    fn kind(&self, page: u32) -> Kind {
        self.of.stored_file().header.kind_of_page(page)
    }

    fn offset(&self, page: u32) -> u64 {
        self.of.stored_file().header.page_offset(page)
    }

    fn storage(&self) -> Arc<dyn Storage> {
        self.storage.clone()
    }

    fn check(&self, page: u32, bytes: &[u8]) -> Result<(), String> {
        self.of.stored_file().header.check_page(page, bytes).map_err(|e| e.to_string())
    }

    fn name(&self) -> String {
        self.of.stored_file().path.display().to_string()
    }
}

/// What is the same of clouds and grids: `$of` makes one of its open file, whose header is a
/// `$header`.
macro_rules! paged_file {
    ($name:ident, $what:literal, $header:ty, $of:expr) => {
        impl std::fmt::Debug for $name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.debug_struct(stringify!($name))
                    .field("path", &self.file.path)
                    .field("header", &self.file.header)
                    .finish_non_exhaustive()
            }
        }

        impl $name {
            #[doc = concat!("Opens a ", $what, " and checks its header, its length, its descriptions and its footer.")]
            /// The path may be an address
            /// ([`storage::open_addresses_with`](rayset_store::storage::open_addresses_with)).
            ///
            /// # Errors
            #[doc = concat!("[`OpenError`] if the file cannot be read, or is not a complete ", $what, " of this version.")]
            pub fn open(path: impl AsRef<std::path::Path>) -> Result<Self, OpenError> {
                PagedFile::open(path.as_ref()).map($of)
            }

            #[doc = concat!("Opens a ", $what, " whose bytes are in memory, for example those of a file that was read.")]
            /// They are used in place.
            ///
            /// # Errors
            #[doc = concat!("[`OpenError`] if they are not a complete ", $what, " of this version.")]
            pub fn from_bytes(bytes: impl Into<Arc<[u8]>>) -> Result<Self, OpenError> {
                PagedFile::from_bytes(bytes.into()).map($of)
            }

            #[doc = concat!("Opens a ", $what, " whose bytes are read from any storage; `name` is for messages.")]
            #[doc = concat!("The bytes must not change while the ", $what, " is open.")]
            ///
            /// # Errors
            /// As [`open`](Self::open).
            pub fn from_storage(name: &str, storage: Arc<dyn Storage>) -> Result<Self, OpenError> {
                PagedFile::over(name, storage).map($of)
            }

            /// The storage that its pages are read from; `None` for a file on disk, which is opened
            /// by its path.
            #[doc(hidden)]
            #[must_use]
            pub fn storage(&self) -> Option<&Arc<dyn Storage>> {
                self.file.storage.as_ref()
            }

            /// The path of the file, an address without its query, or the name of the storage.
            #[must_use]
            pub fn path(&self) -> &std::path::Path {
                &self.file.path
            }

            /// What opens it again: its path or address, with the query of a signed one, which
            /// grants access and is not to be shown; the name of the storage else.
            #[must_use]
            pub fn address(&self) -> &std::path::Path {
                &self.file.address
            }

            /// The checked header.
            #[must_use]
            pub fn header(&self) -> &$header {
                &self.file.header
            }
        }
    };
}
pub(crate) use paged_file;

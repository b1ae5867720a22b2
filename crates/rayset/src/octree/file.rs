//! Opening a cloud: header, footer and length are checked here, pages when they are read.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use super::format::{BLOCK_BYTES, Footer, Header, HeaderError, PageError, PageKind};
use super::node::NodePage;
use super::page::{PointPage, Run};

/// An open cloud file: its header, checked, and the path from which its pages are read.
#[derive(Debug)]
pub struct Cloud {
    path: PathBuf,
    header: Header,
    footer: Footer,
}

/// Why a file does not open as a cloud.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OpenError {
    /// The operating system refused.
    #[error("cannot open {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        r#source: io::Error,
    },
    /// The header or footer is not what it should be.
    #[error("{}, {source}", path.display())]
    Header {
        /// The file.
        path: PathBuf,
        /// What is wrong, and where.
        r#source: HeaderError,
    },
    /// The file is shorter or longer than its header says.
    #[error("{}: {found} bytes where the header says {expected}; the file is incomplete or has been appended to",
        path.display())]
    Length {
        /// The file.
        path: PathBuf,
        /// Bytes of the file.
        found: u64,
        /// Bytes that the header states.
        expected: u64,
    },
}

impl Cloud {
    /// Opens a cloud and checks its header, its length and its footer.
    ///
    /// # Errors
    /// [`OpenError`] where the file cannot be read or is no whole cloud of this version.
    pub fn open(path: &Path) -> Result<Self, OpenError> {
        let io = |source| OpenError::Io { path: path.to_owned(), source };
        let mut file = File::open(path).map_err(io)?;
        let found = file.metadata().map_err(io)?.len();
        let mut head = [0; BLOCK_BYTES];
        let got = read_up_to(&mut file, &mut head).map_err(io)?;
        let wrong = |source| OpenError::Header { path: path.to_owned(), source };
        if got < BLOCK_BYTES {
            if head[..got.min(8)] != super::format::MAGIC[..got.min(8)] || got == 0 {
                return Err(wrong(HeaderError::Magic));
            }
            return Err(OpenError::Length { path: path.to_owned(), found, expected: 2 * BLOCK_BYTES as u64 });
        }
        let header = Header::decode(&head).map_err(wrong)?;
        if found != header.file_bytes {
            return Err(OpenError::Length { path: path.to_owned(), found, expected: header.file_bytes });
        }
        let footer_at = header.file_bytes - BLOCK_BYTES as u64;
        let mut foot = [0; BLOCK_BYTES];
        file.seek(SeekFrom::Start(footer_at)).map_err(io)?;
        file.read_exact(&mut foot).map_err(io)?;
        let footer = Footer::decode(&foot, &head, footer_at).map_err(wrong)?;
        Ok(Self { path: path.to_owned(), header, footer })
    }

    /// Path of the file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The checked header.
    #[must_use]
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// The checked footer.
    #[must_use]
    pub fn footer(&self) -> &Footer {
        &self.footer
    }

    /// What kind of page stands at a number.
    #[must_use]
    pub fn page_kind(&self, page: u32) -> PageKind {
        if page < self.header.point_pages { PageKind::Points } else { PageKind::Octree }
    }

    /// Checks a page that has just been read: checksum, kind, place, and every record in it.
    ///
    /// # Errors
    /// [`PageError`] that says what is wrong.
    pub fn check_page(&self, page: u32, bytes: &[u8]) -> Result<(), PageError> {
        if self.page_kind(page) == PageKind::Points {
            PointPage::check(bytes, page, &self.header).map(|_| ())
        } else {
            NodePage::check(bytes, page, &self.header).map(|_| ())
        }
    }
}

/// Why a walk through all pages of a file stopped.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ScanError {
    /// The operating system refused.
    #[error("cannot read {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        r#source: io::Error,
    },
    /// A page is damaged.
    #[error("{}, byte {offset} (page {page}): {source}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The page.
        page: u32,
        /// Its place.
        offset: u64,
        /// What is wrong.
        r#source: PageError,
    },
}

impl Cloud {
    /// Reads every page in order, checks it, and hands it over with its number; holds one page at a time.
    ///
    /// # Errors
    /// [`ScanError`] at the first page that cannot be read or is damaged.
    pub fn for_each_page(&self, mut visit: impl FnMut(u32, &[u8])) -> Result<(), ScanError> {
        let io = |source| ScanError::Io { path: self.path.clone(), source };
        let mut file = File::open(&self.path).map_err(io)?;
        file.seek(SeekFrom::Start(self.header.page_offset(0))).map_err(io)?;
        let mut bytes = vec![0; self.header.page_bytes as usize];
        for page in 0..self.header.pages() {
            file.read_exact(&mut bytes).map_err(io)?;
            self.check_page(page, &bytes).map_err(|source| ScanError::Damaged {
                path: self.path.clone(),
                page,
                offset: self.header.page_offset(page),
                source,
            })?;
            visit(page, &bytes);
        }
        Ok(())
    }

    /// Reads every run of points in the order of the file, with the page it stands in.
    ///
    /// # Errors
    /// [`ScanError`] at the first page that cannot be read or is damaged.
    pub fn for_each_run(&self, mut visit: impl FnMut(u32, Run<'_>)) -> Result<(), ScanError> {
        self.for_each_page(|page, bytes| {
            if self.page_kind(page) == PageKind::Points {
                let runs = PointPage::trusted(bytes, &self.header);
                (0..runs.len()).for_each(|index| visit(page, runs.run(index)));
            }
        })
    }
}

/// Fills as much of `buffer` as the file holds.
fn read_up_to(file: &mut File, buffer: &mut [u8]) -> io::Result<usize> {
    let mut filled = 0;
    while filled < buffer.len() {
        match file.read(&mut buffer[filled..]) {
            Ok(0) => break,
            Ok(n) => filled += n,
            Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
            Err(e) => return Err(e),
        }
    }
    Ok(filled)
}

//! Opening a file: header, footer, length and the sections without pages are checked here; pages
//! are checked when they are read.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::header::{BLOCK_BYTES, FileHeader, FileKind, Footer, HeaderError, Section, SectionKind};
use super::page::{PageError, stored_page_checksum};
use super::write::Metadata;
use crate::storage::input_file::read_ahead;
use crate::storage::transport::Transport;
use crate::storage::{FileStorage, Storage, address, address_of, shown};
use rayset_base::regular_file;

/// Longest section that is read into memory as a whole: columns, descriptions.
const MAX_SECTION_BYTES: u64 = 512 << 10;

/// Why a file does not open.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OpenError {
    /// The operating system refused.
    #[error("cannot open {}: {source}", shown(path))]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        r#source: io::Error,
    },
    /// The header, the footer or a section is invalid.
    #[error("{}, {source}", shown(path))]
    Header {
        /// The file.
        path: PathBuf,
        /// What is wrong, and where.
        r#source: HeaderError,
    },
    /// The file is shorter or longer than its header says.
    #[error(
        "{}: {found} bytes where the header says {expected}; the file is incomplete or has been appended to",
        shown(path)
    )]
    Length {
        /// The file.
        path: PathBuf,
        /// Bytes of the file.
        found: u64,
        /// Bytes that the header states.
        expected: u64,
    },
}

/// Why a walk through all pages of a file stopped.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ScanError {
    /// The file cannot be read, or is invalid.
    #[error(transparent)]
    File(#[from] OpenError),
    /// Another file has replaced the one that was opened.
    #[error("{}: another file stands here now than the one that was opened", shown(path))]
    Replaced {
        /// The file.
        path: PathBuf,
    },
    /// A page is damaged.
    #[error("{}, byte {offset} (page {page}): {source}", shown(path))]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The page.
        page: u32,
        /// The page's offset in the file.
        offset: u64,
        /// What is wrong.
        r#source: PageError,
    },
}

/// A file whose header, length and footer have been checked.
pub struct OpenFile {
    /// The path of the file; only a name for messages if it is not a file on disk.
    path: PathBuf,
    /// Of a remote file, one that reads ahead.
    storage: Arc<dyn Storage>,
    /// `None` if the file is local.
    remote: Option<(Arc<dyn Storage>, Arc<dyn Transport>)>,
    header: FileHeader,
}

impl OpenFile {
    /// Opens a file of a kind and checks its header, its features, its length and its footer.
    ///
    /// # Errors
    /// [`OpenError`] if the file cannot be read, or is not a complete file of this kind and
    /// version.
    pub fn open(path: &Path, kind: FileKind) -> Result<Self, OpenError> {
        let file =
            regular_file::open(path).map_err(|source| OpenError::Io { path: path.to_owned(), source })?;
        Self::over(path, Arc::new(FileStorage::from(file)), kind)
    }

    /// As [`open`](Self::open), also of an address. With the storage that whoever opens the same
    /// object again has to use, so that it is the same object; `None` for a file on disk, which is
    /// opened by its path.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn of_path(path: &Path, kind: FileKind) -> Result<(Self, Option<Arc<dyn Storage>>), OpenError> {
        if address_of(path).is_none() {
            return Ok((Self::open(path, kind)?, None));
        }
        let named = address::without_secrets(path);
        let storage =
            address::open(path, false).map_err(|source| OpenError::Io { path: named.clone(), source })?;
        Ok((Self::over(&named, storage.clone(), kind)?, Some(storage)))
    }

    /// As [`open`](Self::open), but reads from any storage; `path` is only a name for messages.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn over(path: &Path, storage: Arc<dyn Storage>, kind: FileKind) -> Result<Self, OpenError> {
        let io = |source| OpenError::Io { path: path.to_owned(), source };
        let wrong = |source| OpenError::Header { path: path.to_owned(), source };
        let remote = storage.transport().map(|transport| (storage.clone(), transport));
        let storage = read_ahead(storage).map_err(io)?;
        let found = storage.length().map_err(io)?;
        let mut head = [0; BLOCK_BYTES];
        let got = found.min(BLOCK_BYTES as u64) as usize;
        storage.read_exact_at(&mut head[..got], 0).map_err(io)?;
        if got < BLOCK_BYTES {
            let begins = got > 0 && kind.magic().starts_with(&head[..got.min(8)]);
            return Err(if begins {
                OpenError::Length { path: path.to_owned(), found, expected: 2 * BLOCK_BYTES as u64 }
            } else {
                wrong(HeaderError::Magic)
            });
        }
        let header = FileHeader::decode(&head, kind).map_err(wrong)?;
        if found != header.file_bytes {
            return Err(OpenError::Length { path: path.to_owned(), found, expected: header.file_bytes });
        }
        let footer_at = header.file_bytes - BLOCK_BYTES as u64;
        let mut foot = [0; BLOCK_BYTES];
        storage.read_exact_at(&mut foot, footer_at).map_err(io)?;
        Footer::check(&foot, &head, footer_at).map_err(wrong)?;
        let mut opened = Self { path: path.to_owned(), storage, remote, header };
        opened.check_features()?;
        Ok(opened)
    }

    fn check_features(&mut self) -> Result<(), OpenError> {
        if self.header.required_features == 0 {
            return Ok(());
        }
        let words = self.metadata().ok();
        let name = |bit: u32| words.as_ref()?.features.get(&bit.to_string()).cloned();
        self.header
            .check_features(name)
            .map_err(|source| OpenError::Header { path: self.path.clone(), source })
    }

    /// An error about the contents of a section of this file.
    pub fn wrong_section(&self, kind: SectionKind, what: &'static str) -> OpenError {
        let at = self.header.section(kind).map_or(0, |section| section.offset);
        OpenError::Header { path: self.path.clone(), source: HeaderError::Field { at, what } }
    }

    /// The checked header.
    #[must_use]
    pub fn header(&self) -> &FileHeader {
        &self.header
    }

    /// The bytes of a section that does not consist of pages, checked.
    ///
    /// # Errors
    /// [`OpenError`] if the file has no such section, or it is damaged or too long.
    pub fn section(&mut self, kind: SectionKind) -> Result<Vec<u8>, OpenError> {
        let wrong =
            |at, what| OpenError::Header { path: self.path.clone(), source: HeaderError::Field { at, what } };
        let section = *self
            .header
            .section(kind)
            .ok_or_else(|| wrong(0, "a section that every such file has is missing"))?;
        if section.pages > 0 {
            return Err(wrong(section.offset, "a section that should be bytes is one of pages"));
        }
        if section.bytes > MAX_SECTION_BYTES {
            return Err(wrong(section.offset, "a section of more than 524288 bytes"));
        }
        let mut bytes = Vec::new();
        self.read_section(&section, |chunk| bytes.extend_from_slice(chunk))?;
        Ok(bytes)
    }

    /// The textual descriptions in the file.
    ///
    /// # Errors
    /// [`OpenError`] if the section is damaged, or is not JSON of the expected form.
    pub fn metadata(&mut self) -> Result<Metadata, OpenError> {
        let bytes = self.section(SectionKind::META)?;
        serde_json::from_slice(&bytes).map_err(|_| {
            self.wrong_section(SectionKind::META, "the description is not JSON of the expected form")
        })
    }

    /// Checks the sections that do not consist of pages, including unknown ones.
    ///
    /// # Errors
    /// [`OpenError`] at the first that is damaged.
    pub fn check_sections(&mut self) -> Result<(), OpenError> {
        let sections = self.header.sections.clone();
        sections.iter().filter(|s| s.pages == 0).try_for_each(|s| self.read_section(s, |_| {}))
    }

    /// Reads all pages in order, one at a time, and checks the digest of every section of pages.
    /// Calls `check` first for each page of the sections of these `kinds`, with its number (counted
    /// over all sections), its offset in the file and its bytes.
    ///
    /// # Errors
    /// The error of `check`, or [`OpenError`] if a page cannot be read or a digest differs.
    pub fn for_each_page<E: From<OpenError>>(
        &mut self,
        kinds: &[SectionKind],
        mut check: impl FnMut(u32, u64, &[u8]) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut page = vec![0; self.header.page_bytes as usize];
        let mut number = 0_u32;
        for section in self.header.sections.iter().filter(|s| s.pages > 0) {
            let mut digest = 0;
            for index in 0..section.pages {
                let offset = section.offset + u64::from(index) * u64::from(self.header.page_bytes);
                self.storage.read_exact_at(&mut page, offset).map_err(|e| self.ends_early(offset, e))?;
                if kinds.contains(&section.kind) {
                    check(number, offset, &page)?;
                }
                digest = crc32c::crc32c_append(digest, &stored_page_checksum(&page).to_le_bytes());
                number = number.wrapping_add(1);
            }
            if digest != section.checksum {
                let source =
                    HeaderError::Checksum { at: section.offset, found: section.checksum, expected: digest };
                return Err(OpenError::Header { path: self.path.clone(), source }.into());
            }
        }
        Ok(())
    }

    /// Reads a page by its number within a section of pages. Returns its offset in the file and its
    /// bytes, which have yet to be checked.
    ///
    /// # Errors
    /// [`OpenError`] if there is no such page, or it cannot be read.
    pub fn page(&self, kind: SectionKind, index: u32) -> Result<(u64, Vec<u8>), OpenError> {
        let offset = self.page_offset(kind, index)?;
        let mut page = vec![0; self.header.page_bytes as usize];
        self.storage.read_exact_at(&mut page, offset).map_err(|e| self.ends_early(offset, e))?;
        Ok((offset, page))
    }

    /// The offset in the file of a page of a section.
    ///
    /// # Errors
    /// [`OpenError`] if there is no such page.
    pub(super) fn page_offset(&self, kind: SectionKind, index: u32) -> Result<u64, OpenError> {
        let section = self.header.section(kind).filter(|section| index < section.pages);
        let section =
            section.ok_or_else(|| self.wrong_section(kind, "a page that should be there is not"))?;
        Ok(section.offset + u64::from(index) * u64::from(self.header.page_bytes))
    }

    /// The file as it is, and what reads many parts of it at a time, if it is remote.
    pub(super) fn remote(&self) -> Option<(Arc<dyn Storage>, Arc<dyn Transport>)> {
        self.remote.clone()
    }

    pub(super) fn ends_early(&self, at: u64, source: io::Error) -> OpenError {
        if source.kind() == io::ErrorKind::UnexpectedEof {
            let what =
                "the file ends here, before what its header says; it has been cut off since it was opened";
            return OpenError::Header { path: self.path.clone(), source: HeaderError::Field { at, what } };
        }
        OpenError::Io { path: self.path.clone(), source }
    }

    /// Reads a section in blocks, and verifies its checksum and the zero padding behind it.
    fn read_section(&mut self, section: &Section, mut take: impl FnMut(&[u8])) -> Result<(), OpenError> {
        let wrong = |source| OpenError::Header { path: self.path.clone(), source };
        let mut block = [0; BLOCK_BYTES];
        let (mut left, mut checksum, mut at) = (section.bytes, 0, section.offset);
        while left > 0 {
            self.storage.read_exact_at(&mut block, at).map_err(|e| self.ends_early(at, e))?;
            let used = left.min(BLOCK_BYTES as u64) as usize;
            checksum = crc32c::crc32c_append(checksum, &block[..used]);
            take(&block[..used]);
            if block[used..].iter().any(|&b| b != 0) {
                let at = at + used as u64;
                return Err(wrong(HeaderError::Field { at, what: "bytes other than zero behind a section" }));
            }
            left -= used as u64;
            at += BLOCK_BYTES as u64;
        }
        if checksum == section.checksum {
            Ok(())
        } else {
            let (found, expected) = (section.checksum, checksum);
            Err(wrong(HeaderError::Checksum { at: section.offset, found, expected }))
        }
    }
}

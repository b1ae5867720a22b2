//! Opening a grid: header, footer and length are checked here, pages when they are read.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use super::format::{GridHeader, PAGE_BYTES, RANGES_PER_PAGE};
use crate::octree::file::OpenError;
use crate::octree::format::stored_page_checksum;
use crate::octree::format::{
    BLOCK_BYTES, Footer, HeaderError, PAGE_HEAD_BYTES, PageError, PageHead, PageKind,
};

/// An open grid file: its header, checked, and the path from which its pages are read.
#[derive(Debug)]
pub struct Grid {
    path: PathBuf,
    header: GridHeader,
    footer: Footer,
}

impl Grid {
    /// Opens a grid and checks its header, its length and its footer.
    ///
    /// # Errors
    /// [`OpenError`] where the file cannot be read or is no whole grid of this version.
    pub fn open(path: &Path) -> Result<Self, OpenError> {
        let io = |source| OpenError::Io { path: path.to_owned(), source };
        let wrong = |source| OpenError::Header { path: path.to_owned(), source };
        let mut file = File::open(path).map_err(io)?;
        let found = file.metadata().map_err(io)?.len();
        if found < 2 * BLOCK_BYTES as u64 {
            return Err(wrong(HeaderError::Magic));
        }
        let mut head = [0; BLOCK_BYTES];
        file.read_exact(&mut head).map_err(io)?;
        let header = GridHeader::decode(&head).map_err(wrong)?;
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

    /// Whether a file says that it is a grid.
    #[must_use]
    pub fn is_grid(path: &Path) -> bool {
        let mut magic = [0; 8];
        File::open(path).and_then(|mut file| file.read_exact(&mut magic)).is_ok()
            && magic == super::format::MAGIC
    }

    /// Path of the file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The checked header.
    #[must_use]
    pub fn header(&self) -> &GridHeader {
        &self.header
    }

    /// Checks a page that has just been read: checksum, kind and place.
    ///
    /// # Errors
    /// [`PageError`] that says what is wrong.
    pub fn check_page(&self, page: u32, bytes: &[u8]) -> Result<(), PageError> {
        let (bricks, kind) = (self.header.brick_pages(), self.header.kind);
        if u64::from(page) < bricks {
            let head = PageHead::check(bytes, PageKind::Voxels, page)?;
            let voxels = kind.brick_voxels().pow(3);
            let fits = head.used_bytes as usize == PAGE_HEAD_BYTES + voxels * kind.bytes();
            return if fits { Ok(()) } else { Err(PageError::Content { what: "a brick of another size" }) };
        }
        let head = PageHead::check(bytes, PageKind::Ranges, page)?;
        let first = (u64::from(page) - bricks) * RANGES_PER_PAGE;
        let fits = u64::from(head.records) == (bricks - first).min(RANGES_PER_PAGE);
        if fits { Ok(()) } else { Err(PageError::Content { what: "ranges of another number of bricks" }) }
    }

    /// Reads and checks every page, and the digest of them all. Returns how many there are.
    ///
    /// # Errors
    /// A sentence that says what cannot be read or is damaged, and where.
    pub fn verify(&self) -> Result<u64, String> {
        let mut file = File::open(&self.path).map_err(|e| e.to_string())?;
        file.seek(SeekFrom::Start(BLOCK_BYTES as u64)).map_err(|e| e.to_string())?;
        let (mut page, mut digest) = (vec![0; PAGE_BYTES], 0);
        for number in 0..self.header.pages() {
            let place = || format!("byte {} (page {number})", self.header.page_offset(number));
            file.read_exact(&mut page).map_err(|e| format!("{}: {e}", place()))?;
            self.check_page(number as u32, &page).map_err(|e| format!("{}: {e}", place()))?;
            digest = crc32c::crc32c_append(digest, &stored_page_checksum(&page).to_le_bytes());
        }
        if digest == self.footer.digest {
            Ok(self.header.pages())
        } else {
            Err("the pages are not those that the footer was made for".into())
        }
    }

    /// Reads every voxel, x fastest, as stored: for small grids.
    ///
    /// # Errors
    /// A sentence that says what cannot be read or is damaged.
    pub fn load(&self) -> Result<Vec<f32>, String> {
        let mut file = File::open(&self.path).map_err(|e| e.to_string())?;
        let header = &self.header;
        let (kind, bricks) = (header.kind, header.bricks());
        let (n, cells) = (kind.brick_voxels(), kind.brick_cells());
        let mut voxels = vec![0.0; header.size.iter().product::<u64>() as usize];
        let mut page = vec![0; PAGE_BYTES];
        file.seek(SeekFrom::Start(BLOCK_BYTES as u64)).map_err(|e| e.to_string())?;
        for brick in 0..header.brick_pages() {
            file.read_exact(&mut page).map_err(|e| e.to_string())?;
            self.check_page(brick as u32, &page).map_err(|e| format!("page {brick}: {e}"))?;
            let corner = [brick % bricks[0], brick / bricks[0] % bricks[1], brick / bricks[0] / bricks[1]];
            for i in 0..n * n * n {
                let local = [i % n, i / n % n, i / n / n].map(|v| v as u64);
                let at: [u64; 3] = std::array::from_fn(|a| (corner[a] * cells + local[a]).wrapping_sub(1));
                if (0..3).all(|a| at[a] < header.size[a]) {
                    let bytes = &page[PAGE_HEAD_BYTES + i * kind.bytes()..];
                    let place = (at[2] * header.size[1] + at[1]) * header.size[0] + at[0];
                    voxels[place as usize] = kind.value(bytes);
                }
            }
        }
        Ok(voxels)
    }
}

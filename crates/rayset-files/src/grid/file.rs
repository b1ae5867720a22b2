//! Opening a grid: header, footer, length and descriptions are checked here; pages are checked when they are read.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::format::{GridHeader, RANGES_PER_PAGE};
use crate::points::{ColumnType, PointBatch, Values};
use rayset_base::geometry::DVec3;
use rayset_store::container::{
    FileKind, OpenError, OpenFile, PAGE_HEAD_BYTES, PageError, PageHead, PageKind, ScanError, SectionKind,
};
use rayset_store::storage::{MemoryStorage, Storage, address};

/// An open grid: its checked header, and where its pages are read from.
pub struct Grid {
    /// The path of the file; only a name for messages if it is not a file on disk.
    path: PathBuf,
    address: PathBuf,
    /// `None` for a file on disk, which is opened by its path.
    storage: Option<Arc<dyn Storage>>,
    header: GridHeader,
}

impl std::fmt::Debug for Grid {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Grid").field("path", &self.path).field("header", &self.header).finish_non_exhaustive()
    }
}

impl Grid {
    /// Opens a grid and checks its header, its length, its descriptions and its footer. The path may be an address
    /// ([`storage::open_addresses_with`](rayset_store::storage::open_addresses_with)).
    ///
    /// # Errors
    /// [`OpenError`] if the file cannot be read, or is not a complete grid of this version.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, OpenError> {
        let path = path.as_ref();
        let (mut file, storage) = OpenFile::of_path(path, FileKind::Grid)?;
        let header = GridHeader::read(&mut file)?;
        Ok(Self { path: address::without_secrets(path), address: path.to_owned(), storage, header })
    }

    /// Opens a grid whose bytes are in memory, for example those of a file that was read. They are used in place.
    ///
    /// # Errors
    /// [`OpenError`] if they are not a complete grid of this version.
    pub fn from_bytes(bytes: impl Into<Arc<[u8]>>) -> Result<Self, OpenError> {
        let bytes: Arc<[u8]> = bytes.into();
        Self::from_storage("memory", Arc::new(MemoryStorage::new(Arc::new(bytes))))
    }

    /// Opens a grid whose bytes are read from any storage; `name` is for messages. The bytes must not change while the grid
    /// is open.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn from_storage(name: &str, storage: Arc<dyn Storage>) -> Result<Self, OpenError> {
        let path = PathBuf::from(name);
        let mut file = OpenFile::over(&path, storage.clone(), FileKind::Grid)?;
        let (storage, header) = (Some(storage), GridHeader::read(&mut file)?);
        Ok(Self { address: path.clone(), path, storage, header })
    }

    /// The storage that its pages are read from; `None` for a file on disk, which is opened by its path.
    #[doc(hidden)]
    #[must_use]
    pub fn storage(&self) -> Option<&Arc<dyn Storage>> {
        self.storage.as_ref()
    }

    fn reopened(&self) -> Result<OpenFile, OpenError> {
        match &self.storage {
            Some(storage) => OpenFile::over(&self.path, storage.clone(), FileKind::Grid),
            None => OpenFile::open(&self.path, FileKind::Grid),
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
    pub fn header(&self) -> &GridHeader {
        &self.header
    }

    /// Checks a page that has just been read: checksum, kind and place.
    ///
    /// # Errors
    /// [`PageError`], which says what is wrong.
    #[doc(hidden)]
    pub fn check_page(&self, page: u32, bytes: &[u8]) -> Result<(), PageError> {
        let bricks = self.header.brick_pages();
        if u64::from(page) < bricks {
            let head = PageHead::check(bytes, PageKind::Voxels, page, self.header.identity)?;
            let fits = head.used_bytes as usize == PAGE_HEAD_BYTES + self.header.brick_bytes();
            return if fits { Ok(()) } else { Err(PageError::Content { what: "a brick of another size" }) };
        }
        let head = PageHead::check(bytes, PageKind::Ranges, page, self.header.identity)?;
        let first = (u64::from(page) - bricks) * RANGES_PER_PAGE;
        let fits = u64::from(head.records) == (bricks - first).min(RANGES_PER_PAGE);
        if fits { Ok(()) } else { Err(PageError::Content { what: "ranges of another number of bricks" }) }
    }

    /// Reads every page in order, one at a time, checks it, and passes it to `visit` with its number.
    fn for_each_page(&self, mut visit: impl FnMut(u32, &[u8])) -> Result<(), ScanError> {
        let mut file = self.reopened()?;
        if file.header().identity != self.header.identity {
            return Err(ScanError::Replaced { path: self.path.clone() });
        }
        file.check_sections()?;
        file.for_each_page([SectionKind::VOXELS, SectionKind::RANGES], |page, offset, bytes| {
            let damaged = |source| ScanError::Damaged { path: self.path.clone(), page, offset, source };
            self.check_page(page, bytes).map_err(damaged)?;
            visit(page, bytes);
            Ok(())
        })
    }

    /// Reads and checks every page, and the digests of all pages. Returns the number of pages.
    ///
    /// # Errors
    /// [`ScanError`] at the first page that cannot be read or is damaged.
    pub fn verify(&self) -> Result<u64, ScanError> {
        self.for_each_page(|_, _| {})?;
        Ok(self.header.pages())
    }

    /// About `most` voxels, or all if there are fewer, from bricks evenly spaced along the file: their positions in the space
    /// of the file, and a column of their values, scaled as the header says. A function of the file alone.
    ///
    /// # Errors
    /// [`ScanError`] if a page cannot be read or is damaged.
    pub fn sample(&self, most: usize) -> Result<PointBatch, ScanError> {
        /// Most bricks that are read.
        const MOST_BRICKS: u64 = 1024;
        let header = &self.header;
        let (bricks, voxels) = (header.brick_pages(), header.size.iter().product::<u64>());
        let read = bricks.min(MOST_BRICKS);
        let mut batch = PointBatch { position: Vec::new(), columns: vec![Values::empty(ColumnType::F64)] };
        if most == 0 || read == 0 {
            return Ok(batch);
        }
        let stride = (voxels / bricks * read + voxels % bricks).div_ceil(most as u64).max(1);
        let file = self.reopened()?;
        let mut count = 0_u64;
        let chosen: Vec<u32> = (0..read).map(|at| ((2 * at + 1) * bricks / (2 * read)) as u32).collect();
        file.each_of(SectionKind::VOXELS, &chosen, |page, offset, bytes| {
            let damaged = |source| ScanError::Damaged { path: self.path.clone(), page, offset, source };
            self.check_page(page, bytes).map_err(damaged)?;
            self.for_each_own_voxel(u64::from(page), bytes, |place, value| {
                if count.is_multiple_of(stride) {
                    let place = DVec3::from_array(place.map(|i| i as f64));
                    batch.position.push(header.space_from_voxel.transform_point3(place).to_array());
                    batch.columns[0].push(header.value(value));
                }
                count += 1;
            });
            Ok::<(), ScanError>(())
        })?;
        Ok(batch)
    }

    /// The value of the voxel nearest to a place in the space of the file, scaled as the header says; `None` outside of the grid.
    ///
    /// # Errors
    /// [`ScanError`] if its page cannot be read or is damaged.
    #[doc(hidden)]
    pub fn value_at(&self, place: DVec3) -> Result<Option<f64>, ScanError> {
        let header = &self.header;
        let voxel = header.space_from_voxel.inverse().transform_point3(place).round();
        let is_within = voxel.cmpge(DVec3::ZERO).all() && voxel.cmple(header.last_voxel()).all();
        if !is_within {
            return Ok(None);
        }
        let voxel = voxel.to_array().map(|at| at as u64);
        let bricks = header.bricks();
        let corner: [u64; 3] =
            std::array::from_fn(|axis| (voxel[axis] / header.brick_cells()[axis]).min(bricks[axis] - 1));
        let brick = (corner[2] * bricks[1] + corner[1]) * bricks[0] + corner[0];
        let mut found = None;
        self.reopened()?.each_of(SectionKind::VOXELS, &[brick as u32], |page, offset, bytes| {
            let damaged = |source| ScanError::Damaged { path: self.path.clone(), page, offset, source };
            self.check_page(page, bytes).map_err(damaged)?;
            self.for_each_own_voxel(brick, bytes, |at, stored| {
                if at == voxel {
                    found = Some(header.value(stored));
                }
            });
            Ok::<(), ScanError>(())
        })?;
        Ok(found)
    }

    /// Passes the voxels of a brick that no other brick has as its own to `take`: their places and stored values.
    fn for_each_own_voxel(&self, brick: u64, page: &[u8], mut take: impl FnMut([u64; 3], f64)) {
        let header = &self.header;
        let (kind, bricks) = (header.kind, header.bricks());
        let (n, cells) = (header.brick_voxels, header.brick_cells());
        let corner = [brick % bricks[0], brick / bricks[0] % bricks[1], brick / bricks[0] / bricks[1]];
        // Voxel 1 of a brick is its first own; the last of a row belongs to the last brick alone.
        let own: [std::ops::Range<u64>; 3] = std::array::from_fn(|axis| {
            let first = corner[axis] * cells[axis];
            let end = if corner[axis] + 1 == bricks[axis] { header.size[axis] } else { first + cells[axis] };
            1..(1 + end - first).min(n[axis])
        });
        for z in own[2].clone() {
            for y in own[1].clone() {
                for x in own[0].clone() {
                    let at = ((z * n[1] + y) * n[0] + x) as usize * kind.bytes();
                    let local = [x, y, z];
                    let place = std::array::from_fn(|axis| corner[axis] * cells[axis] + local[axis] - 1);
                    take(place, f64::from(kind.value(&page[PAGE_HEAD_BYTES + at..])));
                }
            }
        }
    }

    /// Reads all voxels into memory, x fastest, as stored (without scale and offset): for small grids.
    ///
    /// # Errors
    /// [`ScanError`] at the first page that cannot be read or is damaged.
    pub fn load(&self) -> Result<Vec<f32>, ScanError> {
        let header = &self.header;
        let (kind, bricks) = (header.kind, header.bricks());
        let (n, cells) = (header.brick_voxels, header.brick_cells());
        let mut voxels = vec![0.0; header.size.iter().product::<u64>() as usize];
        self.for_each_page(|brick, page| {
            let brick = u64::from(brick);
            if brick >= header.brick_pages() {
                return;
            }
            let corner = [brick % bricks[0], brick / bricks[0] % bricks[1], brick / bricks[0] / bricks[1]];
            for i in 0..n.iter().product::<u64>() {
                let local = [i % n[0], i / n[0] % n[1], i / n[0] / n[1]];
                let at: [u64; 3] = std::array::from_fn(|a| (corner[a] * cells[a] + local[a]).wrapping_sub(1));
                if (0..3).all(|a| at[a] < header.size[a]) {
                    let bytes = &page[PAGE_HEAD_BYTES + i as usize * kind.bytes()..];
                    let place = (at[2] * header.size[1] + at[1]) * header.size[0] + at[0];
                    voxels[place as usize] = kind.value(bytes);
                }
            }
        })?;
        Ok(voxels)
    }
}

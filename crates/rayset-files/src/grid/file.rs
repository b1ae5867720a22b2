//! Opening a grid: header, footer, length and descriptions are checked here; pages are checked when
//! they are read.

use std::sync::Arc;

use super::format::{GridHeader, PAGE_BYTES, RANGES_PER_PAGE};
use crate::paged_file::{HasPages, PagedFile, PagedHeader, paged_file};
use crate::points::{ColumnType, PointBatch, Values};
use rayset_base::geometry::DVec3;
use rayset_store::container::{
    FileKind, Identity, OpenError, OpenFile, PAGE_HEAD_BYTES, PageError, PageHead, PageKind, ScanError,
    SectionKind,
};
use rayset_store::storage::Storage;
use rayset_store::working_set::Kind;

/// An open grid: its checked header, and where its pages are read from.
pub struct Grid {
    file: PagedFile<GridHeader>,
}

paged_file!(Grid, "grid", GridHeader, |file| Self { file });

#[doc(hidden)]
impl PagedHeader for GridHeader {
    const FILE: FileKind = FileKind::Grid;
    const SECTIONS: &[SectionKind] = &[SectionKind::VOXELS, SectionKind::RANGES];

    fn read(file: &mut OpenFile) -> Result<Self, OpenError> {
        Self::read(file)
    }

    fn identity(&self) -> Identity {
        self.identity
    }

    fn pages(&self) -> u32 {
        self.pages() as u32
    }

    fn page_bytes(&self) -> usize {
        PAGE_BYTES
    }

    fn page_offset(&self, page: u32) -> u64 {
        self.page_offset(u64::from(page))
    }

    fn kind_of_page(&self, _: u32) -> Kind {
        Kind::Voxels
    }

    fn check_page(&self, page: u32, bytes: &[u8]) -> Result<(), PageError> {
        let bricks = self.brick_pages();
        if u64::from(page) < bricks {
            let head = PageHead::check(bytes, PageKind::Voxels, page, self.identity)?;
            let fits = head.used_bytes as usize == PAGE_HEAD_BYTES + self.brick_bytes();
            return if fits { Ok(()) } else { Err(PageError::Content { what: "a brick of another size" }) };
        }
        let head = PageHead::check(bytes, PageKind::Ranges, page, self.identity)?;
        let first = (u64::from(page) - bricks) * RANGES_PER_PAGE;
        let fits = u64::from(head.records) == (bricks - first).min(RANGES_PER_PAGE);
        if fits { Ok(()) } else { Err(PageError::Content { what: "ranges of another number of bricks" }) }
    }
}

#[doc(hidden)]
impl HasPages for Grid {
    type Header = GridHeader;

    fn stored_file(&self) -> &PagedFile<GridHeader> {
        &self.file
    }
}

impl Grid {
    /// Reads and checks every page, and the digests of all pages. Returns the number of pages.
    ///
    /// # Errors
    /// [`ScanError`] at the first page that cannot be read or is damaged.
    pub fn verify(&self) -> Result<u64, ScanError> {
        self.file.for_each_page(|_, _| {})?;
        Ok(self.file.header.pages())
    }

    /// About `most` voxels, or all if there are fewer, from bricks evenly spaced along the file:
    /// their positions in the space of the file, and a column of their values, scaled as the header
    /// says. A function of the file alone.
    ///
    /// # Errors
    /// [`ScanError`] if a page cannot be read or is damaged.
    pub fn sample(&self, most: usize) -> Result<PointBatch, ScanError> {
        /// Most bricks that are read.
        const MOST_BRICKS: u64 = 1024;
        let header = &self.file.header;
        let (bricks, voxels) = (header.brick_pages(), header.size.iter().product::<u64>());
        let read = bricks.min(MOST_BRICKS);
        let mut batch = PointBatch { position: Vec::new(), columns: vec![Values::empty(ColumnType::F64)] };
        if most == 0 || read == 0 {
            return Ok(batch);
        }
        let stride = (voxels / bricks * read + voxels % bricks).div_ceil(most as u64).max(1);
        let file = self.file.reopened()?;
        let mut until_next = 0_u64;
        let chosen: Vec<u32> = (0..read).map(|at| ((2 * at + 1) * bricks / (2 * read)) as u32).collect();
        file.each_of(SectionKind::VOXELS, &chosen, |page, offset, bytes| {
            self.file.check(page, offset, bytes)?;
            self.for_each_own_voxel(u64::from(page), bytes, |place, value| {
                if until_next == 0 {
                    until_next = stride;
                    let place = DVec3::from_array(place.map(|i| i as f64));
                    batch.position.push(header.space_from_voxel.transform_point3(place).to_array());
                    batch.columns[0].push(header.value(value));
                }
                until_next -= 1;
            });
            Ok::<(), ScanError>(())
        })?;
        Ok(batch)
    }

    /// The value of the voxel nearest to a place in the space of the file, scaled as the header
    /// says; `None` outside of the grid.
    ///
    /// # Errors
    /// [`ScanError`] if its page cannot be read or is damaged.
    #[doc(hidden)]
    pub fn value_at(&self, place: DVec3) -> Result<Option<f64>, ScanError> {
        let header = &self.file.header;
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
        self.file.reopened()?.each_of(SectionKind::VOXELS, &[brick as u32], |page, offset, bytes| {
            self.file.check(page, offset, bytes)?;
            self.for_each_own_voxel(brick, bytes, |at, stored| {
                if at == voxel {
                    found = Some(header.value(stored));
                }
            });
            Ok::<(), ScanError>(())
        })?;
        Ok(found)
    }

    /// Passes the voxels of a brick that no other brick has as its own to `take`: their places and
    /// stored values.
    fn for_each_own_voxel(&self, brick: u64, page: &[u8], mut take: impl FnMut([u64; 3], f64)) {
        let header = &self.file.header;
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

    /// Reads all voxels into memory, x fastest, as stored (without scale and offset): for small
    /// grids.
    ///
    /// # Errors
    /// [`ScanError`] at the first page that cannot be read or is damaged.
    pub fn load(&self) -> Result<Vec<f32>, ScanError> {
        let header = &self.file.header;
        let (kind, bricks) = (header.kind, header.bricks());
        let (n, cells) = (header.brick_voxels, header.brick_cells());
        let mut voxels = vec![0.0; header.size.iter().product::<u64>() as usize];
        self.file.for_each_page(|brick, page| {
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

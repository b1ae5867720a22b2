//! From a stream of voxels to a grid file: slices pass by once, and a layer of bricks is written as soon as the slices
//! that it needs are there.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use super::format::{GridHeader, PAGE_BYTES, RANGES_PER_PAGE};
use super::read::{ReadError, VolumeSource};
use crate::octree::format::{BLOCK_BYTES, Footer, PAGE_HEAD_BYTES, PageHead, PageKind, stored_page_checksum};

/// Why no grid was built.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum GridBuildError {
    /// The input.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The output.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// The slices that a layer of bricks needs do not fit.
    #[error("a layer of bricks needs {needed} bytes of memory, {budget} may be used")]
    Memory {
        /// The smallest that would do.
        needed: u64,
        /// What may be used.
        budget: u64,
    },
    /// No grid that can be sampled.
    #[error("{what}")]
    Grid {
        /// What is wrong with it.
        what: String,
    },
}

/// Builds a grid file, beside its name until it is whole. `progress` hears of slices done.
///
/// # Errors
/// [`GridBuildError`]; no file is left then.
pub fn build(
    mut source: VolumeSource,
    path: &Path,
    memory_bytes: u64,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<GridHeader, GridBuildError> {
    let mut header = header_of(&source)?;
    let slice_bytes = header.size[0] * header.size[1] * header.kind.bytes() as u64;
    let needed = slice_bytes * (header.kind.brick_voxels() as u64 + 1) + (4 << 20) + 8 * header.brick_pages();
    if needed > memory_bytes {
        return Err(GridBuildError::Memory { needed, budget: memory_bytes });
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let partial = path.with_file_name(format!(".{name}.rayset-partial"));
    let outcome = write(&mut source, &partial, &mut header, progress);
    let wrong = |source| GridBuildError::Write { path: path.to_owned(), source };
    match outcome {
        Ok(()) => std::fs::rename(&partial, path).map_err(wrong)?,
        Err(error) => {
            let _ = std::fs::remove_file(&partial);
            return Err(error);
        }
    }
    Ok(header)
}

fn header_of(source: &VolumeSource) -> Result<GridHeader, GridBuildError> {
    let mut header = GridHeader {
        size: source.size,
        kind: source.kind,
        range: (f32::INFINITY, f32::NEG_INFINITY),
        scale: source.scale,
        offset: source.offset,
        space_from_voxel: source.space_from_voxel,
        file_bytes: 0,
    };
    let what = if source.size.iter().any(|n| !(2..=1 << 24).contains(n)) {
        format!("a grid of {:?} voxels: 2 to 16777216 are needed along each axis", source.size)
    } else if header.pages() > u64::from(u32::MAX) {
        "the grid has more than 4294967295 bricks".into()
    } else if !(source.space_from_voxel.matrix3.determinant().abs() > 0.0) {
        "the axes of the grid are not independent, or a spacing is 0".into()
    } else {
        header.file_bytes = header.expected_file_bytes();
        return Ok(header);
    };
    Err(GridBuildError::Grid { what })
}

fn write(
    source: &mut VolumeSource,
    partial: &Path,
    header: &mut GridHeader,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<(), GridBuildError> {
    let wrong = |source| GridBuildError::Write { path: partial.to_owned(), source };
    let file = File::create(partial).map_err(wrong)?;
    let mut out = BufWriter::with_capacity(1 << 20, file);
    out.write_all(&[0; BLOCK_BYTES]).map_err(wrong)?;
    let (bricks, cells) = (header.bricks(), header.kind.brick_cells());
    let mut slices = Slices { first: 0, held: VecDeque::new() };
    let (mut ranges, mut digest, mut page_number) = (Vec::new(), 0, 0);
    let mut page = vec![0; PAGE_BYTES];
    for layer in 0..bricks[2] {
        slices.advance(source, header, layer * cells, progress)?;
        for row in 0..bricks[1] {
            for column in 0..bricks[0] {
                let range = fill_brick(&slices, header, [column, row, layer], &mut page);
                header.range = (header.range.0.min(range.0), header.range.1.max(range.1));
                ranges.push(range);
                let used_bytes =
                    (PAGE_HEAD_BYTES + header.kind.brick_voxels().pow(3) * header.kind.bytes()) as u32;
                PageHead { kind: PageKind::Voxels, page: page_number, records: 1, used_bytes }
                    .seal(&mut page);
                digest = crc32c::crc32c_append(digest, &stored_page_checksum(&page).to_le_bytes());
                out.write_all(&page).map_err(wrong)?;
                page_number += 1;
            }
        }
    }
    source.finish()?;
    for chunk in ranges.chunks(RANGES_PER_PAGE as usize) {
        page.fill(0);
        for (bytes, (low, high)) in page[PAGE_HEAD_BYTES..].chunks_exact_mut(8).zip(chunk) {
            bytes[..4].copy_from_slice(&low.to_le_bytes());
            bytes[4..].copy_from_slice(&high.to_le_bytes());
        }
        let used_bytes = (PAGE_HEAD_BYTES + 8 * chunk.len()) as u32;
        PageHead { kind: PageKind::Ranges, page: page_number, records: chunk.len() as u32, used_bytes }
            .seal(&mut page);
        digest = crc32c::crc32c_append(digest, &stored_page_checksum(&page).to_le_bytes());
        out.write_all(&page).map_err(wrong)?;
        page_number += 1;
    }
    let block = header.encode();
    out.write_all(&Footer::new(&block, digest).encode()).map_err(wrong)?;
    out.seek(SeekFrom::Start(0)).map_err(wrong)?;
    out.write_all(&block).map_err(wrong)?;
    let file = out.into_inner().map_err(|e| wrong(e.into_error()))?;
    file.sync_all().map_err(wrong)
}

/// The slices that a layer of bricks needs, little-endian.
struct Slices {
    first: u64,
    held: VecDeque<Vec<u8>>,
}

impl Slices {
    /// Holds the slices around a layer whose first cell is given.
    fn advance(
        &mut self,
        source: &mut VolumeSource,
        header: &GridHeader,
        first_cell: u64,
        progress: &mut dyn FnMut(u64, u64),
    ) -> Result<(), GridBuildError> {
        let first = first_cell.saturating_sub(1);
        let end = (first_cell + header.kind.brick_cells() + 2).min(header.size[2]);
        while self.first < first {
            self.held.pop_front();
            self.first += 1;
        }
        while self.first + (self.held.len() as u64) < end {
            let bytes = (header.size[0] * header.size[1]) as usize * header.kind.bytes();
            let mut slice = vec![0; bytes];
            source.read(&mut slice)?;
            self.held.push_back(slice);
            progress(self.first + self.held.len() as u64, header.size[2]);
        }
        Ok(())
    }
}

/// Copies the voxels of a brick, those beyond the grid repeated from its edge. Returns the range of those that samples
/// in its cells may use.
fn fill_brick(slices: &Slices, header: &GridHeader, brick: [u64; 3], page: &mut [u8]) -> (f32, f32) {
    let (kind, n) = (header.kind, header.kind.brick_voxels());
    let width = kind.bytes();
    let place = |axis: usize, local: usize| {
        (brick[axis] * kind.brick_cells() + local as u64).saturating_sub(1).min(header.size[axis] - 1)
    };
    page.fill(0);
    let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
    let mut at = PAGE_HEAD_BYTES;
    for z in 0..n {
        let slice = &slices.held[(place(2, z) - slices.first) as usize];
        for y in 0..n {
            let row = place(1, y) * header.size[0];
            for x in 0..n {
                let from = (row + place(0, x)) as usize * width;
                page[at..at + width].copy_from_slice(&slice[from..from + width]);
                let used = [x, y, z].iter().all(|v| (1..n - 1).contains(v));
                if used {
                    let value = kind.value(&page[at..at + width]);
                    (low, high) = (low.min(value), high.max(value));
                }
                at += width;
            }
        }
    }
    (low, high)
}

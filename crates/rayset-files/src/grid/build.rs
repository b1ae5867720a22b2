//! Out-of-core building of a grid file from a stream of voxels: slices are read once, and a layer
//! of bricks is written as soon as the slices that it needs have been read.

use std::collections::VecDeque;
use std::io::{self, BufWriter, Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

use super::census::Census;
use super::format::{GridHeader, PAGE_BYTES, RANGES_PER_PAGE, brick_shape};
use super::labels::GridLabels;
use super::slices::{Held, PIECE_BYTES, SliceError, Slices, Window};
use super::{VolumeError, VolumeSource};
use crate::octree::build::{BuildControl, Stage};
use rayset_base::geometry::DVec3;
use rayset_base::setters;
use rayset_store::container::{
    BLOCK_BYTES, FileKind, Identity, PAGE_CHECKSUM_AT, PAGE_HEAD_BYTES, PageHead, PageKind, SectionKind,
    seal_file,
};
use rayset_store::output::{Destination, OutputError, OutputFile, OutputWriter, remove_leftovers};
use rayset_store::spill::Spill;
use rayset_store::storage::shown;

/// Why a grid could not be built.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum GridBuildError {
    /// The build was cancelled.
    #[error("cancelled")]
    Cancelled,
    /// The input cannot be read.
    #[error(transparent)]
    Read(#[from] VolumeError),
    /// The output cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// Writing the output failed.
    #[error("cannot write {}: {source}", shown(path))]
    Write {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        r#source: io::Error,
    },
    /// A temporary file cannot be created, written or read.
    #[error("temporary file in {}: {source}", shown(folder))]
    Temporary {
        /// The folder of the file.
        folder: PathBuf,
        /// The system's reason.
        r#source: io::Error,
    },
    /// The memory is too small even for one brick and the buffers.
    #[error("{needed} bytes of memory are needed, {budget} may be used")]
    Memory {
        /// The least memory that suffices, in bytes.
        needed: u64,
        /// The memory that may be used, in bytes.
        budget: u64,
    },
    /// The voxels do not form a grid that can be sampled.
    #[error("{what}")]
    Grid {
        /// What is wrong with it.
        what: String,
    },
}

/// Memory for buffers, in bytes: of a piece of voxels before and after conversion, of a
/// decompressor, of the output, and of the values that are counted.
const BUFFER_BYTES: u64 = 3 * PIECE_BYTES as u64 + (3 << 20) + Census::BYTES;
/// Upper limit on the bytes that are copied out of the slices at a time.
const MOST_WINDOW_BYTES: u64 = 16 << 20;

/// The resources that a build may use; they do not affect the bytes of the file.
#[derive(Clone, Debug)]
#[cfg_attr(not(feature = "internals"), non_exhaustive)]
pub struct GridBuildOptions {
    /// Memory to use, in bytes.
    pub memory_bytes: u64,
    /// Folder of the temporary file that is used if the slices do not fit in memory; by default
    /// that of the output.
    pub temp_dir: Option<PathBuf>,
}

setters!(GridBuildOptions {
    with_memory_bytes => memory_bytes: u64,
    with_temp_dir => temp_dir: Option<PathBuf>,
});

impl Default for GridBuildOptions {
    /// 256 MiB of memory.
    fn default() -> Self {
        Self { memory_bytes: 256 << 20, temp_dir: None }
    }
}

/// Builds a grid file, which gets its name once it is complete. The control's progress reports the
/// slices done, as [`Stage::Read`].
///
/// # Errors
/// [`GridBuildError`]; no file is left behind then.
pub fn build(
    source: VolumeSource,
    path: impl AsRef<Path>,
    options: &GridBuildOptions,
    control: &BuildControl<'_>,
) -> Result<GridHeader, GridBuildError> {
    build_at(source, path.as_ref(), options, control)
}

fn build_at(
    mut source: VolumeSource,
    path: &Path,
    options: &GridBuildOptions,
    control: &BuildControl<'_>,
) -> Result<GridHeader, GridBuildError> {
    let mut header = header_of(&source)?;
    let room = Room::divide(options.memory_bytes, BUFFER_BYTES + source.memory_bytes(), &header)?;
    let destination = Destination::new(path)?;
    destination.require_file()?;
    destination.refuse_inputs(source.paths())?;
    let folder = options.temp_dir.clone().unwrap_or_else(|| destination.folder().to_owned());
    let temporary = |source| GridBuildError::Temporary { folder: folder.clone(), source };
    let file = OutputFile::create(&destination)?;
    remove_leftovers(&folder, &destination);
    let held = if room.holds_slices {
        Held::Memory(VecDeque::new())
    } else {
        let places = header.brick_voxels[2];
        Held::Disk { file: Spill::create(&destination, &folder).map_err(temporary)?, places }
    };
    let slices = Slices::new(&header, held);
    let failed = |failure| match failure {
        Failure::Slices(SliceError::Read(error)) => error.into(),
        Failure::Slices(SliceError::Spill(error)) => temporary(error),
        Failure::Slices(SliceError::Cancelled) => GridBuildError::Cancelled,
        Failure::Write(source) => GridBuildError::Write { path: path.to_owned(), source },
    };
    let writer = Writer::create(&file, &header).map_err(|e| failed(Failure::Write(e)))?;
    write(&mut source, slices, room.bricks_at_once, writer, &mut header, control).map_err(failed)?;
    if control.cancel.is_cancelled() {
        return Err(GridBuildError::Cancelled);
    }
    file.publish()?;
    Ok(header)
}

/// How the memory is divided.
struct Room {
    /// Whether the slices of a layer fit in memory.
    holds_slices: bool,
    /// Bricks of a row whose voxels are copied out of the slices together.
    bricks_at_once: u64,
}

impl Room {
    /// `buffer_bytes` are those of the buffers and of the reader.
    fn divide(memory_bytes: u64, buffer_bytes: u64, header: &GridHeader) -> Result<Self, GridBuildError> {
        let [n, height, depth] = header.brick_voxels;
        let column_bytes = height * depth * header.kind.bytes() as u64;
        let needed = buffer_bytes + n * column_bytes;
        if needed > memory_bytes {
            return Err(GridBuildError::Memory { needed, budget: memory_bytes });
        }
        let free = memory_bytes - buffer_bytes;
        let window_bytes = (free / 2).clamp(n * column_bytes, MOST_WINDOW_BYTES);
        Ok(Self {
            holds_slices: Slices::layer_bytes(header) <= free - window_bytes,
            bricks_at_once: ((window_bytes / column_bytes).saturating_sub(3) / header.brick_cells()[0])
                .max(1),
        })
    }
}

fn sorted(sentences: &[String]) -> Vec<String> {
    let mut sentences = sentences.to_vec();
    sentences.sort_unstable();
    sentences
}

fn header_of(source: &VolumeSource) -> Result<GridHeader, GridBuildError> {
    let header = GridHeader {
        identity: Identity::default(),
        size: source.size,
        kind: source.kind,
        brick_voxels: brick_shape(source.size.map(|n| n.max(2)), source.kind),
        // Not known yet.
        range: (0.0, 0.0),
        scale: source.scale,
        offset: source.offset,
        space_from_voxel: source.space_from_voxel,
        file_bytes: 0,
        sources: sorted(&source.about),
        up: source.up.and_then(DVec3::try_normalize),
        facing: source.facing.and_then(DVec3::try_normalize),
        // Not known yet.
        labels: GridLabels::default(),
    };
    let checked = header.check_size().and_then(|()| header.check_numbers());
    checked.map_err(|what| GridBuildError::Grid {
        what: format!("{what}: {} x {} x {} voxels", source.size[0], source.size[1], source.size[2]),
    })?;
    Ok(GridHeader { range: (f32::INFINITY, f32::NEG_INFINITY), ..header })
}

enum Failure {
    Slices(SliceError),
    Write(io::Error),
}

impl From<SliceError> for Failure {
    fn from(error: SliceError) -> Self {
        Self::Slices(error)
    }
}

impl From<io::Error> for Failure {
    fn from(error: io::Error) -> Self {
        Self::Write(error)
    }
}

/// Writes all bricks of all layers, and completes the file.
fn write(
    source: &mut VolumeSource,
    mut slices: Slices,
    bricks_at_once: u64,
    mut writer: Writer,
    header: &mut GridHeader,
    control: &BuildControl<'_>,
) -> Result<(), Failure> {
    let [columns, rows, layers] = header.bricks();
    let mut window = Window::new();
    for layer in 0..layers {
        let z = voxels_of(header, 2, layer..layer + 1);
        slices.advance(source, z.clone(), &control.cancel)?;
        control.progress.update(Stage::Read, z.end, header.size[2]);
        for row in 0..rows {
            let y = voxels_of(header, 1, row..row + 1);
            for first in (0..columns).step_by(bricks_at_once as usize) {
                if control.cancel.is_cancelled() {
                    return Err(Failure::Slices(SliceError::Cancelled));
                }
                let bricks = first..(first + bricks_at_once).min(columns);
                slices.look([voxels_of(header, 0, bricks.clone()), y.clone(), z.clone()], &mut window)?;
                for column in bricks {
                    let range = fill_brick(&window, header, [column, row, layer], &mut writer.page);
                    header.range = (header.range.0.min(range.0), header.range.1.max(range.1));
                    writer.brick(header, range)?;
                }
            }
        }
    }
    if header.range.0 > header.range.1 {
        header.range = (0.0, 0.0);
    }
    header.identity = slices.identity();
    header.labels = slices.labels(header, source.labels());
    Ok(writer.finish(header)?)
}

/// The range of voxels along an axis that bricks hold, clipped to the grid.
fn voxels_of(header: &GridHeader, axis: usize, bricks: Range<u64>) -> Range<u64> {
    let cells = header.brick_cells()[axis];
    (bricks.start * cells).saturating_sub(1)..(bricks.end * cells + 2).min(header.size[axis])
}

/// Copies the voxels of a brick; beyond the grid, its edge voxels are repeated. Returns the range
/// of the values that samples in the cells of the brick may use.
fn fill_brick(window: &Window, header: &GridHeader, brick: [u64; 3], page: &mut [u8]) -> (f32, f32) {
    let (kind, n, cells) = (header.kind, header.brick_voxels, header.brick_cells());
    let width = kind.bytes();
    let place = |axis: usize, local: u64| {
        (brick[axis] * cells[axis] + local).saturating_sub(1).min(header.size[axis] - 1)
    };
    page.fill(0);
    let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
    let mut at = PAGE_HEAD_BYTES;
    for z in 0..n[2] {
        for y in 0..n[1] {
            for x in 0..n[0] {
                page[at..at + width].copy_from_slice(window.voxel([place(0, x), place(1, y), place(2, z)]));
                let used = [x, y, z].iter().zip(n).all(|(v, n)| (1..n - 1).contains(v));
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

/// The file being written: bricks in order, and the pages of their ranges behind the place where
/// the bricks will end.
struct Writer {
    bricks: BufWriter<OutputWriter>,
    /// A second position for writing, and reading, in the same file.
    ranges: OutputWriter,
    /// The brick to be written.
    page: Vec<u8>,
    range_page: Vec<u8>,
    ranges_in_page: u64,
    page_number: u32,
    range_page_number: u32,
}

impl Writer {
    fn create(file: &OutputFile, header: &GridHeader) -> io::Result<Self> {
        let mut bricks = BufWriter::with_capacity(1 << 20, file.writer());
        bricks.write_all(&[0; BLOCK_BYTES])?;
        let mut ranges = file.writer();
        ranges.seek(SeekFrom::Start(header.page_offset(header.brick_pages())))?;
        Ok(Self {
            bricks,
            ranges,
            page: vec![0; PAGE_BYTES],
            range_page: vec![0; PAGE_BYTES],
            ranges_in_page: 0,
            page_number: 0,
            range_page_number: header.brick_pages() as u32,
        })
    }

    /// Writes the brick in `page`.
    fn brick(&mut self, header: &GridHeader, (low, high): (f32, f32)) -> io::Result<()> {
        let used_bytes = (PAGE_HEAD_BYTES + header.brick_bytes()) as u32;
        PageHead { kind: PageKind::Voxels, page: self.page_number, records: 1, used_bytes }
            .seal(&mut self.page, Identity::default());
        self.bricks.write_all(&self.page)?;
        self.page_number += 1;
        let at = PAGE_HEAD_BYTES + 8 * self.ranges_in_page as usize;
        self.range_page[at..at + 4].copy_from_slice(&low.to_le_bytes());
        self.range_page[at + 4..at + 8].copy_from_slice(&high.to_le_bytes());
        self.ranges_in_page += 1;
        if self.ranges_in_page == RANGES_PER_PAGE { self.end_range_page() } else { Ok(()) }
    }

    fn end_range_page(&mut self) -> io::Result<()> {
        let records = self.ranges_in_page as u32;
        let used_bytes = PAGE_HEAD_BYTES as u32 + 8 * records;
        PageHead { kind: PageKind::Ranges, page: self.range_page_number, records, used_bytes }
            .seal(&mut self.range_page, Identity::default());
        self.ranges.write_all(&self.range_page)?;
        self.range_page.fill(0);
        self.range_page_number += 1;
        self.ranges_in_page = 0;
        Ok(())
    }

    /// Enters the identity into the checksums of the pages, writes the sections behind them, and
    /// finally the header that makes this a grid file.
    fn finish(mut self, header: &mut GridHeader) -> io::Result<()> {
        if self.ranges_in_page > 0 {
            self.end_range_page()?;
        }
        self.bricks.flush()?;
        let (bricks, ranges) = (header.brick_pages(), header.range_pages());
        let pages = [
            (SectionKind::VOXELS, bricks as u32, identify(&mut self.ranges, header, 0..bricks)?),
            (
                SectionKind::RANGES,
                ranges as u32,
                identify(&mut self.ranges, header, bricks..bricks + ranges)?,
            ),
        ];
        let mut sections = vec![(SectionKind::GRID, header.encode())];
        sections.extend(header.labels.encode().map(|labels| (SectionKind::LABELS, labels)));
        let whole = seal_file(
            &mut self.bricks,
            FileKind::Grid,
            header.identity,
            PAGE_BYTES as u32,
            &pages,
            &sections,
            &header.metadata(),
        )?;
        header.file_bytes = whole.file_bytes;
        self.bricks.flush()
    }
}

/// Converts the checksums of pages that were sealed with an all-zero identity to those for the
/// identity of the file, which was known only after the last voxel; returns the digest of the
/// pages.
///
/// The checksum is the CRC of the identity followed by the rest of the page. The CRC of a
/// concatenation follows from the CRCs of its parts, so the pages need not be read again. Before,
/// the identity was sixteen zero bytes.
fn identify(file: &mut OutputWriter, header: &GridHeader, pages: Range<u64>) -> io::Result<u32> {
    let rest_bytes = PAGE_BYTES - 4;
    let before = Identity::default().seed();
    // The CRC is affine: replacing what precedes the page XORs the same term into the checksum of
    // every page.
    let zeros = vec![0; rest_bytes];
    let exchange =
        crc32c::crc32c_append(before, &zeros) ^ crc32c::crc32c_append(header.identity.seed(), &zeros);
    let mut digest = 0;
    for page in pages {
        let at = SeekFrom::Start(header.page_offset(page) + PAGE_CHECKSUM_AT as u64);
        let mut checksum = [0; 4];
        file.seek(at)?;
        file.read_exact(&mut checksum)?;
        let checksum = (u32::from_le_bytes(checksum) ^ exchange).to_le_bytes();
        file.seek(at)?;
        file.write_all(&checksum)?;
        digest = crc32c::crc32c_append(digest, &checksum);
    }
    Ok(digest)
}

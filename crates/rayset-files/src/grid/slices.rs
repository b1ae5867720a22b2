//! The slices of voxels that a layer of bricks needs: in memory if they fit, otherwise in a
//! temporary file.

use std::collections::VecDeque;
use std::io;
use std::ops::Range;

use super::census::Census;
use super::format::{GridHeader, VoxelKind};
use super::labels::{GridLabels, NamedLabels};
use super::{VolumeError, VolumeSource};
use rayset_base::cancel::CancelToken;
use rayset_store::container::{Identity, StreamHash};
use rayset_store::spill::Spill;

/// Size in bytes of the pieces in which voxels are read from the source.
pub(super) const PIECE_BYTES: usize = 1 << 20;

/// Why slices cannot be read.
pub(super) enum SliceError {
    Read(VolumeError),
    /// The temporary file.
    Spill(io::Error),
    Cancelled,
}

/// Consecutive slices, little-endian.
pub(super) struct Slices {
    /// The numbers of the slices that are held.
    numbers: Range<u64>,
    row_bytes: u64,
    slice_bytes: u64,
    voxel_bytes: u64,
    held: Held,
    piece: Vec<u8>,
    kind: VoxelKind,
    census: Census,
    /// Hash of the size, type, scaling and transform of the grid, and of all voxels so far.
    hash: StreamHash,
}

/// Where slices are.
pub(super) enum Held {
    Memory(VecDeque<Vec<u8>>),
    /// Slice k is stored at place k mod `places` of the file, a ring buffer.
    Disk {
        file: Spill,
        places: u64,
    },
}

/// A block of voxels of the slices held.
pub(super) struct Window {
    /// The voxel ranges along x, y and z, clamped to the grid.
    ranges: [Range<u64>; 3],
    voxel_bytes: usize,
    bytes: Vec<u8>,
}

impl Slices {
    pub(super) fn new(header: &GridHeader, held: Held) -> Self {
        let voxel_bytes = header.kind.bytes() as u64;
        let row_bytes = header.size[0] * voxel_bytes;
        Self {
            numbers: 0..0,
            row_bytes,
            slice_bytes: header.size[1] * row_bytes,
            voxel_bytes,
            held,
            piece: Vec::new(),
            kind: header.kind,
            census: Census::new(header.size[0]),
            hash: StreamHash::new(&format!(
                "{:?} {} {:?} {:?} {:?}",
                header.size,
                header.kind.name(),
                header.scale,
                header.offset,
                header.space_from_voxel.to_cols_array()
            )),
        }
    }

    /// The identity of a file of these voxels, once all have been read.
    pub(super) fn identity(&self) -> Identity {
        self.hash.identity()
    }

    /// The values of all voxels, once all have been read.
    pub(super) fn labels(&self, header: &GridHeader, names: &NamedLabels) -> GridLabels {
        self.census.labels(|stored| header.value(stored), names)
    }

    /// Size in bytes of the slices that a layer of bricks needs.
    pub(super) fn layer_bytes(header: &GridHeader) -> u64 {
        let places = header.brick_voxels[2];
        places * header.size[0] * header.size[1] * header.kind.bytes() as u64
    }

    /// Releases the slices before the range `to`, and reads on to its end.
    pub(super) fn advance(
        &mut self,
        source: &mut VolumeSource,
        to: Range<u64>,
        cancel: &CancelToken,
    ) -> Result<(), SliceError> {
        while self.numbers.start < to.start {
            if let Held::Memory(slices) = &mut self.held {
                slices.pop_front();
            }
            self.numbers.start += 1;
        }
        while self.numbers.end < to.end {
            self.read_slice(source, cancel)?;
            self.numbers.end += 1;
        }
        Ok(())
    }

    fn read_slice(&mut self, source: &mut VolumeSource, cancel: &CancelToken) -> Result<(), SliceError> {
        let number = self.numbers.end;
        let mut slice = match &self.held {
            Held::Memory(_) => Vec::with_capacity(self.slice_bytes as usize),
            Held::Disk { .. } => Vec::new(),
        };
        let mut done = 0;
        while done < self.slice_bytes {
            if cancel.is_cancelled() {
                return Err(SliceError::Cancelled);
            }
            self.piece.resize((self.slice_bytes - done).min(PIECE_BYTES as u64) as usize, 0);
            source.read(&mut self.piece).map_err(SliceError::Read)?;
            self.hash.update(&self.piece);
            self.census.add(self.kind, &self.piece);
            match &self.held {
                Held::Memory(_) => slice.extend_from_slice(&self.piece),
                Held::Disk { file, places } => {
                    let place = number % places * self.slice_bytes + done;
                    file.write_at(&self.piece, place).map_err(SliceError::Spill)?;
                }
            }
            done += self.piece.len() as u64;
        }
        if let Held::Memory(slices) = &mut self.held {
            slices.push_back(slice);
        }
        Ok(())
    }

    /// Copies a block of voxels out of the slices held into a window.
    pub(super) fn look(&self, ranges: [Range<u64>; 3], window: &mut Window) -> Result<(), SliceError> {
        let [x, y, z] = ranges.clone();
        let length = ((x.end - x.start) * self.voxel_bytes) as usize;
        // Whole rows follow each other without a gap.
        let rows_at_once = if length as u64 == self.row_bytes { y.end - y.start } else { 1 };
        let piece = length * rows_at_once as usize;
        window.bytes.resize(length * (y.end - y.start) as usize * (z.end - z.start) as usize, 0);
        window.ranges = ranges;
        window.voxel_bytes = self.voxel_bytes as usize;
        let mut pieces = window.bytes.chunks_exact_mut(piece);
        for slice in z {
            for row in y.clone().step_by(rows_at_once as usize) {
                let Some(piece) = pieces.next() else { return Ok(()) };
                let from = row * self.row_bytes + x.start * self.voxel_bytes;
                match &self.held {
                    Held::Memory(slices) => {
                        let slice = &slices[(slice - self.numbers.start) as usize];
                        piece.copy_from_slice(&slice[from as usize..][..piece.len()]);
                    }
                    Held::Disk { file, places } => {
                        let place = slice % places * self.slice_bytes + from;
                        file.read_at(piece, place).map_err(SliceError::Spill)?;
                    }
                }
            }
        }
        Ok(())
    }
}

impl Window {
    pub(super) fn new() -> Self {
        Self { ranges: [0..0, 0..0, 0..0], voxel_bytes: 1, bytes: Vec::new() }
    }

    /// A voxel, which must be in the window.
    pub(super) fn voxel(&self, place: [u64; 3]) -> &[u8] {
        let local: [usize; 3] = std::array::from_fn(|axis| (place[axis] - self.ranges[axis].start) as usize);
        let [width, height] = [0, 1].map(|axis: usize| {
            let range = &self.ranges[axis];
            (range.end - range.start) as usize
        });
        let at = ((local[2] * height + local[1]) * width + local[0]) * self.voxel_bytes;
        &self.bytes[at..at + self.voxel_bytes]
    }
}

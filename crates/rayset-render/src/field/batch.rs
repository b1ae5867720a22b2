//! Runs that are decoded together, so that a ray takes them block by block of its samples.

use fearless_simd::prelude::*;

use super::columns::PointColumns;
use super::lane_ray::Frames;
use super::packet::{Packet, Slab};
use super::pairs::Pairs;
use super::run::DecodedRun;
use super::simd::{SimdLevel, dispatch};
use rayset_files::octree::layout::RUN_POINTS;

/// Most runs of a batch: more than a slab of an opaque cloud mostly needs, and few enough for the
/// second cache.
pub(super) const MOST_RUNS: usize = 8;

/// The most bytes that a batch takes, of points with up to eight attributes.
pub const BATCH_BYTES: u64 =
    (MOST_RUNS * (size_of::<BatchedRun>() + 8 * RUN_POINTS * size_of::<f32>())) as u64;

/// Up to 8 runs, in the order of the file. Their memory is kept from batch to batch.
#[derive(Debug, Default)]
pub struct RunBatch {
    runs: Vec<Box<BatchedRun>>,
    len: usize,
}

/// A run, with scratch memory for the packet.
#[derive(Debug, Default)]
pub(super) struct BatchedRun {
    pub(super) run: DecodedRun,
    pub(super) frames: Frames,
    /// The points near one group of rays at a time.
    pub(super) near: PointColumns,
    /// The chunks of these.
    pub(super) near_chunks: u64,
    /// Of one ray at a time.
    pub(super) pairs: Pairs,
}

impl RunBatch {
    /// Adds a run at the end, whose place `place` decodes, if any samples of a slab on the rays in
    /// `lanes` may lie in it; its points are then to be decoded into what is returned. `None` too
    /// if the batch is full.
    pub fn append(
        &mut self,
        (packet, slab, lanes): (&Packet, Slab, u64),
        simd: SimdLevel,
        place: impl FnOnce(&mut DecodedRun),
    ) -> Option<&mut DecodedRun> {
        if self.len == MOST_RUNS {
            return None;
        }
        if self.len == self.runs.len() {
            self.runs.push(Box::default());
        }
        let BatchedRun { run, frames, .. } = &mut *self.runs[self.len];
        place(run);
        dispatch!(simd.level(), simd => set_frames(simd, frames, run, packet, slab));
        if !run.may_be_wide && frames.meets.iter().all(|meets| meets & lanes == 0) {
            return None;
        }
        self.len += 1;
        Some(&mut self.runs[self.len - 1].run)
    }

    /// Whether there is no room for another run.
    #[must_use]
    pub fn is_full(&self) -> bool {
        self.len == MOST_RUNS
    }

    /// Removes all runs.
    pub fn clear(&mut self) {
        self.len = 0;
    }

    /// Removes all runs; their memory is still valid.
    pub(super) fn take(&mut self) -> &mut [Box<BatchedRun>] {
        let len = std::mem::take(&mut self.len);
        &mut self.runs[..len]
    }
}

/// Sets the frames of a run. It is the same for all kernels, and compiled apart from them: there
/// are 42 loops over kernels and quantities for each set of instructions.
#[inline(always)]
fn set_frames<S: Simd>(simd: S, frames: &mut Frames, run: &DecodedRun, packet: &Packet, slab: Slab) {
    simd.vectorize(
        #[inline(always)]
        || frames.set(simd, run, packet, slab),
    );
}

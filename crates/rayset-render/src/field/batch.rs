//! Runs that are decoded together, so that a ray takes them block by block of its samples.

use fearless_simd::prelude::*;

use super::columns::PointColumns;
use super::kept_runs::KeptRuns;
use super::lane_ray::Frames;
use super::packet::{Packet, Slab};
use super::pairs::Pairs;
use super::run::{DECODED_BYTES, DecodedRun, RunDecoder};
use super::run_key::RunKey;
use super::sight::Sight;
use super::simd::{SimdLevel, dispatch};
use rayset_base::geometry::Aabb;
use rayset_files::octree::format::Header;
use rayset_files::octree::page::Run;

/// Most runs of a batch: more than a slab of an opaque cloud mostly needs, and few enough for the
/// second cache.
pub(super) const MOST_RUNS: usize = 8;

/// The most bytes that a batch takes, of points with up to eight attributes, besides the runs that
/// it keeps. One run more is there while it is found out whether it is part of the last.
pub const BATCH_BYTES: u64 = ((MOST_RUNS + 1) * (size_of::<BatchedRun>() + DECODED_BYTES)) as u64;

/// Up to 8 runs, in the order of the file. Their memory is kept from batch to batch; if there is
/// [room](Self::set_room), runs are, too.
#[derive(Debug, Default)]
pub struct RunBatch {
    runs: Vec<Box<BatchedRun>>,
    len: usize,
    kept: KeptRuns,
    sight: Option<Sight>,
    /// The sights by which runs are kept that are seen from afar, and the number of the one above.
    sights: Vec<Sight>,
    sight_number: u16,
}

/// More sights than there mostly are: of some ten faces and levels of tables and 24 widths of
/// pixels for each light, in the space of each cloud.
const MOST_SIGHTS: usize = 512;

/// Bytes of all of them.
pub(crate) const SIGHTS_BYTES: usize = MOST_SIGHTS * size_of::<Sight>();

/// What became of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Appended {
    /// It is in the batch, and was decoded.
    Decoded,
    /// It is in the batch, and had been decoded before.
    Known,
    /// It is not in the batch: no sample may lie in it.
    Nothing,
    /// It is not in the batch, which is full.
    NoRoom,
}

/// A run, with scratch memory for the packet.
#[derive(Debug, Default)]
pub(super) struct BatchedRun {
    pub(super) run: Box<DecodedRun>,
    key: Option<RunKey>,
    pub(super) frames: Frames,
    /// The points near one group of rays at a time, if they are balls.
    pub(super) near: PointColumns,
    /// The chunks of these; of ellipsoids those of the run with points near the group.
    pub(super) near_chunks: u64,
    /// Of one ray at a time.
    pub(super) pairs: Pairs,
}

impl RunBatch {
    /// Adds a run at the end, if any samples of a slab on the rays in `lanes` may lie in it. A run
    /// with a key is kept for the next time. A run that is one point becomes part of the last, if
    /// that is one in the same place: also in a full batch, so that sums do not depend on the runs
    /// before.
    pub fn append(
        &mut self,
        (decoder, run, header): (&RunDecoder, &Run<'_>, &Header),
        key: Option<RunKey>,
        (packet, slab, lanes): (&Packet, Slab, u64),
        simd: SimdLevel,
    ) -> Appended {
        let joins = self.may_join(decoder, run);
        if self.len == MOST_RUNS && !joins {
            return Appended::NoRoom;
        }
        if self.len == self.runs.len() {
            self.runs.push(Box::default());
        }
        let (item, step) = (&mut *self.runs[self.len], packet.least_step());
        item.key = key;
        let is_known = key.is_some_and(|key| self.kept.take(key, step, &mut item.run));
        if !is_known {
            decoder.place(run, header, (step, self.sight.as_ref()), &mut item.run);
        }
        item.set_frames(simd, (packet, slab, lanes));
        if !item.run.may_be_wide && item.frames.meets.iter().all(|meets| meets & lanes == 0) {
            if is_known {
                self.keep(self.len);
            }
            return Appended::Nothing;
        }
        if !is_known {
            decoder.decode(run, header, (step, self.sight.as_ref()), simd, &mut item.run);
            if item.run.has_plates {
                item.set_frames(simd, (packet, slab, lanes));
            }
        }
        let appended = if is_known { Appended::Known } else { Appended::Decoded };
        if joins && self.join_last_two() {
            self.keep(self.len);
            return appended;
        }
        if self.len == MOST_RUNS {
            self.keep(self.len);
            return Appended::NoRoom;
        }
        self.len += 1;
        appended
    }

    /// Adds a run at the end that `decode` makes, if any samples of a slab on the rays in `lanes`
    /// may lie in it and it has points. If it is known to be `within` a box, it is not made where
    /// none lie in that.
    ///
    /// # Errors
    /// Those of `decode`.
    pub(crate) fn append_made<E>(
        &mut self,
        (key, within): (RunKey, Option<&Aabb>),
        (packet, slab, lanes): (&Packet, Slab, u64),
        simd: SimdLevel,
        decode: impl FnOnce(f64, &mut DecodedRun) -> Result<(), E>,
    ) -> Result<Appended, E> {
        if self.len == MOST_RUNS {
            return Ok(Appended::NoRoom);
        }
        let key = RunKey { sight: self.sight_number, ..key };
        if self.kept.is_empty_run(key) {
            return Ok(Appended::Nothing);
        }
        if self.len == self.runs.len() {
            self.runs.push(Box::default());
        }
        let (item, step) = (&mut *self.runs[self.len], packet.least_step());
        // Also of what is known: what a packet sees must not depend on that.
        if let Some(within) = within {
            item.key = None;
            item.run.lies_within(within);
            item.set_frames(simd, (packet, slab, lanes));
            if item.frames.meets.iter().all(|meets| meets & lanes == 0) {
                return Ok(Appended::Nothing);
            }
        }
        item.key = Some(key);
        let is_known = self.kept.take(key, step, &mut item.run);
        if !is_known {
            item.key = None;
            decode(step, &mut item.run)?;
            item.key = Some(key);
        }
        if item.run.len > 0 {
            item.set_frames(simd, (packet, slab, lanes));
        }
        let is_wide = item.run.wide.is_some();
        if item.run.len == 0 || !is_wide && item.frames.meets.iter().all(|meets| meets & lanes == 0) {
            self.keep(self.len);
            return Ok(Appended::Nothing);
        }
        self.len += 1;
        Ok(if is_known { Appended::Known } else { Appended::Decoded })
    }

    /// Whether a run may be one point in the place of the last, by its bounds.
    fn may_join(&self, decoder: &RunDecoder, run: &Run<'_>) -> bool {
        let last = self.len.checked_sub(1).map(|last| &self.runs[last].run);
        last.is_some_and(|last| decoder.may_join(run, last))
    }

    /// Makes the run behind the last part of the last, if both are one point. The last is not what
    /// it is in its file any more.
    fn join_last_two(&mut self) -> bool {
        let (runs, added) = self.runs.split_at_mut(self.len);
        let (Some(last), [added, ..]) = (runs.last_mut(), added) else { return false };
        let is_one = last.run.join(&added.run);
        if is_one {
            last.key = None;
        }
        is_one
    }

    /// Sets how points are seen, in their cloud's space; of a cloud of splats it must always be the
    /// same.
    pub fn set_sight(&mut self, sight: Option<Sight>) {
        self.sight = sight;
        let Some(sight) = sight else { return };
        if self.sights.get(usize::from(self.sight_number)) == Some(&sight) {
            return;
        }
        let known = self.sights.iter().rposition(|known| *known == sight);
        let number = known.unwrap_or_else(|| {
            if self.sights.len() == MOST_SIGHTS {
                self.sights.clear();
                self.kept.forget_packed();
            }
            self.sights.push(sight);
            self.sights.len() - 1
        });
        self.sight_number = number as u16;
    }

    /// Says whether there are [`KEPT_BYTES`](super::KEPT_BYTES) of memory to keep runs in; without,
    /// as at first, none is kept.
    pub fn set_room(&mut self, has_room: bool) {
        self.kept.set_room(has_room);
    }

    /// Says how many bytes of memory there are to keep what is seen of runs from afar.
    pub(crate) fn set_room_from_afar(&mut self, bytes: usize) {
        self.kept.set_packed_room(bytes);
    }

    /// Keeps the run of an item for the next time.
    fn keep(&mut self, at: usize) {
        let item = &mut *self.runs[at];
        if let Some(key) = item.key {
            self.kept.keep(key, &mut item.run);
        }
    }

    /// The runs.
    pub(super) fn runs(&mut self) -> &mut [Box<BatchedRun>] {
        &mut self.runs[..self.len]
    }

    /// Removes all runs.
    pub fn clear(&mut self) {
        (0..std::mem::take(&mut self.len)).for_each(|at| self.keep(at));
    }
}

impl BatchedRun {
    /// Finds where rays are near the run. It is the same for all kernels, and compiled apart from
    /// them: there are 42 loops over kernels and quantities for each set of instructions.
    fn set_frames(&mut self, simd: SimdLevel, (packet, slab, lanes): (&Packet, Slab, u64)) {
        dispatch!(simd.level(), simd => simd.vectorize(
            #[inline(always)]
            || self.frames.set(simd, &self.run, packet, slab, lanes),
        ));
    }
}

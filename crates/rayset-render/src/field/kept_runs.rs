//! Runs that have been decoded: the next slab of a packet needs many of them again, and so do its
//! neighbours.

use super::packed_runs::PackedRuns;
use super::run::{DECODED_BYTES, DecodedRun};
use super::run_key::{RunKey, RunPart};

/// The memory for runs that are kept, in the largest runs that are not wide: what a packet and its
/// neighbours need of ellipsoids.
const ROOM: usize = 128;

/// Balls are decoded soon: so much less memory is for them.
const LESS_FOR_BALLS: usize = 4;

/// Most runs whose memory waits for others: as many as are taken out for a batch.
const MOST_SPARE: usize = 9;

/// The most bytes that kept runs take: larger runs are not kept.
pub const KEPT_BYTES: usize = (ROOM + MOST_SPARE) * (size_of::<Kept>() + DECODED_BYTES);

/// Runs, of which the one that has not been used for longest goes first.
#[derive(Debug, Default)]
pub(super) struct KeptRuns {
    /// Whether there is memory for them.
    has_room: bool,
    /// In the order of their last use.
    runs: Vec<Kept>,
    /// Of all of them, of the [`ROOM`].
    cost: usize,
    /// Memory for others.
    spare: Vec<Box<DecodedRun>>,
    /// What is seen of runs from afar.
    packed: PackedRuns,
}

#[derive(Debug)]
struct Kept {
    key: RunKey,
    cost: usize,
    run: Box<DecodedRun>,
}

impl KeptRuns {
    /// Says whether there is memory for runs. If not, those that are kept are forgotten.
    pub(super) fn set_room(&mut self, has_room: bool) {
        self.has_room = has_room;
        if !has_room {
            (self.runs, self.spare, self.cost) = (Vec::new(), Vec::new(), 0);
        }
    }

    /// Gives what is seen of runs from afar so many bytes of memory.
    pub(super) fn set_packed_room(&mut self, bytes: usize) {
        self.packed.set_room(bytes);
    }

    /// Forgets what is seen of runs from afar.
    pub(super) fn forget_packed(&mut self) {
        self.packed.clear();
    }

    /// Takes a run out, if it is kept as samples that are at least `step` apart need it: `run`
    /// becomes it.
    pub(super) fn take(&mut self, key: RunKey, step: f64, run: &mut Box<DecodedRun>) -> bool {
        if key.what != RunPart::Whole {
            return self.packed.find(key, step, run);
        }
        // Mostly one of those that were used last.
        let Some(at) = self.runs.iter().rposition(|kept| kept.key == key) else { return false };
        let Kept { run: kept, cost, .. } = self.runs.remove(at);
        self.cost -= cost;
        let is_right = kept.is_for(step);
        let other = if is_right { std::mem::replace(run, kept) } else { kept };
        self.spare(other);
        is_right
    }

    /// Whether it is known that nothing is seen of a run from afar.
    pub(super) fn is_empty_run(&self, key: RunKey) -> bool {
        key.what != RunPart::Whole && self.packed.is_empty_run(key)
    }

    /// Keeps a run, if there is room and it is not too large; `run` is memory for another then.
    pub(super) fn keep(&mut self, key: RunKey, run: &mut Box<DecodedRun>) {
        run.forget_spare();
        if key.what != RunPart::Whole {
            return self.packed.keep(key, run);
        }
        let Some(memory) = run.memory().filter(|_| self.has_room) else { return };
        let cost = memory * if run.has_shapes() { 1 } else { LESS_FOR_BALLS };
        while self.cost + cost > ROOM && !self.runs.is_empty() {
            let Kept { run, cost, .. } = self.runs.remove(0);
            self.cost -= cost;
            self.spare(run);
        }
        let other = self.spare.pop().unwrap_or_default();
        self.cost += cost;
        self.runs.push(Kept { key, cost, run: std::mem::replace(run, other) });
    }

    /// Keeps the memory of a run for another.
    fn spare(&mut self, mut run: Box<DecodedRun>) {
        run.forget_spare();
        if self.spare.len() < MOST_SPARE && run.memory() == Some(1) {
            self.spare.push(run);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(number: u16) -> RunKey {
        RunKey { cloud: 1, page: 2, number, what: RunPart::Whole, sight: 0 }
    }

    #[test]
    fn runs_are_kept_if_there_is_room_and_they_fit_and_the_oldest_goes_first() {
        let (mut kept, mut run) = (KeptRuns::default(), Box::<DecodedRun>::default());
        let mut keep = |kept: &mut KeptRuns, number, columns| {
            run.attribute = vec![[0.0; 128]; columns];
            kept.keep(key(number), &mut run);
        };
        let mut found = Box::<DecodedRun>::default();
        keep(&mut kept, 0, 1);
        assert!(!kept.take(key(0), 1.0, &mut found), "there is no room");
        kept.set_room(true);
        keep(&mut kept, 1, 17);
        assert!(!kept.take(key(1), 1.0, &mut found), "it has more columns than were borrowed for");
        const MOST: u16 = (ROOM / LESS_FOR_BALLS) as u16;
        (0..=MOST).for_each(|number| keep(&mut kept, number, 8));
        assert!(!kept.take(key(0), 1.0, &mut found) && kept.take(key(1), 1.0, &mut found));
        assert_eq!(found.attribute.len(), 8);
        assert!(!kept.take(RunKey { page: 3, ..key(2) }, 1.0, &mut found));
        kept.set_room(false);
        assert!(!kept.take(key(2), 1.0, &mut found), "its memory was given back");
    }
}

//! Runs that have been decoded: the next slab of a packet needs many of them again, and so do its
//! neighbours.

use super::run::DecodedRun;
use rayset_files::octree::layout::RUN_POINTS;

/// Most runs that are kept: about what a packet and its neighbours need.
const MOST_KEPT: usize = 32;

/// Bytes of a run with up to eight attributes.
pub(super) const DECODED_BYTES: usize = size_of::<DecodedRun>() + 8 * RUN_POINTS * size_of::<f32>();
/// The most bytes that kept runs take, of points with up to eight attributes.
pub const KEPT_BYTES: usize = MOST_KEPT * (size_of::<Kept>() + DECODED_BYTES);

/// Which run it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RunKey {
    /// A number of the cloud and of how its runs are decoded.
    pub cloud: usize,
    /// Its page.
    pub page: u32,
    /// Its number in the page.
    pub number: u16,
}

/// Runs, of which the one that has not been used for longest goes first.
#[derive(Debug, Default)]
pub(super) struct KeptRuns {
    /// Whether there is memory for them.
    has_room: bool,
    runs: Vec<Kept>,
    uses: u64,
    /// Memory for others.
    spare: Vec<Box<DecodedRun>>,
}

#[derive(Debug)]
struct Kept {
    key: RunKey,
    last_use: u64,
    run: Box<DecodedRun>,
}

impl KeptRuns {
    /// Says whether there is memory for runs. If not, those that are kept are forgotten.
    pub(super) fn set_room(&mut self, has_room: bool) {
        self.has_room = has_room;
        if !has_room {
            (self.runs, self.spare) = (Vec::new(), Vec::new());
        }
    }

    /// Takes a run out, if it is kept as samples that are at least `step` apart need it: `run`
    /// becomes it.
    pub(super) fn take(&mut self, key: RunKey, step: f64, run: &mut Box<DecodedRun>) -> bool {
        let Some(at) = self.runs.iter().position(|kept| kept.key == key) else { return false };
        let kept = self.runs.swap_remove(at).run;
        let is_right = kept.is_for(step);
        self.spare.push(if is_right { std::mem::replace(run, kept) } else { kept });
        is_right
    }

    /// Keeps a run, if there is room; `run` is memory for another then.
    pub(super) fn keep(&mut self, key: RunKey, run: &mut Box<DecodedRun>) {
        if !self.has_room {
            return;
        }
        self.uses += 1;
        if self.runs.len() == MOST_KEPT
            && let Some(oldest) = (0..MOST_KEPT).min_by_key(|&at| self.runs[at].last_use)
        {
            self.spare.push(self.runs.swap_remove(oldest).run);
        }
        let other = self.spare.pop().unwrap_or_default();
        self.runs.push(Kept { key, last_use: self.uses, run: std::mem::replace(run, other) });
    }
}

//! How far a render has come.

use std::any::Any;
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Instant;

use super::scheduler::Tally;
use super::tiles::Deferred;
use super::work::{PixelMask, Tile};
use super::{RenderCounts, RenderError};
use crate::field::LANES;
use crate::image::LayerPixel;
use rayset_base::sync::{Condvar, Mutex, MutexGuard, lock_counting};

/// Most finished tiles that wait to be handed out; at this many, no further tiles are begun.
pub(super) const MOST_WAITING: usize = 32;
/// With this many or fewer, threads that have left are called back.
pub(super) const FEW_WAITING: usize = MOST_WAITING / 2;

/// How far a render has come. A thread that leaves releases the render itself before it reports so
/// here, so that nothing of a render outlives the call.
#[derive(Default)]
pub(super) struct Progress {
    state: Mutex<State>,
    pub(super) changed: Condvar,
    tally: Arc<Tally>,
}

impl Progress {
    pub(super) fn new(tally: &Arc<Tally>) -> Self {
        Self { tally: tally.clone(), ..Self::default() }
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, State> {
        lock_counting(&self.state, &self.tally.lock_waits)
    }

    /// A thread has left.
    pub(super) fn left(&self) {
        self.lock().threads -= 1;
        self.changed.notify_all();
    }

    /// Makes the caller look at the state again.
    pub(super) fn wake(&self) {
        drop(self.lock());
        self.changed.notify_all();
    }
}

/// A finished tile.
pub(super) struct Output {
    pub(super) tile: Tile,
    /// Its number among the tiles of the work.
    pub(super) number: usize,
    pub(super) traced: PixelMask,
    pub(super) pass: u32,
    pub(super) pixels: [[f32; 4]; LANES],
    pub(super) layers: Option<Box<[LayerPixel; LANES]>>,
    /// Seconds that a thread took for it.
    pub(super) seconds: f32,
}

/// The state of a render, under its lock.
#[derive(Default)]
pub(super) struct State {
    /// When the caller was last told of tiles.
    pub(super) called: Option<Instant>,
    pub(super) pass: usize,
    /// The next tile of the pass.
    pub(super) next: usize,
    /// Tiles of the pass that are finished.
    pub(super) finished: usize,
    /// Tiles that threads deferred, or had taken for their own, before they left.
    pub(super) left_behind: Vec<Deferred>,
    pub(super) outputs: VecDeque<Output>,
    /// Tiles handed out since threads were last called back.
    pub(super) since_call: usize,
    /// Threads at work.
    pub(super) threads: usize,
    pub(super) counts: RenderCounts,
    pub(super) error: Option<RenderError>,
    pub(super) panic: Option<Box<dyn Any + Send>>,
}

impl State {
    /// Whether so many tiles wait that no thread joins.
    pub(super) fn is_filling(&self) -> bool {
        self.outputs.len() > FEW_WAITING
    }

    /// Whether any tile of so many passes over so many tiles is to be begun.
    pub(super) fn has_tiles(&self, passes: usize, tiles: usize) -> bool {
        let fresh = self.pass < passes && self.next < tiles;
        fresh || !self.left_behind.is_empty()
    }
}

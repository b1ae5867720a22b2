//! One render: its tiles, the threads that trace them, and the tiles that wait to be handed out.

use std::cell::{Cell, RefCell};
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};

use super::access::{Access, Foreseen, Halt};
use super::layers::Layers;
use super::packet_tracer::PacketTracer;
use super::predict::{Lookahead, LookaheadState};
use super::prepared::Prepared;
use super::progress::{FEW_WAITING, MOST_WAITING, Output, Progress, State};
use super::ray_tree::{MOST_SHEETS, PrimaryRay, Sheet};
use super::scheduler::{Task, Turn};
use super::steps::StepRule;
use super::tiles::{Attempt, Deferred, TileQueue, Together};
use super::work::{PixelMask, Tile, TilePlace, Work};
use super::{RenderCounts, RenderError};
use crate::field::LANES;
use crate::scene::{RayMaker, RenderSettings};
use rayset_base::cancel::CancelToken;
use rayset_base::sync::{Mutex, MutexGuard, wait_timeout};
use rayset_store::working_set::{PageClient, Reuse};

/// The caller is woken at most this often while few tiles wait: waking costs a small tile's time.
const BETWEEN_CALLS: Duration = Duration::from_millis(5);
/// The caller looks for tiles of its own accord after this long.
const MOST_UNSEEN: Duration = Duration::from_millis(20);
/// Most tiles that a thread takes for itself, and traces together: those beside each other need
/// much the same of what it has decoded.
const MOST_TOGETHER: usize = 16;

pub(super) struct Job {
    prepared: Arc<Prepared>,
    rays: RayMaker,
    steps: Arc<StepRule>,
    settings: RenderSettings,
    pub(super) tiles: Arc<[Tile]>,
    /// The pixels of each tile that are traced, if they are not all.
    traced: Option<Box<[PixelMask]>>,
    /// The range of rays of a pixel in each pass.
    passes: Vec<Range<u32>>,
    /// What the rays of each tile have seen in earlier passes; empty if there is only one pass.
    earlier: Vec<Mutex<Option<Box<TileSums>>>>,
    lookahead_state: LookaheadState,
    pages: PageClient,
    /// Cancels this render only.
    stop: CancelToken,
    progress: Arc<Progress>,
}

/// What a render returns to its caller next.
pub(super) enum Next {
    /// A finished tile; and how many threads are to be called back, because there is room for their
    /// tiles again.
    Tile {
        output: Box<Output>,
        room: usize,
    },
    Finished(Result<RenderCounts, RenderError>),
}

/// What the rays of a tile have seen so far.
#[derive(Clone)]
struct TileSums {
    pixels: [[f32; 4]; LANES],
    layers: Option<Layers>,
    asked_bytes: u64,
}

impl Job {
    /// `work` has at least one tile, and all of its tiles lie in the picture.
    pub(super) fn new(
        prepared: Arc<Prepared>,
        (rays, steps): (RayMaker, Arc<StepRule>),
        settings: RenderSettings,
        work: &Work,
        stop: &CancelToken,
    ) -> Self {
        let passes = work.passes.ranges(settings.samples.along_a_side().pow(2));
        let kept = if passes.len() > 1 { work.tiles.len() } else { 0 };
        let (tiles, threads) = (Arc::<[Tile]>::from(&*work.tiles), prepared.engine.exec.threads);
        let visited = match work.upcoming.is_empty() {
            true => tiles.clone(),
            false => tiles.iter().chain(&work.upcoming).copied().collect(),
        };
        Self {
            lookahead_state: LookaheadState::new(&prepared.world, visited, threads),
            pages: prepared.engine.pages.client(stop),
            rays,
            steps,
            settings,
            tiles,
            traced: work.traced.as_deref().map(Box::from),
            passes,
            earlier: (0..kept).map(|_| Mutex::new(None)).collect(),
            stop: stop.clone(),
            progress: Arc::new(Progress::new(prepared.engine.scheduler.tally())),
            prepared,
        }
    }

    pub(super) fn passes(&self) -> u32 {
        self.passes.len() as u32
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.progress.lock()
    }

    pub(super) fn progress(&self) -> Arc<Progress> {
        self.progress.clone()
    }

    // For the caller of the render.

    /// Waits for a tile to hand out, or for the end: no thread works on the render any more.
    pub(super) fn next(&self) -> Next {
        let mut state = self.lock();
        loop {
            let stopped = self.stop.is_cancelled();
            if !stopped && let Some(output) = state.outputs.pop_front() {
                // At most one thread a tile: those that find too many waiting are idle again.
                let calls = state.since_call + 1 >= FEW_WAITING && !state.is_filling();
                state.since_call = if calls { 0 } else { state.since_call + 1 };
                return Next::Tile { output: Box::new(output), room: if calls { FEW_WAITING } else { 0 } };
            }
            let complete = state.pass == self.passes.len();
            if state.threads == 0 && (complete || stopped) {
                break;
            }
            state = wait_timeout(&self.progress.changed, state, MOST_UNSEEN);
        }
        let complete = state.pass == self.passes.len() && state.outputs.is_empty();
        let (panic, error, counts) = (state.panic.take(), state.error.take(), state.counts);
        drop(state);
        self.lookahead(&self.pages, &RefCell::default()).finish();
        self.pages.forget_hints();
        if let Some(panic) = panic {
            resume_unwind(panic);
        }
        Next::Finished(match error {
            Some(error) => Err(error),
            None if complete => Ok(counts),
            None => Err(RenderError::Cancelled),
        })
    }

    /// Ends the render with an error, unless it has one already.
    pub(super) fn fail(&self, error: RenderError) {
        self.lock().error.get_or_insert(error);
        self.stop.cancel();
    }

    // For the threads.

    /// Traces tile after tile, until none is left, the thread's turn is over, or too many finished
    /// tiles wait.
    fn trace_tiles(&self, turn: &Turn<'_>) {
        let exec = &self.prepared.engine.exec;
        let mut tracer =
            PacketTracer::new(&self.prepared.world, (&self.rays, &self.steps), exec.slab_samples);
        let (asked_bytes, reuse, foreseen) = (Cell::new(0), RefCell::default(), Foreseen::default());
        let mut together = Together::new(self.most_together());
        let pages = self.pages.for_thread();
        let mut queue =
            TileQueue::new((&pages, &*exec.predictor), exec.threads.max(1), &asked_bytes, &reuse, &foreseen);
        let mut own = TilePlace { tile: 0, count: 0, pass: 0 };
        while !self.stop.is_cancelled()
            && let Some(attempt) = queue
                .next(self.lookahead_state.deferral(), |waits| self.take(&mut own, together.tiles(), waits))
        {
            exec.predictor.ahead(self.lookahead(&pages, &reuse), attempt.place.tile);
            let (before, mut is_full) = (tracer.counts(), false);
            asked_bytes.set(0);
            pages.begin_round(&mut reuse.borrow_mut());
            let begun = Instant::now();
            let traced = self.trace(&attempt, &mut tracer);
            if !attempt.access.waits {
                self.lookahead_state.worked(begun.elapsed());
            }
            match traced {
                Ok(mut outputs) => {
                    let seconds = begun.elapsed().as_secs_f32() / outputs.len() as f32;
                    outputs.iter_mut().for_each(|output| output.seconds = seconds);
                    foreseen.finished(attempt.place.tile, &pages);
                    attempt.place.tiles().for_each(|tile| {
                        self.lookahead_state.finished(tile, attempt.number());
                    });
                    pages.end_round(&mut reuse.borrow_mut());
                    together.finished(outputs.len());
                    is_full = self.finish(outputs, turn);
                }
                Err(Halt::Deferred(lacking)) => {
                    attempt.place.tiles().for_each(|tile| {
                        self.lookahead_state.deferred(tile, attempt.number());
                    });
                    together.put_off();
                    tracer.deferred(before);
                    queue.deferred(&attempt, lacking);
                }
                Err(Halt::Failed(error)) => self.fail(error),
            }
            if is_full || turn.is_over() {
                break;
            }
        }
        let deferred = queue.into_deferred();
        let calls = !deferred.is_empty() || own.count > 0;
        let mut state = self.lock();
        state.counts += tracer.counts();
        state.left_behind.extend(deferred.into_iter().chain(own.singly().rev().map(Deferred::fresh)));
        drop(state);
        if calls {
            turn.call_others();
        }
    }

    /// Most tiles that a thread traces together. Only where rays are mirrored or bent is there
    /// anything to gain: rays that follow from different tiles share packets. Those of more sheets
    /// than that do not.
    fn most_together(&self) -> usize {
        let world = &self.prepared.world;
        let rays = self.passes.iter().map(ExactSizeIterator::len).max().unwrap_or(1);
        if world.bounces.is_none() || world.layers { 1 } else { (MOST_SHEETS / rays).clamp(1, MOST_TOGETHER) }
    }

    /// A tile that a thread left behind, otherwise the next of the thread's own: as many as are
    /// traced together. If it has none, it takes the next tiles of the work for its own, fewer at
    /// the end, so that all threads have something to do until then. `None` if there are none, or
    /// if the thread has deferred tiles to wait for and the next tile should come after them.
    fn take(&self, own: &mut TilePlace, together: usize, waits: bool) -> Option<Deferred> {
        let mut state = self.lock();
        if let Some(deferred) = state.left_behind.pop() {
            return Some(deferred);
        }
        if own.count == 0 && !state.has_tiles(self.passes.len(), self.tiles.len()) {
            return None;
        }
        let tile = if own.count == 0 { state.next } else { own.tile };
        if waits && self.lookahead_state.is_too_early(tile) {
            return None;
        }
        if own.count == 0 {
            let left = self.tiles.len() - tile;
            // What is looked ahead at is let go behind the tile that was begun last.
            let looks_ahead = !self.prepared.world.foresight.is_empty();
            let most = if looks_ahead { together } else { MOST_TOGETHER };
            let count = most.min(left / (2 * self.prepared.engine.exec.threads.max(1))).max(1);
            let count = self.lookahead_state.together(tile, count);
            state.next += count;
            *own = TilePlace { tile, count, pass: state.pass };
        }
        let place = TilePlace { count: together.min(own.count), ..*own };
        (own.tile, own.count) = (own.tile + place.count, own.count - place.count);
        Some(Deferred::fresh(place))
    }

    fn lookahead<'a>(&'a self, pages: &'a PageClient, reuse: &'a RefCell<Reuse>) -> Lookahead<'a> {
        let world = &self.prepared.world;
        Lookahead { state: &self.lookahead_state, world, rays: &self.rays, pages, reuse }
    }

    /// Traces the rays of some tiles in one pass.
    fn trace(&self, attempt: &Attempt<'_>, tracer: &mut PacketTracer<'_>) -> Result<Vec<Output>, Halt> {
        let (place, access) = (attempt.place, attempt.access);
        let mut sums: Vec<TileSums> =
            place.tiles().map(|index| self.earlier(index, tracer.layers())).collect();
        let rays = self.passes[place.pass].clone();
        // A sheet for each ray of a pixel, tile by tile. With layers, which know one tile and add
        // up ray by ray, sheets are traced one by one.
        let sheets = place.count * rays.len();
        let at_once = if self.prepared.world.layers { 1 } else { sheets };
        for first in (0..sheets).step_by(at_once) {
            let make = |number: usize, sheet: &mut Sheet| {
                let number = (first + number) as u32;
                let tile = place.tile + (number / rays.len() as u32) as usize;
                self.fill(tile, rays.start + number % rays.len() as u32, sheet);
            };
            tracer.trace(access, at_once, make, |number, seen| {
                let sums = &mut sums[(first + number) / rays.len()];
                for (sum, seen) in sums.pixels.iter_mut().zip(seen) {
                    (0..4).for_each(|channel| sum[channel] += seen[channel]);
                }
            })?;
        }
        let outputs = place.singly().zip(sums);
        Ok(outputs.map(|(place, sums)| self.output(place, sums, access, tracer)).collect())
    }

    /// Makes the sheet of one ray of every pixel of a tile that is traced.
    fn fill(&self, index: usize, cell: u32, sheet: &mut Sheet) {
        let (tile, cells) = (self.tiles[index], self.settings.samples.along_a_side());
        let (i, j) = (cell % cells, cell / cells);
        sheet.clear();
        for pixel in self.traced(index).pixels() {
            let (x, y) = (tile.x + pixel as u32 % tile.width, tile.y + pixel as u32 / tile.width);
            let (u, v) = self.settings.ray_place(x, y, i, j);
            let sample_offset = self.settings.sample_offset_of(x * cells + i, y * cells + j);
            sheet.push(PrimaryRay { ray: self.rays.ray(u, v), sample_offset, pixel });
        }
    }

    /// The pixels of a tile that are traced.
    fn traced(&self, index: usize) -> PixelMask {
        self.traced.as_ref().map_or_else(|| PixelMask::all_of(&self.tiles[index]), |traced| traced[index])
    }

    /// A tile as its rays have seen it so far.
    fn output(
        &self,
        TilePlace { tile: index, pass, .. }: TilePlace,
        mut sums: TileSums,
        access: Access<'_>,
        tracer: &mut PacketTracer<'_>,
    ) -> Output {
        let tile = self.tiles[index];
        sums.asked_bytes += access.asked_bytes.get();
        let share = 1.0 / self.passes[pass].end as f32;
        let pixels = sums.pixels.map(|sum| sum.map(|v| v * share));
        let traced = self.traced(index);
        if pass + 1 == self.passes.len() {
            tracer.count_errors(traced, tile.pixels());
        }
        let layers = tracer.layers().filter(|_| self.prepared.world.layers);
        let known = layers.map(|layers| Box::new(layers.pixels(tile.pixels(), sums.asked_bytes)));
        if let Some(earlier) = self.earlier.get(index) {
            sums.layers = tracer.layers().cloned();
            *earlier.lock().unwrap_or_else(PoisonError::into_inner) = Some(Box::new(sums));
        }
        Output { tile, number: index, traced, pass: pass as u32, pixels, layers: known, seconds: 0.0 }
    }

    /// What the rays of a tile have seen in earlier passes; the thread's layers become those, too.
    fn earlier(&self, tile: usize, layers: Option<&mut Layers>) -> TileSums {
        let earlier = self.earlier.get(tile);
        let known = earlier.and_then(|sums| sums.lock().unwrap_or_else(PoisonError::into_inner).clone());
        let sums = known.map_or_else(
            || TileSums { pixels: [[0.0; 4]; LANES], layers: None, asked_bytes: 0 },
            |sums| *sums,
        );
        if let Some(layers) = layers {
            match &sums.layers {
                Some(earlier) => layers.clone_from(earlier),
                None => layers.begin(),
            }
        }
        sums
    }

    /// Hands over finished tiles; after the last tile of a pass, begins the next pass. Wakes the
    /// caller at the end of a pass, while more than [`FEW_WAITING`] tiles wait, and otherwise at
    /// most every [`BETWEEN_CALLS`]. Returns whether too many tiles wait.
    fn finish(&self, outputs: Vec<Output>, turn: &Turn<'_>) -> bool {
        let mut state = self.lock();
        state.finished += outputs.len();
        state.outputs.extend(outputs);
        let next_pass = state.finished == self.tiles.len();
        if next_pass {
            (state.pass, state.next, state.finished) = (state.pass + 1, 0, 0);
        }
        let is_full = state.outputs.len() >= MOST_WAITING;
        let calls = next_pass && state.pass < self.passes.len();
        let since = state.called.map_or(BETWEEN_CALLS, |called| called.elapsed());
        let calls_caller = next_pass || state.is_filling() || since >= BETWEEN_CALLS;
        if calls_caller {
            state.called = Some(Instant::now());
        }
        drop(state);
        if calls_caller {
            self.progress.changed.notify_all();
        }
        if calls {
            turn.call_others();
        }
        is_full
    }
}

impl Task for Job {
    fn has_work(&self) -> bool {
        let state = self.lock();
        !self.stop.is_cancelled()
            && !state.is_filling()
            && state.has_tiles(self.passes.len(), self.tiles.len())
    }

    fn entered(&self) {
        self.lock().threads += 1;
    }

    fn work(&self, turn: &Turn<'_>) {
        if let Err(panic) = catch_unwind(AssertUnwindSafe(|| self.trace_tiles(turn))) {
            self.lock().panic.get_or_insert(panic);
            self.stop.cancel();
        }
    }

    fn when_left(&self) -> Box<dyn FnOnce()> {
        let progress = self.progress.clone();
        Box::new(move || progress.left())
    }
}

//! Counts the votes for the inside of a node, on a session's threads: block by block of the
//! lattice's rays.

use std::any::Any;
use std::cell::{Cell, RefCell};
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use super::lattice::{Lattice, Votes};
use super::passes::PassTracer;
use crate::trace::RenderError;
use crate::trace::access::{Access, Foreseen, Halt};
use crate::trace::engine::Engine;
use crate::trace::predict::Foresight;
use crate::trace::program::Program;
use crate::trace::scheduler::{Task, Turn};
use crate::trace::steps::StepRule;
use rayset_base::cancel::CancelToken;
use rayset_base::geometry::Ray;
use rayset_store::working_set::PageClient;

/// Rays along one axis that meet the surface.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct AxisCount {
    /// Rays that cross it at least once.
    pub(super) crossing: u64,
    /// Of these, rays that cross it an odd number of times: it is open there.
    pub(super) odd: u64,
}

/// Counts the votes of all rays of a lattice through a node. The counts are of the three axes.
pub(super) fn count(
    engine: &Engine,
    program: Program,
    steps: StepRule,
    lattice: Lattice,
) -> Result<(Arc<Votes>, [AxisCount; 3]), RenderError> {
    let stop = CancelToken::new();
    let votes = Arc::new(Votes::new(lattice));
    let task = Arc::new(Counting {
        // Rays go through everything.
        foresight: Foresight::new(&program, 0.0),
        asked: AtomicUsize::new(0),
        program,
        steps,
        slab_samples: engine.exec.slab_samples,
        pages: engine.pages.client(&stop),
        votes: votes.clone(),
        stop,
        progress: Arc::default(),
    });
    let scheduled = engine.scheduler.add(task.clone());
    let outcome = task.wait();
    drop(scheduled);
    outcome.map(|axes| (votes, axes))
}

struct Counting {
    program: Program,
    foresight: Foresight,
    /// Blocks whose pages have been asked for, if they are remote: those before this one.
    asked: AtomicUsize,
    steps: StepRule,
    slab_samples: usize,
    pages: PageClient,
    votes: Arc<Votes>,
    stop: CancelToken,
    progress: Arc<Progress>,
}

#[derive(Default)]
struct Progress {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    /// The next block of rays.
    next: usize,
    /// Threads at work.
    threads: usize,
    axes: [AxisCount; 3],
    error: Option<RenderError>,
    panic: Option<Box<dyn Any + Send>>,
}

impl Progress {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Counting {
    fn blocks(&self) -> usize {
        self.votes.lattice.blocks()
    }

    /// Waits until every block is done and no thread is at work.
    fn wait(&self) -> Result<[AxisCount; 3], RenderError> {
        let mut state = self.progress.lock();
        while state.threads > 0 || (state.next < self.blocks() && !self.stop.is_cancelled()) {
            state = self.progress.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        if let Some(panic) = state.panic.take() {
            drop(state);
            resume_unwind(panic);
        }
        state.error.take().map_or(Ok(state.axes), Err)
    }

    fn take(&self) -> Option<usize> {
        let mut state = self.progress.lock();
        (state.next < self.blocks() && !self.stop.is_cancelled()).then(|| {
            state.next += 1;
            state.next - 1
        })
    }

    fn trace_blocks(&self, turn: &Turn<'_>) -> Result<(), RenderError> {
        let mut tracer = PassTracer::new(&self.program, &self.steps, self.slab_samples);
        let (mut row, mut axes) = (Vec::new(), [AxisCount::default(); 3]);
        let (asked_bytes, reuse, foreseen) = (Cell::new(0), RefCell::default(), Foreseen::default());
        let pages = self.pages.for_thread();
        let access = Access {
            pages: &pages,
            waits: true,
            slabs_on_a_miss: 1,
            follows_lines: false,
            foresees: None,
            foreseen: &foreseen,
            threads: 1,
            asked_bytes: &asked_bytes,
            sight: None,
            reuse: &reuse,
        };
        let mut outcome = Ok(());
        while !turn.is_over()
            && let Some(number) = self.take()
        {
            self.ask_ahead(access, number);
            outcome = self.trace_block(access, number, &mut tracer, &mut row, &mut axes);
            if outcome.is_err() {
                break;
            }
        }
        let mut state = self.progress.lock();
        for (sum, own) in state.axes.iter_mut().zip(axes) {
            sum.crossing += own.crossing;
            sum.odd += own.odd;
        }
        outcome
    }

    /// Asks for the pages of the blocks from one on, if they are remote: a block that waited for
    /// page after page would take a round trip for each.
    fn ask_ahead(&self, access: Access<'_>, number: usize) {
        const AHEAD: usize = 16;
        /// They are asked for in bursts, so that neighbours come in one request.
        const BURST: usize = 4;
        let until = (number + AHEAD).min(self.blocks());
        let from = self.asked.load(Ordering::Relaxed).max(number);
        let asks = self.foresight.policy.asks_along_rays();
        if !asks || (from + BURST > until && from > number) || from >= until {
            return;
        }
        self.asked.store(until, Ordering::Relaxed);
        let lattice = &self.votes.lattice;
        let rays_of = |number| {
            let block = lattice.block(number);
            block.first_cells().map(|cell| block.ray(lattice, cell)).collect::<Vec<Ray>>()
        };
        let packets: Vec<Vec<Ray>> = (from..until).map(rays_of).collect();
        let access = Access { foresees: Some(1.0), ..access };
        self.foresight.ask(&self.program, access, packets.iter().map(Vec::as_slice));
        access.foreseen.forget();
    }

    fn trace_block(
        &self,
        access: Access<'_>,
        number: usize,
        tracer: &mut PassTracer<'_>,
        row: &mut Vec<f64>,
        axes: &mut [AxisCount; 3],
    ) -> Result<(), RenderError> {
        let lattice = &self.votes.lattice;
        let block = lattice.block(number);
        let first_cells: Vec<[usize; 3]> = block.first_cells().collect();
        let rays: Vec<Ray> = first_cells.iter().map(|&cell| block.ray(lattice, cell)).collect();
        let found = tracer.crossings(access, &rays).map_err(|halt| match halt {
            Halt::Failed(error) => error,
            Halt::Deferred(_) => RenderError::Cancelled,
        })?;
        for ((first, ray), distances) in first_cells.iter().zip(&rays).zip(found) {
            let crossings: Vec<f64> =
                distances.iter().map(|&t| lattice.in_cells(ray.at(t))[block.axis]).collect();
            let count = &mut axes[block.axis];
            count.crossing += u64::from(!crossings.is_empty());
            count.odd += (crossings.len() % 2) as u64;
            self.votes.add_line(block.axis, *first, &crossings, row);
        }
        Ok(())
    }

    fn fail(&self, with: impl FnOnce(&mut State)) {
        with(&mut self.progress.lock());
        self.stop.cancel();
    }
}

impl Task for Counting {
    fn has_work(&self) -> bool {
        !self.stop.is_cancelled() && self.progress.lock().next < self.blocks()
    }

    fn entered(&self) {
        self.progress.lock().threads += 1;
    }

    fn work(&self, turn: &Turn<'_>) {
        match catch_unwind(AssertUnwindSafe(|| self.trace_blocks(turn))) {
            Ok(Ok(())) => {}
            Ok(Err(error)) => self.fail(|state| _ = state.error.get_or_insert(error)),
            Err(panic) => self.fail(|state| _ = state.panic.get_or_insert(panic)),
        }
    }

    fn when_left(&self) -> Box<dyn FnOnce()> {
        let progress = self.progress.clone();
        Box::new(move || {
            progress.lock().threads -= 1;
            progress.changed.notify_all();
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::SimdLevel;
    use crate::scene::{Compositing, Form, Node, Operator, RenderSettings, Scene, Shape, Solid};
    use crate::trace::engine::ExecSettings;
    use crate::trace::program::Purpose;
    use rayset_base::geometry::{DVec3, Ray};
    use rayset_files::PagedFiles;
    use rayset_store::working_set::read::{self, BackendKind};
    use rayset_store::working_set::{Limits, WorkingSet};

    fn ball(radius: f64) -> Node {
        Node::new(Shape::Procedural(Arc::new(Solid::new(Form::Sphere { radius }))))
    }

    #[test]
    fn rays_along_the_rim_of_a_shell_graze_it_and_all_others_cross_it_twice() {
        let shell = Node::operator(Operator::Difference, [ball(1.0), ball(0.9)]);
        let scene = Scene {
            root: Arc::new(shell),
            lighting: crate::scene::Lighting::Unlit,
            background: None,
            unit_distance: 1.0,
            compositing: Compositing::Linear,
        };
        let backend = read::backend(BackendKind::Pool).expect("a pool");
        let files = PagedFiles::new(WorkingSet::new(Limits::total(1 << 20), backend));
        let exec = ExecSettings { threads: 2, ..ExecSettings::default() };
        let engine = Engine::start(files.clone(), exec, None, String::new()).expect("an engine");
        let program = Program::compile(&scene, Purpose::Surface, SimdLevel::default());
        let program = program.open(&files).expect("files in a working set");
        let steps = StepRule::new(&program, &RenderSettings::default(), None).expect("steps");
        let lattice = Lattice::over(&scene.root.bounds(), 48).expect("a lattice");
        let (votes, axes) = count(&engine, program, steps, lattice).expect("votes");
        // Of rays at random distances from the axis, a tenth of a radius meets the shell without
        // its hollow.
        let distance = |ray: Ray| DVec3::new(ray.origin.y, ray.origin.z, 0.0).length();
        let block_rays = (0..36).flat_map(|number| {
            let block = lattice.block(number);
            block.first_cells().map(|cell| distance(block.ray(&lattice, cell))).collect::<Vec<_>>()
        });
        let grazing = block_rays.filter(|&far| far > 0.97 && far < 1.0).count();
        assert!(grazing > 50, "{grazing}");
        for axis in axes {
            assert!(axis.crossing > 1000 && axis.odd == 0, "{axis:?}");
        }
        assert_eq!(votes.of([24, 24, 24]), 6 * super::super::lattice::VOTE);
        assert_eq!(votes.of([0, 0, 0]), 0);
    }
}

//! Looks ahead of the tile being traced. The picture is divided into look-ahead tiles of 32 × 32
//! pixels. The pages of upcoming look-ahead tiles are hinted at as far as there is room, given up
//! if their look-ahead tile has passed without using them, and retired once no later look-ahead
//! tile can need them.

use std::cell::RefCell;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use super::deferral::{Deferral, DeferredTiles};
use super::found::{Found, Looked, PageId};
use super::order::{Edge, Order};
use super::pace::Pace;
use super::policy::Policy;
use super::probe::{Gap, Needed, ProbeRays};
use crate::field::LANES;
use crate::scene::RayMaker;
use crate::trace::cloud::{FarAhead, NodesInMemory};
use crate::trace::shadow::{LitPlace, RaysToLight};
use crate::trace::work::{Region, Tile};
use crate::trace::world::World;
use rayset_base::geometry::{Aabb, DVec3, Ray};
use rayset_files::octree::node::Node;
use rayset_store::working_set::{Object, PageClient, Reuse};

/// What is known about the picture being rendered and the rays to come.
#[derive(Clone, Copy)]
pub struct Lookahead<'a> {
    pub(in crate::trace) state: &'a LookaheadState,
    pub(in crate::trace) world: &'a World,
    pub(in crate::trace) rays: &'a RayMaker,
    pub(in crate::trace) pages: &'a PageClient,
    /// What this thread knows about when pages are used again.
    pub(in crate::trace) reuse: &'a RefCell<Reuse>,
}

/// The order in which a render visits its picture, and what has been found ahead.
pub(in crate::trace) struct LookaheadState {
    /// Bytes of the largest page.
    pub(super) page_bytes: u64,
    pub(super) threads: usize,
    pub(super) order: Order,
    found: Mutex<Found>,
    /// Pages that fit the budget besides those that the look-ahead tiles being traced need.
    spare_pages: AtomicU64,
    pub(super) pace: Pace,
    /// How pages are brought in.
    policy: &'static dyn Policy,
    /// Number of tiles that have been examined, where pages are held for them.
    pub(super) examined: AtomicU32,
    /// Tiles that are deferred, where pages are held for them.
    deferred: DeferredTiles,
}

impl LookaheadState {
    /// The order given by some tiles, of which there must be at least one.
    pub(in crate::trace) fn new(world: &World, tiles: Arc<[Tile]>, threads: usize) -> Self {
        Self {
            page_bytes: world.foresight.page_bytes(),
            threads: threads.max(1),
            order: Order::new(tiles),
            found: Mutex::default(),
            spare_pages: AtomicU64::new(0),
            pace: Pace::default(),
            examined: AtomicU32::new(0),
            deferred: DeferredTiles::default(),
            policy: world.foresight.policy,
        }
    }

    /// A tile is deferred after so many attempts.
    pub(in crate::trace) fn deferred(&self, tile: usize, attempts: u32) {
        if self.policy.holds_pages() {
            self.deferred.add(tile as u32, attempts, Instant::now());
        }
    }

    /// A tile is finished with an attempt of this number.
    pub(in crate::trace) fn finished(&self, tile: usize, attempt: u32) {
        if self.policy.holds_pages() {
            self.deferred.remove(tile as u32, attempt);
        }
    }

    /// Whether a tile should wait until those that are deferred are finished: the pages that it
    /// needs have not been looked for, because those of the deferred ones take all the room.
    pub(in crate::trace) fn is_too_early(&self, tile: usize) -> bool {
        self.policy.holds_pages() && tile as u32 >= self.examined.load(Ordering::Relaxed)
    }

    /// A thread has traced for so long, without waiting.
    pub(in crate::trace) fn worked(&self, time: Duration) {
        self.pace.worked(time);
    }

    /// How many of `count` tiles from one on are in the same look-ahead tile: at least that one.
    /// What a thread is still to trace must not count as passed.
    pub(in crate::trace) fn together(&self, tile: usize, count: usize) -> usize {
        self.order.rest_of_square(tile as u32, Edge::MOST).len().min(count)
    }

    /// How many tiles a thread may defer: as many as there is room for besides those being traced.
    /// If rays need most of the budget at a time, tracing other tiles meanwhile would only evict
    /// their pages.
    pub(in crate::trace) fn deferral(&self) -> Deferral {
        let spare = self.spare_pages.load(Ordering::Relaxed);
        let most = self.policy.most_deferred(spare / self.threads as u64);
        Deferral { most, policy: self.policy, stuck: self.is_stuck() }
    }

    /// Whether any tile has less room than it needs: nothing more is to be looked ahead at until it
    /// is finished.
    pub(super) fn is_stuck(&self) -> bool {
        self.deferred.is_any_stuck()
    }
}

impl<'a> Lookahead<'a> {
    /// Looks ahead of a tile that is about to be traced: at the look-ahead tiles beyond its own, up
    /// to `tiles_ahead` of them, or, of remote files, at as many as there is room for. Hints at
    /// their pages.
    pub(super) fn scout(&self, tile: usize, tiles_ahead: u32) {
        let state = self.state;
        if self.world.foresight.is_empty() {
            return;
        }
        // One thread at a time does this; the others have tiles to trace.
        let Ok(mut found) = state.found.try_lock() else { return };
        let here = tile as u32;
        let patience = state.policy.patience(&|| self.latency());
        let first = state.deferred.first_since(Instant::now(), patience).unwrap_or(here);
        self.retire(&mut found, first.min(here));
        if found.next < here {
            found.next = here;
            found.nodes_hinted.clear();
            found.lacking.clear();
        }
        if state.policy.holds_pages() {
            self.fill_window(&mut found, here);
        } else {
            self.follow_squares(&mut found, here, tiles_ahead);
        }
    }

    /// Looks ahead at some squares beyond the one that is being traced, one after another, as far
    /// as there is room.
    fn follow_squares(&self, found: &mut Found, here: u32, tiles_ahead: u32) {
        let state = self.state;
        let end_of = |place| state.order.rest_of_square(place, Edge::MOST).end;
        let next = end_of(here);
        let until =
            (0..tiles_ahead).fold(next, |end, _| if end < state.order.len() { end_of(end) } else { end });
        // The current look-ahead tile and the next are examined even without room, to know how many
        // pages they need.
        while found.next < until && (self.hint(found, here) || found.next <= next) {
            let Some(looked) = self.look(found.next, Edge::MOST, found) else { return };
            found.take_in(looked);
        }
    }

    /// Ends looking ahead: nothing is kept for it any more.
    pub(in crate::trace) fn finish(&self) {
        let Ok(found) = self.state.found.try_lock() else { return };
        if self.state.policy.holds_pages() {
            let kept: Vec<PageId> =
                found.seen.keys().chain(&found.to_let_go).chain(&found.nodes_to_let_go).copied().collect();
            kept.into_iter().chain(found.records_to_let_go.iter().copied()).for_each(|page| {
                self.let_go(page);
            });
        }
    }

    /// Hints at the waiting pages; false if there was no room for some of them.
    fn hint(&self, found: &mut Found, here: u32) -> bool {
        /// Hints may take one part in this many of the budget: more would leave too little for
        /// pages that later look-ahead tiles use again.
        const MOST_OF_BUDGET: u64 = 4;
        let spare = self.spare(found, here) * self.state.page_bytes;
        let most = self.pages.share_bytes() / MOST_OF_BUDGET;
        // Where the tiles being traced need nearly all, what they need would give way, or the
        // hinted pages before their use.
        if spare < most {
            return false;
        }
        let pages: Vec<PageId> = found.waiting.iter().map(|&(_, _, page)| page).collect();
        for same_file in pages.chunk_by(|a, b| a.file == b.file) {
            let numbers: Vec<u32> = same_file.iter().map(|id| id.page).collect();
            let Some(object) = self.object(same_file[0].file) else { continue };
            let dealt_with = self.pages.hint_knowing(object, &numbers, most, Some(self.reuse));
            found.dealt_with(dealt_with);
            if dealt_with < numbers.len() {
                break;
            }
        }
        found.waiting.is_empty()
    }

    pub(super) fn object(&self, file: u32) -> Option<&'a Arc<Object>> {
        self.world.foresight.file(file)
    }

    /// Calls `tell` with some pages, grouped by file.
    fn by_file(&self, mut pages: Vec<PageId>, tell: impl Fn(&Arc<Object>, &[u32])) {
        pages.sort_unstable();
        for same_file in pages.chunk_by(|a, b| a.file == b.file) {
            let numbers: Vec<u32> = same_file.iter().map(|id| id.page).collect();
            if let Some(object) = self.object(same_file[0].file) {
                tell(object, &numbers);
            }
        }
    }

    /// Pages that fit the budget besides those that the look-ahead tiles being traced need.
    pub(super) fn spare(&self, found: &mut Found, here: u32) -> u64 {
        let past = found.demands.iter().take_while(|&&(end, _)| end <= here).count();
        found.demands.drain(..past);
        // The pages of one look-ahead tile are replaced gradually by those of the next, and threads
        // may be in different ones.
        let columns = found.demands.iter().take(self.state.threads).map(|&(_, pages)| pages);
        let budget = self.pages.share_bytes() / self.state.page_bytes;
        let needed = match found.demands.is_empty() {
            true if found.nodes_do_not_fit => budget,
            // As long as it is not known what they need.
            true => budget / 2,
            false => columns.sum(),
        };
        let spare = budget.saturating_sub(needed);
        self.state.spare_pages.store(spare, Ordering::Relaxed);
        spare
    }

    /// Gives up the pages whose squares have passed once rays are at `here`, one square late
    /// because other threads may still be there.
    fn retire(&self, found: &mut Found, here: u32) {
        let order = &self.state.order;
        let square = order.begin_of_square(here, found.edge);
        let passed_to = match square.checked_sub(1) {
            Some(before) if self.state.threads > 1 || self.state.policy.stays_a_square_longer() => {
                order.begin_of_square(before, found.edge)
            }
            _ => square,
        };
        let passed = found.pass(passed_to);
        if self.state.policy.holds_pages() {
            let let_go: Vec<PageId> =
                found.to_let_go.drain(..).chain(passed.unused.iter().copied()).collect();
            found.to_let_go = let_go.into_iter().filter(|&page| self.let_go(page)).collect();
        }
        self.by_file(passed.unused, |object, pages| self.pages.retire_unused(object, pages));
        self.by_file(passed.finished, |object, pages| self.pages.retire(object, pages));
    }

    /// The last place whose rays may meet a box.
    pub(super) fn last_visit(&self, bounds: &Aabb) -> u32 {
        let (mut low, mut high) = ((f64::INFINITY, f64::INFINITY), (f64::NEG_INFINITY, f64::NEG_INFINITY));
        for corner in 0..8 {
            let pick = |bit: u32, axis: usize| {
                if corner >> bit & 1 == 0 { bounds.min[axis] } else { bounds.max[axis] }
            };
            let Some((x, y)) = self.rays.project(DVec3::new(pick(0, 0), pick(1, 1), pick(2, 2))) else {
                return self.state.order.len();
            };
            low = (low.0.min(x), low.1.min(y));
            high = (high.0.max(x), high.1.max(y));
        }
        self.state.order.last_place(low, high)
    }

    /// Lists the pages that a tile wants and those that follow it in its square; `None` if pages of
    /// nodes or records were absent, which are then hinted at.
    pub(super) fn look(&self, at: u32, edge: Edge, found: &mut Found) -> Option<Looked> {
        let rays = self.rays_of(&self.state.order.pixels_of_square(at, edge));
        let mut looked = Looked::new(self.state.order.rest_of_square(at, edge));
        let (mut complete, mut gone) = (true, false);
        found.lacking.clear();
        let (world, policy) = (self.world, self.state.policy);
        let (casts_shadows, mut met) = (policy.asks_along_rays() && world.shadows.is_some(), Vec::new());
        let sight = self.rays.sight();
        for (volume, file, expected) in world.foresight.clouds(&world.program) {
            let cloud = &volume.placement;
            let mut want = |node: &Node, needed: Needed| {
                let pages = match needed {
                    Needed::Points => policy.own_pages(cloud, node),
                    Needed::Records(page) => page..page + 1,
                };
                let stay = |page: u32| found.records_to_let_go.contains(&PageId { file, page });
                if !pages.is_empty() && !(matches!(needed, Needed::Records(_)) && stay(pages.start)) {
                    let use_by = self.last_visit(&cloud.bounds_world_of(node));
                    pages.for_each(|page| looked.want(PageId { file, page }, use_by));
                }
            };
            let mut nodes = NodesInMemory::new(self.pages, cloud);
            let mut far = FarAhead::new(self.pages, volume, Some(&sight));
            let local = rays.map(|ray| cloud.local_ray(&ray));
            let mut probes = ProbeRays::new(world.program.simd, &local, Gap::of_lattice(&local));
            if casts_shadows {
                probes.note_met();
            }
            probes.explore(&mut nodes, far.as_mut(), expected, &mut want);
            met.append(&mut probes.take_met());
            let mut absent = nodes.absent;
            absent.extend(far.into_iter().flat_map(|far| far.absent));
            complete &= absent.is_empty();
            gone |= self.hint_once(file, absent, found);
        }
        let gap = Gap::of_lattice(&rays);
        for (grid, file, opaque) in world.foresight.grids(&world.program) {
            let ahead = grid.pages_ahead(self.pages, &rays, |distance| gap.at(distance), opaque);
            complete &= ahead.absent_ranges.is_empty();
            gone |= self.hint_once(file, ahead.absent_ranges, found);
            met.extend(ahead.met);
            for page in ahead.bricks {
                looked.want(PageId { file, page }, self.last_visit(&grid.bounds_world_of(page)));
            }
        }
        found.nodes_do_not_fit = gone;
        if casts_shadows && complete {
            self.look_at_shadows(&rays, met, &mut looked, found);
        }
        complete.then_some(looked)
    }

    /// Lists the pages that shadows are expected to need where probe rays have met something.
    fn look_at_shadows(
        &self,
        rays: &[Ray; LANES],
        mut met: Vec<(usize, f32)>,
        looked: &mut Looked,
        found: &Found,
    ) {
        let Some(shadows) = &self.world.shadows else { return };
        for (lane, ray) in rays.iter().enumerate() {
            met.extend(self.world.program.solids_met(ray).map(|t| (lane, t as f32)));
        }
        let places: Vec<LitPlace> = met
            .into_iter()
            .map(|(lane, t)| {
                let (ray, t) = (&rays[lane], f64::from(t));
                LitPlace { place: ray.at(t), pixel_width: self.rays.footprint(ray).at(t) }
            })
            .collect();
        // Rays from the eye may come to these pages at any time.
        let use_by = self.state.order.len();
        let foresight = &self.world.foresight;
        for RaysToLight { rays, tile, sight } in shadows.rays_ahead(&places, &found.tiles_of_lights) {
            let complete = shadows.foresight.each_page(
                &shadows.program,
                (self.pages, sight.as_ref()),
                &rays,
                1.0,
                |file, page| {
                    if let Some(file) = foresight.number_of(&shadows.foresight, file) {
                        looked.want(PageId { file, page }, use_by);
                    }
                },
            );
            looked.tiles_of_lights.extend(tile.filter(|_| complete));
        }
    }

    /// Hints at pages without which a square cannot be looked at, each once; returns whether any
    /// has gone again since.
    fn hint_once(&self, file: u32, mut absent: Vec<u32>, found: &mut Found) -> bool {
        let Some(object) = self.object(file) else { return false };
        let mut gone = false;
        absent.sort_unstable();
        absent.dedup();
        found.lacking.extend(absent.iter().map(|&page| PageId { file, page }));
        absent.retain(|&page| {
            let fresh = found.nodes_hinted.insert(PageId { file, page });
            gone |= !fresh && object.is_absent(page);
            fresh
        });
        self.pages.hint_knowing(object, &absent, u64::MAX, Some(self.reuse));
        gone
    }

    /// A lattice of rays over some pixels, their edges included.
    fn rays_of(&self, Region { columns, rows }: &Region) -> [Ray; LANES] {
        std::array::from_fn(|lane| {
            let (u, v) = (lane % 8, lane / 8);
            let x = f64::from(columns.start) + f64::from(columns.end - columns.start) * u as f64 / 7.0;
            let y = f64::from(rows.start) + f64::from(rows.end - rows.start) * v as f64 / 7.0;
            self.rays.ray(x, y)
        })
    }
}

//! The live rays of a packet and those of their samples that still matter: which boxes they meet,
//! and where.

use std::cell::OnceCell;

use crate::field::{ChosenRays, Packet, RayColumns, SimdLevel, Slab};
use crate::trace::node_samples::{Live, each_lane};
use rayset_base::geometry::{Aabb, Beam};

/// Rays whose directions differ by more than this along any axis are tested individually.
const MOST_SPREAD: f64 = 0.25;

/// A set of rays of a packet.
struct RaySet {
    lanes: u64,
    beam: Beam,
    /// Whether the rays are tested individually against every box: the set is incomplete or its
    /// directions diverge, and their common bound may contain much that no ray meets.
    apart: bool,
    chosen: ChosenRays,
    /// The shortest and the longest tick of these rays.
    ticks: (f64, f64),
}

impl RaySet {
    fn new(packet: &Packet, lanes: u64) -> Self {
        let beam = packet.beam(lanes);
        let apart = lanes != packet.all() || beam.spread() > MOST_SPREAD;
        Self { lanes, beam, apart, chosen: ChosenRays::new(lanes), ticks: packet.tick_range(lanes) }
    }

    /// The ticks of samples that may lie in a box, or `None` if there are none. `each`: all rays of
    /// the packet, if they are to be tested individually.
    fn ticks_in<'c>(
        &self,
        packet: &Packet,
        bounds: &Aabb,
        each: impl FnOnce() -> &'c RayColumns,
        apart: bool,
    ) -> Option<(u64, u64)> {
        let (first, last) = packet.ticks_in(&self.beam, bounds)?;
        if self.lanes == 0 || !apart && !self.may_pass_between(packet, bounds, first) {
            return Some((first, last));
        }
        let near = each().near(bounds, &self.chosen);
        if near.lanes == 0 {
            return None;
        }
        // A slack of two ticks, as for the beam; what single precision loses is in the margin of
        // the test.
        let (least, most) = self.ticks;
        let (enter, exit) = near.span;
        let enter = f64::from(enter) * (1.0 - 1e-5) / most - 2.0;
        let exit = f64::from(exit) * (1.0 + 1e-5) / least + 2.0;
        let (first, last) = (first.max(enter.max(0.0) as u64), last.min(exit as u64));
        (first <= last).then_some((first, last))
    }

    /// Whether a box that the rays come to at a tick is so small that some of them may miss it.
    fn may_pass_between(&self, packet: &Packet, bounds: &Aabb, tick: u64) -> bool {
        let there = tick as f64 * packet.tick_world();
        bounds.size().max_element() < self.beam.width_at(there)
    }
}

/// The samples of a slab that still matter, if these are not all samples of the live rays.
struct LiveSamples {
    slab: Slab,
    live: Live,
    /// The union over all rays.
    any: u32,
    rays: SomeRays,
}

/// Some rays of a packet, tested individually.
struct SomeRays {
    mask: u64,
    chosen: ChosenRays,
    /// Reciprocals of their longest and shortest tick.
    per_tick: (f32, f32),
}

impl SomeRays {
    fn new(packet: &Packet, mask: u64) -> Self {
        let (least, most) = packet.tick_range(mask);
        let per_tick = ((1.0 / most) as f32, (1.0 / least) as f32);
        Self { mask, chosen: ChosenRays::new(mask), per_tick }
    }
}

impl LiveSamples {
    /// Whether any of these samples may lie in a box. `first` and `last` are the packet's ticks in
    /// the box, and `each` all its rays.
    fn meets(&self, bounds: &Aabb, (first, last): (u64, u64), each: &RayColumns) -> bool {
        let in_slab = self.slab.samples_at(first, last);
        if last < self.slab.first_tick() || self.any & bits_between(in_slab.0, in_slab.1) == 0 {
            return false;
        }
        let near = each.near(bounds, &self.rays.chosen);
        // A power of two, so that products with it are exact.
        let per_step = 2_f32.powi(-(self.slab.level as i32));
        let (slow, fast) = (self.rays.per_tick.0 * per_step, self.rays.per_tick.1 * per_step);
        // A slack of two samples, as for the beam; wherever single precision is used, it is far
        // finer than one sample.
        let first_sample = self.slab.first as f32;
        let mut lanes = near.lanes;
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize;
            lanes &= lanes - 1;
            let enter = near.enter[lane] * (1.0 - 1e-5) * slow - 2.0 - first_sample;
            let exit = near.exit[lane] * (1.0 + 1e-5) * fast + 2.0 - first_sample;
            // Negative numbers become 0 in the cast.
            let bits = if exit < 0.0 { 0 } else { bits_between(enter as u64, exit as u64) };
            if bits & self.live.0[lane] != 0 {
                return true;
            }
        }
        false
    }
}

/// The bits from one to another, both included.
pub(super) fn bits_between(first: u64, last: u64) -> u32 {
    let last = last.min(31) as u32;
    if first > 31 { 0 } else { (u32::MAX >> (31 - last)) & (u32::MAX << first) }
}

/// The live rays of a packet, and those of their samples in the current slab that still matter.
pub(super) struct LiveRays {
    /// All rays of the packet individually, once they have been needed.
    each: OnceCell<RayColumns>,
    going: RaySet,
    now: Option<LiveSamples>,
    simd: SimdLevel,
    /// Whether some of the rays wait: they come to the slab with finer steps.
    some_wait: bool,
}

impl LiveRays {
    /// The ticks of samples of live rays that may lie in a box, or `None` if there are none.
    pub(super) fn ticks_in(&self, packet: &Packet, bounds: &Aabb) -> Option<(u64, u64)> {
        self.going.ticks_in(packet, bounds, || self.each(packet), self.going.apart)
    }

    /// The same, and each ray is tested by itself, whatever the box is.
    pub(super) fn ticks_of_each(&self, packet: &Packet, bounds: &Aabb) -> Option<(u64, u64)> {
        self.going.ticks_in(packet, bounds, || self.each(packet), true)
    }

    fn each(&self, packet: &Packet) -> &RayColumns {
        self.each.get_or_init(|| RayColumns::new(self.simd, packet.rays(packet.all())))
    }

    /// Whether samples of live rays in a slab may lie in a box.
    pub(super) fn reach(&self, packet: &Packet, bounds: &Aabb, slab: Slab) -> bool {
        let ticks = self.ticks_in(packet, bounds);
        ticks.is_some_and(|(first, last)| {
            first < slab.end_tick()
                && last >= slab.first_tick()
                && !self.misses_now(packet, bounds, (first, last))
        })
    }

    /// Whether none of the samples that matter in this slab lies in a box; `range` is the packet's
    /// ticks in the box.
    pub(super) fn misses_now(&self, packet: &Packet, bounds: &Aabb, range: (u64, u64)) -> bool {
        self.now.as_ref().is_some_and(|now| !now.meets(bounds, range, self.each(packet)))
    }

    /// Whether rays have yet to come to what lies in the slab.
    pub(super) fn some_wait(&self) -> bool {
        self.some_wait
    }

    /// All rays of a packet.
    pub(super) fn new(packet: &Packet, simd: SimdLevel) -> Self {
        let going = RaySet::new(packet, packet.all());
        Self { each: OnceCell::new(), going, now: None, simd, some_wait: false }
    }

    /// Replaces the rays by others of the same packet, with those of their samples in a slab that
    /// still matter: of those in `going`. Those in `waiting` have theirs at finer levels.
    pub(super) fn become_rays(
        &mut self,
        packet: &Packet,
        slab: Slab,
        live: &Live,
        (going, waiting): (u64, u64),
    ) {
        self.some_wait = waiting != 0;
        let going = going | waiting;
        if self.going.lanes != going {
            self.going = RaySet::new(packet, going);
        }
        let all = bits_between(0, slab.samples as u64 - 1);
        let mut partial = live.lanes() != going;
        each_lane(going, |lane| partial |= live.0[lane] & all != all);
        let mask = live.lanes();
        if !partial || mask == 0 {
            self.now = None;
            return;
        }
        let known = self.now.take().map(|now| now.rays).filter(|rays| rays.mask == mask);
        let rays = known.unwrap_or_else(|| SomeRays::new(packet, mask));
        let any = live.0.iter().fold(0, |any, lane| any | lane);
        self.now = Some(LiveSamples { slab, live: *live, any, rays });
    }
}

//! The live rays of a packet and those of their samples that still matter: which boxes they meet,
//! and where.

use std::cell::OnceCell;

use crate::field::{LANES, Packet, RayColumns, SimdLevel, Slab};
use crate::trace::node_samples::{Live, each_lane};
use rayset_base::geometry::{Aabb, Beam};

/// Rays whose directions differ by more than this along any axis are tested individually.
const MOST_SPREAD: f64 = 0.25;

/// A set of rays of a packet.
pub(super) struct RaySet {
    lanes: u64,
    beam: Beam,
    /// Whether the rays are tested individually against every box: the set is incomplete or its
    /// directions diverge, and their common bound may contain much that no ray meets.
    apart: bool,
    /// The rays individually, once they have been needed.
    each: OnceCell<RayColumns>,
    /// The shortest and the longest tick of these rays.
    ticks: (f64, f64),
    simd: SimdLevel,
}

impl RaySet {
    fn new(packet: &Packet, lanes: u64, simd: SimdLevel) -> Self {
        let beam = packet.beam(lanes);
        let apart = lanes != packet.all() || beam.spread() > MOST_SPREAD;
        Self { lanes, beam, apart, each: OnceCell::new(), ticks: packet.tick_range(lanes), simd }
    }

    /// The same rays, tested individually.
    fn ray_by_ray(&self) -> Self {
        Self { apart: true, each: self.each.clone(), ..*self }
    }

    /// The ticks of samples that may lie in a box, or `None` if there are none.
    pub(super) fn ticks_in(&self, packet: &Packet, bounds: &Aabb) -> Option<(u64, u64)> {
        let (first, last) = packet.ticks_in(&self.beam, bounds)?;
        if self.lanes == 0 || !self.apart && !self.may_pass_between(packet, bounds, first) {
            return Some((first, last));
        }
        let each = self.each.get_or_init(|| RayColumns::new(self.simd, packet.rays(self.lanes)));
        let crossing = each.cross(bounds, 0.0);
        if crossing.near == 0 {
            return None;
        }
        // A slack of two ticks, as for the beam; what single precision loses is in the margin of
        // the test.
        let (least, most) = self.ticks;
        let (enter, exit) = crossing.span_near;
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
    lanes: Vec<u8>,
    columns: RayColumns,
    /// Reciprocals of their longest and shortest tick.
    per_tick: (f32, f32),
}

impl SomeRays {
    fn new(packet: &Packet, mask: u64, simd: SimdLevel) -> Self {
        let mut lanes = Vec::with_capacity(mask.count_ones() as usize);
        each_lane(mask, |lane| lanes.push(lane as u8));
        let (least, most) = packet.tick_range(mask);
        let per_tick = ((1.0 / most) as f32, (1.0 / least) as f32);
        Self { mask, lanes, columns: RayColumns::new(simd, packet.rays(mask)), per_tick }
    }
}

impl LiveSamples {
    /// Whether any of these samples may lie in a box. `first` and `last` are the packet's ticks in
    /// the box.
    fn meets(&self, bounds: &Aabb, (first, last): (u64, u64)) -> bool {
        let in_slab = self.slab.samples_at(first, last);
        if last < self.slab.first_tick() || self.any & bits_between(in_slab.0, in_slab.1) == 0 {
            return false;
        }
        let crossing = self.rays.columns.cross(bounds, 0.0);
        // A power of two, so that products with it are exact.
        let per_step = 2_f32.powi(-(self.slab.level as i32));
        let (slow, fast) = (self.rays.per_tick.0 * per_step, self.rays.per_tick.1 * per_step);
        // A slack of two samples, as for the beam; wherever single precision is used, it is far
        // finer than one sample.
        let first_sample = self.slab.first as f32;
        let mut near = crossing.near & (u64::MAX >> (LANES - self.rays.lanes.len()));
        while near != 0 {
            let column = near.trailing_zeros() as usize;
            near &= near - 1;
            let enter = crossing.enter_near[column] * (1.0 - 1e-5) * slow - 2.0 - first_sample;
            let exit = crossing.exit_near[column] * (1.0 + 1e-5) * fast + 2.0 - first_sample;
            // Negative numbers become 0 in the cast.
            let bits = if exit < 0.0 { 0 } else { bits_between(enter as u64, exit as u64) };
            if bits & self.live.0[usize::from(self.rays.lanes[column])] != 0 {
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
    going: RaySet,
    now: Option<LiveSamples>,
    /// Whether some of the rays wait: they come to the slab with finer steps.
    some_wait: bool,
}

impl LiveRays {
    /// The ticks of samples of live rays that may lie in a box, or `None` if there are none.
    pub(super) fn ticks_in(&self, packet: &Packet, bounds: &Aabb) -> Option<(u64, u64)> {
        self.going.ticks_in(packet, bounds)
    }

    /// Whether samples of live rays in a slab may lie in a box.
    pub(super) fn reach(&self, packet: &Packet, bounds: &Aabb, slab: Slab) -> bool {
        let ticks = self.ticks_in(packet, bounds);
        ticks.is_some_and(|(first, last)| {
            first < slab.end_tick() && last >= slab.first_tick() && !self.misses_now(bounds, (first, last))
        })
    }

    /// The same rays, tested individually.
    pub(super) fn ray_by_ray(&self) -> RaySet {
        self.going.ray_by_ray()
    }

    /// Whether none of the samples that matter in this slab lies in a box; `range` is the packet's
    /// ticks in the box.
    pub(super) fn misses_now(&self, bounds: &Aabb, range: (u64, u64)) -> bool {
        self.now.as_ref().is_some_and(|now| !now.meets(bounds, range))
    }

    /// Whether rays have yet to come to what lies in the slab.
    pub(super) fn some_wait(&self) -> bool {
        self.some_wait
    }

    /// All rays of a packet.
    pub(super) fn new(packet: &Packet, simd: SimdLevel) -> Self {
        Self { going: RaySet::new(packet, packet.all(), simd), now: None, some_wait: false }
    }

    /// Replaces the rays by others of the same packet, with those of their samples in a slab that
    /// still matter: of those in `going`. Those in `waiting` have theirs at finer levels.
    pub(super) fn become_rays(
        &mut self,
        packet: &Packet,
        slab: Slab,
        live: &Live,
        (going, waiting): (u64, u64),
        simd: SimdLevel,
    ) {
        self.some_wait = waiting != 0;
        let going = going | waiting;
        if self.going.lanes != going {
            self.going = RaySet::new(packet, going, simd);
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
        let rays = known.unwrap_or_else(|| SomeRays::new(packet, mask, simd));
        let any = live.0.iter().fold(0, |any, lane| any | lane);
        self.now = Some(LiveSamples { slab, live: *live, any, rays });
    }
}

//! Rays that change direction: mirrored where a material reflects, refracted (bent) where the
//! refractive index changes.
//!
//! Each pixel has a tree of rays. A ray that reaches another refractive index ends there; a ray in
//! the refracted direction takes its place, and one in the mirrored direction sees what the
//! boundary reflects. Elsewhere samples reflect, and consecutive reflecting samples of a ray do so
//! together: as one ray from their mean position, with the sum of their weights.

use super::composite::RayState;
use super::inside::{Inside, Samples};
use super::node_samples::{Constants, MATERIAL, NodeSamples, REFLECTANCE, REFRACTIVE_INDEX, each_lane};
use crate::field::{LANES, Packet, SLAB_SAMPLES, Slab};
use crate::scene::Footprint;
use rayset_base::geometry::{DVec3, Ray};

/// Samples whose reflection contributes less than this fraction of their pixel's light show their
/// own colour instead.
const LEAST_WEIGHT: f64 = 1.0 / 256.0;
/// A refracted ray of less weight than this is not traced.
const LEAST_PASSED: f64 = 1.0 / 4096.0;

/// The maximum number of rays in one generation of a pixel's tree. Mirrored rays have a weight of
/// at least [`LEAST_WEIGHT`] each and of at most 1 in total; each ray has at most one refracted
/// successor.
pub(super) fn most_rays_of_a_pixel(max_depth: u32) -> usize {
    (1.0 / LEAST_WEIGHT) as usize * (max_depth as usize + 1)
}

/// How the materials of a scene change the direction of rays.
#[derive(Clone, Copy, Debug)]
pub(super) struct ScatterKinds {
    reflects: bool,
    refracts: bool,
}

impl ScatterKinds {
    pub(super) fn of(materials: &[[f32; MATERIAL]]) -> Self {
        Self {
            reflects: materials.iter().any(|m| m[REFLECTANCE] > 0.0),
            refracts: materials.iter().any(|m| m[REFRACTIVE_INDEX] != 1.0),
        }
    }

    pub(super) fn any(self) -> bool {
        self.reflects || self.refracts
    }
}

/// How far reflected and refracted rays are followed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounces {
    pub(super) turns: ScatterKinds,
    pub(super) max_depth: u32,
    /// Samples within this distance or so many steps behind a boundary reflect at the boundary.
    pub(super) reach_world: f64,
    pub(super) boundary_steps: f64,
}

/// A ray in the tree of a pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct TreeRay {
    pub(super) ray: Ray,
    /// Offset of its samples along the ray, in steps.
    pub(super) sample_offset: f64,
    /// The step where it begins; world space. 0 at the eye.
    pub(super) step_world: f64,
    /// The number of its sheet of rays from the eye times 64, and its place there.
    pub(super) pixel: u32,
    /// The width of the pixel along the ray, as if no surface on the way were curved.
    pub(super) footprint: Footprint,
    /// The fraction of its light that reaches the pixel.
    pub(super) weight: f64,
    /// Whether what it meets counts towards the opacity of the pixel: it has at most been
    /// refracted, never mirrored by a material.
    pub(super) covers: bool,
    depth: u32,
    /// Refractive index at its origin.
    index: f32,
    /// Normal of the boundary at its origin.
    normal: DVec3,
}

impl TreeRay {
    /// A primary ray, which starts at the eye.
    pub(super) fn primary(ray: Ray, sample_offset: f64, pixel: u32, footprint: Footprint) -> Self {
        let (step_world, weight, covers, depth) = (0.0, 1.0, true, 0);
        let (index, normal) = (1.0, DVec3::ZERO);
        Self { ray, sample_offset, step_world, pixel, footprint, weight, covers, depth, index, normal }
    }

    /// Whether it starts at the eye.
    pub(super) fn is_primary(&self) -> bool {
        self.depth == 0
    }

    /// The octant of its direction: a bit for each negative component.
    pub(super) fn octant(&self) -> u8 {
        let d = self.ray.direction;
        u8::from(d.x < 0.0) | u8::from(d.y < 0.0) << 1 | u8::from(d.z < 0.0) << 2
    }
}

/// Consecutive samples of a ray that reflect together.
#[derive(Clone, Copy, Debug)]
struct Mirror {
    /// Sums over the samples, each weighted by what it reflects.
    weight: f64,
    place: DVec3,
    normal: DVec3,
    /// Their own colour, used if the reflection is too weak to be traced.
    color: [f32; 3],
    /// Where the sample begins that would be the next, in ticks.
    next_tick: u64,
    /// The step at the last sample; world space.
    step_world: f64,
}

/// The rays that replace a refracted ray. Their weights are set by [`RefractionStates::follow`].
#[derive(Clone, Copy, Debug)]
struct Bent {
    through: TreeRay,
    /// The mirrored ray, and the fraction of the light that the boundary reflects.
    mirrored: Option<(TreeRay, f64)>,
}

/// The state of a ray while it is traced.
#[derive(Clone, Copy, Debug)]
struct RefractionState {
    from: TreeRay,
    index: f32,
    inside: Inside,
    mirror: Option<Mirror>,
    bent: Option<Bent>,
}

/// The reflections and refractions of the rays of a packet while it is traced.
pub(super) struct RefractionStates {
    bounces: Bounces,
    states_of_rays: Vec<RefractionState>,
    /// Lanes of rays that may have successors.
    deepens: u64,
    replaced: u64,
    /// Successor rays, each with the lane of the ray that it comes from.
    next: Vec<(usize, TreeRay)>,
}

impl RefractionStates {
    /// Allocates room for the rays of a packet; call [`begin`](Self::begin) before anything else.
    pub(super) fn new(bounces: Bounces) -> Self {
        let states_of_rays = Vec::with_capacity(LANES);
        Self { bounces, states_of_rays, deepens: 0, replaced: 0, next: Vec::with_capacity(LANES) }
    }

    /// Starts with the rays of a packet, given lane by lane.
    pub(super) fn begin(&mut self, rays: impl Iterator<Item = TreeRay>) {
        self.states_of_rays.clear();
        self.states_of_rays.extend(rays.map(|from| RefractionState {
            from,
            index: from.index,
            inside: Inside {
                t: 0.0,
                normal: from.normal,
                depth: 0.0,
                step_world: from.step_world,
                reflectance: 0.0,
            },
            mirror: None,
            bent: None,
        }));
        let deepens = |c: &RefractionState| c.from.depth < self.bounces.max_depth;
        self.deepens = (self.states_of_rays.iter().enumerate())
            .fold(0, |lanes, (lane, state)| lanes | u64::from(deepens(state)) << lane);
        self.replaced = 0;
        self.next.clear();
    }

    /// Finds the rays of `going` that reach another refractive index in a slab, and makes their
    /// samples transparent from there on; [`follow`](Self::follow) ends them there.
    pub(super) fn bend(
        &mut self,
        packet: &Packet,
        slab: Slab,
        node: &mut NodeSamples,
        going: u64,
        constants: &Constants,
    ) {
        each_lane(self.may_bend(going), |lane| {
            let state = &mut self.states_of_rays[lane];
            let touched = node.touched >> lane & 1 == 1;
            if !touched && state.index == 1.0 {
                return;
            }
            let samples = Samples { packet, slab, node, constants, lane };
            let inside = if touched { samples.inside() } else { 0 };
            let mut left = u32::MAX >> (SLAB_SAMPLES - slab.samples);
            loop {
                // Samples that are not at the ray's refractive index. At all others that stays as
                // it is.
                let outside = if state.index == 1.0 { 0 } else { !inside };
                let changes = (inside & samples.of_other_index(inside, state.index) | outside) & left;
                let passed = inside & left & changes.wrapping_sub(1) & !changes;
                if passed != 0 {
                    state.inside = samples.at(passed.ilog2() as usize);
                }
                if changes == 0 {
                    return;
                }
                let j = changes.trailing_zeros() as usize;
                let is_inside = inside >> j & 1 == 1;
                let here = is_inside.then(|| samples.at(j));
                let index = if is_inside { samples.index(j) } else { 1.0 };
                if state.comes_to(here, index) {
                    if touched {
                        node.opacity[lane].0[j..].fill(0.0);
                    }
                    return;
                }
                left &= u32::MAX.checked_shl(j as u32 + 1).unwrap_or(0);
            }
        });
    }

    /// Takes the rays of `going` that are inside an object out of it, because the samples that
    /// follow are empty. Returns the lanes of the rays that end.
    pub(super) fn leave(&mut self, going: u64, states: &[RayState; LANES]) -> u64 {
        each_lane(self.may_bend(going), |lane| _ = self.states_of_rays[lane].comes_to(None, 1.0));
        self.follow(going, states)
    }

    /// Ends the rays of `going` that are refracted; successors with the light still transmitted
    /// take their place. Returns the lanes of the rays that end.
    pub(super) fn follow(&mut self, going: u64, states: &[RayState; LANES]) -> u64 {
        let mut ended = 0;
        each_lane(self.may_bend(going), |lane| {
            let state = &mut self.states_of_rays[lane];
            let Some(Bent { through, mirrored }) = state.bent.take() else { return };
            ended |= 1 << lane;
            let mut weight = state.from.weight * states[lane].transmittance;
            if let Some((mirrored, part)) = mirrored
                && weight * part >= LEAST_WEIGHT
            {
                self.next.push((lane, TreeRay { weight: weight * part, ..mirrored }));
                weight *= 1.0 - part;
            }
            if weight >= LEAST_PASSED {
                self.next.push((lane, TreeRay { weight, ..through }));
            }
        });
        self.replaced |= ended;
        ended
    }

    /// Lanes of rays that successors have replaced.
    pub(super) fn replaced(&self) -> u64 {
        self.replaced
    }

    fn may_bend(&self, going: u64) -> u64 {
        if self.bounces.turns.refracts { going & self.deepens } else { 0 }
    }

    /// The fraction of a sample's light that comes from the mirrored direction, given the values of
    /// its material. Refracting materials reflect at their boundary only.
    #[inline(always)]
    pub(super) fn reflectance(&self, lane: usize, material: impl Fn(usize) -> f32) -> f32 {
        let reflects = self.bounces.turns.reflects && self.deepens >> lane & 1 == 1;
        if reflects && material(REFRACTIVE_INDEX) == 1.0 { material(REFLECTANCE) } else { 0.0 }
    }

    /// Adds a sample that reflects `weight` of its ray's light and has the given colour of its own.
    /// Returns the light of the preceding samples that reflect together, if they end here and
    /// reflect too little to be traced.
    #[expect(clippy::too_many_arguments, reason = "one sample of one packet, and what it reflects")]
    pub(super) fn reflect(
        &mut self,
        packet: &Packet,
        slab: Slab,
        node: &NodeSamples,
        lane: usize,
        j: usize,
        weight: f32,
        color: [f32; 3],
    ) -> [f32; 3] {
        let sample = slab.first + j as u64;
        let normal = node.normal_at(lane, j);
        let tick = sample << slab.level;
        let goes_on = |m: &Mirror| m.next_tick == tick && m.normal.dot(normal) > 0.0;
        let ended = if self.states_of_rays[lane].mirror.as_ref().is_some_and(goes_on) {
            [0.0; 3]
        } else {
            self.end_mirror(lane)
        };
        // A sample within reach of the boundary reflects at the boundary.
        let depth = -f64::from(node.boundary[lane].0[j]);
        let reach = self.bounces.reach_world.max(self.bounces.boundary_steps * packet.step_world());
        let lift = if depth > 0.0 && depth <= reach { depth } else { 0.0 };
        let none = Mirror {
            weight: 0.0,
            place: DVec3::ZERO,
            normal: DVec3::ZERO,
            color: [0.0; 3],
            next_tick: tick,
            step_world: 0.0,
        };
        let mirror = self.states_of_rays[lane].mirror.get_or_insert(none);
        let part = f64::from(weight);
        mirror.weight += part;
        mirror.place += part * (packet.ray(lane).at(packet.sample_t_world(lane, sample)) + lift * normal);
        mirror.normal += part * normal;
        (mirror.next_tick, mirror.step_world) = (tick + (1 << slab.level), packet.step_world());
        for channel in 0..3 {
            mirror.color[channel] += weight * color[channel];
        }
        ended
    }

    /// Ends the samples of a lane that reflect together: either a mirrored ray starts from them, or
    /// their own colour is returned.
    fn end_mirror(&mut self, lane: usize) -> [f32; 3] {
        let state = &mut self.states_of_rays[lane];
        let Some(mirror) = state.mirror.take() else { return [0.0; 3] };
        let weight = state.from.weight * mirror.weight;
        let Some(normal) = mirror.normal.try_normalize().filter(|_| weight >= LEAST_WEIGHT) else {
            return mirror.color;
        };
        let direction = mirrored(state.from.ray.direction, normal);
        let place = mirror.place / mirror.weight;
        // As for a shadow ray, the first sample is (½ + offset) steps from `place`.
        let step_world = mirror.step_world;
        let ray = Ray { origin: place + direction * (0.5 * step_world), direction };
        let depth = state.from.depth + 1;
        let footprint = state.from.footprint.from(place.distance(state.from.ray.origin));
        let from = TreeRay { footprint, ..state.from };
        self.next.push((
            lane,
            TreeRay { ray, step_world, weight, depth, index: 1.0, normal, covers: false, ..from },
        ));
        [0.0; 3]
    }

    /// Ends the samples that reflect together, on every ray.
    pub(super) fn end_mirrors(&mut self, states: &mut [RayState; LANES]) {
        for (lane, state) in states.iter_mut().enumerate().take(self.states_of_rays.len()) {
            let color = self.end_mirror(lane);
            (0..3).for_each(|channel| state.color[channel] += color[channel]);
        }
    }

    /// The successor rays; those of one lane are in the order in which they arose.
    pub(super) fn next(&self) -> &[(usize, TreeRay)] {
        &self.next
    }
}

impl RefractionState {
    /// Advances to a sample of refractive index `index`, inside an object (`here`) or not. Returns
    /// whether the ray is refracted.
    fn comes_to(&mut self, here: Option<Inside>, index: f32) -> bool {
        let before = self.index;
        let goes_out = here.is_none();
        let at = here.unwrap_or(self.inside);
        if let Some(here) = here {
            self.inside = here;
        }
        if index == before {
            return false;
        }
        let direction = self.from.ray.direction;
        let cosine = at.normal.dot(direction).abs();
        if cosine == 0.0 {
            self.index = index;
            return false;
        }
        // Where the ray crosses the boundary: at most one of its steps from the sample inside.
        let to_boundary = (at.depth / cosine).min(at.step_world);
        let t = if goes_out { at.t + to_boundary } else { (at.t - to_boundary).max(0.0) };
        let toward = |direction, index| {
            let ray = Ray { origin: self.from.ray.at(t), direction };
            let footprint = self.from.footprint.from(t);
            let (depth, step_world) = (self.from.depth + 1, at.step_world);
            TreeRay { ray, step_world, footprint, depth, index, normal: at.normal, ..self.from }
        };
        let back = toward(mirrored(direction, at.normal), before);
        self.bent = Some(match refracted(direction, at.normal, f64::from(before) / f64::from(index)) {
            Some(direction) => {
                let part = f64::from(at.reflectance);
                let mirrored = (part > 0.0).then_some((TreeRay { covers: false, ..back }, part));
                Bent { through: toward(direction, index), mirrored }
            }
            None => Bent { through: back, mirrored: None },
        });
        true
    }
}

fn mirrored(direction: DVec3, normal: DVec3) -> DVec3 {
    (direction - 2.0 * direction.dot(normal) * normal).normalize()
}

/// The direction refracted by Snell's law; the normal may point to either side. `ratio` is the
/// refractive index before the boundary divided by that behind it. `None` for total internal
/// reflection.
fn refracted(direction: DVec3, normal: DVec3, ratio: f64) -> Option<DVec3> {
    let normal = if direction.dot(normal) > 0.0 { -normal } else { normal };
    let cosine = -direction.dot(normal);
    let squared = 1.0 - ratio * ratio * (1.0 - cosine * cosine);
    (squared >= 0.0).then(|| (ratio * direction + (ratio * cosine - squared.sqrt()) * normal).normalize())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn unit() -> impl Strategy<Value = DVec3> {
        (-1.0..1.0, 0.0..std::f64::consts::TAU).prop_map(|(z, a): (f64, f64)| {
            let r = (1.0 - z * z).sqrt();
            DVec3::new(r * a.cos(), r * a.sin(), z)
        })
    }

    proptest! {
        #[test]
        fn bent_rays_obey_snells_law_and_come_back_the_way_they_came(d in unit(), n in unit(), ratio in 0.4..2.5) {
            let sine = d.cross(n).length();
            match refracted(d, n, ratio) {
                Some(bent) => {
                    prop_assert!((bent.cross(n).length() - ratio * sine).abs() < 1e-9);
                    prop_assert!(bent.dot(d.cross(n)).abs() < 1e-9, "out of the plane of incidence");
                    prop_assert!(d.dot(n) * bent.dot(n) >= -1e-9, "to the wrong side");
                    if bent.dot(n).abs() > 1e-6 && d.dot(n).abs() > 1e-6 {
                        let back = refracted(-bent, n, 1.0 / ratio);
                        prop_assert!(back.is_some_and(|back| (back + d).length() < 1e-6));
                    }
                }
                None => prop_assert!(ratio * sine >= 1.0 - 1e-9),
            }
        }

        #[test]
        fn mirrored_rays_leave_at_the_angle_at_which_they_came(d in unit(), n in unit()) {
            let m = mirrored(d, n);
            prop_assert!((m.dot(n) + d.dot(n)).abs() < 1e-12);
            prop_assert!((m.length() - 1.0).abs() < 1e-12);
            prop_assert!((mirrored(m, n) - d).length() < 1e-12);
        }
    }
}

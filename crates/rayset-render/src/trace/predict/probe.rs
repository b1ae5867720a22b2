//! Up to sixty-four probe rays that are traced ahead through node records only, each as far as it
//! is expected to reach.

use std::convert::Infallible;

use super::policy::Expects;
use crate::field::{Crossing, LANES, RayColumns, SimdLevel};
use crate::scene::OpacityRule;
use crate::trace::cloud::{CloudShading, FarAhead, NodePart, NodesInMemory, Opened};
use rayset_base::geometry::{Aabb, Beam, DVec3, Ray};
use rayset_base::nearest_first::NearestFirst;
use rayset_files::octree::layout::RootCell;
use rayset_files::octree::node::Node;
use rayset_files::octree::walk::{NodePages, Visit, Visitor, Walk};

/// How far from each other rays are of which only some are probed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Gap {
    /// Half the distance between diagonal neighbours at distance 0.
    at_start: f64,
    /// Its increase per unit of distance.
    growth: f64,
    /// Whether the rays are an 8 × 8 lattice, row by row, over others between them.
    is_lattice: bool,
}

impl Gap {
    /// That of rays between which there are none.
    pub(super) const NONE: Self = Self { at_start: 0.0, growth: 0.0, is_lattice: false };

    /// That of an 8 × 8 lattice of rays, row by row.
    pub(super) fn of_lattice(rays: &[Ray; LANES]) -> Self {
        let half_gap = |v: fn(&Ray) -> DVec3| 0.5 * v(&rays[0]).distance(v(&rays[9]));
        Self { at_start: half_gap(|r| r.origin), growth: half_gap(|r| r.direction), is_lattice: true }
    }

    /// The gap at a distance.
    pub(super) fn at(self, distance: f64) -> f64 {
        self.at_start + self.growth * distance
    }
}

/// Rays that are probed, in the space of one cloud. The length of a direction is that of a unit of
/// world space, so that distances are in world space.
pub(super) struct ProbeRays {
    rays: RayColumns,
    beam: Beam,
    gap: Gap,
    /// Distance at which each ray is expected to end.
    ends: [f32; LANES],
    /// Distance at which the rays around each, up to the next ones of the lattice, are expected to
    /// have ended.
    all_end: [f32; LANES],
    /// A factor on the optical depth with which rays are expected to have ended.
    reach: f32,
    /// Expected optical depth that each ray has accumulated.
    optical_depth: [f32; LANES],
    /// Where rays have gone through boxes of points: the ray, and the distance of the middle.
    /// `None` if that is of no interest.
    met: Option<Vec<(usize, f32)>>,
}

/// Most places at which it is noted that rays meet something.
const MOST_MET: usize = 4096;

impl ProbeRays {
    /// Takes at most 64 rays.
    ///
    /// Panics if there are none.
    pub(super) fn new(simd: SimdLevel, rays: &[Ray], gap: Gap) -> Self {
        let mut beam = Beam::EMPTY;
        rays.iter().for_each(|ray| beam.include(ray));
        Self {
            rays: RayColumns::new(simd, rays.iter().copied()),
            beam,
            gap,
            ends: [f32::INFINITY; LANES],
            all_end: [f32::INFINITY; LANES],
            reach: 1.0,
            optical_depth: [0.0; LANES],
            met: None,
        }
    }

    /// Lets them go on until so many times the optical depth with which they are expected to have
    /// ended.
    pub(super) fn reaching(mut self, reach: f32) -> Self {
        self.reach = reach;
        self
    }

    /// Notes from now on where rays go through boxes of points.
    pub(super) fn note_met(&mut self) {
        self.met = Some(Vec::new());
    }

    /// Where rays have gone through boxes of points, if that was noted: each ray, and the distance
    /// of the middle.
    pub(super) fn take_met(&mut self) -> Vec<(usize, f32)> {
        self.met.take().unwrap_or_default()
    }

    /// Distance at which the rays first meet a box, if any does.
    fn first_meeting(&self, bounds: &Aabb) -> Option<f64> {
        self.beam.span(bounds).map(|(enter, _)| enter)
    }

    /// Tests the rays against a box that they first meet at `distance`. Near are those from which
    /// rays within half the gap may meet the box. Rays that are expected to end before it are left
    /// out.
    fn cross(&self, bounds: &Aabb, distance: f64) -> Crossing {
        let mut crossing = self.rays.cross(bounds, self.gap.at(distance));
        let mut before_their_ends = 0;
        for lane in 0..LANES {
            before_their_ends |= u64::from(crossing.enter_near[lane] < self.all_end[lane]) << lane;
        }
        crossing.near &= before_their_ends;
        crossing.through &= before_their_ends;
        crossing
    }

    /// Advances rays through a box of points; those that are then expected to be opaque end behind
    /// it.
    fn absorb(&mut self, crossing: &Crossing, extinction: f64, expected: &Expected) {
        let opaque_optical_depth = expected.opaque_optical_depth * self.reach;
        let (mut lanes, mut ended) = (crossing.through, false);
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize;
            lanes &= lanes - 1;
            if let Some(met) = self.met.as_mut().filter(|met| met.len() < MOST_MET) {
                met.push((lane, crossing.exit[lane] - 0.5 * crossing.length[lane]));
            }
            self.optical_depth[lane] += extinction as f32 * crossing.length[lane];
            if self.optical_depth[lane] >= opaque_optical_depth {
                self.ends[lane] = self.ends[lane].min(crossing.exit[lane]);
                ended = true;
            }
        }
        if ended {
            self.end_all(expected.careful && self.gap.is_lattice);
        }
    }

    /// Updates where all rays around each have ended. Rays between those of the lattice may pass an
    /// edge that these meet: with `careful`, each goes on as far as any of its neighbours.
    fn end_all(&mut self, careful: bool) {
        if !careful {
            self.all_end = self.ends;
            return;
        }
        for lane in 0..LANES {
            let (column, row) = (lane % 8, lane / 8);
            let columns = column.saturating_sub(1)..=(column + 1).min(7);
            let rows = row.saturating_sub(1)..=(row + 1).min(7);
            let around = rows.flat_map(|row| columns.clone().map(move |column| row * 8 + column));
            self.all_end[lane] = around.map(|other| self.ends[other]).fold(0.0, f32::max);
        }
    }

    /// Calls `want`, nearest first, with what the rays are expected to need, as far as nodes are in
    /// memory, and records if the cloud is seen from afar.
    pub(super) fn explore(
        &mut self,
        nodes: &mut NodesInMemory<'_>,
        far: Option<&mut FarAhead<'_>>,
        expected: &Expected,
        want: &mut dyn FnMut(&Node, Needed),
    ) {
        let root_cell = nodes.header().root_cell();
        let mut exploration = Exploration {
            rays: self,
            far,
            expected,
            root_cell,
            want,
            ahead: NearestFirst::default(),
            distance: 0.0,
            part: None,
        };
        if exploration.far.as_mut().is_some_and(|far| !far.begin()) {
            return;
        }
        let mut walk = Walk::new();
        let Ok(()) = walk.begin(nodes, &mut exploration);
        let Ok(()) = walk.go_on(nodes, &mut exploration);
    }
}

/// What rays that come to a node need besides those of its children.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Needed {
    /// Its own points.
    Points,
    /// A page of records, by its number in the file.
    Records(u32),
}

/// Probe rays on their way through an octree.
struct Exploration<'t, 'a> {
    rays: &'t mut ProbeRays,
    /// If the cloud is seen from afar.
    far: Option<&'t mut FarAhead<'a>>,
    expected: &'t Expected,
    root_cell: RootCell,
    /// Called for what rays are expected to need.
    want: &'t mut dyn FnMut(&Node, Needed),
    /// Nodes ahead of the rays, by the distance at which they meet them, with the part that is seen
    /// of each, if that is not every point.
    ahead: NearestFirst<f64, (Node, Option<NodePart>)>,
    /// Distance at which the rays meet the node that is visited.
    distance: f64,
    /// The part that is seen of it.
    part: Option<NodePart>,
}

impl Exploration<'_, '_> {
    /// Bounds of influence of a node.
    fn bounds(&self, node: &Node) -> Aabb {
        self.far.as_ref().map_or_else(|| node.bounds(self.root_cell), |far| far.bounds(node))
    }
}

impl Visitor<NodesInMemory<'_>> for Exploration<'_, '_> {
    fn meet(&mut self, node: Node) {
        let part = self.far.as_mut().and_then(|far| far.meet(&node));
        if let Some(distance) = self.rays.first_meeting(&self.bounds(&node)) {
            self.ahead.push(distance, (node, part));
        }
    }

    fn next(&mut self) -> Option<Node> {
        let (distance, (node, part)) = self.ahead.pop()?;
        (self.distance, self.part) = (distance, part);
        Some(node)
    }

    fn visit(&mut self, node: &Node, _: &mut Walk, _: &mut NodesInMemory<'_>) -> Result<Visit, Infallible> {
        let bounds = self.bounds(node);
        let crossing = self.rays.cross(&bounds, self.distance);
        if crossing.near == 0 {
            return Ok(Visit::Skip);
        }
        let (part, all) = (self.part, Opened { points: true, children: true });
        let opened = self.far.as_mut().map_or(all, |far| far.open(node, part));
        if opened.points {
            (self.want)(node, Needed::Points);
        }
        for page in self.far.as_mut().map(|far| far.take_touched()).unwrap_or_default() {
            (self.want)(node, Needed::Records(page));
        }
        if node.child_mask == 0 || !opened.children {
            self.rays.absorb(&crossing, self.expected.extinction(node, &bounds), self.expected);
        }
        Ok(if opened.children { Visit::Open } else { Visit::Skip })
    }
}

/// The expected effect of a cloud's nodes on light, from their records only.
pub(super) struct Expected {
    transfer: OpacityRule,
    unit_distance: f64,
    /// ∫ω dV of a point of radius one.
    point_integral: f64,
    normalised: bool,
    /// Optical depth behind which nothing is expected to be visible.
    opaque_optical_depth: f32,
    /// Whether a page that has to be waited for costs far more than one that is read in vain.
    careful: bool,
}

impl Expected {
    /// The effect with a safety factor on the optical depth: densities vary, and a page that is
    /// read in vain costs less than one that has to be waited for, the more so if it is remote.
    pub(super) fn new(shading: &CloudShading, stop_transmittance: f32, expects: Expects) -> Self {
        Self {
            transfer: shading.opacity.clone(),
            unit_distance: shading.unit_distance,
            point_integral: shading.kernel.integral(),
            normalised: shading.normalised,
            opaque_optical_depth: -stop_transmittance.ln() * expects.margin,
            careful: expects.careful,
        }
    }

    /// Extinction, per unit of world space, of the mean density of all points below a node,
    /// averaged over their bounds of influence.
    fn extinction(&self, node: &Node, bounds: &Aabb) -> f64 {
        let radius = (f64::from(node.detail_min) * f64::from(node.detail_max)).sqrt();
        let point = if self.normalised { 1.0 } else { self.point_integral * radius.powi(3) };
        let density = node.weight_sum * point / bounds.size().element_product();
        self.transfer.extinction(density, self.unit_distance)
    }
}

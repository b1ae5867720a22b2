//! Sixty-four rays sent ahead of the rest, through node records alone, each as far as it is expected to go.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use crate::field::{Crossing, LANES, RayColumns, SimdLevel};
use crate::geometry::{Aabb, Beam, DVec3, Ray};
use crate::octree::node::Node;
use crate::scene::OpacityRule;
use crate::trace::cloud::CloudShading;

/// Rays on a lattice over a block of the picture, as one cloud sees them: directions have the length that a unit of the
/// world has there, so that distances are the world's.
pub(super) struct ProbeRays {
    rays: RayColumns,
    beam: Beam,
    /// Half the gap between neighbouring rays, at distance 0 and what a unit of distance adds to it.
    gap: (f64, f64),
    /// Distance at which each ray is expected to have ended.
    ends: [f32; LANES],
    /// Optical depth that each ray is expected to have passed.
    optical_depth: [f32; LANES],
}

impl ProbeRays {
    /// Rays of an 8 × 8 lattice, row by row.
    pub(super) fn new(simd: SimdLevel, rays: &[Ray; LANES]) -> Self {
        let mut beam = Beam::EMPTY;
        rays.iter().for_each(|ray| beam.include(ray));
        let half_gap = |v: fn(&Ray) -> DVec3| 0.5 * v(&rays[0]).distance(v(&rays[9]));
        Self {
            rays: RayColumns::new(simd, rays.iter().copied()),
            beam,
            gap: (half_gap(|r| r.origin), half_gap(|r| r.direction)),
            ends: [f32::INFINITY; LANES],
            optical_depth: [0.0; LANES],
        }
    }

    /// Distance at which the rays first meet a box, if they do.
    fn first_meeting(&self, bounds: &Aabb) -> Option<f64> {
        self.beam.span(bounds).map(|(enter, _)| enter)
    }

    /// What the rays make of a box that they first meet at a distance: near are those beside which, within half a gap,
    /// there may be rays that meet it. Only rays that have not ended before it count.
    fn cross(&self, bounds: &Aabb, distance: f64) -> Crossing {
        let mut crossing = self.rays.cross(bounds, self.gap.0 + self.gap.1 * distance);
        let mut before_their_ends = 0;
        for lane in 0..LANES {
            before_their_ends |= u64::from(crossing.enter_near[lane] < self.ends[lane]) << lane;
        }
        crossing.near &= before_their_ends;
        crossing.through &= before_their_ends;
        crossing
    }

    /// Lets rays pass through a box of points; those that are expected to be opaque then end behind it.
    fn absorb(&mut self, crossing: &Crossing, extinction: f64, opaque_optical_depth: f32) {
        let mut lanes = crossing.through;
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize;
            lanes &= lanes - 1;
            self.optical_depth[lane] += extinction as f32 * crossing.length[lane];
            if self.optical_depth[lane] >= opaque_optical_depth {
                self.ends[lane] = self.ends[lane].min(crossing.exit[lane]);
            }
        }
    }

    /// Wants, nearest first, the nodes that the rays are expected to reach.
    pub(super) fn explore(&mut self, root: Node, expected: &Expected, terrain: &mut impl OctreeView) {
        let mut heap = BinaryHeap::new();
        let mut found = vec![root];
        loop {
            for node in found.drain(..) {
                let meeting = self.first_meeting(&terrain.bounds(&node));
                heap.extend(meeting.map(|distance| Ahead { distance, node }));
            }
            let Some(Ahead { distance, node }) = heap.pop() else { return };
            let bounds = terrain.bounds(&node);
            let crossing = self.cross(&bounds, distance);
            if crossing.near == 0 {
                continue;
            }
            terrain.want(&node);
            if node.child_mask == 0 {
                self.absorb(&crossing, expected.extinction(&node, &bounds), expected.opaque_optical_depth);
            } else {
                terrain.children(&node, &mut found);
            }
        }
    }
}

/// What scouts travel through.
pub(super) trait OctreeView {
    /// Bounds of influence of all below a node.
    fn bounds(&self, node: &Node) -> Aabb;

    /// The children of a node, as far as they are in memory.
    fn children(&mut self, node: &Node, found: &mut Vec<Node>);

    /// A node that rays are expected to reach.
    fn want(&mut self, node: &Node);
}

/// A node ahead of the rays.
struct Ahead {
    distance: f64,
    node: Node,
}

impl PartialEq for Ahead {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}
impl Eq for Ahead {}
impl PartialOrd for Ahead {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Ahead {
    /// Nearer is greater.
    fn cmp(&self, other: &Self) -> Ordering {
        other.distance.total_cmp(&self.distance)
    }
}

/// What nodes of a cloud are expected to do to light, from their records alone.
pub(super) struct Expected {
    transfer: OpacityRule,
    unit_distance: f64,
    /// ∫ω dV of a point of radius one.
    point_integral: f64,
    normalised: bool,
    /// Optical depth behind which nothing is expected to be seen.
    opaque_optical_depth: f32,
}

impl Expected {
    pub(super) fn new(shading: &CloudShading, stop_transmittance: f32) -> Self {
        /// How much more than enough is taken for enough: densities are uneven, and a page read in vain costs less
        /// than one that is waited for.
        const MARGIN: f32 = 1.2;
        Self {
            transfer: shading.opacity.clone(),
            unit_distance: shading.unit_distance,
            point_integral: shading.kernel.integral(),
            normalised: shading.normalised,
            opaque_optical_depth: -stop_transmittance.ln() * MARGIN,
        }
    }

    /// Extinction in world units of the mean density of all points below a node, within their bounds of influence.
    fn extinction(&self, node: &Node, bounds: &Aabb) -> f64 {
        let radius = (f64::from(node.radius_min) * f64::from(node.radius_max)).sqrt();
        let point = if self.normalised { 1.0 } else { self.point_integral * radius.powi(3) };
        let density = node.weight_sum * point / bounds.size().element_product();
        self.transfer.extinction(density, self.unit_distance)
    }
}

//! Where samples are lit, and in which direction their lights are.

use crate::field::{LANES, Packet, Slab};
use crate::scene::{Footprint, Light, LightKind};
use crate::trace::node_samples::NodeSamples;
use rayset_base::geometry::DVec3;

/// −ln(1 − [`SOLID_OPACITY`](crate::scene::SOLID_OPACITY)).
const SOLID_OPTICAL_DEPTH: f32 = 6.907_755;

/// The samples of a slab, by lane and number.
#[derive(Clone, Copy)]
pub(super) struct SlabToLight<'s> {
    pub(super) packet: &'s Packet,
    pub(super) slab: Slab,
    pub(super) node: &'s NodeSamples,
    /// How wide the pixels of the rays are.
    pub(super) footprints: &'s [Footprint; LANES],
    pub(super) reach: BoundaryReach,
}

/// How far behind a boundary samples are lit at it.
#[derive(Clone, Copy)]
pub(super) struct BoundaryReach {
    /// In steps.
    pub(super) steps: f64,
    /// In solids, at least this; world space. Light goes about an eighth of a unit distance
    /// into them, however fine their steps are, and they must not shadow themselves.
    pub(super) solid_world: f64,
}

impl SlabToLight<'_> {
    /// The distance of a sample along its ray.
    #[inline(always)]
    fn t_world(&self, (lane, j): (usize, usize)) -> f64 {
        self.packet.sample_t_world(lane, self.slab.first + j as u64)
    }

    /// How wide the pixel of a sample is there; world space.
    #[inline(always)]
    pub(super) fn pixel_width(&self, (lane, j): (usize, usize)) -> f64 {
        self.footprints[lane].at(self.t_world((lane, j)))
    }

    /// How far behind a boundary a sample is lit at it; world space.
    #[inline(always)]
    pub(super) fn reach_world(&self, (lane, j): (usize, usize)) -> f64 {
        let reach = self.reach.steps * self.packet.step_world();
        let is_solid = self.node.opacity[lane].0[j] >= SOLID_OPTICAL_DEPTH;
        if is_solid { reach.max(self.reach.solid_world) } else { reach }
    }

    /// The position at which a sample is lit: on the boundary if that reaches it, otherwise its
    /// own.
    #[inline(always)]
    pub(super) fn place(&self, (lane, j): (usize, usize)) -> DVec3 {
        let place = self.packet.ray(lane).at(self.t_world((lane, j)));
        let depth = -f64::from(self.node.boundary[lane].0[j]);
        if !(depth > 0.0 && depth <= self.reach_world((lane, j))) {
            return place;
        }
        place + self.node.normal_at(lane, j) * depth
    }
}

/// Direction and distance from a position to a light; the distance is infinite for directional
/// lights. `None` for lights without shadow rays, or if the position is that of the light.
pub(super) fn toward(light: &Light, place: DVec3) -> Option<(DVec3, f64)> {
    match light.kind {
        LightKind::Directional { direction } => Some((-direction.normalize(), f64::INFINITY)),
        LightKind::Point { position, .. } => {
            let toward = position - place;
            Some((toward.try_normalize()?, toward.length()))
        }
        LightKind::Ambient | LightKind::Headlight => None,
    }
}

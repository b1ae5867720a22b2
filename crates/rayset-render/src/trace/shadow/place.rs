//! Where samples are lit, and in which direction their lights are.

use crate::field::Packet;
use crate::scene::{Light, LightKind};
use crate::trace::node_samples::NodeSamples;
use rayset_base::geometry::DVec3;

/// The position at which a sample is lit: on the boundary if it is at most `reach_world` behind
/// one, otherwise its own.
#[inline(always)]
pub(super) fn lit_place(
    packet: &Packet,
    node: &NodeSamples,
    (lane, j): (usize, usize),
    sample: u64,
    reach_world: f64,
) -> DVec3 {
    let place = packet.ray(lane).at(packet.sample_t_world(lane, sample));
    let depth = -f64::from(node.boundary[lane].0[j]);
    if !(depth > 0.0 && depth <= reach_world) {
        return place;
    }
    place + node.normal_at(lane, j) * depth
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

//! The rays that shadows will need at places that rays from the eye have not come to yet.

use std::collections::HashSet;

use super::place::toward;
use super::sights::Octave;
use super::world::{LightWithShadows, ShadowWorld};
use crate::field::{LANES, Sight};
use rayset_base::geometry::{DVec3, Ray};

/// A place that will be lit, and how wide its pixel is there; world space.
#[derive(Clone, Copy, Debug)]
pub(in crate::trace) struct LitPlace {
    pub(in crate::trace) place: DVec3,
    pub(in crate::trace) pixel_width: f64,
}

/// A tile of the table of a light, by the number of the light.
pub(in crate::trace) type TileOfLight = (u32, u32);

/// Rays that are expected to be traced for shadows, at most 64.
pub(in crate::trace) struct RaysToLight {
    pub(in crate::trace) rays: Vec<Ray>,
    /// The tile that they make, if they make one.
    pub(in crate::trace) tile: Option<TileOfLight>,
    /// How they see what is far.
    pub(in crate::trace) sight: Option<Sight>,
}

impl ShadowWorld {
    /// The rays that shadows at some places are expected to need: those of tiles that have not been
    /// made and are not `known`, or, of lights without a table, rays from the places, or from some
    /// of them if they are many.
    pub(in crate::trace) fn rays_ahead(
        &self,
        places: &[LitPlace],
        known: &HashSet<TileOfLight>,
    ) -> Vec<RaysToLight> {
        /// Rays of neighbouring places go through the same pages.
        const MOST_PLACES: usize = 4 * LANES;
        let (mut packets, mut fresh) = (Vec::new(), HashSet::new());
        for (number, light) in (0..).zip(&self.lights) {
            let Some(LightWithShadows { light, table, .. }) = light else { continue };
            let Some(table) = table else {
                let some = places.iter().step_by(places.len().div_ceil(MOST_PLACES).max(1));
                let rays = some.filter_map(|lit| {
                    let (direction, _) = toward(light, lit.place)?;
                    Some((self.octaves.of(lit.pixel_width), Ray { origin: lit.place, direction }))
                });
                let mut rays: Vec<(Octave, Ray)> = rays.collect();
                rays.sort_by_key(|(octave, _)| *octave);
                for some in rays.chunk_by(|a, b| a.0 == b.0).flat_map(|alike| alike.chunks(LANES)) {
                    let sight = self.octaves.sight(some[0].0, light).map(|(sight, _)| sight);
                    let rays = some.iter().map(|(_, ray)| *ray).collect();
                    packets.push(RaysToLight { rays, tile: None, sight });
                }
                continue;
            };
            for lit in places {
                let Some(texel) = table.map.texel(lit.place, lit.pixel_width) else { continue };
                let tile = (number, texel.tile);
                if !known.contains(&tile) && fresh.insert(tile) && !table.tiles.is_resident(texel.tile) {
                    let rays = table.map.rays(texel.tile);
                    let sight = table.sight(texel.tile).map(|of_tile| of_tile.sight);
                    let of_tile = rays.chunks(LANES).map(|rays| RaysToLight {
                        rays: rays.to_vec(),
                        tile: Some(tile),
                        sight,
                    });
                    packets.extend(of_tile);
                }
            }
        }
        packets
    }
}

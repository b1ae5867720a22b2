//! A cloud as it is seen from afar: whether it can be, and how far what is seen of it reaches.

use crate::field::{AttributeColumns, FarDecoder, Kernel, Sight};
use crate::lod::CrossSections;
use crate::scene::{CloudObject, ColorRule, Lod, MapInput, Scene, largest_stretch};
use crate::trace::node_samples::RequiredOutputs;
use rayset_base::geometry::{Aabb, DAffine3, DMat3};
use rayset_files::octree::aggregates::{AggregateHeader, CellPlace};

/// How far a Gaussian with the variance of what is in a box may reach beyond the box, in widths of
/// the box: of a spread that ends at 3.28 deviations.
const BEYOND: f64 = 1.22;
/// How far a Gaussian reaches from its middle, in deviations.
const DEVIATIONS: f64 = 3.28;
/// How much farther each reaches because it is as wide as a pixel, in pixels.
const OF_PIXEL: f64 = 1.3;
/// The longest edge of cells that are seen in place of their points, in pixels: of those that are
/// not divided.
const WIDEST_CELL: f64 = 2.0;

/// What is needed to see a cloud from afar.
pub(in crate::trace) struct CloudLod {
    /// How wide pixels are taken to be, in pixels.
    factor: f64,
    /// How much farther than itself what is seen reaches, in pixels as wide as they are taken to
    /// be.
    beyond: f64,
    pub(super) aggregates: AggregateHeader,
    pub(super) decoder: FarDecoder,
    /// Length in local space of a unit of world space.
    pub(super) stretch: f64,
}

impl CloudLod {
    /// `None` if every point of the object is seen.
    pub(super) fn new(
        object: &CloudObject,
        world_from_local: &DAffine3,
        scene: &Scene,
        lod: Lod,
    ) -> Option<Self> {
        let (factor, spread) = lod.pixels()?;
        if why_whole(object, world_from_local).is_some() {
            return None;
        }
        let aggregates = object.cloud.header().aggregates.clone()?;
        let stretch = 1.0 / largest_stretch(world_from_local);
        let opacity = &object.transfer.opacity;
        let g = |density: f64| opacity.extinction(density, scene.unit_distance) / stretch;
        let sections = CrossSections::new((object.kernel.integral(), object.kernel.variance()), g);
        let decoder = match &object.transfer.color {
            ColorRule::Map { map, input: MapInput::Density } => {
                let color = |density: f64| map.color(density).map(|v| v as f32);
                FarDecoder::new(sections.with_colors(g, color), spread, true)
            }
            _ => FarDecoder::new(sections, spread, false),
        };
        let beyond = OF_PIXEL * spread;
        Some(Self { factor, beyond, aggregates, decoder, stretch })
    }

    /// Sets which attributes fields carry, and what else the required outputs need.
    pub(super) fn carry(&mut self, columns: &AttributeColumns, required: &RequiredOutputs) {
        self.decoder.carry(columns, required.normal, required.color);
    }

    /// Bytes that it takes besides itself.
    pub(super) fn bytes(&self) -> usize {
        self.decoder.bytes()
    }

    /// With pixels as wide as they are taken to be.
    pub(in crate::trace) fn sight(&self, sight: &Sight) -> Sight {
        Sight { pixel: sight.pixel * self.factor, ..*sight }
    }

    /// How far what is seen of points in a box may reach beyond it, with points of radii up to one.
    pub(in crate::trace) fn reach_in(&self, bounds: &Aabb, sight: &Sight, radius_max: f64) -> f64 {
        let pixel = sight.largest_pixel_in(bounds);
        let cell = WIDEST_CELL * pixel;
        let width = bounds.size().max_element().min(cell + cell.min(2.0 * radius_max));
        BEYOND * width + self.beyond * pixel
    }

    /// How far points in a box that are seen by themselves reach beyond what they reach as
    /// densities.
    pub(super) fn reach_of_points(&self, bounds: &Aabb, sight: &Sight) -> f64 {
        self.beyond * sight.largest_pixel_in(bounds)
    }

    /// Where what stands for a cell reaches.
    pub(super) fn around(&self, cell: &CellPlace, sight: &Sight) -> Aabb {
        let reach = DEVIATIONS * cell.deviation + self.beyond * sight.pixel_at(cell.centroid);
        Aabb::new(cell.centroid, cell.centroid).inflated(reach)
    }
}

/// Why every point of an object is seen, whatever is asked for.
pub(super) fn why_whole(object: &CloudObject, world_from_local: &DAffine3) -> Option<&'static str> {
    let header = object.cloud.header();
    if object.kernel == Kernel::Splat {
        return Some("it is of splats");
    }
    let Some(aggregates) = &header.aggregates else {
        return Some("its file has no aggregates (rayset lod adds them)");
    };
    if aggregates.kernel != object.kernel || aggregates.normalised != object.normalised {
        return Some(
            "its aggregates are of another kernel, or not normalised alike (rayset lod --kernel, --normalised)",
        );
    }
    if header.radius_scale != 1.0 || header.weight.min() < 0.0 {
        return Some("its radii are scaled, or some weights are negative");
    }
    (!keeps_angles(world_from_local)).then_some("it is stretched")
}

/// Whether a map is a rotation with the same scale in all directions.
fn keeps_angles(map: &DAffine3) -> bool {
    let product = map.matrix3.transpose() * map.matrix3;
    let scale = product.x_axis.x;
    let off =
        (product - DMat3::IDENTITY * scale).to_cols_array().into_iter().fold(0.0, |a: f64, v| a.max(v.abs()));
    off <= 1e-6 * scale
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayset_base::geometry::{DQuat, DVec3};

    #[test]
    fn turns_and_scales_keep_angles_and_stretches_do_not() {
        let turn = DQuat::from_rotation_x(0.7);
        let of = |scale: DVec3| DAffine3::from_scale_rotation_translation(scale, turn, DVec3::ONE);
        assert!(keeps_angles(&DAffine3::IDENTITY) && keeps_angles(&of(DVec3::splat(1e-3))));
        assert!(!keeps_angles(&of(DVec3::new(1.0, 1.0, 1.001))));
    }
}

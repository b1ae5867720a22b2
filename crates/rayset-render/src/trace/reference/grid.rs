//! Grids by the formulas: trilinear values and central differences, or the labels that weigh most,
//! in `f64`.

use super::sample::{NOTHING, Sample};
use super::{ReferenceRenderer, SeenNode, maps, surface};
use crate::scene::{ColorRule, GRID_ATTRIBUTE, GridObject};
use rayset_base::geometry::DVec3;
use rayset_files::grid::GridHeader;

/// The voxels of a grid, repeated beyond it.
struct Voxels<'a> {
    header: &'a GridHeader,
    stored: &'a [f32],
}

impl Voxels<'_> {
    fn value(&self, place: DVec3) -> f64 {
        let place = place.clamp(DVec3::ZERO, self.header.last_voxel());
        let [width, height, _] = self.header.size;
        let at = (place.z as u64 * height + place.y as u64) * width + place.x as u64;
        self.header.value(f64::from(self.stored[at as usize]))
    }

    /// The corners of the cell of a place, moved by `shift`, each with the trilinear weight that it
    /// has at the place.
    fn corners(&self, p: DVec3, shift: DVec3) -> [(f64, f64); 8] {
        let cell = p.floor().min(self.header.last_voxel() - 1.0);
        std::array::from_fn(|corner| {
            let c = DVec3::new(
                f64::from(corner as u8 & 1),
                f64::from(corner as u8 >> 1 & 1),
                f64::from(corner as u8 >> 2),
            );
            let w = c * (p - cell) + (1.0 - c) * (1.0 - (p - cell));
            (w.x * w.y * w.z, self.value(cell + c + shift))
        })
    }

    /// The trilinear mean of a quantity of values at a place, and half its difference a voxel to
    /// either side.
    fn mean_and_gradient(&self, p: DVec3, quantity: impl Fn(f64) -> f64) -> (f64, DVec3) {
        let mean = |shift| {
            self.corners(p, shift).into_iter().map(|(weight, value)| weight * quantity(value)).sum::<f64>()
        };
        let difference = |axis: DVec3| 0.5 * (mean(axis) - mean(-axis));
        (mean(DVec3::ZERO), DVec3::new(difference(DVec3::X), difference(DVec3::Y), difference(DVec3::Z)))
    }

    /// The label with the most weight at a place, the larger of two with as much.
    fn label(&self, p: DVec3) -> f64 {
        let corners = self.corners(p, DVec3::ZERO);
        let weight = |label: f64| corners.iter().filter(|c| c.1 == label).map(|c| c.0).sum::<f64>();
        let heavier = |a: f64, b: f64| weight(a).total_cmp(&weight(b)).then(a.total_cmp(&b));
        corners.iter().map(|c| c.1).max_by(|a, b| heavier(*a, *b)).unwrap_or(0.0)
    }
}

impl ReferenceRenderer<'_> {
    pub(super) fn sample_grid(
        &self,
        node: &SeenNode<'_>,
        object: &GridObject,
        stored: &[f32],
        q: DVec3,
    ) -> Sample {
        let header = object.grid.header();
        let voxel_from_local = header.space_from_voxel.inverse();
        let p = voxel_from_local.transform_point3(node.local_from_world.transform_point3(q));
        if p.cmplt(DVec3::ZERO).any() || p.cmpgt(header.last_voxel()).any() {
            return Sample { material: node.material.to_array(), ..NOTHING };
        }
        let (unit, voxels) = (self.scene.unit_distance, Voxels { header, stored });
        let opacity_of = |v: f64| object.transfer.opacity.opacity_of_value(v, unit);
        let (v, implicit, gradient) = if object.labels {
            let label = voxels.label(p);
            let least = opacity_of(label);
            let shows = |v: f64| if least > 0.0 { opacity_of(v) >= least } else { opacity_of(v) > 0.0 };
            let (part, gradient) = voxels.mean_and_gradient(p, |v| if shows(v) { 1.0 } else { 0.0 });
            (label, 0.5 - part, -gradient)
        } else {
            let (v, gradient) = voxels.mean_and_gradient(p, |v| v);
            (v, (v - object.boundary_value(unit)) * object.outward(), gradient * object.outward())
        };
        let to_local = voxel_from_local.matrix3.transpose();
        let (normal, boundary) = surface(node, implicit, to_local * gradient);
        let color = match &object.transfer.color {
            ColorRule::Uniform(c) => c.map(f64::from),
            ColorRule::Points => [1.0; 3],
            ColorRule::Map { map, .. } => maps::color(map, v),
        };
        let attributes = self.attributes(|name| (name == GRID_ATTRIBUTE).then_some(v));
        let material = node.material.to_array();
        Sample { opacity: opacity_of(v), color, normal, boundary, material, attributes }
    }
}

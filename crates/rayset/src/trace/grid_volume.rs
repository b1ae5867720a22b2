//! Grids as volume objects in the world: trilinear samples from bricks that are read as rays reach them.

use std::sync::Arc;

use super::access::{Access, Halt};
use super::brick::{Brick, cell_in_brick};
use super::math::ln;
use super::node_samples::{
    Live, MATERIAL, MAX_OPTICAL_DEPTH, Measure, NodeSamples, RequiredOutputs, each_lane, numbers,
};
use super::transfer::ColorTable;
use crate::container::PAGE_HEAD_BYTES;
use crate::field::{LANES, Packet, SLAB_SAMPLES, Slab};
use crate::geometry::{Aabb, DAffine3, DMat3, DVec3, Ray};
use crate::grid::format::{PAGE_BYTES, RANGES_PER_PAGE};
use crate::scene::{ColorRule, GRID_ATTRIBUTE, GridObject, MAX_OPACITY, largest_stretch};
use crate::working_set::{Object, PageGuard, PagedFiles};

enum Color {
    Uniform([f32; 3]),
    Map(ColorTable),
}

/// A grid as the scene graph places it in the world.
pub(super) struct GridVolume {
    object: GridObject,
    pages: Arc<Object>,
    voxel_from_world: DAffine3,
    world_from_voxel: DAffine3,
    /// Transforms gradients from voxel space to world space.
    world_gradient: DMat3,
    bounds_voxel: Aabb,
    color: Color,
    /// The number of the program's attribute that its values provide, if any.
    value_number: Option<usize>,
    unit_distance: f64,
    boundary_value: f64,
    /// −1 if the opacity rises with the value, 1 if it falls: times the gradient of the values, the direction of the
    /// shading vector.
    outward: f64,
    pub(super) material: [f32; MATERIAL],
}

/// A brick that samples are taken from, with the position of its first voxel.
struct Held {
    number: u64,
    /// `None` if all of its values are transparent.
    brick: Option<PageGuard>,
    first: [i64; 3],
}

/// Bits of the index of a sample within a slab of a packet. The number of a brick, shifted left by these, still fits a
/// `u64`, because a file has at most 2³² pages.
const SAMPLE_BITS: u32 = (LANES * SLAB_SAMPLES).trailing_zeros();

impl GridVolume {
    /// `None` if the grid is not open in `paged`.
    pub(super) fn new(
        object: &GridObject,
        world_from_local: &DAffine3,
        unit_distance: f64,
        material: [f32; MATERIAL],
        paged: &PagedFiles,
    ) -> Option<Self> {
        let pages = paged.find_grid(&object.grid)?.clone();
        let world_from_voxel = *world_from_local * object.grid.header().space_from_voxel;
        let voxel_from_world = world_from_voxel.inverse();
        let color = match &object.transfer.color {
            ColorRule::Uniform(color) => Color::Uniform(*color),
            ColorRule::Points => Color::Uniform([1.0; 3]),
            ColorRule::Map { map, .. } => Color::Map(ColorTable::new(map)),
        };
        Some(Self {
            pages,
            voxel_from_world,
            world_from_voxel,
            world_gradient: voxel_from_world.matrix3.transpose(),
            bounds_voxel: Aabb::new(DVec3::ZERO, object.grid.header().last_voxel()),
            color,
            value_number: None,
            unit_distance,
            boundary_value: object.boundary_value(unit_distance),
            outward: object.outward(),
            material,
            object: object.clone(),
        })
    }

    /// Sets the names of the program's attributes.
    pub(super) fn carry(&mut self, names: &[Arc<str>]) {
        self.value_number = names.iter().position(|name| **name == *GRID_ATTRIBUTE);
    }

    pub(super) fn uniform_color(&self) -> Option<[f32; 3]> {
        if let Color::Uniform(color) = self.color { Some(color) } else { None }
    }

    /// The distance between voxels along a ray; world space.
    pub(super) fn spacing_world(&self, ray: &Ray) -> f64 {
        1.0 / self.voxel_from_world.transform_vector3(ray.direction).length()
    }

    /// The largest such distance along any ray.
    pub(super) fn largest_spacing_world(&self) -> f64 {
        largest_stretch(&self.world_from_voxel)
    }

    /// Fills the lanes that meet anything visible.
    #[expect(clippy::too_many_arguments, reason = "one slab of one grid")]
    pub(super) fn sample(
        &self,
        access: Access<'_>,
        packet: &Packet,
        slab: Slab,
        live: &Live,
        measure: Measure,
        required: RequiredOutputs,
        out: &mut NodeSamples,
    ) -> Result<(), Halt> {
        out.touched = 0;
        let lanes = self.lanes_within(packet, slab, live);
        self.fetch(access, packet, slab, live, &lanes)?;
        // Brick by brick, whichever rays pass through them: each brick is retained once, and a small budget need not
        // read it again for every ray. Samples are independent of each other, so their order does not matter.
        let mut samples = Vec::new();
        for (lane, first, end) in lanes {
            for j in (first..end).filter(|j| live.0[lane] >> j & 1 == 1) {
                let (number, _) = self.brick_of(self.place(packet, lane, slab.first + j as u64));
                samples.push(number << SAMPLE_BITS | (lane * SLAB_SAMPLES + j) as u64);
            }
        }
        samples.sort_unstable();
        let mut held = None;
        for sample in samples {
            let sample = (sample & ((1 << SAMPLE_BITS) - 1)) as usize;
            let (lane, j) = (sample / SLAB_SAMPLES, sample % SLAB_SAMPLES);
            let place = self.place(packet, lane, slab.first + j as u64);
            let brick = self.hold(access, place, &mut held)?;
            let Some(page) = &brick.brick else { continue };
            self.fill(page, brick.first, place, lane, j, (measure, required), out);
        }
        Ok(())
    }

    fn place(&self, packet: &Packet, lane: usize, sample: u64) -> DVec3 {
        self.voxel_from_world.transform_point3(packet.ray(lane).at(packet.sample_t_world(lane, sample)))
    }

    /// Lanes that pass through the grid in the slab, each with its first sample and the one after its last.
    fn lanes_within(&self, packet: &Packet, slab: Slab, live: &Live) -> Vec<(usize, usize, usize)> {
        let mut lanes = Vec::new();
        each_lane(live.lanes(), |lane| {
            let world = packet.ray(lane);
            let ray = Ray {
                origin: self.voxel_from_world.transform_point3(world.origin),
                direction: self.voxel_from_world.transform_vector3(world.direction),
            };
            let Some((enter, exit)) = self.bounds_voxel.clip(&ray) else { return };
            let (step, first_t) = (packet.step_world(), packet.sample_t_world(lane, slab.first));
            let number = |t: f64| ((t - first_t) / step).clamp(-1.0, SLAB_SAMPLES as f64);
            // Whether a sample is inside is tested at its own position; this range has at most one sample too many at
            // either end.
            let inside =
                |j: &usize| self.bounds_voxel.contains(self.place(packet, lane, slab.first + *j as u64));
            let range = number(enter).floor().max(0.0) as usize
                ..((number(exit).ceil() + 1.0).max(0.0) as usize).min(slab.samples);
            let (first, last) = (range.clone().find(inside), range.rev().find(inside));
            if let (Some(first), Some(last)) = (first, last) {
                lanes.push((lane, first, last + 1));
            }
        });
        lanes
    }

    /// The number of the brick of a place, and the brick's first voxel.
    fn brick_of(&self, place: DVec3) -> (u64, [i64; 3]) {
        let header = self.object.grid.header();
        let (bricks, cells) = (header.bricks(), header.kind.brick_cells());
        let brick: [u64; 3] = std::array::from_fn(|axis| {
            let cell = (place[axis].max(0.0) as u64).min(header.size[axis] - 2);
            cell / cells
        });
        let number = (brick[2] * bricks[1] + brick[1]) * bricks[0] + brick[0];
        (number, brick.map(|b| (b * cells) as i64 - 1))
    }

    /// Requests all absent bricks of a slab at once, unless the attempt waits for each page.
    fn fetch(
        &self,
        access: Access<'_>,
        packet: &Packet,
        slab: Slab,
        live: &Live,
        lanes: &[(usize, usize, usize)],
    ) -> Result<(), Halt> {
        if access.waits {
            return Ok(());
        }
        let (mut absent, mut last) = (Vec::new(), None);
        for &(lane, first, end) in lanes {
            for j in (first..end).filter(|j| live.0[lane] >> j & 1 == 1) {
                let (number, _) = self.brick_of(self.place(packet, lane, slab.first + j as u64));
                if last == Some(number) {
                    continue;
                }
                last = Some(number);
                let page = number as u32;
                if self.shows(access, number)? && !self.pages.is_resident(page) && !absent.contains(&page) {
                    absent.push(page);
                }
            }
        }
        if absent.len() > 1 {
            access.pages.hint(&self.pages, &absent, u64::MAX);
        }
        Ok(())
    }

    /// Whether any value of a brick is visible.
    fn shows(&self, access: Access<'_>, brick: u64) -> Result<bool, Halt> {
        let header = self.object.grid.header();
        let page = header.brick_pages() + brick / RANGES_PER_PAGE;
        let guard = access.retain_page(&self.pages, page as u32)?;
        let at = PAGE_HEAD_BYTES + (brick % RANGES_PER_PAGE) as usize * 8;
        let number = |at: usize| f32::from_le_bytes([guard[at], guard[at + 1], guard[at + 2], guard[at + 3]]);
        let (a, b) = (header.value(f64::from(number(at))), header.value(f64::from(number(at + 4))));
        Ok(self.object.transfer.opacity.shows_between(a.min(b), a.max(b)))
    }

    fn hold<'h>(
        &self,
        access: Access<'_>,
        place: DVec3,
        held: &'h mut Option<Held>,
    ) -> Result<&'h Held, Halt> {
        let (number, first) = self.brick_of(place);
        let known = held.take().filter(|held| held.number == number);
        let new = match known {
            Some(known) => known,
            None => {
                let shows = self.shows(access, number)?;
                let brick = if shows { Some(access.retain_page(&self.pages, number as u32)?) } else { None };
                Held { number, brick, first }
            }
        };
        Ok(held.insert(new))
    }

    /// Fills one sample.
    #[expect(clippy::too_many_arguments, reason = "one sample of one lane")]
    fn fill(
        &self,
        page: &[u8],
        first: [i64; 3],
        place: DVec3,
        lane: usize,
        j: usize,
        (measure, required): (Measure, RequiredOutputs),
        out: &mut NodeSamples,
    ) {
        let header = self.object.grid.header();
        let brick = Brick { bytes: &page[PAGE_HEAD_BYTES..PAGE_BYTES], kind: header.kind };
        let (cell, within) = cell_in_brick(header, place, first);
        let value = header.value(brick.trilinear(cell, within));
        let opacity = self.object.transfer.opacity.opacity_of_value(value, self.unit_distance) as f32;
        if !(opacity > 0.0) && !required.outside {
            return;
        }
        if out.touched >> lane & 1 == 0 {
            out.clear_lane(lane, required);
            if required.material {
                for (rows, &v) in out.material.iter_mut().zip(&self.material) {
                    rows[lane].0.fill(v);
                }
            }
        }
        out.opacity[lane].0[j] = match measure {
            Measure::Opacity => opacity,
            Measure::OpticalDepth => (-ln(1.0 - opacity.min(MAX_OPACITY as f32))).min(MAX_OPTICAL_DEPTH),
        };
        if required.color {
            let color = match &self.color {
                Color::Uniform(color) => *color,
                Color::Map(table) => table.color(value as f32),
            };
            for (rows, v) in out.color.iter_mut().zip(color) {
                rows[lane].0[j] = v;
            }
        }
        for number in numbers(required.attributes) {
            let own = self.value_number == Some(number);
            out.attributes[number][lane].0[j] = if own { value as f32 } else { 0.0 };
        }
        if required.normal || required.boundary {
            let over_voxels = brick.neighborhood(cell).gradient(within) * header.scale;
            let gradient = self.world_gradient * over_voxels * self.outward;
            let length = gradient.length();
            if required.normal && length > 0.0 {
                for (rows, v) in out.normal.iter_mut().zip((gradient / length).to_array()) {
                    rows[lane].0[j] = v as f32;
                }
            }
            if required.boundary {
                out.boundary[lane].0[j] = ((value - self.boundary_value) * self.outward / length) as f32;
            }
        }
    }
}

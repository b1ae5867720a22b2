//! A grid as the scene graph places it in the world, and its samples in a slab.

use std::sync::Arc;

use super::batch::{Around, Brick};
use super::brick::{BrickSamples, Groups};
use super::field::{Color, GridField, GridMarch, GridRequest};
use super::gradients::Gradients;
use super::opacity::{Opacities, Values};
use super::placement::{Bricks, Placement};
use super::places::Places;
use super::rays::GridRays;
use super::spans::{MetBricks, bricks_met};
use super::visible::{Blocks, KnownBlocks};
use super::voxels::with_voxel;
use crate::field::{LANES, Packet, SLAB_SAMPLES, dispatch};
use crate::scene::{ColorRule, GRID_ATTRIBUTE, GridObject, largest_stretch};
use crate::trace::access::Halt;
use crate::trace::node_samples::{MATERIAL, NodeSamples};
use crate::trace::transfer::ColorTable;
use crate::trace::unopened::Unopened;
use rayset_base::geometry::{Aabb, DAffine3, DVec3, Ray};
use rayset_files::PagedFiles;
use rayset_files::grid::Grid;
use rayset_files::grid::format::{PAGE_BYTES, RANGES_PER_PAGE, VoxelKind};
use rayset_store::container::PAGE_HEAD_BYTES;
use rayset_store::working_set::Object;

/// A grid as the scene graph places it in the world.
pub(in crate::trace) struct GridVolume<P = Arc<Object>> {
    object: GridObject,
    pages: P,
    world_from_voxel: DAffine3,
    field: GridField,
    unit_distance: f64,
}

/// Most bricks of a slab that are looked at before its rays are.
const MOST_BRICKS: u32 = 64;

/// Scratch memory shared by all grids of a thread.
pub(in crate::trace) struct GridScratch {
    met: MetBricks,
    samples: Option<Box<(Places, Groups, Around)>>,
    blocks: KnownBlocks,
}

impl GridScratch {
    /// The most that it takes.
    pub(in crate::trace) const BYTES: usize = KnownBlocks::BYTES
        + size_of::<(Places, Groups, Around)>()
        + 2 * LANES * SLAB_SAMPLES * MetBricks::BYTES_OF_SAMPLE;

    pub(in crate::trace) fn new() -> Self {
        Self { met: MetBricks::new(), samples: None, blocks: KnownBlocks::new() }
    }
}

impl GridVolume<Unopened> {
    pub(in crate::trace) fn new(
        object: &GridObject,
        world_from_local: &DAffine3,
        unit_distance: f64,
        material: [f32; MATERIAL],
    ) -> Self {
        let world_from_voxel = *world_from_local * object.grid.header().space_from_voxel;
        let voxel_from_world = world_from_voxel.inverse();
        let header = object.grid.header();
        let values = Values::new(header, &object.transfer.opacity);
        let color = match &object.transfer.color {
            ColorRule::Uniform(color) => Color::Uniform(*color),
            ColorRule::Points => Color::Uniform([1.0; 3]),
            ColorRule::Map { map, .. } => Color::Map(ColorTable::new(map)),
        };
        let field = GridField {
            placement: Placement {
                voxel_from_world,
                bounds_voxel: Aabb::new(DVec3::ZERO, header.last_voxel()),
                bricks: Bricks::new(header),
            },
            color,
            value_number: None,
            opacities: Opacities::new(&object.transfer.opacity, &values, unit_distance),
            gradients: if object.labels {
                Gradients::of_shown(&voxel_from_world)
            } else {
                let boundary = object.boundary_value(unit_distance);
                Gradients::new(&voxel_from_world, &values, object.outward(), boundary)
            },
            labels: object.labels,
            values,
            material,
        };
        Self { pages: Unopened, world_from_voxel, field, unit_distance, object: object.clone() }
    }

    /// With its pages in a working set; `None` if they are in none.
    pub(in crate::trace) fn open(self, paged: &PagedFiles) -> Option<GridVolume> {
        let Self { object, pages: Unopened, world_from_voxel, field, unit_distance } = self;
        let pages = paged.find_grid(&object.grid)?.clone();
        Some(GridVolume { object, pages, world_from_voxel, field, unit_distance })
    }
}

impl<P> GridVolume<P> {
    /// Sets the names of the program's attributes.
    pub(in crate::trace) fn carry(&mut self, names: &[Arc<str>]) {
        self.field.value_number = names.iter().position(|name| **name == *GRID_ATTRIBUTE);
    }

    pub(in crate::trace) fn material(&self) -> &[f32; MATERIAL] {
        &self.field.material
    }

    pub(in crate::trace) fn uniform_color(&self) -> Option<[f32; 3]> {
        if let Color::Uniform(color) = self.field.color { Some(color) } else { None }
    }

    /// Bytes that it takes.
    pub(in crate::trace) fn bytes(&self) -> usize {
        size_of::<GridVolume>() + self.field.bytes()
    }

    pub(in crate::trace) fn grid(&self) -> &Arc<Grid> {
        &self.object.grid
    }
}

impl GridVolume {
    /// The pages of its file.
    pub(in crate::trace) fn pages(&self) -> &Arc<Object> {
        &self.pages
    }

    pub(super) fn field(&self) -> &GridField {
        &self.field
    }

    /// The length over which opacities hold; world space.
    pub(super) fn unit_distance(&self) -> f64 {
        self.unit_distance
    }

    /// Cells along the edges of a brick.
    pub(super) fn brick_cells(&self) -> DVec3 {
        DVec3::from_array(self.object.grid.header().brick_cells().map(|n| n as f64))
    }

    /// The first page of the ranges of bricks, behind the last brick.
    pub(in crate::trace) fn first_ranges_page(&self) -> u32 {
        self.object.grid.header().brick_pages() as u32
    }

    /// The page that has the range of a brick.
    pub(super) fn ranges_page(&self, brick: u32) -> u32 {
        self.first_ranges_page() + (u64::from(brick) / RANGES_PER_PAGE) as u32
    }

    /// The range of a brick, of the page that has it: the least and the largest number, less the
    /// base.
    pub(super) fn range_of(&self, page: &[u8], brick: u32) -> (f32, f32) {
        let at = PAGE_HEAD_BYTES + (u64::from(brick) % RANGES_PER_PAGE) as usize * 8;
        let number = |at: usize| f32::from_le_bytes([page[at], page[at + 1], page[at + 2], page[at + 3]]);
        (number(at) - self.field.values.base, number(at + 4) - self.field.values.base)
    }

    /// World space.
    pub(in crate::trace) fn bounds_world_of(&self, brick: u32) -> Aabb {
        let bricks = &self.field.placement.bricks;
        let cells = self.brick_cells();
        let corner = DVec3::from_array(bricks.place(brick).map(f64::from)) * cells;
        Aabb::new(corner, corner + cells).transformed(&self.world_from_voxel)
    }

    /// The distance between voxels along a ray; world space.
    pub(in crate::trace) fn spacing_world(&self, ray: &Ray) -> f64 {
        1.0 / self.field.placement.voxel_from_world.transform_vector3(ray.direction).length()
    }

    /// The smallest such distance along any ray.
    pub(in crate::trace) fn least_spacing_world(&self) -> f64 {
        1.0 / largest_stretch(&self.field.placement.voxel_from_world)
    }

    /// The largest such distance along any ray.
    pub(in crate::trace) fn largest_spacing_world(&self) -> f64 {
        largest_stretch(&self.world_from_voxel)
    }

    /// Starts a packet.
    pub(in crate::trace) fn begin(&self, packet: &Packet) -> GridMarch {
        GridMarch(GridRays::new(&self.field.placement, packet))
    }

    /// Fills the lanes that meet anything visible.
    // Not inlined: its rows would be part of the stack of every instruction of every slab.
    #[inline(never)]
    pub(in crate::trace) fn sample(
        &self,
        request: &GridRequest<'_>,
        scratch: &mut GridScratch,
        out: &mut NodeSamples,
    ) -> Result<(), Halt> {
        out.touched = 0;
        let GridRequest { access, march: GridMarch(rays), slab, live, simd, .. } = *request;
        let GridScratch { met, samples, blocks } = scratch;
        let (places, groups, around) =
            &mut **samples.get_or_insert_with(|| Box::new((Places::new(), Groups::new(), Around::new())));
        let kind = self.object.grid.header().kind;
        if !request.required.outside && self.known_empty(request, blocks) {
            return Ok(());
        }
        dispatch!(simd.level(), _simd => met.find(&self.field.placement, rays, slab, live, places));
        self.fetch(request, met, blocks)?;
        let mut seen = [SLAB_SAMPLES; LANES];
        // Brick by brick, whichever rays pass through them: each brick is retained once, and a
        // small budget need not read it again for every ray. Samples are independent of each other,
        // so their order does not matter.
        for brick in met.bricks() {
            if !self.shows(request, brick.number, blocks)? {
                continue;
            }
            let page = access.retain_page(&self.pages, brick.number)?;
            let voxels = &page[PAGE_HEAD_BYTES..PAGE_BYTES];
            let blocks = self.blocks_of(request, brick.number, voxels, blocks);
            let segments = met.segments(brick);
            let brick = Brick { kind, shape: self.field.placement.bricks.shape, voxels };
            let samples = BrickSamples { brick, field: &self.field, request, places, blocks };
            dispatch!(simd.level(), simd => samples.fill(simd, segments, &mut seen, groups, around, out));
        }
        Ok(())
    }

    /// The blocks of a brick that are to be looked at.
    fn blocks_of(
        &self,
        request: &GridRequest<'_>,
        brick: u32,
        voxels: &[u8],
        known: &mut KnownBlocks,
    ) -> Blocks {
        if request.required.outside {
            return Blocks::ALL;
        }
        let key = request.key(brick);
        if let Some(blocks) = known.get(key) {
            return *blocks;
        }
        let blocks = self.find_blocks(request, voxels);
        known.insert(key, blocks);
        blocks
    }

    /// The blocks of a brick that show anything. Not inlined: what it needs of the stack would be
    /// taken for every slab.
    #[inline(never)]
    fn find_blocks(&self, request: &GridRequest<'_>, voxels: &[u8]) -> Blocks {
        let GridField { values, opacities, .. } = &self.field;
        let (header, shape) = (self.object.grid.header(), self.field.placement.bricks.shape);
        with_voxel!(header.kind, V => if header.has_cubes() {
            dispatch!(request.simd.level(), _simd => Blocks::of::<V>(voxels, values, opacities))
        } else {
            Blocks::of_cuboid::<V>(shape, voxels, values, opacities)
        })
    }

    /// Whether all bricks that the samples of a slab lie in are known to show nothing.
    fn known_empty(&self, request: &GridRequest<'_>, blocks: &KnownBlocks) -> bool {
        let GridRequest { march: GridMarch(rays), slab, live, simd, .. } = *request;
        let met = dispatch!(simd.level(), _simd =>
            bricks_met(&self.field.placement, rays, slab, live.lanes()));
        let Some([x, y, z]) = met else { return true };
        let count = [x, y, z].iter().map(|[low, high]| high - low + 1).fold(1, u32::saturating_mul);
        count <= MOST_BRICKS
            && (z[0]..=z[1]).all(|z| {
                (y[0]..=y[1]).all(|y| {
                    (x[0]..=x[1]).all(|x| {
                        let number = self.field.placement.bricks.number([x, y, z]);
                        blocks.get(request.key(number)) == Some(&Blocks::NONE)
                    })
                })
            })
    }

    /// Requests all absent bricks of a slab at once, unless the attempt waits for each page.
    fn fetch(
        &self,
        request: &GridRequest<'_>,
        met: &MetBricks,
        blocks: &mut KnownBlocks,
    ) -> Result<(), Halt> {
        let access = request.access;
        if access.waits {
            return Ok(());
        }
        let mut absent = Vec::new();
        for brick in met.bricks() {
            if self.shows(request, brick.number, blocks)? && !self.pages.is_resident(brick.number) {
                absent.push(brick.number);
            }
        }
        if absent.len() > 1 {
            access.pages.hint(&self.pages, &absent, u64::MAX);
        }
        Ok(())
    }

    /// Whether any sample of a brick is to be looked at.
    fn shows(&self, request: &GridRequest<'_>, brick: u32, known: &mut KnownBlocks) -> Result<bool, Halt> {
        let GridRequest { access, required, .. } = *request;
        let key = request.key(brick);
        if !required.outside
            && let Some(blocks) = known.get(key)
        {
            return Ok(*blocks != Blocks::NONE);
        }
        let guard = access.retain_page(&self.pages, self.ranges_page(brick))?;
        let (low, high) = self.range_of(&guard, brick);
        let shows = self.field.opacities.shows(low, high);
        if !shows {
            known.insert(key, Blocks::NONE);
        }
        Ok(shows)
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use rayset_files::grid::format::GridHeader;

    pub(in crate::trace::grid) fn header(size: [u64; 3], kind: VoxelKind) -> GridHeader {
        GridHeader {
            identity: rayset_store::container::Identity::default(),
            size,
            kind,
            brick_voxels: [kind.brick_voxels() as u64; 3],
            range: (0.0, 1.0),
            scale: 1.0,
            offset: 0.0,
            space_from_voxel: DAffine3::IDENTITY,
            file_bytes: 0,
            sources: Vec::new(),
            up: None,
            facing: None,
            labels: Default::default(),
        }
    }
}

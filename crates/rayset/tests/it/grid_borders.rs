//! Samples in the outermost cells of grids, and on both sides of where bricks meet.

use std::path::Path;
use std::sync::Arc;

use rayset::geometry::DVec3;
use rayset::grid::build::{GridBuildOptions, build};
use rayset::grid::{Grid, VoxelKind};
use rayset::scene::{
    Camera, ColorRule, Compositing, GridObject, Light, LightKind, Lighting, Node, OpacityRule, Projection,
    RenderSettings, Scene, Shape, Step, TransferFunction,
};
use rayset::trace::ExecSettings;
use rayset::trace::reference::{ReferenceRenderer, ReferenceSteps};
use rayset::volumes::RawLayout;

use crate::common::{Random, folder, paged, picture, settings};

/// A grid of random voxels, from 0 to 250.
fn random_grid(folder: &Path, size: [u64; 3], kind: VoxelKind) -> Arc<Grid> {
    let (raw, path) = (folder.join("v.raw"), folder.join("v.rset"));
    let mut random = Random(size[0] * 1_000_003 + size[1] * 1009 + size[2]);
    let voxels = (0..size.iter().product()).flat_map(|_| {
        let value = 250.0 * random.unit();
        match kind {
            VoxelKind::U8 => vec![value as u8],
            VoxelKind::I16 | VoxelKind::U16 => (value as u16).to_le_bytes().to_vec(),
            VoxelKind::F32 => (value as f32).to_le_bytes().to_vec(),
        }
    });
    std::fs::write(&raw, voxels.collect::<Vec<u8>>()).expect("a write");
    let layout: RawLayout =
        format!("{}x{}x{},{}", size[0], size[1], size[2], kind.name()).parse().expect("a layout");
    let source = layout.open(&raw).expect("it opens");
    build(source, &path, &GridBuildOptions::default(), &rayset::build::BuildControl::default())
        .expect("it builds");
    Arc::new(Grid::open(&path).expect("it opens"))
}

/// A grid alone, with an opacity that grows with the value.
fn scene(grid: &Arc<Grid>, lit: bool) -> Scene {
    let opacity = OpacityRule::Curve(vec![(0.0, 0.02), (250.0, 0.6)]);
    let transfer = TransferFunction { opacity, color: ColorRule::Uniform([0.9, 0.6, 0.3]) };
    let headlight = Light { kind: LightKind::Headlight, color: [1.0; 3], shadow: false };
    Scene {
        root: Arc::new(Node::new(Shape::Grid(GridObject { grid: grid.clone(), transfer, labels: false }))),
        lighting: if lit { Lighting::Lit(vec![headlight]) } else { Lighting::Unlit },
        background: None,
        unit_distance: 1.0,
        compositing: Compositing::Linear,
    }
}

/// Looks across `axis` at a stretch of some voxels around `place` on it.
fn camera(size: [u64; 3], axis: usize, place: f64) -> Camera {
    let mut target = DVec3::from_array(size.map(|n| (n - 1) as f64 / 2.0));
    target[axis] = place;
    // Askew, so that no row of samples runs along the voxels.
    let mut direction = DVec3::new(0.37, 0.29, 0.83);
    direction.swap_axes(axis);
    let mut up = DVec3::ZERO;
    up[axis] = 1.0;
    let projection = Projection::Orthographic { height: 3.1 };
    Camera { position: target - direction.normalize() * 6.0, direction, up, projection }
}

trait SwapAxes {
    fn swap_axes(&mut self, axis: usize);
}

impl SwapAxes for DVec3 {
    /// Makes the shortest component that of `axis`.
    fn swap_axes(&mut self, axis: usize) {
        *self = DVec3::from_array(
            [[self.y, self.x, self.z], [self.z, self.y, self.x], [self.z, self.x, self.y]][axis],
        );
    }
}

/// Compares a picture with the reference renderer's, pixel by pixel. Returns how many pixels show
/// anything.
fn compare(grid: &Arc<Grid>, camera: &Camera, what: &str) -> usize {
    const SIDE: (u32, u32) = (3, 8);
    const STEP: f64 = 0.09;
    let mut covered = 0;
    for lit in [false, true] {
        let scene = scene(grid, lit);
        let step = Step::Fixed(STEP);
        let settings = RenderSettings { step, stop_transmittance: 0.0, ..settings(SIDE.0, SIDE.1) };
        let exec = ExecSettings { threads: 1, ..ExecSettings::default() };
        let paged = paged(&scene, u64::MAX / 2);
        let found = picture(&scene, camera, &settings, &exec, &paged).expect("a picture");
        let reference_renderer = ReferenceRenderer::load(&scene).expect("it loads");
        for (at, pixel) in found.iter().enumerate() {
            let (x, y) = (at as u32 % SIDE.0, at as u32 / SIDE.0);
            let exact = reference_renderer
                .pixel(camera, &settings, &ReferenceSteps::same(STEP), x, y)
                .expect("a camera");
            covered += usize::from(exact[3] > 0.05);
            for channel in 0..4 {
                let difference = (f64::from(pixel[channel]) - exact[channel]).abs();
                assert!(difference <= 1.0 / 1024.0, "{what}, lit {lit}, pixel {x} {y}: off by {difference}");
            }
        }
    }
    covered
}

#[test]
fn the_last_cells_of_grids_of_every_size_are_those_of_the_reference_renderer() {
    let folder = folder();
    for axis in 0..3 {
        for n in 2..=70 {
            let mut size = [2, 3, 2];
            size.swap(axis, 1);
            size[axis] = n;
            let grid = random_grid(folder.path(), size, VoxelKind::F32);
            let covered = compare(&grid, &camera(size, axis, (n - 1) as f64 - 0.7), &format!("{size:?}"));
            assert!(covered > 8, "{size:?}: only {covered} pixels show anything");
        }
    }
}

#[test]
fn cells_on_both_sides_of_where_bricks_meet_are_those_of_the_reference_renderer() {
    let folder = folder();
    for &kind in VoxelKind::ALL {
        for axis in 0..3 {
            // Wide enough for bricks that are cubes.
            let cells = kind.brick_cells();
            let mut size = [cells + 2; 3];
            size[axis] = 2 * cells + 2;
            let grid = random_grid(folder.path(), size, kind);
            assert_eq!(grid.header().brick_cells(), [cells; 3]);
            for border in [0, cells, 2 * cells] {
                let what = format!("{} {size:?} about {border}", kind.name());
                assert!(compare(&grid, &camera(size, axis, border as f64), &what) > 8, "{what}");
            }
        }
    }
}

#[test]
fn cells_on_both_sides_of_where_bricks_of_thin_grids_meet_are_those_of_the_reference_renderer() {
    let folder = folder();
    for &kind in VoxelKind::ALL {
        for axis in 0..3 {
            // A rod, and a sheet across which nothing is long.
            let (mut rod, mut sheet) = ([3; 3], [120; 3]);
            (rod[axis], sheet[(axis + 1) % 3]) = (2700, 4);
            for size in [rod, sheet] {
                let grid = random_grid(folder.path(), size, kind);
                let cells = grid.header().brick_cells()[axis];
                assert!(cells > kind.brick_cells(), "{} {size:?}: bricks of {cells} cells", kind.name());
                for border in [0, cells, 2 * cells].into_iter().filter(|&border| border < size[axis]) {
                    let what = format!("{} {size:?} about {border}", kind.name());
                    assert!(compare(&grid, &camera(size, axis, border as f64), &what) > 8, "{what}");
                }
            }
        }
    }
}

#[test]
fn thin_grids_take_little_more_room_than_their_voxels() {
    let folder = folder();
    for size in [[2, 2, 100_000], [100_000, 2, 2], [2, 100_000, 2], [700, 700, 2], [2, 700, 700]] {
        let grid = random_grid(folder.path(), size, VoxelKind::U8);
        let (bytes, voxels) = (std::fs::read(grid.path()).expect("a read"), size.iter().product::<u64>());
        // A sheet or a rod of two voxels has one beyond on either side.
        let most = if size.contains(&700) { 3 * voxels } else { 5 * voxels };
        assert!(bytes.len() as u64 <= most + (128 << 10), "{size:?}: {} bytes for {voxels}", bytes.len());
        let stored = std::fs::read(folder.path().join("v.raw")).expect("a read");
        let loaded = grid.load().expect("it loads");
        assert!(loaded.iter().zip(&stored).all(|(&found, &expected)| found == f32::from(expected)));
        assert_eq!(loaded.len() as u64, voxels);
        assert_eq!(grid.verify().expect("it is whole"), grid.header().pages());
        // Programs that know cubes alone refuse it.
        assert_eq!(bytes[32], 1, "{size:?}: the feature that readers must know");
    }
    for size in [[40, 50, 60], [31, 31, 31], [60, 60, 29]] {
        let grid = random_grid(folder.path(), size, VoxelKind::U8);
        assert_eq!(std::fs::read(grid.path()).expect("a read")[32..40], [0; 8], "{size:?}: as ever");
    }
}

#[test]
fn the_smallest_grid_can_be_lit() {
    let folder = folder();
    for &kind in VoxelKind::ALL {
        let grid = random_grid(folder.path(), [2; 3], kind);
        for axis in 0..3 {
            assert!(compare(&grid, &camera([2; 3], axis, 0.5), kind.name()) > 8);
        }
    }
}

#[test]
fn the_value_of_a_voxel_is_found_in_bricks_of_any_shape() {
    let folder = folder();
    for size in [[2, 3, 5000], [40, 35, 3], [33, 40, 52]] {
        let grid = random_grid(folder.path(), size, VoxelKind::U16);
        let all = grid.load().expect("it reads");
        for at in (0..all.len() as u64).step_by(all.len() / 40) {
            let place = [at % size[0], at / size[0] % size[1], at / size[0] / size[1]];
            let place = DVec3::from_array(place.map(|v| v as f64)) + 0.2;
            let found = grid.value_at(place.min(grid.header().last_voxel())).expect("it reads");
            assert_eq!(found, Some(f64::from(all[at as usize])), "{size:?} at {place}");
        }
    }
}

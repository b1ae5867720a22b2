//! Small clouds and pictures of them.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rayset::PagedFiles;
use rayset::field::Kernel;
use rayset::geometry::DVec3;
use rayset::octree::Cloud;
use rayset::octree::build::{self, BuildControl, BuildOptions, Rule};
use rayset::points::{ArraySource, PointSource, Workload};
use rayset::scene::{
    Camera, CloudObject, ColorRule, Lighting, Node, OpacityRule, RenderSettings, Scene, Shape,
    TransferFunction,
};
use rayset::trace::{ExecSettings, RenderError, render_once};
use rayset::working_set::read::{self, BackendKind, Transport};
use rayset::working_set::{Limits, WorkingSet};

/// A folder that goes with the test.
pub(crate) fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

/// Real scans, where `RAYSET_TEST_DATA` names a folder of them; tests never need them. Says so
/// where a test has to do without, past the harness, which keeps to itself what a test that passes
/// prints.
pub(crate) fn real_data(name: &str) -> Option<PathBuf> {
    let root = std::env::var_os("RAYSET_TEST_DATA").map(PathBuf::from);
    let found = root.map(|root| root.join(name)).filter(|path| path.exists());
    if found.is_none() {
        let thread = std::thread::current();
        let test = thread.name().unwrap_or("a test");
        let _ = writeln!(std::io::stderr(), "{test}: skipped, for RAYSET_TEST_DATA has no {name}");
    }
    found
}

/// splitmix64, as numbers of 0 to 1.
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// Points in a cube with radii over `octaves` octaves, positive weights and colours.
pub(crate) fn mixed_points(count: usize, octaves: f64, seed: u64) -> ArraySource {
    let mut random = Random(seed);
    let mut position = Vec::new();
    let mut columns = vec![Vec::new(); 5];
    for _ in 0..count {
        let p: [f64; 3] = std::array::from_fn(|_| 2.0 * random.unit() - 1.0);
        position.push(p);
        columns[0].push((0.35 * 2_f64.powf(-octaves * random.unit())) as f32);
        columns[1].push((0.2 + random.unit()) as f32);
        for column in &mut columns[2..] {
            column.push(random.unit() as f32);
        }
    }
    let names = ["radius", "weight", "red", "green", "blue"];
    ArraySource::new(position, names.into_iter().zip(columns).collect())
}

pub(crate) fn build_at(path: &Path, source: Box<dyn PointSource>, options: &BuildOptions) -> Arc<Cloud> {
    build::run(vec![source], path, options, &BuildControl::default()).expect("the cloud builds");
    Arc::new(Cloud::open(path).expect("the cloud opens"))
}

pub(crate) fn workload_cloud(name: &str, folder: &Path) -> Arc<Cloud> {
    let workload: Workload = name.parse().expect("a workload");
    let options = BuildOptions {
        radius: workload.radius().map(Rule::Number),
        page_bytes: Some(16 << 10),
        ..BuildOptions::default()
    };
    build_at(&folder.join(format!("{name}.rset")), workload.source(), &options)
}

/// The standard look of a cloud: extinction, in its own colours where it has any.
pub(crate) fn look(cloud: &Arc<Cloud>, kernel: Kernel) -> CloudObject {
    let header = cloud.header();
    let color = if header.has_color { ColorRule::Points } else { ColorRule::Uniform([0.9, 0.6, 0.3]) };
    let transfer = TransferFunction { opacity: OpacityRule::Extinction(0.3 / header.radius_mean), color };
    CloudObject { kernel, transfer, ..CloudObject::plain(cloud.clone()) }
}

/// A cloud alone, lit by a headlight or not at all.
pub(crate) fn scene_of(object: CloudObject, lit: bool) -> Scene {
    let lighting = if lit { Lighting::headlight() } else { Lighting::Unlit };
    Scene { lighting, ..Scene::of_cloud(object) }
}

/// The standard look, alone.
pub(crate) fn scene(cloud: &Arc<Cloud>, kernel: Kernel, lit: bool) -> Scene {
    scene_of(look(cloud, kernel), lit)
}

/// Every cloud of a graph, each once.
pub(crate) fn clouds_of(scene: &Scene) -> Vec<Arc<Cloud>> {
    let mut clouds: Vec<Arc<Cloud>> = Vec::new();
    scene.root.for_each(&mut |node: &Node| {
        if let Shape::Cloud(object) = &node.shape
            && !clouds.iter().any(|known| Arc::ptr_eq(known, &object.cloud))
        {
            clouds.push(object.cloud.clone());
        }
    });
    clouds
}

pub(crate) fn settings(width: u32, height: u32) -> RenderSettings {
    RenderSettings { width, height, ..RenderSettings::default() }
}

/// From (0, 0, 3) at the origin, as the standard workloads are seen.
pub(crate) fn camera() -> Camera {
    Camera::look_at(DVec3::new(0.0, 0.0, 3.0), DVec3::ZERO, DVec3::Y, 45_f64.to_radians())
}

/// A working set over the files of all clouds of a scene.
pub(crate) fn paged(scene: &Scene, budget: u64) -> PagedFiles {
    paged_with(scene, budget, read::backend(BackendKind::Pool).expect("a pool"), false)
}

pub(crate) fn paged_with(
    scene: &Scene,
    budget: u64,
    backend: Arc<dyn Transport>,
    direct: bool,
) -> PagedFiles {
    let mut paged = PagedFiles::new(WorkingSet::new(Limits::total(budget), backend));
    for cloud in clouds_of(scene) {
        paged.open(&cloud, direct).expect("the file opens");
    }
    scene.root.for_each(&mut |node: &Node| {
        if let Shape::Grid(object) = &node.shape {
            paged.open_grid(&object.grid, direct).expect("the file opens");
        }
    });
    paged
}

pub(crate) fn picture(
    scene: &Scene,
    camera: &Camera,
    settings: &RenderSettings,
    exec: &ExecSettings,
    paged: &PagedFiles,
) -> Result<Vec<[f32; 4]>, RenderError> {
    Ok(render_once(scene, camera, settings, exec, paged)?.0.pixels)
}

/// The picture with everything in memory.
pub(crate) fn plain_picture(scene: &Scene, settings: &RenderSettings) -> Vec<[f32; 4]> {
    let exec = ExecSettings { threads: 2, ..ExecSettings::default() };
    let paged = paged(scene, u64::MAX / 2);
    picture(scene, &camera(), settings, &exec, &paged).expect("the picture is made")
}

/// Bits, so that equality means equality.
pub(crate) fn bits(pixels: &[[f32; 4]]) -> Vec<[u32; 4]> {
    pixels.iter().map(|p| p.map(f32::to_bits)).collect()
}

/// Points of which many are in one place, each with a weight and colours of its own: some places
/// are those of whole runs.
pub(crate) fn points_in_few_places(places: usize, most: f64) -> ArraySource {
    let mut random = Random(31);
    let (mut position, mut columns) = (Vec::new(), vec![Vec::new(); 5]);
    for place in 0..places {
        let p: [f64; 3] = std::array::from_fn(|_| 2.0 * random.unit() - 1.0);
        let radii = [0.3, 0.25].map(|most| (most * 2_f64.powf(-random.unit())) as f32);
        for _ in 0..most.powf(random.unit()) as usize {
            position.push(p);
            columns[0].push(radii[usize::from(random.unit() < 0.05)]);
            // Of every other place a few are negative, and counted one by one.
            let least = if place % 2 == 0 { 0.01 } else { -0.02 };
            columns[1].push((random.unit() + least) as f32);
            columns[2..].iter_mut().for_each(|column| column.push(random.unit() as f32));
        }
    }
    let names = ["radius", "weight", "red", "green", "blue"];
    ArraySource::new(position, names.into_iter().zip(columns).collect())
}

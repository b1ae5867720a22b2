//! What several files of tests use.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use rayset::build::{self, BuildControl, BuildOptions, GridBuildOptions};
use rayset::points::{self, ReadOptions, Workload};
use rayset::scene::{
    Camera, CloudObject, Compositing, GridObject, Lighting, Node, RenderSettings, Scene, Shape,
};
use rayset::volumes;
use rayset::working_set::Limits;
use rayset::{Cloud, Grid, Session};

use crate::range_server::{Behaviour, RangeServer};

/// Opens addresses in this process, and starts a server.
pub(crate) fn server() -> RangeServer {
    rayset_remote::open_addresses(&rayset_remote::Settings::default()).expect("no cache, no error");
    RangeServer::start(None, 0, Behaviour::default()).expect("a server")
}

/// One deviation of a server.
pub(crate) fn odd(name: &'static str) -> Behaviour {
    Behaviour { odd: [name].into(), ..Behaviour::default() }
}

/// The file of a cloud.
pub(crate) fn cloud(workload: &str) -> Vec<u8> {
    let workload: Workload = workload.parse().expect("a workload");
    let options = BuildOptions::default().with_radius(workload.radius().map(build::Rule::Number));
    let options = options.with_page_bytes(Some(16384));
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("cloud.rset");
    rayset::octree::build::run(vec![workload.source()], &path, &options, &BuildControl::default())
        .expect("a build");
    std::fs::read(&path).expect("the file")
}

pub(crate) fn render(cloud: &Arc<Cloud>, budget: u64) -> Result<Vec<[f32; 4]>, String> {
    render_scene(&Scene::of_cloud(CloudObject::plain(cloud.clone())), budget)
}

pub(crate) fn render_grid(grid: &Arc<Grid>, budget: u64) -> Result<Vec<[f32; 4]>, String> {
    let root = Arc::new(Node::new(Shape::Grid(GridObject::plain(grid.clone()))));
    render_scene(
        &Scene {
            root,
            lighting: Lighting::headlight(),
            background: None,
            unit_distance: 1.0,
            compositing: Compositing::Linear,
        },
        budget,
    )
}

fn render_scene(scene: &Scene, budget: u64) -> Result<Vec<[f32; 4]>, String> {
    let camera = Camera::framing(
        &scene.root.bounds(),
        [0.2, -0.3, -1.0].into(),
        [0.0, 1.0, 0.0].into(),
        0.8,
        1.0,
        false,
    );
    let session =
        Session::builder().page_limits(Limits::total(budget)).threads(2).build().expect("a session");
    let settings = RenderSettings::default().with_size(64, 64);
    let prepared = session.prepare(scene, &settings).map_err(|error| error.to_string())?;
    let view = prepared.view(&camera).map_err(|error| error.to_string())?;
    Ok(view.picture().map_err(|error| error.to_string())?.pixels)
}

pub(crate) fn open(address: &str) -> Result<Arc<Cloud>, String> {
    Cloud::open(Path::new(address)).map(Arc::new).map_err(|error| error.to_string())
}

pub(crate) fn near(file: &[u8]) -> Vec<[f32; 4]> {
    render(&Arc::new(Cloud::from_bytes(file.to_vec()).expect("a cloud")), 1 << 30).expect("a picture")
}

pub(crate) fn fixtures() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../rayset/tests/fixtures")
}

/// Builds the cloud of one input.
pub(crate) fn build_cloud(input: &Path, output: &Path) -> Result<(), String> {
    let source = points::open(input, &ReadOptions::default()).map_err(|error| error.to_string())?;
    let options = BuildOptions::default().with_radius(Some(build::Rule::Number(0.01)));
    let built = rayset::octree::build::run(vec![source], output, &options, &BuildControl::default());
    built.map(drop).map_err(|error| error.to_string())
}

/// The cloud of one input.
pub(crate) fn built(input: &Path) -> Result<Vec<u8>, String> {
    written(|output| build_cloud(input, output))
}

/// The file that something writes.
fn written(write: impl FnOnce(&Path) -> Result<(), String>) -> Result<Vec<u8>, String> {
    let folder = tempfile::tempdir().expect("a folder");
    let output = folder.path().join("out.rset");
    write(&output)?;
    Ok(std::fs::read(output).expect("the file"))
}

/// Builds the grid of a volume.
pub(crate) fn build_grid(input: &Path, output: &Path) -> Result<(), String> {
    let source = volumes::open(input, None).map_err(|error| error.to_string())?;
    let built = build::grid_to_file(source, output, &GridBuildOptions::default(), &BuildControl::default());
    built.map(drop).map_err(|error| error.to_string())
}

/// The grid of a volume.
pub(crate) fn built_grid(input: &Path) -> Result<Vec<u8>, String> {
    written(|output| build_grid(input, output))
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

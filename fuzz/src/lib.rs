//! What the fuzzers do with bytes: open them as a file of some kind, and go on as long as that is
//! no error. Nothing may panic, hang or take much memory, whatever is built must open and be whole,
//! and every error has to be a sentence.
//!
//! An input is a byte that chooses the kind of file, then the file. `tests/it/corpus.rs` writes
//! inputs to begin with.

use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use rayset::PagedFiles;
use rayset::geometry::DVec3;
use rayset::grid::Grid;
use rayset::grid::build::{self as grid_build, GridBuildOptions};
use rayset::octree::Cloud;
use rayset::octree::build::{self, BuildControl, BuildOptions, Rule};
use rayset::octree::verify::Depth;
use rayset::points::{self, MeshSource, PointBatch, PointSource, ReadOptions};
use rayset::scene::{
    Camera, CloudObject, ColorRule, Compositing, GridObject, Kernel, Lighting, Node, OpacityRule,
    RenderSettings, Samples, Scene, Shape, SplatFilter, Step,
};
use rayset::scene_file::SceneFile;
use rayset::trace::{ExecSettings, render_once};
use rayset::volumes::{self, RawLayout};
use rayset::working_set::{Limits, WorkingSet, read};

/// Names that the first byte of an input chooses from.
pub const POINTS: [&str; 28] = [
    "p.ply", "p.las", "p.laz", "p.csv", "p.xyz", "p.pts", "p.txt", "mesh.ply", "s.spz", "s.splat",
    "s.ksplat", "m.obj", "m.stl", "p.hdf5", "p.gadget", "p.npy", "p.npz", "p.vtk", "p.vtp", "p.vtu", "p.e57",
    "p.pcd", "p.ptx", "p.csv.gz", "m.off", "p.bin", "s.glb", "s.sog",
];
/// See [`POINTS`].
pub const VOLUMES: [&str; 12] = [
    "v.nrrd", "v.mha", "v.nii", "v.nii.gz", "v.vti", "v.mhd", "v.vdb", "v.npy", "v.npz", "v.slc", "v.vtk",
    "v.dx",
];

/// A folder of this process, in memory where there is one. It stays when the process ends.
pub fn folder() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let shared = Path::new("/dev/shm");
        let folder = if shared.is_dir() { tempfile::tempdir_in(shared) } else { tempfile::tempdir() };
        folder.expect("a temporary folder").keep()
    })
}

fn written(names: &[&str], data: &[u8]) -> Option<PathBuf> {
    let (&choice, bytes) = data.split_first()?;
    let path = folder().join(names[usize::from(choice) % names.len()]);
    std::fs::write(&path, bytes).expect("a write");
    Some(path)
}

/// An error has to be a sentence for a person.
fn sentence(error: &dyn std::error::Error) {
    let said = error.to_string();
    assert!(!said.is_empty() && !said.contains("failed to fill whole buffer"), "{said}");
    assert!(!said.contains("panicked"), "{said}");
}

/// Points and meshes: reads all, then builds a cloud of a part of them and checks it deeply.
pub fn points(data: &[u8]) {
    let Some(path) = written(&POINTS, data) else { return };
    let open = || -> Result<Box<dyn PointSource>, points::ReadError> {
        if path.ends_with("mesh.ply") {
            return Ok(Box::new(MeshSource::open(&path, 100)?));
        }
        points::open(&path, &ReadOptions::default())
    };
    let mut source = match open() {
        Ok(source) => source,
        Err(error) => return sentence(&error),
    };
    let all: Vec<usize> = (0..source.schema().columns.len()).collect();
    source.select(&all);
    let (mut batch, mut count) = (PointBatch::default(), 0);
    loop {
        match source.fill(&mut batch, 1000) {
            Err(error) => return sentence(&error),
            Ok(()) if batch.is_empty() => break,
            Ok(()) => {}
        }
        assert!(batch.columns.iter().all(|column| column.len() == batch.len()));
        count += batch.len();
        if count > 20_000 {
            return;
        }
    }
    let attributes: Vec<String> = source.schema().names().take(5).map(str::to_owned).collect();
    // With radii and shapes that are measured, or those of the file.
    let radius = data.len().is_multiple_of(2).then_some(Rule::Auto);
    let options =
        BuildOptions { radius, attributes, memory_bytes: 16 << 20, threads: 1, ..BuildOptions::default() };
    let Ok(source) = open() else { return };
    let cloud = folder().join("built.rset");
    match build::run(vec![source], &cloud, &options, &BuildControl::default()) {
        Err(error) => sentence(&error),
        Ok(_) => {
            let cloud = Cloud::open(&cloud).expect("what is built opens");
            cloud.verify(Depth::Deep).expect("what is built is whole");
            pictures_of(cloud);
        }
    }
}

/// Pictures of a cloud as it is, and as splats, whatever its weights are.
fn pictures_of(cloud: Cloud) {
    let settings = RenderSettings { width: 6, height: 6, ..RenderSettings::default() };
    let mut object = CloudObject::plain(Arc::new(cloud));
    let plain = Scene::of_cloud(object.clone());
    picture(&plain, &framing(&plain), &settings);
    (object.kernel, object.splat_filter) = (Kernel::Splat, SplatFilter::Mip);
    object.transfer.opacity = OpacityRule::Extinction(1.0);
    if object.cloud.header().has_color {
        object.transfer.color = ColorRule::Points;
    }
    let mean_radius = object.cloud.header().radius_mean;
    let splats = Scene { compositing: Compositing::Display, ..Scene::of_cloud(object) };
    // Filtered splats are as wide as pixels, of which steps are to be a part, as the look makes
    // them: seen from afar, a picture would take a million steps a pixel otherwise.
    let pixel = 0.2 * splats.root.bounds().size().length();
    let step = if pixel > mean_radius { Step::Fixed(0.05 * pixel) } else { settings.step };
    picture(&splats, &framing(&splats), &RenderSettings { step, ..settings });
}

/// Volumes: builds a grid, and checks it.
pub fn volumes(data: &[u8]) {
    let Some(path) = written(&VOLUMES, data) else { return };
    // The voxels of a header of its own.
    std::fs::write(folder().join("v.raw"), [7; 4096]).expect("a write");
    let source = match volumes::open(&path, None) {
        Ok(source) => source,
        Err(error) => return sentence(&error),
    };
    if source.size.iter().product::<u64>() > 1 << 20 {
        return;
    }
    let grid = folder().join("built.rset");
    let options = GridBuildOptions { memory_bytes: 4 << 20, temp_dir: None };
    match grid_build::build(source, &grid, &options, &rayset::build::BuildControl::default()) {
        Err(error) => sentence(&error),
        Ok(_) => {
            let grid = Grid::open(&grid).expect("what is built opens");
            grid.verify().expect("what is built is whole");
        }
    }
}

/// Scenes over a cloud, a grid and a preset: renders what passes the check, in a few pixels.
pub fn scenes(data: &[u8]) {
    static DATA: OnceLock<()> = OnceLock::new();
    DATA.get_or_init(data_of_scenes);
    let Ok(text) = std::str::from_utf8(data) else { return };
    let mut scene = match SceneFile::parse(&folder().join("scene.json"), text) {
        Ok(scene) => scene,
        Err(error) => return sentence(&error),
    };
    (scene.settings.width, scene.settings.height) = (4, 4);
    // Haze of glass around everything may send a ray from every sample, again and again: rightly
    // slow, and nothing to find.
    (scene.settings.samples, scene.settings.max_depth) = (Samples::Fixed(1), scene.settings.max_depth.min(1));
    picture(&scene.scene, &scene.camera, &scene.settings);
}

/// Files of rayset itself, with checksums made right after they were changed.
pub fn files(data: &[u8]) {
    let path = folder().join("f.rset");
    let mut bytes = data.to_vec();
    rayset::container::reseal(&mut bytes);
    std::fs::write(&path, &bytes).expect("a write");
    let settings = RenderSettings { width: 6, height: 6, ..RenderSettings::default() };
    match Cloud::open(&path) {
        Err(error) => sentence(&error),
        Ok(cloud) => {
            if let Err(error) = cloud.verify(Depth::Deep) {
                sentence(&error);
            }
            pictures_of(cloud);
        }
    }
    match Grid::open(&path) {
        Err(error) => sentence(&error),
        Ok(grid) => {
            if let Err(error) = grid.verify() {
                sentence(&error);
            }
            let object = GridObject::plain(Arc::new(grid));
            let root = Arc::new(Node::new(Shape::Grid(object)));
            let scene = Scene {
                root,
                lighting: Lighting::headlight(),
                background: None,
                unit_distance: 1.0,
                compositing: Compositing::Linear,
            };
            picture(&scene, &framing(&scene), &settings);
        }
    }
}

/// A camera before the whole scene.
fn framing(scene: &Scene) -> Camera {
    let bounds = scene.root.bounds();
    let (center, reach) =
        if bounds.is_empty() { (DVec3::ZERO, 1.0) } else { (bounds.center(), bounds.size().length()) };
    Camera::look_at(center + DVec3::Z * 1.5 * reach, center, DVec3::Y, 0.8)
}

/// Renders in little memory: a picture of numbers, or an error.
fn picture(scene: &Scene, camera: &Camera, settings: &RenderSettings) {
    let backend = read::backend(read::BackendKind::Pool).expect("a pool");
    let files = PagedFiles::new(WorkingSet::new(Limits::total(4 << 20), backend));
    let exec = ExecSettings { threads: 1, ..ExecSettings::default() };
    match render_once(scene, camera, settings, &exec, &files) {
        Err(error) => sentence(&error),
        Ok((picture, _)) => {
            assert!(picture.pixels.iter().flatten().all(|v| !v.is_nan()), "a pixel that is no number");
        }
    }
}

/// `cloud.rset`, `grid.rset` and `maps.json`, which scenes may name.
fn data_of_scenes() {
    let source = "knot-500".parse::<points::Workload>().expect("a workload").source();
    let options = BuildOptions { attributes: vec!["weight".into()], threads: 1, ..BuildOptions::default() };
    build::run(vec![source], &folder().join("cloud.rset"), &options, &BuildControl::default())
        .expect("it builds");
    let raw = folder().join("voxels.raw");
    std::fs::write(&raw, (0..1000).map(|i| (i * 7) as u8).collect::<Vec<u8>>()).expect("a write");
    let layout = "10x10x10,u8".parse::<RawLayout>().expect("a layout");
    let source = layout.open(&raw).expect("it opens");
    grid_build::build(
        source,
        folder().join("grid.rset"),
        &GridBuildOptions::default(),
        &rayset::build::BuildControl::default(),
    )
    .expect("it builds");
    let maps = r#"[{"Name": "Fire", "RGBPoints": [0, 0, 0, 0, 1, 1, 0.5, 0], "Points": [0, 0, 0.5, 0, 1, 1, 0.5, 0]}]"#;
    std::fs::write(folder().join("maps.json"), maps).expect("a write");
}

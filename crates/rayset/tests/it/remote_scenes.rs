//! Scenes of which clouds and grids are remote: the pictures of near ones, in few requests.

use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use rayset::build::{self, BuildControl, BuildOptions, GridBuildOptions};
use rayset::file::VoxelKind;
use rayset::geometry::{DAffine3, DVec3};
use rayset::points::Workload;
use rayset::scene_file::SceneFile;
use rayset::storage::{FileStorage, RemoteOptions, RemoteStorage, Storage};
use rayset::trace::Picture;
use rayset::volumes::VolumeSource;
use rayset::working_set::Limits;
use rayset::{CancelToken, Cloud, Grid, Session};
use rayset_lab::simulated::{Behaviour, SimulatedObject};

/// Voxels along a side of the grid.
const SIDE: u64 = 96;
const GRID: &str = r#"{"type": "grid", "file": "mist.rset", "transferFunction": {"opacity": [[0.3, 0], [1, 0.2]]},
    "transform": {"translate": [0.4, 0.2, 0.5]}}"#;
const CLOUD: &str = r#"{"type": "cloud", "file": "sphere.rset"}"#;
const SUN: &str =
    r#""lights": [{"type": "directional", "direction": [-1, -0.4, -0.5]}], "rendering": {"shadows": "KIND"}"#;

/// Scenes whose rays go to files in every way there is, by name.
fn scenes() -> Vec<(&'static str, String)> {
    let view = r#""camera": {"position": [0.3, 0.4, 3], "lookAt": [0, 0, 0], "fovy": 45}"#;
    let scene = |rest: &str, root: &str| format!(r#"{{"rayset": 1, {view}, {rest}, "root": {root}}}"#);
    let both = format!(
        r#"{{"type": "union", "children": [{CLOUD}, {GRID},
            {{"type": "box", "size": [3, 0.1, 3], "transform": {{"translate": [0, -1.1, 0]}}}}]}}"#
    );
    let mirror = format!(
        r#"{{"type": "union", "children": [{{"type": "sphere", "radius": 0.8, "material": {{"reflectance": 0.9, "diffuse": 0.1}}}},
            {{"type": "blend", "children": [{CLOUD}, {GRID}], "transform": {{"translate": [0, 0, 4.5]}}}}]}}"#
    );
    let cut = format!(
        r##"{{"type": "difference", "cap": "#ff8040", "children": [{CLOUD},
            {{"type": "box", "size": [1, 1, 3], "transform": {{"translate": [0.5, 0.5, 1]}}}}]}}"##
    );
    vec![
        ("tables of shadows", scene(&SUN.replace("KIND", "cached"), &both)),
        ("exact shadows", scene(&SUN.replace("KIND", "exact"), &both)),
        ("a mirror", scene(r#""lights": [{"type": "ambient"}]"#, &mirror)),
        ("a cap", scene(r#""lights": [{"type": "headlight"}], "rendering": {"capResolution": 48}"#, &cut)),
    ]
}

/// A folder with the files that the scenes refer to.
fn files() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    let workload: Workload = "sphere-100k".parse().expect("a workload");
    let radius = workload.radius().map(build::Rule::Number);
    let options = BuildOptions::default().with_radius(radius).with_page_bytes(Some(16384));
    let path = folder.path().join("sphere.rset");
    rayset::octree::build::run(vec![workload.source()], &path, &options, &BuildControl::default())
        .expect("a build");
    let wave = |at: u64| (at as f64 * 4.0 * std::f64::consts::TAU / SIDE as f64).sin();
    let voxel =
        |i: u64| (127.0 + 126.0 * wave(i % SIDE) * wave(i / SIDE % SIDE) * wave(i / SIDE / SIDE)) as u8;
    let voxels: Vec<u8> = (0..SIDE.pow(3)).map(voxel).collect();
    let space = DAffine3::from_translation(DVec3::splat(-0.5))
        * DAffine3::from_scale(DVec3::splat(1.0 / SIDE as f64));
    let source =
        VolumeSource::from_reader("mist", [SIDE; 3], VoxelKind::U8, space, Box::new(Cursor::new(voxels)));
    let path = folder.path().join("mist.rset");
    let (source, control) = (source.expect("a volume"), BuildControl::default());
    build::grid_to_file(source, &path, &GridBuildOptions::default(), &control).expect("a build");
    folder
}

/// A file behind a simulated network.
fn remote(path: &Path, latency: Duration) -> (Arc<SimulatedObject>, Arc<RemoteStorage>) {
    let near = FileStorage::open(path, false).expect("the file");
    let length = near.length().expect("its length");
    let behaviour = Behaviour { latency, jitter: 0.2, ..Behaviour::default() };
    let object = Arc::new(SimulatedObject::new(Arc::new(near), behaviour, 7).expect("a thread"));
    let storage = RemoteStorage::new(object.clone(), length, RemoteOptions::default()).expect("a thread");
    (object, Arc::new(storage))
}

/// A scene, its files remote.
fn remote_scene(folder: &Path, text: &str, latency: Duration) -> (Vec<Arc<SimulatedObject>>, SceneFile) {
    let place = |name: &str| -> (PathBuf, String) {
        let path = folder.join(name);
        let called = path.display().to_string();
        (path, called)
    };
    let (mut objects, mut clouds, mut grids) = (Vec::new(), Vec::new(), Vec::new());
    if text.contains("sphere.rset") {
        let (path, called) = place("sphere.rset");
        let (object, storage) = remote(&path, latency);
        objects.push(object);
        clouds.push(Arc::new(Cloud::from_storage(&called, storage).expect("a cloud")));
    }
    if text.contains("mist.rset") {
        let (path, called) = place("mist.rset");
        let (object, storage) = remote(&path, latency);
        objects.push(object);
        grids.push(Arc::new(Grid::from_storage(&called, storage).expect("a grid")));
    }
    let scene = SceneFile::parse_using(&folder.join("scene.json"), text, &clouds, &grids);
    (objects, scene.expect("a scene"))
}

fn render(session: &Session, file: &SceneFile, size: u32) -> Vec<[f32; 4]> {
    let prepared = session.prepare(&file.scene, &file.settings.with_size(size, size)).expect("a scene");
    prepared.view(&file.camera).expect("a view").picture().expect("a picture").pixels
}

#[test]
fn pictures_of_remote_scenes_are_those_of_local_ones_for_every_budget_and_thread_count() {
    let folder = files();
    for (name, text) in scenes() {
        let near = SceneFile::parse(&folder.path().join("scene.json"), &text).expect("a scene");
        let session = Session::builder().threads(2).build().expect("a session");
        let expected = render(&session, &near, 48);
        let seen = expected.iter().filter(|pixel| pixel[3] > 0.5).count();
        assert!(seen > 300, "{name}: {seen} pixels show anything");
        for (threads, budget) in [(1, 1_u64 << 30), (3, 3 << 20), (1, 1 << 20)] {
            let (objects, scene) = remote_scene(folder.path(), &text, Duration::from_millis(2));
            let session = Session::builder().page_limits(Limits::total(budget)).threads(threads).build();
            let session = session.expect("a session");
            assert!(render(&session, &scene, 48) == expected, "{name}, {threads} threads, {budget} bytes");
            assert!(session.statistics().peak_bytes <= budget, "{name}, {threads} threads, {budget} bytes");
            assert!(objects.iter().all(|object| object.counts().requests > 0), "{name}");
        }
    }
}

#[test]
fn whatever_rays_go_to_is_asked_for_before_they_do_so_in_few_requests() {
    let folder = files();
    for (name, text) in scenes() {
        let (objects, scene) = remote_scene(folder.path(), &text, Duration::from_millis(10));
        let session = Session::builder().threads(1).build().expect("a session");
        objects.iter().for_each(|object| object.reset_counts());
        render(&session, &scene, 96);
        let requests: u64 = objects.iter().map(|object| object.counts().requests).sum();
        let pages = session.statistics().total(|kind| kind.reads);
        assert!(requests as f64 <= 0.6 * pages as f64, "{name}: {requests} requests for {pages} pages");
    }
}

#[test]
fn samples_of_remote_files_are_those_of_local_ones_and_read_many_pages_at_a_time() {
    let folder = files();
    let (sphere, mist) = (folder.path().join("sphere.rset"), folder.path().join("mist.rset"));
    let (cloud_remote, storage) = remote(&sphere, Duration::from_millis(5));
    let cloud = Cloud::from_storage("sphere", storage).expect("a cloud");
    let (grid_remote, storage) = remote(&mist, Duration::from_millis(5));
    let grid = Grid::from_storage("mist", storage).expect("a grid");
    [&cloud_remote, &grid_remote].iter().for_each(|object| object.reset_counts());
    let near = Cloud::open(&sphere).expect("a cloud").sample(5000).expect("a sample");
    let sample = cloud.sample(5000).expect("a sample");
    assert!(sample.position == near.position && sample.columns == near.columns);
    let near = Grid::open(&mist).expect("a grid").sample(5000).expect("a sample");
    let sample = grid.sample(5000).expect("a sample");
    assert!(sample.position == near.position && sample.columns == near.columns);
    // Opened again, and then all of a mebibyte in a few requests, or in many at once.
    for (name, pages, counts) in [
        ("cloud", cloud.header().point_pages, cloud_remote.counts()),
        ("grid", grid.header().brick_pages() as u32, grid_remote.counts()),
    ] {
        let rounds = 2 + counts.bytes.div_ceil(1 << 20);
        assert!(pages > 20, "{name}: {pages} pages");
        let in_turn = counts.requests.div_ceil(counts.most_at_once);
        assert!(in_turn <= rounds, "{name}: {counts:?}, {pages} pages");
    }
}

#[test]
fn a_band_does_not_begin_with_waiting_for_its_pages() {
    let folder = files();
    let text = format!(
        r#"{{"rayset": 1, "camera": {{"position": [0, 0, 3], "lookAt": [0, 0, 0]}}, "root": {CLOUD}}}"#
    );
    let (_, scene) = remote_scene(folder.path(), &text, Duration::from_millis(30));
    let session = Session::builder().threads(1).build().expect("a session");
    let prepared = session.prepare(&scene.scene, &scene.settings.with_size(256, 256)).expect("a scene");
    let view = prepared.view(&scene.camera).expect("a view");
    let (mut picture, cancel) = (Picture::default(), CancelToken::new());
    let counts = view.render_bands(&view.region(), 32, &cancel, &mut picture).expect("a picture");
    // A tile after the other is deferred where nothing has been asked for, up to sixteen at a time.
    assert!(counts.deferred < 8 * 12, "{} tiles deferred in eight bands", counts.deferred);
}

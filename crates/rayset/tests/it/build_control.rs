//! Builds from slices, into memory, and builds that are cancelled.

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use rayset::cancel::CancelToken;
use rayset::field::Kernel;
use rayset::octree::Cloud;
use rayset::octree::build::{self, BuildControl, BuildError, BuildOptions, Progress, Stage};
use rayset::points::{
    ColorDepth, ColumnInfo, ColumnType, PointBatch, PointSource, ReadError, Schema, SliceSource, Values,
    Workload,
};
use rayset::scene::{Compositing, GridObject, Node, Scene, Shape};
use rayset::storage::{FileStorage, Storage};
use rayset::trace::{ExecSettings, render_once};

use crate::common::{Random, bits, build_at, camera, folder, mixed_points, paged, scene, settings};

/// Points in slices of several types: positions, radii, weights, colours, identifiers.
struct Slices {
    positions: Vec<[f64; 3]>,
    radii: Vec<f32>,
    weights: Vec<f64>,
    colors: Vec<[f32; 3]>,
    ids: Vec<u64>,
}

impl Slices {
    fn new(count: usize) -> Self {
        let mut random = Random(7);
        let mut unit = || random.unit();
        Self {
            positions: (0..count).map(|_| std::array::from_fn(|_| 2.0 * unit() - 1.0)).collect(),
            radii: (0..count).map(|_| 0.05 + 0.1 * unit() as f32).collect(),
            weights: (0..count).map(|_| 0.2 + unit()).collect(),
            colors: (0..count).map(|_| std::array::from_fn(|_| unit() as f32)).collect(),
            ids: (0..count as u64).map(|id| id << 40).collect(),
        }
    }

    fn source(&self) -> SliceSource<'_> {
        let source = SliceSource::new(&self.positions).radius(&self.radii).expect("a length");
        let source = source.weight(&self.weights).expect("a length").color(&self.colors).expect("a length");
        source.attribute("id", &self.ids).expect("a length")
    }

    fn options() -> BuildOptions {
        BuildOptions { attributes: vec!["id".into()], ..BuildOptions::default() }
    }
}

#[test]
fn a_cloud_built_in_memory_is_the_file_byte_for_byte_and_renders_alike() {
    let folder = folder();
    let slices = Slices::new(9000);
    let (in_memory, report) =
        build::run_in_memory(vec![Box::new(slices.source())], &Slices::options(), &BuildControl::default())
            .expect("a cloud");
    let path = folder.path().join("c.rset");
    build::run(vec![Box::new(slices.source())], &path, &Slices::options(), &BuildControl::default())
        .expect("a cloud");
    let memory = in_memory.storage().and_then(|storage| storage.memory()).expect("it lies in memory");
    assert!((*memory).as_ref() == std::fs::read(&path).expect("the file"));
    assert_eq!((report.points, in_memory.header().attributes[0].name.as_str()), (9000, "id"));
    assert!(in_memory.header().has_color);
    let on_disk = Arc::new(Cloud::open(&path).expect("it opens"));
    let picture = |cloud: &Arc<Cloud>| {
        let scene = scene(cloud, Kernel::Wyvill, true);
        // Pages in memory need no room.
        let budget = if cloud.storage().is_some() { 0 } else { 1 << 30 };
        let exec = ExecSettings { threads: 2, ..ExecSettings::default() };
        let files = paged(&scene, budget);
        bits(&render_once(&scene, &camera(), &settings(40, 40), &exec, &files).expect("a picture").0.pixels)
    };
    let expected = picture(&on_disk);
    assert!(expected.iter().any(|pixel| f32::from_bits(pixel[3]) > 0.5));
    assert!(picture(&Arc::new(in_memory)) == expected);
    let bytes = std::fs::read(&path).expect("the file");
    assert!(picture(&Arc::new(Cloud::from_bytes(bytes.clone()).expect("it opens"))) == expected);
    // Nothing that renders the cloud knows where it lies.
    let file: Arc<dyn Storage> = Arc::new(FileStorage::open(&path, false).expect("it opens"));
    let elsewhere = Arc::new(Cloud::from_storage("elsewhere", file).expect("it opens"));
    let scene = scene(&elsewhere, Kernel::Wyvill, true);
    let found =
        render_once(&scene, &camera(), &settings(40, 40), &ExecSettings::default(), &paged(&scene, 1 << 20));
    assert!(bits(&found.expect("a picture").0.pixels) == expected);
    let cut =
        Cloud::from_bytes(bytes[..bytes.len() - 1].to_vec()).expect_err("a byte is missing").to_string();
    assert!(cut.contains("memory") && cut.contains("incomplete"), "{cut}");
}

#[test]
fn a_memory_build_that_partitions_again_is_that_of_the_file() {
    let folder = folder();
    let source = || Box::new(mixed_points(60_000, 3.0, 2)) as Box<dyn PointSource>;
    // A budget in which nothing can be ordered at once.
    let options = BuildOptions { memory_bytes: 12 << 20, threads: 2, ..BuildOptions::default() };
    let path = folder.path().join("c.rset");
    build_at(&path, source(), &options);
    let (cloud, _) =
        build::run_in_memory(vec![source()], &options, &BuildControl::default()).expect("a cloud");
    let memory = cloud.storage().and_then(|storage| storage.memory()).expect("it lies in memory");
    assert!((*memory).as_ref() == std::fs::read(&path).expect("the file"));
    let listed = std::fs::read_dir(folder.path()).expect("the folder").count();
    assert_eq!(listed, 1, "nothing else was written");
}

#[test]
fn a_grid_in_memory_is_used_where_it_is() {
    let folder = folder();
    let grid = crate::grids::grid(folder.path(), rayset::grid::format::VoxelKind::U8);
    let bytes = std::fs::read(grid.path()).expect("the file");
    let in_memory = Arc::new(rayset::grid::Grid::from_bytes(bytes).expect("it opens"));
    let picture = |grid: &Arc<rayset::grid::Grid>, budget| {
        let root = Arc::new(Node::new(Shape::Grid(GridObject::plain(grid.clone()))));
        let scene = Scene {
            root,
            lighting: rayset::scene::Lighting::headlight(),
            background: None,
            unit_distance: 1.0,
            compositing: Compositing::Linear,
        };
        let bounds = scene.root.bounds();
        let eye = bounds.center() + 1.5 * bounds.size().length() * rayset::geometry::DVec3::Z;
        let camera = rayset::scene::Camera::look_at(eye, bounds.center(), rayset::geometry::DVec3::Y, 0.8);
        let found =
            render_once(&scene, &camera, &settings(24, 24), &ExecSettings::default(), &paged(&scene, budget));
        bits(&found.expect("a picture").0.pixels)
    };
    let expected = picture(&grid, 1 << 30);
    assert!(expected.iter().any(|pixel| f32::from_bits(pixel[3]) > 0.1));
    assert!(picture(&in_memory, 0) == expected);
}

/// The stages in the order in which they were heard of.
#[derive(Default)]
struct Heard(Mutex<Vec<(Stage, u64, u64)>>);

impl Progress for Heard {
    fn update(&self, stage: Stage, done: u64, total: u64) {
        self.0.lock().expect("no panic").push((stage, done, total));
    }
}

/// Cancels a build in a stage, when it first hears of that.
struct CancelsIn(Stage, CancelToken);

impl Progress for CancelsIn {
    fn update(&self, stage: Stage, _: u64, _: u64) {
        if stage == self.0 {
            self.1.cancel();
        }
    }
}

#[test]
fn a_build_says_how_every_stage_gets_on() {
    let heard = Heard::default();
    let workload: Workload = "sphere-100k".parse().expect("a workload");
    let control = BuildControl::from(&heard as &dyn Progress);
    build::run_in_memory(vec![workload.source()], &BuildOptions::default(), &control).expect("a cloud");
    let heard = heard.0.into_inner().expect("no panic");
    for stage in [Stage::Read, Stage::Spacing, Stage::Write] {
        let of_stage: Vec<_> = heard.iter().filter(|(s, ..)| *s == stage).collect();
        assert!(of_stage.is_sorted_by_key(|(_, done, _)| *done), "{of_stage:?}");
        assert_eq!(of_stage.last().map(|(_, done, total)| (*done, *total)), Some((100_000, 100_000)));
    }
}

#[test]
fn a_build_is_cancelled_at_once_in_every_stage_and_leaves_nothing() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    let workload: Workload = "sphere-300k".parse().expect("a workload");
    let options = BuildOptions { threads: 2, memory_bytes: 64 << 20, ..BuildOptions::default() };
    let started = Instant::now();
    build::run(vec![workload.source()], &path, &options, &BuildControl::default()).expect("a cloud");
    let takes = started.elapsed();
    std::fs::remove_file(&path).expect("it is there");
    let mut random = Random(11);
    let mut late = Vec::new();
    for _ in 0..40 {
        let control = BuildControl::default();
        let canceller = {
            let (cancel, wait) = (control.cancel.clone(), takes.mul_f64(random.unit()));
            std::thread::spawn(move || {
                std::thread::sleep(wait);
                let now = Instant::now();
                cancel.cancel();
                now
            })
        };
        let outcome = build::run(vec![workload.source()], &path, &options, &control);
        let returned = Instant::now();
        late.push(returned.saturating_duration_since(canceller.join().expect("it cancels")));
        match outcome {
            Err(BuildError::Cancelled) => {
                let left: Vec<_> = std::fs::read_dir(folder.path()).expect("the folder").collect();
                assert!(left.is_empty(), "{left:?}");
            }
            Ok(_) => std::fs::remove_file(&path).expect("it is there"),
            Err(other) => panic!("{other}"),
        }
    }
    for stage in [Stage::Read, Stage::Spacing, Stage::Write] {
        let cancel = CancelToken::new();
        let canceller = CancelsIn(stage, cancel.clone());
        let control = BuildControl { progress: &canceller, cancel, ..BuildControl::default() };
        let outcome = build::run(vec![workload.source()], &path, &options, &control);
        assert!(matches!(outcome, Err(BuildError::Cancelled)), "{stage:?}: {outcome:?}");
        assert_eq!(std::fs::read_dir(folder.path()).expect("the folder").count(), 0, "{stage:?}");
    }
    late.sort_unstable();
    // Other tests keep the processors and the disk busy meanwhile; docs/benchmarks.md says what a
    // quiet machine does.
    assert!(late[20] < Duration::from_millis(150) && late[39] < Duration::from_secs(3), "{late:?}");
}

/// Hands out what was not asked for: another number of columns, or one that is shorter than the
/// positions.
struct Careless {
    schema: Schema,
    columns: Vec<Values>,
}

impl PointSource for Careless {
    fn schema(&self) -> &Schema {
        &self.schema
    }
    fn count_hint(&self) -> Option<u64> {
        None
    }
    fn select(&mut self, _columns: &[usize]) {}
    fn fill(&mut self, batch: &mut PointBatch, _limit: usize) -> Result<(), ReadError> {
        batch.position = vec![[0.0; 3], [1.0; 3]];
        batch.columns.clone_from(&self.columns);
        Ok(())
    }
}

#[test]
fn a_source_that_hands_out_other_columns_than_were_selected_is_an_error() {
    let schema = Schema::new(vec![ColumnInfo::new("radius", ColumnType::F32)], ColorDepth::Unit);
    let column = |length: usize| Values::from(vec![0.1_f32; length]);
    for columns in [vec![], vec![column(1)], vec![column(3)], vec![column(2), column(2)]] {
        let count = columns.len();
        let source = Careless { schema: schema.clone(), columns };
        let outcome =
            build::run_in_memory(vec![Box::new(source)], &BuildOptions::default(), &BuildControl::default());
        let Err(BuildError::Source { input: 1, columns, selected: 1 }) = outcome else {
            panic!("{count} columns: {:?}", outcome.map(|(_, report)| report))
        };
        assert_eq!(columns, count);
    }
}

/// A file that takes long to be read before its first point: a mesh of each kind, splats of which
/// attributes lie behind others.
fn slow_files(folder: &std::path::Path) -> Vec<std::path::PathBuf> {
    let write = |name: &str, bytes: Vec<u8>| {
        let path = folder.join(name);
        std::fs::write(&path, bytes).expect("a write");
        path
    };
    let triangles = 300_000_u32;
    let mut stl = vec![b' '; 80];
    stl.extend(triangles.to_le_bytes());
    for i in 0..triangles {
        let numbers = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, i as f32];
        numbers.iter().for_each(|n: &f32| stl.extend(n.to_le_bytes()));
        stl.extend([0, 0]);
    }
    let mut obj = String::from("v 0 0 0\nv 1 0 0\nv 0 1 0\n");
    obj.push_str(&"f 1 2 3\n".repeat(100_000));
    obj.push_str(&"vn 0 0 1\n".repeat(400_000));
    let mut ply = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
                   element face 300000\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n"
        .to_owned();
    ply.push_str(&"3 0 1 2\n".repeat(300_000));
    let count = 3_000_000_u32;
    let mut spz = b"NGSP".to_vec();
    spz.extend(2_u32.to_le_bytes());
    spz.extend(count.to_le_bytes());
    spz.extend([0, 12, 0, 0]);
    spz.resize(16 + count as usize * 19, 0x80);
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::new(1));
    std::io::Write::write_all(&mut gzip, &spz).expect("a write");
    vec![
        write("a.stl", stl),
        write("a.obj", obj.into_bytes()),
        write("a.ply", ply.into_bytes()),
        write("a.spz", gzip.finish().expect("gzip")),
    ]
}

/// What came of reading the file while another thread cancels it after a delay, and the time from
/// that moment to its end.
fn fill_and_cancel(
    path: &std::path::Path,
    options: &rayset::points::ReadOptions,
    delay: Duration,
) -> (Result<(), ReadError>, Duration) {
    let mut source = rayset::points::open(path, options).expect("it opens");
    source.select(&[]);
    let cancel = CancelToken::new();
    source.watch(&cancel);
    let cancelled = std::thread::spawn(move || {
        std::thread::sleep(delay);
        cancel.cancel();
        Instant::now()
    });
    let filled = source.fill(&mut PointBatch::default(), 100);
    let took = Instant::now().saturating_duration_since(cancelled.join().expect("it ends"));
    (filled, took)
}

#[test]
fn meshes_and_splats_that_are_read_before_their_first_point_stop_when_they_are_cancelled() {
    let folder = folder();
    for path in slow_files(folder.path()) {
        let options = rayset::points::ReadOptions::default().with_mesh_points(Some(10));
        let cancel = CancelToken::new();
        // On a busy machine the file may have been read whole before the token is cancelled; then
        // it is cancelled sooner.
        let stopped = [4000, 2000, 1000, 500, 250, 125, 0].into_iter().any(|delay_us| {
            let (filled, took) = fill_and_cancel(&path, &options, Duration::from_micros(delay_us));
            assert!(took < Duration::from_secs(1), "{}: {took:?}, {filled:?}", path.display());
            matches!(filled, Err(ReadError::Cancelled))
        });
        assert!(stopped, "{}", path.display());
        cancel.cancel();
        // A build says that it was cancelled, and leaves nothing.
        let source = rayset::points::open(&path, &options).expect("it opens");
        let control = BuildControl::default().with_cancel(&cancel);
        let output = folder.path().join("c.rset");
        let built = build::run(vec![source], &output, &BuildOptions::default(), &control);
        assert!(matches!(built, Err(BuildError::Cancelled)) && !output.exists(), "{}", path.display());
    }
}

//! Pictures of clouds that are 50 ms away: `cargo bench -p rayset --bench remote_storage [--
//! WORD…]`.
//!
//! The storage is simulated: each request is answered after 50 ms, 20 % more or less, and at most
//! 64 are in flight. Of each case the time is compared with 1.3 times the larger of the time with
//! all pages in memory and that of the distinct pages that rays ask for, 50 ms each and 64 at a
//! time; plus ten round trips. Requests are counted for each of these pages, too. Ends with 1 if a
//! limit is exceeded (with the predictor `packet`). `figure=FOLDER` adds a scene `fig10.json` with
//! its data, as `rayset figure 10 --data FOLDER` writes it; `predictors` adds those without
//! look-ahead; `parts=10,40` has room for a tenth of the pages, and for a fortieth.
#![allow(clippy::print_stdout, reason = "it prints what it measured")]

use std::io::Cursor;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use rayset::build::{self, BuildControl, BuildOptions, GridBuildOptions, Rule};
use rayset::file::VoxelKind;
use rayset::geometry::{DAffine3, DVec3};
use rayset::points::Workload;
use rayset::scene::{
    Camera, CloudObject, ColorRule, Lighting, OpacityRule, RenderSettings, Scene, TransferFunction,
};
use rayset::scene_file::SceneFile;
use rayset::storage::{FileStorage, RemoteOptions, RemoteStorage, Storage};
use rayset::volumes::VolumeSource;
use rayset::working_set::Limits;
use rayset::{Cloud, Grid, Prediction, Session};
use rayset_lab::simulated::{Behaviour, SimulatedObject};

const LATENCY: Duration = Duration::from_millis(50);
const IN_FLIGHT: u64 = 64;
/// Most requests for each page that rays ask for.
const MOST_REQUESTS: f64 = 0.6;

/// The sphere in sunlight, all shadows from tables or each by rays of its own.
const SUN: &str = r#"{"rayset": 1, "camera": {"position": [0, 0, 3], "lookAt": [0, 0, 0], "fovy": 45},
    "lights": [{"type": "directional", "direction": [-1, -0.4, -0.5]}], "rendering": {"shadows": "SHADOWS"},
    "root": {"type": "union", "children": [{"type": "cloud", "file": "sphere-10m.rset"},
        {"type": "box", "size": [0.4, 0.4, 0.4], "transform": {"translate": [1.2, 0.5, 0.9]}}]}}"#;
/// The sphere behind the eye, in a mirror that is not seen in the first picture of a look-ahead.
const MIRROR: &str = r#"{"rayset": 1, "camera": {"position": [0, 0, 2], "lookAt": [0, 0, 6], "fovy": 40},
    "lights": [{"type": "ambient"}, {"type": "directional", "direction": [-1, -0.4, -0.5], "shadow": false}],
    "root": {"type": "union", "children": [{"type": "cloud", "file": "sphere-10m.rset"},
        {"type": "sphere", "radius": 1.2, "material": {"reflectance": 0.9, "diffuse": 0.1},
            "transform": {"translate": [0, 0, 6]}}]}}"#;
/// A volume of which every voxel is seen.
const MIST: &str = r#"{"rayset": 1, "camera": {"position": [0.3, 0.5, 2.2], "lookAt": [0, 0, 0], "fovy": 40}, "lights": "none",
    "rendering": {"unitDistance": 0.01, "stopTransmittance": 0},
    "root": {"type": "grid", "file": "mist-256.rset", "transferFunction": {"opacity": [[0, 0], [0.4, 0], [1, 0.02]]}}}"#;

/// A scene over files that are near or remote.
struct Look {
    name: String,
    scene: Scene,
    settings: RenderSettings,
    camera: Camera,
}

struct Case {
    near: Look,
    remote: Look,
    objects: Vec<Arc<SimulatedObject>>,
    /// Memory for tables of shadows, besides that of files.
    shadow_bytes: u64,
    page_bytes: u64,
    all_bytes: u64,
    /// Parts of all pages that fit, one in so many.
    parts: Vec<u64>,
}

fn main() {
    let words: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with("--")).collect();
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("remote_storage");
    std::fs::create_dir_all(&folder).expect("a folder");
    println!(
        "| case | in memory | predictor | in core s | s | bound s | of bound | pages asked for | reads | requests a page | most at once |"
    );
    println!("| --- | ---: | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |");
    let predictors = words.iter().any(|word| word == "predictors");
    let figure = words.iter().find_map(|word| word.strip_prefix("figure="));
    let parts = words.iter().find_map(|word| word.strip_prefix("parts="));
    let parts: Option<Vec<u64>> =
        parts.map(|parts| parts.split(',').map(|part| part.parse().expect("a number")).collect());
    let mut cases = Vec::new();
    for translucent in [false, true] {
        cases.push(sphere(&folder, "sphere-10m", translucent));
    }
    for (name, shadows, size) in [("sun, tables", "cached", 512), ("sun, exact", "exact", 96)] {
        cases.push(of_scene(&folder, name, &SUN.replace("SHADOWS", shadows), size, vec![10]));
    }
    cases.push(of_scene(&folder, "mirror", MIRROR, 512, vec![10]));
    mist(&folder);
    cases.push(of_scene(&folder, "mist", MIST, 512, vec![10]));
    cases.extend(figure.map(|folder| figure_10(Path::new(folder))));
    let only: Vec<&String> =
        words.iter().filter(|word| !word.contains('=') && *word != "predictors").collect();
    let mut met = true;
    for case in &cases {
        if !only.is_empty() && !only.iter().any(|word| case.near.name.contains(word.as_str())) {
            continue;
        }
        let (in_core, needed) = (case.in_core(), case.needed());
        for &part in parts.as_ref().unwrap_or(&case.parts) {
            met &= case.measure(Prediction::Packet, part, (in_core, needed), 5);
            if predictors {
                case.measure(Prediction::Line, part, (in_core, needed), 1);
                case.measure(Prediction::None, part, (in_core, needed), 1);
            }
        }
    }
    if !met {
        println!("missed");
        std::process::exit(1);
    }
}

fn remote(path: &Path) -> (Arc<SimulatedObject>, Arc<RemoteStorage>) {
    let behaviour = Behaviour { latency: LATENCY, jitter: 0.2, ..Behaviour::default() };
    let near = FileStorage::open(path, false).expect("the file");
    let length = near.length().expect("its length");
    let object = Arc::new(SimulatedObject::new(Arc::new(near), behaviour, 1).expect("a thread"));
    let storage = RemoteStorage::new(object.clone(), length, RemoteOptions::default()).expect("a thread");
    (object, Arc::new(storage))
}

fn remote_cloud(path: &Path) -> (Arc<SimulatedObject>, Arc<Cloud>) {
    let (object, storage) = remote(path);
    let cloud = Cloud::from_storage(&path.display().to_string(), storage).expect("a cloud");
    (object, Arc::new(cloud))
}

fn sphere(folder: &Path, name: &str, translucent: bool) -> Case {
    let workload: Workload = name.parse().expect("a workload");
    let path = folder.join(format!("{name}.rset"));
    if !path.exists() {
        let options = BuildOptions::default().with_radius(workload.radius().map(Rule::Number));
        rayset::octree::build::run(vec![workload.source()], &path, &options, &BuildControl::default())
            .expect("a build");
    }
    let near = Arc::new(Cloud::open(&path).expect("a cloud"));
    let (object, remote) = remote_cloud(&path);
    let view = workload.view();
    let camera = Camera::look_at(view.position, view.look_at, view.up, view.fovy_degrees.to_radians());
    let stop = if translucent { 0.0 } else { 0.01 };
    let look = |cloud: &Arc<Cloud>| {
        let radius = cloud.header().radius_mean;
        let kappa = if translucent { 0.02 } else { 2.0 } / radius;
        let transfer =
            TransferFunction { opacity: OpacityRule::Extinction(kappa), color: ColorRule::Uniform([1.0; 3]) };
        let object = CloudObject { transfer, ..CloudObject::plain(cloud.clone()) };
        Look {
            name: format!("{name} {}", if translucent { "translucent" } else { "opaque" }),
            scene: Scene { lighting: Lighting::Unlit, ..Scene::of_cloud(object) },
            settings: RenderSettings::default().with_stop_transmittance(stop),
            camera,
        }
    };
    Case {
        page_bytes: near.header().page_bytes.into(),
        all_bytes: near.header().file_bytes,
        near: look(&near),
        remote: look(&remote),
        objects: vec![object],
        shadow_bytes: 0,
        parts: vec![10],
    }
}

fn figure_10(folder: &Path) -> Case {
    let text = std::fs::read_to_string(folder.join("fig10.json")).expect("the scene");
    of_scene(folder, "figure 10", &text, 1024, vec![1, 2, 10])
}

/// A scene over files of a folder, in pictures of `size` pixels a side.
fn of_scene(folder: &Path, name: &str, text: &str, size: u32, parts: Vec<u64>) -> Case {
    let (mut objects, mut clouds, mut grids, mut all_bytes) = (Vec::new(), Vec::new(), Vec::new(), 0);
    for file in ["scan.rset", "other.rset", "sphere-10m.rset", "volume.rset", "mist-256.rset"] {
        if !text.contains(file) {
            continue;
        }
        let path = folder.join(file);
        let (object, storage) = remote(&path);
        let called = path.display().to_string();
        match Cloud::from_storage(&called, storage.clone()) {
            Ok(cloud) => {
                all_bytes += cloud.header().file_bytes;
                clouds.push(Arc::new(cloud));
            }
            Err(_) => {
                let grid = Grid::from_storage(&called, storage).expect("a cloud or a grid");
                all_bytes += grid.header().file_bytes;
                grids.push(Arc::new(grid));
            }
        }
        objects.push(object);
    }
    let look = |file: SceneFile| Look {
        name: name.into(),
        camera: file.camera,
        settings: file.settings.with_size(size, size),
        scene: file.scene,
    };
    let path = folder.join("scene.json");
    let near = SceneFile::parse(&path, text).expect("a scene");
    let remote = SceneFile::parse_using(&path, text, &clouds, &grids).expect("a scene");
    Case {
        shadow_bytes: 64 << 20,
        page_bytes: 32 << 10,
        all_bytes,
        near: look(near),
        remote: look(remote),
        objects,
        parts,
    }
}

/// A grid of 256³ voxels, soft lumps.
fn mist(folder: &Path) {
    let path = folder.join("mist-256.rset");
    if path.exists() {
        return;
    }
    const SIDE: u64 = 256;
    let wave = |at: u64, times: f64| (at as f64 * times * std::f64::consts::TAU / SIDE as f64).sin();
    let value = |i: u64| {
        let (x, y, z) = (i % SIDE, i / SIDE % SIDE, i / SIDE / SIDE);
        0.5 + (wave(x, 3.0) * wave(y, 2.5) + wave(y, 5.0) * wave(z, 4.0) + wave(z, 2.0) * wave(x, 7.0)) / 6.0
    };
    let voxels: Vec<u8> =
        (0..SIDE.pow(3)).flat_map(|i| ((value(i) * 65535.0) as u16).to_le_bytes()).collect();
    let space = DAffine3::from_translation(DVec3::splat(-0.5))
        * DAffine3::from_scale(DVec3::splat(1.0 / SIDE as f64));
    let source =
        VolumeSource::from_reader("mist", [SIDE; 3], VoxelKind::U16, space, Box::new(Cursor::new(voxels)));
    let source = source.expect("a volume");
    build::grid_to_file(source, &path, &GridBuildOptions::default(), &BuildControl::default())
        .expect("a build");
}

impl Case {
    /// Seconds with all pages in memory, where they have been read before.
    fn in_core(&self) -> f64 {
        let session = Session::builder().page_limits(Limits::total(1 << 30)).threads(1).build();
        let session = session.expect("a session");
        let times: Vec<f64> = (0..6).map(|_| render(&session, &self.near)).collect();
        median(&times[1..])
    }

    /// The distinct pages that rays ask for.
    fn needed(&self) -> u64 {
        let session = Session::builder()
            .page_limits(Limits::total(1 << 30))
            .threads(1)
            .prediction(Prediction::None)
            .build()
            .expect("a session");
        render(&session, &self.near);
        // There is room for all of them: each is read once.
        session.statistics().total(|kind| kind.reads)
    }

    /// Measures renders, prints what they took, and returns whether they kept within the limits.
    fn measure(
        &self,
        prediction: Prediction,
        part: u64,
        (in_core, needed): (f64, u64),
        repeat: usize,
    ) -> bool {
        let budget = (self.all_bytes / self.page_bytes / part * self.page_bytes).max(4 * self.page_bytes);
        let session = Session::builder()
            .page_limits(Limits::total(budget + self.shadow_bytes))
            .threads(1)
            .prediction(prediction)
            .build()
            .expect("a session");
        let (mut seconds, mut requests, mut reads, mut most) = (Vec::new(), Vec::new(), 0, 0);
        for _ in 0..repeat {
            session.evict_all();
            session.reset_statistics();
            self.objects.iter().for_each(|object| object.reset_counts());
            seconds.push(render(&session, &self.remote));
            let counts: Vec<_> = self.objects.iter().map(|object| object.counts()).collect();
            requests.push(counts.iter().map(|counts| counts.requests).sum::<u64>() as f64);
            most = counts.iter().map(|counts| counts.most_at_once).max().unwrap_or(0);
            reads = session.statistics().total(|kind| kind.reads);
        }
        let transfer = needed as f64 * LATENCY.as_secs_f64() / IN_FLIGHT as f64;
        let bound = 1.3 * in_core.max(transfer) + 10.0 * LATENCY.as_secs_f64();
        let (taken, a_page) = (median(&seconds), median(&requests) / needed.max(1) as f64);
        println!(
            "| {} | 1/{part} | {} | {in_core:.3} | {taken:.3} | {bound:.3} | {:.2} | {needed} | {reads} | {a_page:.2} | {most} |",
            self.remote.name,
            prediction.name(),
            taken / bound,
        );
        taken <= bound && a_page <= MOST_REQUESTS
    }
}

fn render(session: &Session, look: &Look) -> f64 {
    let started = Instant::now();
    let prepared = session.prepare(&look.scene, &look.settings).expect("a scene");
    let picture = prepared.view(&look.camera).expect("a view").picture().expect("a picture");
    assert!(!picture.pixels.is_empty());
    started.elapsed().as_secs_f64()
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    sorted[sorted.len() / 2]
}

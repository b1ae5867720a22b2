//! Pictures of clouds that are 50 ms away: `cargo bench -p rayset --bench far_storage [-- WORD…]`.
//!
//! The storage is simulated: each request is answered after 50 ms, 20 % more or less, and at most 64 are in flight. Of each case the
//! time is compared with 1.3 times the larger of the time with all pages in memory and that of the distinct pages needed, 50 ms
//! each and 64 at a time; plus ten round trips. `figure=FOLDER` adds a scene `fig10.json` with its data, as
//! `rayset figure 10 --data FOLDER` writes it; `predictors` adds those without look-ahead; `parts=10,40` has room for a tenth of the pages,
//! and for a fortieth.
#![allow(clippy::print_stdout, reason = "it prints what it measured")]

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use rayset::build::{self, BuildControl, BuildOptions, Rule};
use rayset::points::Workload;
use rayset::scene::{
    Camera, CloudObject, ColorRule, Lighting, OpacityRule, RenderSettings, Scene, TransferFunction,
};
use rayset::scene_file::SceneFile;
use rayset::storage::{Behaviour, FarOptions, FarStorage, FileStorage, SimulatedObject, Storage};
use rayset::working_set::Limits;
use rayset::{Cloud, Grid, Prediction, Session};

const LATENCY: Duration = Duration::from_millis(50);
const IN_FLIGHT: u64 = 64;

/// A scene over files that are near or far.
struct Look {
    name: String,
    scene: Scene,
    settings: RenderSettings,
    camera: Camera,
}

struct Case {
    near: Look,
    far: Look,
    objects: Vec<Arc<SimulatedObject>>,
    page_bytes: u64,
    all_bytes: u64,
    /// Parts of all pages that fit, one in so many.
    parts: Vec<u64>,
}

fn main() {
    let words: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with("--")).collect();
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("far_storage");
    std::fs::create_dir_all(&folder).expect("a folder");
    println!(
        "| case | in memory | predictor | in core s | s | bound s | of bound | pages | reads | requests a page | most at once |"
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
    cases.extend(figure.map(|folder| figure_10(Path::new(folder))));
    let only: Vec<&String> =
        words.iter().filter(|word| !word.contains('=') && *word != "predictors").collect();
    for case in &cases {
        if !only.is_empty() && !only.iter().any(|word| case.near.name.contains(word.as_str())) {
            continue;
        }
        let in_core = case.in_core();
        for &part in parts.as_ref().unwrap_or(&case.parts) {
            case.measure(Prediction::Packet, part, in_core, 5);
            if predictors {
                case.measure(Prediction::Line, part, in_core, 1);
                case.measure(Prediction::None, part, in_core, 1);
            }
        }
    }
}

fn far(path: &Path) -> (Arc<SimulatedObject>, Arc<FarStorage>) {
    let behaviour = Behaviour { latency: LATENCY, jitter: 0.2, ..Behaviour::default() };
    let near = FileStorage::open(path, false).expect("the file");
    let length = near.length().expect("its length");
    let object = Arc::new(SimulatedObject::new(Arc::new(near), behaviour, 1).expect("a thread"));
    let storage = FarStorage::new(object.clone(), length, FarOptions::default()).expect("a thread");
    (object, Arc::new(storage))
}

fn far_cloud(path: &Path) -> (Arc<SimulatedObject>, Arc<Cloud>) {
    let (object, storage) = far(path);
    let cloud = Cloud::from_storage(&path.display().to_string(), storage).expect("a cloud");
    (object, Arc::new(cloud))
}

fn sphere(folder: &Path, name: &str, translucent: bool) -> Case {
    let workload: Workload = name.parse().expect("a workload");
    let path = folder.join(format!("{name}.rset"));
    if !path.exists() {
        let options = BuildOptions::default().with_radius(workload.radius().map(Rule::Number));
        build::to_file(vec![workload.source()], &path, &options, &BuildControl::default()).expect("a build");
    }
    let near = Arc::new(Cloud::open(&path).expect("a cloud"));
    let (object, far) = far_cloud(&path);
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
        far: look(&far),
        objects: vec![object],
        parts: vec![10],
    }
}

fn figure_10(folder: &Path) -> Case {
    let path = folder.join("fig10.json");
    let text = std::fs::read_to_string(&path).expect("the scene");
    let place = |name: &str| folder.join(name);
    let (scan, far_scan) = far_cloud(&place("scan.rset"));
    let (other, far_other) = far_cloud(&place("other.rset"));
    let (volume, storage) = far(&place("volume.rset"));
    let name = place("volume.rset").display().to_string();
    let grid = Arc::new(Grid::from_storage(&name, storage).expect("a grid"));
    let look = |file: SceneFile| Look {
        name: "figure 10".into(),
        camera: file.camera,
        settings: file.settings.with_size(1024, 1024),
        scene: file.scene,
    };
    let near = SceneFile::parse(&path, &text).expect("a scene");
    let far = SceneFile::parse_using(
        &path,
        &text,
        &[far_scan.clone(), far_other.clone()],
        std::slice::from_ref(&grid),
    );
    let all_bytes = far_scan.header().file_bytes + far_other.header().file_bytes + grid.header().file_bytes;
    Case {
        page_bytes: far_scan.header().page_bytes.into(),
        all_bytes,
        near: look(near),
        far: look(far.expect("a scene")),
        objects: vec![scan, other, volume],
        parts: vec![1, 2],
    }
}

impl Case {
    /// Seconds with all pages in memory, where they have been read before.
    fn in_core(&self) -> f64 {
        let session = Session::builder().page_limits(Limits::total(1 << 30)).threads(1).build();
        let session = session.expect("a session");
        let times: Vec<f64> = (0..6).map(|_| render(&session, &self.near)).collect();
        median(&times[1..])
    }

    fn measure(&self, prediction: Prediction, part: u64, in_core: f64, repeat: usize) {
        // Shadows are pages, too; they have their own memory besides.
        let shadows = if self.objects.len() > 1 { 64 << 20 } else { 0 };
        let budget = (self.all_bytes / self.page_bytes / part * self.page_bytes).max(4 * self.page_bytes);
        let session = Session::builder()
            .page_limits(Limits::total(budget + shadows))
            .threads(1)
            .prediction(prediction)
            .build()
            .expect("a session");
        let (mut seconds, mut requests, mut pages, mut reads, mut most) = (Vec::new(), 0, 0, 0, 0);
        for _ in 0..repeat {
            session.evict_all();
            session.reset_statistics();
            self.objects.iter().for_each(|object| object.reset_counts());
            seconds.push(render(&session, &self.far));
            let counts: Vec<_> = self.objects.iter().map(|object| object.counts()).collect();
            requests = counts.iter().map(|counts| counts.requests).sum();
            most = counts.iter().map(|counts| counts.most_at_once).max().unwrap_or(0);
            let statistics = session.statistics();
            pages = statistics.total(|kind| kind.bytes_unique) / self.page_bytes;
            reads = statistics.total(|kind| kind.reads);
        }
        let transfer = pages as f64 * LATENCY.as_secs_f64() / IN_FLIGHT as f64;
        let bound = 1.3 * in_core.max(transfer) + 10.0 * LATENCY.as_secs_f64();
        let taken = median(&seconds);
        println!(
            "| {} | 1/{part} | {} | {in_core:.3} | {taken:.3} | {bound:.3} | {:.2} | {pages} | {reads} | {:.2} | {most} |",
            self.far.name,
            prediction.name(),
            taken / bound,
            requests as f64 / pages.max(1) as f64,
        );
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

//! What renders cost, block by block: the measurements of `benches/scaling/simulate.py`, which runs
//! this.
//!
//!     scaling cloud mesh=FILE points=N out=FILE [radius=R]
//!     scaling trace cloud=FILE size=WxH [look=opaque] [unit=32] [field=30] [frames=1]
//!                   [turn=DEGREES]
//!     scaling remote cloud=FILE size=WxH [look=opaque] [part=1/1] [threads=1] [memory=BYTES]
//!                 [latency=SECONDS]
//!
//! `cloud` makes a cloud of points on a mesh, evenly by area.
//! `trace` renders in core, on one thread, and prints of each square of `unit` pixels (a block
//! has 32): column, row, nanoseconds, and the pages that its rays ask for. `remote` renders a part
//! from a simulated object: each request takes the latency, 20 % more or less, and at most 64
//! are in flight. Both print JSON.
#![allow(clippy::print_stdout, reason = "it prints what it measured")]

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use rayset::PagedFiles;
use rayset::build::{BuildControl, BuildOptions, Rule};
use rayset::geometry::DVec3;
use rayset::octree::Cloud;
use rayset::parts::{PartOptions, Share};
use rayset::points::{MeshSource, PointSource};
use rayset::scene::{
    Camera, CloudObject, ColorRule, Lighting, OpacityRule, RenderSettings, Scene, TransferFunction,
};
use rayset::storage::{FileStorage, RemoteOptions, RemoteStorage, Storage};
use rayset::trace::predict::{Lookahead, NoPredictor, Predictor};
use rayset::trace::{ExecSettings, render_once};
use rayset::working_set::read::{self, BackendKind};
use rayset::working_set::{Limits, WorkingSet};
use rayset::{CancelToken, Session};
use rayset_lab::requests::RequestLog;
use rayset_lab::simulated::{Behaviour, SimulatedObject};
use serde_json::json;

fn main() {
    let words: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with("--")).collect();
    let options = Options(words.iter().filter_map(|word| word.split_once('=')).collect());
    match words.first().map(String::as_str) {
        Some("cloud") => make_cloud(&options),
        Some("trace") => trace(&options),
        Some("remote") => remote(&options),
        _ => println!("scaling cloud|trace|remote KEY=VALUE…; see the head of this file"),
    }
}

struct Options<'a>(HashMap<&'a str, &'a str>);

impl Options<'_> {
    fn text(&self, key: &str, default: &str) -> String {
        (*self.0.get(key).unwrap_or(&default)).to_owned()
    }

    fn number(&self, key: &str, default: f64) -> f64 {
        self.0.get(key).map_or(default, |text| text.parse().expect("a number"))
    }

    fn size(&self) -> (u32, u32) {
        let text = self.text("size", "512x512");
        let (width, height) = text.split_once('x').expect("WIDTHxHEIGHT");
        (width.parse().expect("a width"), height.parse().expect("a height"))
    }
}

/// With automatic radii, unless one is given.
fn make_cloud(options: &Options<'_>) {
    let (mesh, out) = (options.text("mesh", ""), options.text("out", "cloud.rset"));
    let mut source =
        MeshSource::open(Path::new(&mesh), options.number("points", 1e6) as u64).expect("a mesh");
    let radius = options.number("radius", 0.0);
    let radius = (radius > 0.0).then_some(Rule::Number(radius));
    let build_options = BuildOptions { radius, ..BuildOptions::default() };
    PointSource::select(&mut source, &[]);
    let started = Instant::now();
    rayset::octree::build::run(
        vec![Box::new(source)],
        Path::new(&out),
        &build_options,
        &BuildControl::default(),
    )
    .expect("a cloud");
    let seconds = started.elapsed().as_secs_f64();
    let cloud = Cloud::open(Path::new(&out)).expect("it opens");
    println!(
        "{}",
        json!({"points": cloud.header().points, "radius": cloud.header().radius_mean, "seconds": seconds})
    );
}

/// Notes when each tile begins, and where its requests do; predicts nothing.
struct Marks {
    log: Arc<RequestLog>,
    tiles: Mutex<Vec<(usize, usize, Instant)>>,
}

impl Predictor for Marks {
    fn ahead(&self, _: Lookahead<'_>, tile: usize) {
        let requests = self.log.len();
        self.tiles.lock().expect("nobody panicked").push((tile, requests, Instant::now()));
    }
    fn slabs_on_a_miss(&self) -> u64 {
        0
    }
    fn name(&self) -> &'static str {
        "none"
    }
}

fn scene(options: &Options<'_>, cloud: &Arc<Cloud>, turn: f64) -> (Scene, RenderSettings, Camera) {
    let radius = cloud.header().radius_mean;
    let translucent = options.text("look", "opaque") == "translucent";
    let (kappa, stop) = if translucent { (0.02, 0.0) } else { (2.0, 0.01) };
    let transfer = TransferFunction {
        opacity: OpacityRule::Extinction(kappa / radius),
        color: ColorRule::Uniform([1.0; 3]),
    };
    let object = CloudObject { transfer, ..CloudObject::plain(cloud.clone()) };
    let (width, height) = options.size();
    let settings =
        RenderSettings { width, height, ..RenderSettings::default().with_stop_transmittance(stop) };
    // The longest extent is up, and fills nine tenths of the height.
    let bounds = cloud.header().bounds;
    let (middle, extent) = ((bounds.min + bounds.max) / 2.0, bounds.max - bounds.min);
    let up = if extent.y > extent.z { DVec3::Y } else { DVec3::Z };
    let ahead = if extent.y > extent.z { DVec3::Z } else { DVec3::Y };
    let field = options.number("field", 30.0).to_radians();
    let distance = extent.dot(up) / 1.8 / (field / 2.0).tan() + extent.dot(ahead) / 2.0;
    let (sin, cos) = turn.to_radians().sin_cos();
    let eye = middle + (ahead * cos + up.cross(ahead) * sin + up * 0.1) * distance;
    (
        Scene { lighting: Lighting::Unlit, ..Scene::of_cloud(object) },
        settings,
        Camera::look_at(eye, middle, up, field),
    )
}

fn trace(options: &Options<'_>) {
    let cloud = Arc::new(Cloud::open(Path::new(&options.text("cloud", ""))).expect("a cloud"));
    let backend = read::backend(BackendKind::Auto).expect("a way to read");
    let mut paged = PagedFiles::new(WorkingSet::new(Limits::total(cloud.header().file_bytes), backend));
    paged.open(&cloud, false).expect("the cloud opens");
    let edge = options.number("unit", 32.0) as u32;
    let mut frames = Vec::new();
    let log = RequestLog::of(&paged.pages);
    for frame in 0..options.number("frames", 1.0) as u32 {
        let (scene, settings, camera) =
            scene(options, &cloud, options.number("turn", 0.0) * f64::from(frame));
        let still = ExecSettings { threads: 1, predictor: Arc::new(NoPredictor), ..ExecSettings::default() };
        render_once(&scene, &camera, &settings, &still, &paged).expect("a picture");
        let marks = Arc::new(Marks { log: log.clone(), tiles: Mutex::default() });
        let exec = ExecSettings { predictor: marks.clone(), ..still };
        let session = Session::over(paged.clone(), exec.clone()).expect("a session");
        let view = session.prepare(&scene, &settings).expect("a scene").view(&camera).expect("a view");
        let tiles = view.tiles(&view.region());
        drop((view, session));
        log.begin();
        let (_, counts) = render_once(&scene, &camera, &settings, &exec, &paged).expect("a picture");
        let ended = Instant::now();
        let requests = log.end();
        let mut starts = marks.tiles.lock().expect("nobody panicked").clone();
        starts.push((0, requests.len(), ended));
        let mut blocks: BTreeMap<(u32, u32), (u128, BTreeSet<u32>)> = BTreeMap::new();
        for ends in starts.windows(2) {
            let tile = &tiles[ends[0].0];
            let block = blocks.entry((tile.y / edge, tile.x / edge)).or_default();
            block.0 += (ends[1].2 - ends[0].2).as_nanos();
            block.1.extend(requests[ends[0].1..ends[1].1].iter().map(|request| request.page));
        }
        let blocks: Vec<_> =
            blocks.iter().map(|(&(j, i), (ns, pages))| json!([i, j, *ns as u64, pages])).collect();
        frames.push(
            json!({"blocks": blocks, "evaluations": counts.splats.kernel_evaluations, "runs": counts.runs}),
        );
    }
    let header = cloud.header();
    println!(
        "{}",
        json!({
            "points": header.points, "point_pages": header.point_pages, "node_pages": header.node_pages,
            "nodes": header.nodes, "page_bytes": header.page_bytes, "file_bytes": header.file_bytes,
            "first_node_page": header.point_pages, "frames": frames,
        })
    );
}

fn remote(options: &Options<'_>) {
    let path = options.text("cloud", "");
    let near = FileStorage::open(Path::new(&path), false).expect("the file");
    let length = near.length().expect("its length");
    let latency = Duration::from_secs_f64(options.number("latency", 0.05));
    let behaviour = Behaviour { latency, jitter: 0.2, ..Behaviour::default() };
    let object = Arc::new(SimulatedObject::new(Arc::new(near), behaviour, 1).expect("a thread"));
    let storage = RemoteStorage::new(object.clone(), length, RemoteOptions::default()).expect("a thread");
    let opening = Instant::now();
    let cloud = Arc::new(Cloud::from_storage(&path, Arc::new(storage)).expect("a cloud"));
    let opened = opening.elapsed().as_secs_f64();
    let opening_requests = object.counts().requests;
    let memory = options.number("memory", cloud.header().file_bytes as f64 + 1e6) as u64;
    let threads = options.number("threads", 1.0) as usize;
    let session =
        Session::builder().page_limits(Limits::total(memory)).threads(threads).build().expect("a session");
    let (scene, settings, camera) = scene(options, &cloud, 0.0);
    let share: Share = options.text("part", "1/1").parse().expect("a part");
    for repeat in 0..options.number("repeat", 3.0) as u32 {
        if options.number("warm", 0.0) < 1.0 || repeat == 0 {
            session.evict_all();
        }
        session.reset_statistics();
        object.reset_counts();
        let started = Instant::now();
        let view = session.prepare(&scene, &settings).expect("a scene").view(&camera).expect("a view");
        let mut sink = Vec::new();
        view.render_part(
            &view.region(),
            &PartOptions::new(share),
            &CancelToken::new(),
            &mut |_, _| (),
            &mut sink,
        )
        .expect("a part");
        let seconds = started.elapsed().as_secs_f64();
        let (counts, statistics) = (object.counts(), session.statistics());
        println!(
            "{}",
            json!({
                "seconds": seconds, "opened": opened, "opening_requests": opening_requests,
                "requests": counts.requests, "bytes": counts.bytes, "most_at_once": counts.most_at_once,
                "unique": statistics.total(|kind| kind.bytes_unique) / u64::from(cloud.header().page_bytes),
                "reads": statistics.total(|kind| kind.reads), "part_bytes": sink.len(),
            })
        );
    }
}

//! How many pages a render reads where a tile needs more of them than fit, beside rules of eviction
//! that know the future: `cargo bench -p rayset --bench page_reads`; a word like `cube` picks among
//! the cases.
//!
//! The requests of a render on one thread without prediction are recorded, tile by tile. Of the
//! same requests, Belady's rule reads the fewest pages that any rule of eviction can; `LRU` evicts
//! the least recently used page. Then the same is rendered in the budget, with and without
//! prediction. Counts, not times: they do not depend on what else the machine does.
#![allow(clippy::print_stdout, reason = "it prints what it counted")]

use std::collections::{BTreeSet, HashMap};
use std::path::Path;
use std::sync::{Arc, Mutex};

use rayset::PagedFiles;
use rayset::build::{BuildControl, BuildOptions, Rule};
use rayset::geometry::curve::hilbert_order;
use rayset::octree::Cloud;
use rayset::points::Workload;
use rayset::scene::{
    Camera, CloudObject, ColorRule, Lighting, OpacityRule, RenderSettings, Scene, TransferFunction,
};
use rayset::trace::predict::{Lookahead, NoPredictor, PacketPredictor, Predictor};
use rayset::trace::{ExecSettings, render_once};
use rayset::working_set::read::{self, BackendKind};
use rayset::working_set::{Limits, WorkingSet};
use rayset_lab::requests::{RequestLog, least_reads};

/// A workload, translucent or not, in a picture of so many pixels along each side, and the parts of
/// its pages that fit.
struct Case {
    workload: &'static str,
    translucent: bool,
    side: u32,
    budgets: &'static [Budget],
}

#[derive(Clone, Copy)]
enum Budget {
    /// One page in so many.
    Part(u64),
    Bytes(u64),
}

const CASES: &[Case] = &[
    Case::of("cube-1m", true, 128, &[Budget::Part(10), Budget::Part(64)]),
    Case::of("cube-1m", false, 128, &[Budget::Part(10), Budget::Part(64)]),
    Case::of("sphere-10m", true, 128, &[Budget::Bytes(4 << 20), Budget::Part(64)]),
    Case::of("sphere-10m", false, 128, &[Budget::Bytes(4 << 20), Budget::Part(64)]),
    Case::of("cube-20m", true, 32, &[Budget::Bytes(8 << 20), Budget::Bytes(4 << 20), Budget::Part(64)]),
    Case::of("cube-20m", false, 32, &[Budget::Bytes(4 << 20), Budget::Part(64)]),
];

fn main() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("page_reads");
    std::fs::create_dir_all(&folder).expect("a folder");
    let word = std::env::args().skip(1).find(|word| !word.starts_with('-')).unwrap_or_default();
    println!(
        "| workload | pages | a tile asks for | fit | none | packet | Belady | LRU | Belady, other orders of tiles |"
    );
    println!("| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | --- |");
    for case in CASES.iter().filter(|case| case.workload.contains(&word)) {
        case.print(&folder);
    }
}

/// Notes where the requests of each tile begin, and predicts nothing.
struct Marks {
    log: Arc<RequestLog>,
    tiles: Mutex<Vec<usize>>,
}

impl Predictor for Marks {
    fn ahead(&self, _: Lookahead<'_>, _: usize) {
        self.tiles.lock().expect("nobody panicked").push(self.log.len());
    }
    fn slabs_on_a_miss(&self) -> u64 {
        0
    }
    fn name(&self) -> &'static str {
        "none"
    }
}

impl Case {
    const fn of(workload: &'static str, translucent: bool, side: u32, budgets: &'static [Budget]) -> Self {
        Self { workload, translucent, side, budgets }
    }

    fn print(&self, folder: &Path) {
        let cloud = cloud(folder, self.workload);
        let tiles = self.requests(&cloud);
        let mut distinct: Vec<usize> =
            tiles.iter().map(|tile| tile.iter().collect::<BTreeSet<_>>().len()).collect();
        distinct.sort_unstable();
        for budget in self.budgets {
            let header = cloud.header();
            let page = u64::from(header.page_bytes);
            let fit = match *budget {
                Budget::Part(part) => u64::from(header.pages()) / part,
                Budget::Bytes(bytes) => bytes / page,
            }
            .max(4);
            let whole: Vec<u32> = tiles.concat();
            let orders = orders(&tiles, self.side / 8)
                .map(|(name, order)| format!("{name} {}", least_reads(&order.concat(), fit as usize)));
            println!(
                "| {} {} {}² | {} | {} to {} | {fit} | {} | {} | {} | {} | {} |",
                self.workload,
                if self.translucent { "translucent" } else { "opaque" },
                self.side,
                header.pages(),
                distinct[distinct.len() / 2],
                distinct[distinct.len() - 1],
                self.reads(&cloud, Arc::new(NoPredictor), fit * page),
                self.reads(&cloud, Arc::new(PacketPredictor::default()), fit * page),
                least_reads(&whole, fit as usize),
                least_recently_used(&whole, fit as usize),
                orders.join(", "),
            );
        }
    }

    /// The pages that each tile asks for, one after the other.
    fn requests(&self, cloud: &Arc<Cloud>) -> Vec<Vec<u32>> {
        let paged = paged(cloud, cloud.header().file_bytes);
        let log = RequestLog::of(&paged.pages);
        let marks = Arc::new(Marks { log: log.clone(), tiles: Mutex::default() });
        log.begin();
        self.render(cloud, marks.clone(), &paged);
        let requests: Vec<u32> = log.end().iter().map(|request| request.page).collect();
        let mut marks = marks.tiles.lock().expect("nobody panicked").clone();
        marks.push(requests.len());
        let tiles = marks.windows(2).map(|ends| {
            let mut tile = requests[ends[0]..ends[1]].to_vec();
            tile.dedup();
            tile
        });
        tiles.collect()
    }

    fn reads(&self, cloud: &Arc<Cloud>, predictor: Arc<dyn Predictor>, bytes: u64) -> u64 {
        let paged = paged(cloud, bytes);
        self.render(cloud, predictor, &paged);
        paged.pages.statistics().total(|kind| kind.reads)
    }

    fn render(&self, cloud: &Arc<Cloud>, predictor: Arc<dyn Predictor>, paged: &PagedFiles) {
        let radius = cloud.header().radius_mean;
        let (kappa, stop_transmittance) = if self.translucent { (0.02, 0.0) } else { (2.0, 0.01) };
        let object = CloudObject {
            transfer: TransferFunction {
                opacity: OpacityRule::Extinction(kappa / radius),
                color: ColorRule::Uniform([1.0; 3]),
            },
            ..CloudObject::plain(cloud.clone())
        };
        let scene = Scene { lighting: Lighting::Unlit, ..Scene::of_cloud(object) };
        let view = self.workload.parse::<Workload>().expect("a workload").view();
        let camera = Camera::look_at(view.position, view.look_at, view.up, view.fovy_degrees.to_radians());
        let settings = RenderSettings {
            stop_transmittance,
            width: self.side,
            height: self.side,
            ..RenderSettings::default()
        };
        let exec = ExecSettings { threads: 1, predictor, ..ExecSettings::default() };
        render_once(&scene, &camera, &settings, &exec, paged).expect("a picture");
    }
}

fn cloud(folder: &Path, name: &str) -> Arc<Cloud> {
    let path = folder.join(format!("{name}.rset"));
    if !path.exists() {
        let workload: Workload = name.parse().expect("a workload");
        let options = BuildOptions { radius: workload.radius().map(Rule::Number), ..BuildOptions::default() };
        rayset::octree::build::run(vec![workload.source()], &path, &options, &BuildControl::default())
            .expect("a cloud");
    }
    Arc::new(Cloud::open(&path).expect("it opens"))
}

fn paged(cloud: &Arc<Cloud>, bytes: u64) -> PagedFiles {
    let backend = read::backend(BackendKind::Auto).expect("a way to read");
    let mut paged = PagedFiles::new(WorkingSet::new(Limits::total(bytes), backend));
    paged.open(cloud, false).expect("the cloud opens");
    paged
}

/// The tiles in other orders, named. They were recorded in the order of
/// [`View::tiles`](rayset::View::tiles): squares of 4 by 4 along a curve, and the tiles in each
/// along the curve of the whole picture.
fn orders(tiles: &[Vec<u32>], side: u32) -> [(&'static str, Vec<Vec<u32>>); 3] {
    let mut recorded = hilbert_order(side, side);
    let mut place = HashMap::new();
    for (at, square) in hilbert_order(side.div_ceil(4), side.div_ceil(4)).into_iter().enumerate() {
        place.insert(square, at);
    }
    recorded.sort_by_key(|&(i, j)| place[&(i / 4, j / 4)]);
    let at: HashMap<(u32, u32), usize> = recorded.iter().enumerate().map(|(at, &tile)| (tile, at)).collect();
    let ordered = |order: Vec<(u32, u32)>| order.iter().map(|tile| tiles[at[tile]].clone()).collect();
    let rows = |turning: bool| {
        let row = move |j: u32| {
            (0..side).map(move |i| if turning && j % 2 == 1 { (side - 1 - i, j) } else { (i, j) })
        };
        (0..side).flat_map(row).collect()
    };
    [
        ("Hilbert", ordered(hilbert_order(side, side))),
        ("boustrophedon", ordered(rows(true))),
        ("rows", ordered(rows(false))),
    ]
}

/// Pages read where the least recently used one is evicted.
fn least_recently_used(requests: &[u32], fit: usize) -> usize {
    let mut last_use: HashMap<u32, usize> = HashMap::new();
    let mut by_last_use: BTreeSet<(usize, u32)> = BTreeSet::new();
    let mut reads = 0;
    for (now, &page) in requests.iter().enumerate() {
        match last_use.insert(page, now) {
            Some(before) => drop(by_last_use.remove(&(before, page))),
            None => {
                reads += 1;
                if last_use.len() > fit
                    && let Some((_, oldest)) = by_last_use.pop_first()
                {
                    last_use.remove(&oldest);
                }
            }
        }
        by_last_use.insert((now, page));
    }
    reads
}

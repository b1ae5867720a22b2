//! How often pages are read where a tile needs more of them than fit.

use std::sync::{Arc, Mutex};

use rayset::octree::Cloud;
use rayset::octree::build::{BuildOptions, Rule};
use rayset::points::Workload;
use rayset::scene::{CloudObject, ColorRule, Lighting, OpacityRule, Scene, TransferFunction};
use rayset::trace::memory::least_pages;
use rayset::trace::predict::{Lookahead, NoPredictor, PacketPredictor, Predictor};
use rayset::trace::{ExecSettings, render_once};
use rayset_lab::requests::{RequestLog, Requested, least_reads};

use crate::common::{bits, build_at, camera, folder, paged, plain_picture, settings};

/// Notes how many requests each tile begins after, and predicts nothing.
struct Marks(Arc<RequestLog>, Mutex<Vec<usize>>);

impl Predictor for Marks {
    fn ahead(&self, _: Lookahead<'_>, _: usize) {
        self.1.lock().expect("nobody panicked").push(self.0.len());
    }
    fn slabs_on_a_miss(&self) -> u64 {
        0
    }
    fn name(&self) -> &'static str {
        "none"
    }
}

/// A cube full of points, in small pages, seen through or not.
fn cube(folder: &std::path::Path, translucent: bool) -> Scene {
    let workload: Workload = "cube-700k".parse().expect("a workload");
    let radius = workload.radius().map(Rule::Number);
    let options = BuildOptions { page_bytes: Some(16 << 10), radius, ..BuildOptions::default() };
    let cloud: Arc<Cloud> =
        build_at(&folder.join(format!("cube-{translucent}.rset")), workload.source(), &options);
    let kappa = if translucent { 0.02 } else { 2.0 } / cloud.header().radius_mean;
    let object = CloudObject {
        transfer: TransferFunction {
            opacity: OpacityRule::Extinction(kappa),
            color: ColorRule::Uniform([1.0; 3]),
        },
        ..CloudObject::plain(cloud)
    };
    Scene { lighting: Lighting::Unlit, ..Scene::of_cloud(object) }
}

fn exec(predictor: Arc<dyn Predictor>) -> ExecSettings {
    ExecSettings { threads: 1, predictor, ..ExecSettings::default() }
}

/// What a render asks for, and the pages that it reads without prediction and with.
struct Reads {
    requests: Vec<Requested>,
    none: u64,
    packet: u64,
}

fn reads(scene: &Scene, fit: u64) -> Reads {
    let settings = settings(48, 48);
    let page = u64::from(crate::common::clouds_of(scene)[0].header().page_bytes);
    let all = paged(scene, 1 << 30);
    let log = RequestLog::of(&all.pages);
    log.begin();
    let marks = Arc::new(Marks(log.clone(), Mutex::default()));
    render_once(scene, &camera(), &settings, &exec(marks.clone()), &all).expect("a picture");
    assert_eq!(marks.1.lock().expect("nobody panicked").len(), 36, "tiles, each attempted once");
    let expected = bits(&plain_picture(scene, &settings));
    let of = |predictor: Arc<dyn Predictor>| {
        let paged = paged(scene, fit * page);
        let (picture, _) =
            render_once(scene, &camera(), &settings, &exec(predictor), &paged).expect("a picture");
        assert!(bits(&picture.pixels) == expected, "{fit} pages");
        paged.pages.statistics().total(|kind| kind.reads)
    };
    Reads {
        requests: log.end(),
        none: of(Arc::new(NoPredictor)),
        packet: of(Arc::new(PacketPredictor::default())),
    }
}

#[test]
fn tiles_that_need_more_pages_than_fit_read_at_most_1_3_times_what_beladys_rule_would() {
    let folder = folder();
    for translucent in [true, false] {
        let scene = cube(folder.path(), translucent);
        let pages = u64::from(crate::common::clouds_of(&scene)[0].header().pages());
        for part in [64, 10] {
            let fit = (pages / part).max(least_pages(1));
            let Reads { requests, none, packet } = reads(&scene, fit);
            let least = least_reads(&requests, fit as usize);
            let what = format!(
                "translucent: {translucent}, {fit} of {pages} pages: none reads {none}, packet {packet}, Belady {least}"
            );
            // With a tenth of its pages the opaque cube reads hardly any page twice.
            let most = if part == 64 || translucent { 1.3 } else { 1.4 };
            assert!(none as f64 <= most * least as f64, "{what}");
            assert!(part != 64 || packet as f64 <= 1.05 * none as f64, "{what}");
        }
    }
}

//! Table 3 and Fig. 12: twenty objects under three lights, over 1 to 10 point sets.

use std::cell::RefCell;
use std::collections::HashMap;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context as _, Result};
use rayset::octree::Cloud;
use rayset::scene::{Camera, CloudObject, RenderSettings, Scene};
use rayset::trace::predict::NoPredictor;
use rayset::trace::reference::PointField;
use rayset::working_set::read::{self, BackendKind};

use super::sets::{OBJECTS, scene, shipping_cpu_seconds, view};
use super::{BATCH, Setting, Subject, differing, median, object, same_picture_note, scan_or, shipping};
use crate::disk::RealDisk;
use crate::engine::{self, IndexField, all_pixels};
use crate::index::{Index, Limits};
use crate::predict::Variant;
use crate::records::{Budget, OutOfCore};
use crate::report::{Series, Table, number, plot};

/// Point sets; the paper's seconds of preprocessing and of rendering.
const PAPER: [(usize, f64, f64); 5] =
    [(1, 57.0, 13.8), (2, 114.8, 13.9), (4, 230.9, 14.5), (8, 470.7, 16.8), (10, 589.0, 16.8)];

pub(super) fn run(setting: &Setting) -> Result<()> {
    let side = setting.pick(16, 40);
    // The engine that ships would have too little to do for a time.
    let shipping_side = setting.pick(24, 112);
    let repeats = setting.pick(1, 7);
    let sets_wanted: &[_] = setting.pick(&PAPER[..2], &PAPER[..]);
    let folder = setting.work.join("table3");
    std::fs::create_dir_all(&folder)?;
    let mut clouds: Vec<Arc<Cloud>> = Vec::new();
    let mut indices: Vec<Index> = Vec::new();
    let mut preparing = Vec::new();
    let most = sets_wanted.last().map_or(1, |last| last.0);
    for set in 0..most {
        let started = Instant::now();
        let path = folder.join(format!("{set}.rset"));
        let source = scan_or(setting, setting.pick("vase-2k", "vase-35947"))?;
        let subject = Subject::build(source, None, side, &path)?;
        let building = started.elapsed().as_secs_f64();
        let index = subject.index(&folder.join(set.to_string()), Limits { height: 7, leaf_points: 32 })?;
        preparing.push((building, index.summary.build.as_secs_f64()));
        clouds.push(subject.cloud);
        indices.push(index);
    }
    let mut table = Table::new(
        "Table 3 and Fig. 12: many point sets",
        &[
            "point sets",
            "preprocessing: paper s",
            "reference s",
            "shipping s",
            "rendering: paper s",
            "reference s",
            "shipping, cold s",
            "of one set",
            "warm s",
            "of one set",
        ],
    );
    let names = ["paper", "reference", "shipping"];
    let mut lines = names.map(|name| Series { name: name.into(), points: Vec::new() });
    let scenes: Vec<(usize, Scene)> =
        sets_wanted.iter().map(|&(sets, ..)| (sets, scene(&clouds[..sets]))).collect();
    let (camera, settings, step) = view(&scenes[0].1, &clouds[0], side);
    // Runs take turns, so that what else the machine does meets all alike.
    let larger = RenderSettings { width: shipping_side, height: shipping_side, ..settings };
    let mut rounds: Vec<Round> = Vec::new();
    for _ in 0..repeats {
        let mut round = Round::new();
        for (_, scene) in &scenes {
            let (cold, warm) = shipping_cpu_seconds(scene, &camera, &larger)?;
            round.push([cold, warm]);
        }
        rounds.push(round);
    }
    let medians: Vec<[Timing; 2]> = (0..scenes.len())
        .map(|place| {
            [0, 1].map(|state| Timing::of(&rounds, |round: &Round| (round[place][state], round[0][state])))
        })
        .collect();
    let mut worst: f64 = 0.0;
    for (place, &(sets, paper_preparing, paper_rendering)) in sets_wanted.iter().enumerate() {
        let scene = &scenes[place].1;
        let started = Instant::now();
        let picture = reference(scene, &clouds, &indices, sets, (&camera, &settings, step))?;
        let reference_seconds = started.elapsed().as_secs_f64();
        let backend = read::backend(BackendKind::Auto)?;
        let predictor = Arc::new(NoPredictor);
        let (shipped, ..) = shipping(scene, (&camera, &settings), 1 << 40, backend, predictor)?;
        worst = worst.max(differing(&picture, &shipped));
        let sum = |of: fn(&(f64, f64)) -> f64| preparing[..sets].iter().map(of).sum::<f64>();
        for (line, seconds) in
            lines.iter_mut().zip([paper_rendering, reference_seconds, medians[place][0].seconds])
        {
            line.points.push((sets as f64, seconds));
        }
        table.row([
            sets.to_string(),
            number(paper_preparing),
            number(sum(|p| p.1)),
            number(sum(|p| p.0)),
            number(paper_rendering),
            number(reference_seconds),
            number(medians[place][0].seconds),
            medians[place][0].more(),
            number(medians[place][1].seconds),
            medians[place][1].more(),
        ]);
    }
    std::fs::remove_dir_all(&folder)?;
    table.note(format!(
        "{OBJECTS} objects of {} points, three lights with exact shadows, {side}×{side} rays. Reference: out of core on \
         this machine's disk, direct reads, caches of 8192 nodes and 4096 points a set, `line`, one run: more sets have more \
         caches together; its preprocessing begins with the shipping engine's file. Shipping: {shipping_side}×{shipping_side} rays, one thread, processor seconds of the process, \
         nothing in memory (cold) and all pages in memory (warm), medians of {repeats} rounds in which the numbers of sets \
         take turns; of one set: the median of what each is of the same round's single set.",
        clouds[0].header().points
    ));
    table.note(same_picture_note(worst));
    table.write(&setting.out, "table3")?;
    plot(
        &setting.out.join("table3.svg"),
        "Fig. 12: rendering by point sets",
        ("point sets", "seconds"),
        &lines,
    )
}

/// Processor seconds by number of sets, cold and warm, of runs that follow each other.
type Round = Vec<[f64; 2]>;

/// Medians over rounds.
struct Timing {
    seconds: f64,
    /// Of one set in the same round, so that what else the machine does meets both.
    of_one_set: f64,
}

impl Timing {
    /// `pick` finds a time, and that of one set.
    fn of(rounds: &[Round], pick: impl Fn(&Round) -> (f64, f64)) -> Self {
        let (mut seconds, mut ratios): (Vec<f64>, Vec<f64>) =
            rounds.iter().map(pick).map(|(time, one)| (time, time / one)).unzip();
        Self { seconds: median(&mut seconds), of_one_set: median(&mut ratios) }
    }

    fn more(&self) -> String {
        format!("{:+.1} %", 100.0 * (self.of_one_set - 1.0))
    }
}

fn reference(
    scene: &Scene,
    clouds: &[Arc<Cloud>],
    indices: &[Index],
    sets: usize,
    view: (&Camera, &RenderSettings, f64),
) -> Result<engine::Picture> {
    let failure = Rc::new(RefCell::new(None));
    let mut fields = HashMap::new();
    for (cloud, index) in clouds.iter().zip(indices).take(sets) {
        let disk = RealDisk::open(&index.files(), true, BackendKind::Auto)?;
        let budget = Budget { nodes: 8192, points: 4096 };
        let records = OutOfCore::new(Box::new(disk), budget, BATCH, true, None);
        let records = Rc::new(RefCell::new(records));
        let field = IndexField::new(&object(cloud), true, Variant::Line, records, failure.clone());
        fields.insert(Arc::as_ptr(cloud), field);
    }
    // Objects of one set share its controllers, its path and its predictor.
    let known =
        |object: &CloudObject| fields.get(&Arc::as_ptr(&object.cloud)).context("a cloud without an index");
    for cloud in clouds.iter().take(sets) {
        known(&object(cloud))?;
    }
    let first = fields.values().next().context("no point set")?;
    let given = |object: &CloudObject| known(object).unwrap_or(first) as &dyn PointField;
    Ok(engine::render(scene, view, &failure, given, all_pixels(view.1))?)
}

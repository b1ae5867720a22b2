//! Table 3 and Fig. 12: twenty objects under three lights, over 1 to 10 point sets.

use std::cell::RefCell;
use std::collections::HashMap;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context as _, Result};
use rayset::geometry::{DAffine3, DQuat, DVec3};
use rayset::octree::Cloud;
use rayset::scene::{
    Camera, CloudObject, Light, LightKind, Lighting, Node, Operator, RenderSettings, Scene, Shape, Step,
};
use rayset::trace::judge::PointField;
use rayset::trace::predict::NoPredictor;
use rayset::trace::{ExecSettings, WholePicture};
use rayset::working_set::read::{self, BackendKind};
use rayset::working_set::{Limits as WorkingSetLimits, PagedFiles, WorkingSet};

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
const OBJECTS: usize = 20;

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
    let mut shipping_seconds = vec![(Vec::new(), Vec::new()); scenes.len()];
    for _ in 0..repeats {
        for (place, (sets, scene)) in scenes.iter().enumerate() {
            let (cold, warm) = shipping_cpu_seconds(scene, &clouds[..*sets], &camera, &larger)?;
            shipping_seconds[place].0.push(cold);
            shipping_seconds[place].1.push(warm);
        }
    }
    let medians: Vec<(f64, f64)> =
        shipping_seconds.iter_mut().map(|(cold, warm)| (median(cold), median(warm))).collect();
    let mut worst: f64 = 0.0;
    for (place, &(sets, paper_preparing, paper_rendering)) in sets_wanted.iter().enumerate() {
        let scene = &scenes[place].1;
        let started = Instant::now();
        let picture = reference(scene, &clouds, &indices, sets, (&camera, &settings, step))?;
        let reference_seconds = started.elapsed().as_secs_f64();
        let backend = read::backend(BackendKind::Auto)?;
        let predictor = Arc::new(NoPredictor);
        let (shipped, ..) =
            shipping(scene, &clouds[..sets], (&camera, &settings), 1 << 40, backend, predictor)?;
        worst = worst.max(differing(&picture, &shipped));
        let sum = |of: fn(&(f64, f64)) -> f64| preparing[..sets].iter().map(of).sum::<f64>();
        for (line, seconds) in lines.iter_mut().zip([paper_rendering, reference_seconds, medians[place].0]) {
            line.points.push((sets as f64, seconds));
        }
        table.row([
            sets.to_string(),
            number(paper_preparing),
            number(sum(|p| p.1)),
            number(sum(|p| p.0)),
            number(paper_rendering),
            number(reference_seconds),
            number(medians[place].0),
            format!("{:+.1} %", 100.0 * (medians[place].0 / medians[0].0 - 1.0)),
            number(medians[place].1),
            format!("{:+.1} %", 100.0 * (medians[place].1 / medians[0].1 - 1.0)),
        ]);
    }
    std::fs::remove_dir_all(&folder)?;
    table.note(format!(
        "{OBJECTS} objects of {} points, three lights with exact shadows, {side}×{side} rays. Reference: out of core on \
         this machine's disk, direct reads, caches of 8192 nodes and 4096 points a set, `line`, one run: more sets have more \
         caches together; its preprocessing begins with the shipping engine's file. Shipping: {shipping_side}×{shipping_side} rays, one thread, processor seconds of the process, \
         nothing in memory (cold) and all pages in memory (warm), medians of {repeats} runs that take turns.",
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

/// Processor seconds of a render with nothing in memory, and of the same with all pages there.
fn shipping_cpu_seconds(
    scene: &Scene,
    clouds: &[Arc<Cloud>],
    camera: &Camera,
    settings: &RenderSettings,
) -> Result<(f64, f64)> {
    let set = WorkingSet::new(WorkingSetLimits::total(1 << 40), read::backend(BackendKind::Auto)?);
    let mut paged = PagedFiles::new(set);
    for cloud in clouds {
        paged.open(cloud, true)?;
    }
    let exec = ExecSettings { threads: 1, ..ExecSettings::default() };
    let once = || -> Result<f64> {
        let started = cpu_seconds();
        rayset::trace::render(scene, camera, settings, &exec, &paged, &mut WholePicture::default())?;
        Ok(cpu_seconds() - started)
    };
    Ok((once()?, once()?))
}

/// Seconds that the processor has spent on this process.
fn cpu_seconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

/// Objects in four rows on a grid, each turned another way; sets take turns.
fn scene(clouds: &[Arc<Cloud>]) -> Scene {
    let bounds = object(&clouds[0]).bounds();
    let scale = 1.0 / bounds.size().max_element();
    let leaves: Vec<Arc<Node>> =
        clouds.iter().map(|cloud| Arc::new(Node::new(Shape::Cloud(object(cloud))))).collect();
    let place = |i: usize| {
        let at = DVec3::new((i % 5) as f64 - 2.0, 0.0, (i / 5) as f64 - 1.5) * 1.1;
        let moved = DAffine3::from_scale_rotation_translation(
            DVec3::splat(scale),
            DQuat::from_rotation_y(1.3 * i as f64),
            at,
        ) * DAffine3::from_translation(-bounds.center());
        let leaf = leaves[i % leaves.len()].clone();
        Arc::new(Node { parent_from_local: moved, ..Node::new(Shape::Operator(Operator::Union, vec![leaf])) })
    };
    let light = |direction: DVec3, color: [f32; 3]| Light {
        kind: LightKind::Directional { direction },
        color,
        shadow: true,
    };
    Scene {
        root: Arc::new(Node::new(Shape::Operator(Operator::Union, (0..OBJECTS).map(place).collect()))),
        lighting: Lighting::Lit(vec![
            light(DVec3::new(0.3, -1.0, -0.4), [0.5, 0.45, 0.4]),
            light(DVec3::new(-0.8, -0.9, -0.2), [0.3, 0.3, 0.4]),
            light(DVec3::new(0.1, -0.6, 0.8), [0.2, 0.25, 0.2]),
        ]),
        background: None,
        unit_distance: clouds[0].header().radius_mean * scale,
    }
}

fn view(scene: &Scene, cloud: &Arc<Cloud>, side: u32) -> (Camera, RenderSettings, f64) {
    let bounds = scene.root.bounds();
    let eye = bounds.center() + DVec3::new(0.2, 0.6, 1.0).normalize() * 1.1 * bounds.size().length();
    let camera = Camera::look_at(eye, bounds.center(), DVec3::Y, 35_f64.to_radians());
    let scale = 1.0 / object(cloud).bounds().size().max_element();
    let step = 0.25 * cloud.header().radius_mean * scale;
    let settings =
        RenderSettings { width: side, height: side, step: Step::Fixed(step), ..RenderSettings::default() };
    (camera, settings, step)
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

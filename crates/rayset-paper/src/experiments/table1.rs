//! Table 1: random points on a sphere; speed-up over brute force, space and the fullest leaf by height of the octree.

use std::cell::RefCell;
use std::time::Instant;

use anyhow::Result;
use rayset::points::Workload;
use rayset::scene::CloudObject;
use rayset::trace::judge::PointField;

use super::{Setting, Subject, differing, in_core, same_picture_note};
use crate::engine::{self, BruteForce, all_pixels};
use crate::index::Limits;
use crate::predict::Variant;
use crate::report::{Series, Table, megabytes, number, plot};

/// Points; the paper's speed-up, space in MB and η_max.
type Cell = (u64, f64, f64, u64);

/// By height.
const PAPER: [(u32, [Cell; 3]); 3] = [
    (3, [(1_000, 23.75, 20.0, 45), (10_000, 36.62, 155.0, 411), (100_000, 26.92, 1499.0, 3895)]),
    (5, [(1_000, 49.91, 196.0, 15), (10_000, 318.84, 741.0, 89), (100_000, 446.81, 5708.0, 739)]),
    (7, [(1_000, 46.61, 901.0, 9), (10_000, 429.01, 12_189.0, 48), (100_000, 1122.27, 63_634.0, 348)]),
];
/// The paper gives no radius; its η_max fits this part of the sphere's.
const RADIUS: f64 = 0.1;
/// Only the height limits how far nodes are divided.
const LEAF_POINTS: u64 = 1;

pub(super) fn run(setting: &Setting) -> Result<()> {
    let most_points = setting.pick(10_000, 100_000);
    let heights = setting.pick(&PAPER[..2], &PAPER[..]);
    let side = setting.pick(32, 128);
    let mut table = Table::new(
        "Table 1: octrees over random points on a sphere",
        &[
            "points",
            "H",
            "speed-up: paper",
            "reference",
            "shipping",
            "space MB: paper",
            "reference",
            "shipping",
            "η_max: paper",
            "reference",
            "node records",
            "build s",
        ],
    );
    let mut lines: Vec<Series> = Vec::new();
    let mut worst: f64 = 0.0;
    for &(height, row) in heights {
        let mut line = Series { name: format!("reference, H = {height}"), points: Vec::new() };
        let mut of_paper = Series { name: format!("paper, H = {height}"), points: Vec::new() };
        for (points, paper_speed, paper_space, paper_eta) in row {
            if points > most_points {
                continue;
            }
            let workload: Workload = format!("sphere-{points}").parse()?;
            let folder = setting.work.join(format!("table1-{points}-{height}"));
            std::fs::create_dir_all(&folder)?;
            let subject = Subject::build(workload.source(), Some(RADIUS), side, &folder.join("c.rset"))?;
            let index = subject.index(&folder, Limits { height, leaf_points: LEAF_POINTS })?;
            // Brute force takes a part of the rays, spread over the picture: its time is the same for all.
            let stride = setting.pick(4, if points < 100_000 { 8 } else { 16 });
            let some =
                || all_pixels(&subject.settings).filter(move |(x, y)| x % stride == 0 && y % stride == 0);
            let brute = BruteForce::load(&index, &subject.object(), true)?;
            let started = Instant::now();
            let given = |_: &CloudObject| &brute as &dyn PointField;
            let view = (&subject.camera, &subject.settings, subject.step);
            engine::render(&subject.scene, view, &RefCell::new(None), given, some())?;
            let brute_seconds = started.elapsed().as_secs_f64();
            let records = in_core(&index)?;
            let started = Instant::now();
            let (_, records) = subject.reference(records, Variant::None, some())?;
            let reference_seconds = started.elapsed().as_secs_f64();
            let (picture, _) = subject.reference(records, Variant::None, all_pixels(&subject.settings))?;
            let (shipped, mut shipping_seconds) = subject.shipping()?;
            for _ in 0..4 {
                shipping_seconds = shipping_seconds.min(subject.shipping()?.1);
            }
            worst = worst.max(differing(&picture, &shipped));
            let part = f64::from(stride * stride);
            let header = subject.cloud.header();
            let pages = u64::from(header.page_bytes);
            let shipping_index = u64::from(header.node_pages) * pages;
            let speed_up = brute_seconds / reference_seconds;
            line.points.push((points as f64, speed_up));
            of_paper.points.push((points as f64, paper_speed));
            table.row([
                points.to_string(),
                height.to_string(),
                number(paper_speed),
                number(speed_up),
                number(brute_seconds * part / shipping_seconds),
                number(paper_space),
                megabytes(index.summary.index_bytes()),
                format!(
                    "{} + {} of points",
                    megabytes(shipping_index),
                    megabytes(u64::from(header.point_pages) * pages)
                ),
                paper_eta.to_string(),
                index.summary.most_in_leaf.to_string(),
                index.summary.nodes.to_string(),
                number(index.summary.build.as_secs_f64()),
            ]);
            std::fs::remove_dir_all(&folder)?;
        }
        lines.extend([line, of_paper]);
    }
    table.note(format!(
        "Radius {RADIUS} of the sphere's (the paper gives none), steps of a quarter of it, {side}×{side} rays, a \
         headlight, one thread, all in core. Speed-up is over brute force in the same ray tracer. Space is that of \
         nodes and their lists; the engine that ships stores each point once, with an index beside it."
    ));
    table.note(same_picture_note(worst));
    table.write(&setting.out, "table1")?;
    plot(&setting.out.join("table1.svg"), "Table 1: speed-up over brute force", ("points", "times"), &lines)
}

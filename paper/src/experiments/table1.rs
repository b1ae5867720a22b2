//! Table 1: random points on a sphere; speed-up over brute force, space and the fullest leaf by
//! height of the octree.

use std::cell::RefCell;
use std::time::Instant;

use anyhow::{Context as _, Result};
use rayset::points::Workload;
use rayset::scene::CloudObject;
use rayset::trace::reference::PointField;

use super::{Setting, Subject, differing, in_core, same_picture_note};
use crate::engine::{self, BruteForce, all_pixels};
use crate::index::{Index, Limits};
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
    let repeats = setting.pick(1, 3);
    let mut lines: Vec<Series> = heights
        .iter()
        .flat_map(|(height, _)| [format!("reference, H = {height}"), format!("paper, H = {height}")])
        .chain(["shipping".to_owned()])
        .map(|name| Series { name, points: Vec::new() })
        .collect();
    let mut rows: Vec<(u32, [String; 12])> = Vec::new();
    let mut worst: f64 = 0.0;
    for column in 0..PAPER[0].1.len() {
        let points = PAPER[0].1[column].0;
        if points > most_points {
            continue;
        }
        let workload: Workload = format!("sphere-{points}").parse()?;
        let folder = setting.work.join(format!("table1-{points}"));
        std::fs::create_dir_all(&folder)?;
        let subject = Subject::build(workload.source(), Some(RADIUS), side, &folder.join("c.rset"))?;
        // A part of the rays, spread over the picture, is enough for brute force, and the others do
        // the same.
        let stride = setting.pick(4, if points < 100_000 { 8 } else { 16 });
        let some = || all_pixels(&subject.settings).filter(move |(x, y)| x % stride == 0 && y % stride == 0);
        let part = f64::from(stride * stride);
        let (shipped, mut shipping_seconds) = subject.shipping()?;
        for _ in 1..repeats {
            shipping_seconds = shipping_seconds.min(subject.shipping()?.1);
        }
        let mut brute_seconds = None;
        for (place, (height, row)) in heights.iter().enumerate() {
            let (_, paper_speed, paper_space, paper_eta) = row[column];
            let index = subject.index(&folder, Limits { height: *height, leaf_points: LEAF_POINTS })?;
            let brute_seconds = match brute_seconds {
                Some(seconds) => seconds,
                None => *brute_seconds.insert(brute_force(&subject, &index, repeats, some)?),
            };
            let (mut records, mut reference_seconds) = (in_core(&index)?, f64::INFINITY);
            for _ in 0..repeats {
                let started = Instant::now();
                records = subject.reference(records, Variant::None, some())?.1;
                reference_seconds = reference_seconds.min(started.elapsed().as_secs_f64());
            }
            let (picture, _) = subject.reference(records, Variant::None, all_pixels(&subject.settings))?;
            worst = worst.max(differing(&picture, &shipped));
            let header = subject.cloud.header();
            let pages = u64::from(header.page_bytes);
            let speed_up = brute_seconds / reference_seconds;
            lines[2 * place].points.push((points as f64, speed_up));
            lines[2 * place + 1].points.push((points as f64, paper_speed));
            let cells = [
                points.to_string(),
                height.to_string(),
                number(paper_speed),
                number(speed_up),
                number(brute_seconds * part / shipping_seconds),
                number(paper_space),
                megabytes(index.summary.index_bytes()),
                format!(
                    "{} + {} of points",
                    megabytes(u64::from(header.node_pages) * pages),
                    megabytes(u64::from(header.point_pages) * pages)
                ),
                paper_eta.to_string(),
                index.summary.most_in_leaf.to_string(),
                index.summary.nodes.to_string(),
                number(index.summary.build.as_secs_f64()),
            ];
            rows.push((*height, cells));
        }
        let brute_seconds = brute_seconds.unwrap_or(f64::NAN);
        let shipping = lines.last_mut().context("a line for each engine")?;
        shipping.points.push((points as f64, brute_seconds * part / shipping_seconds));
        std::fs::remove_dir_all(&folder)?;
    }
    // In the paper's order.
    rows.sort_by_key(|(height, _)| *height);
    rows.into_iter().for_each(|(_, cells)| table.row(cells));
    table.note(format!(
        "Radius {RADIUS} of the sphere's (the paper gives none), steps of a quarter of it, {side}×{side} rays, a \
         headlight, one thread, the least time of {repeats} runs, the \
         reference in core, the engine that ships from its file, which it reads. Speed-up is over brute force in the same ray tracer. Space is that of \
         nodes and their lists; the engine that ships stores each point once, with an index beside it."
    ));
    table.note(same_picture_note(worst));
    table.write(&setting.out, "table1")?;
    plot(&setting.out.join("table1.svg"), "Table 1: speed-up over brute force", ("points", "times"), &lines)
}

/// Seconds that all points at every sample take.
fn brute_force<P: Iterator<Item = (u32, u32)>>(
    subject: &Subject,
    index: &Index,
    repeats: usize,
    pixels: impl Fn() -> P,
) -> Result<f64> {
    let brute = BruteForce::load(index, &subject.object(), true)?;
    let given = |_: &CloudObject| &brute as &dyn PointField;
    let view = (&subject.camera, &subject.settings, subject.step);
    let mut least = f64::INFINITY;
    for _ in 0..repeats {
        let started = Instant::now();
        engine::render(&subject.scene, view, &RefCell::new(None), given, pixels())?;
        least = least.min(started.elapsed().as_secs_f64());
    }
    Ok(least)
}

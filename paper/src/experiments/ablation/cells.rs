//! Octants against cells of a k-d tree split at the median, over points of one radius and of
//! several.

use std::cell::RefCell;
use std::time::Instant;

use anyhow::Result;
use rayset::points::{PointSource, Workload};
use rayset::scene::CloudObject;
use rayset::trace::reference::PointField;

use super::super::{Setting, Subject, differing, median, scan_or};
use crate::cells::{CellField, Cells, Division, Taken};
use crate::engine::{self, all_pixels};
use crate::index::Limits;
use crate::report::{Series, Table, number, plot};

/// Radii, as parts of that at which neighbours meet.
const RADII: [f64; 2] = [1.0, 2.0];
/// Trees with more are not divided further: they would fill memory.
const MOST_REFERENCES: f64 = 300.0;
/// A cell with no more points is not divided.
const LEAF_POINTS: u64 = 32;

pub(super) fn run(setting: &Setting) -> Result<()> {
    let side = setting.pick(16, 96);
    let repeats = setting.pick(1, 3);
    let mut table = Table::new(
        "Ablation: octants against k-d cells split at the median",
        &[
            "points",
            "radius",
            "height",
            "cells",
            "leaves",
            "references a point",
            "η_max",
            "cells to a sample",
            "points looked at",
            "of them reaching",
            "render s",
        ],
    );
    let folder = setting.work.join("cells");
    std::fs::create_dir_all(&folder)?;
    let path = folder.join("c.rset");
    let (mut worst, mut lines): (f64, Vec<Series>) = (0.0, Vec::new());
    let scan = || scan_or(setting, setting.pick("vase-4k", "vase-35947"));
    let auto = Subject::build(scan()?, None, side, &path)?.cloud.header().radius_mean;
    let workload: Workload = setting.pick("cube-2k", "cube-30k").parse()?;
    let uniform = workload.radius().unwrap_or(0.1);
    type Source<'a> = Box<dyn Fn() -> Result<Box<dyn PointSource>> + 'a>;
    let clouds: [(&str, Source<'_>, f64); 2] =
        [("scan", Box::new(scan), auto), ("cube", Box::new(|| Ok(workload.source())), uniform)];
    for (name, source, unit) in &clouds {
        for part in RADII {
            let subject = Subject::build(source()?, Some(part * unit), side, &path)?;
            let mut curves = ["octants", "k-d"].map(|division| Series {
                name: format!("{name}, radius {part}: {division}"),
                points: vec![],
            });
            let mut most: f64 = 0.0;
            for height in setting.pick(3..5, 3..8) {
                if most > MOST_REFERENCES {
                    break;
                }
                let limits = Limits { height, leaf_points: LEAF_POINTS };
                let found = measure(&subject, limits, &folder, repeats)?;
                for ((curve, division), found) in curves.iter_mut().zip(["octants", "k-d"]).zip(found) {
                    worst = worst.max(found.differing);
                    most = most.max(found.references);
                    curve.points.push((found.references, found.looked_at));
                    let head = [format!("{name}, {}", subject.cloud.header().points), number(part)];
                    table.row(
                        head.into_iter().chain([height.to_string(), division.into()]).chain(found.cells),
                    );
                }
            }
            lines.extend(curves);
        }
    }
    std::fs::remove_dir_all(&folder)?;
    table.note(format!(
        "Trees in memory, {side}×{side} rays, steps of a quarter of the radius, medians of {repeats}; radius 1 is where \
         neighbours meet. Both are divided while a cell has more than {LEAF_POINTS} points, an octree as many times as its \
         height, a k-d tree three times as many, in the middle where points only reach a cell and none lies in it. Cells to a \
         sample: on the way from the root. Points looked at: the list of its leaf."
    ));
    table.note(format!(
        "Pictures of both: at most {:.3} % of the pixels differ by more than 1/1024 in linear light.",
        100.0 * worst
    ));
    table.write(&setting.out, "ablation-cells")?;
    plot(
        &setting.out.join("ablation-cells.svg"),
        "Octants against k-d cells: what space buys",
        ("references a point", "points looked at for a sample"),
        &lines,
    )
}

/// A tree and its picture.
struct Found {
    references: f64,
    looked_at: f64,
    cells: Vec<String>,
    differing: f64,
}

/// Octants, and k-d cells.
fn measure(
    subject: &Subject,
    limits: Limits,
    folder: &std::path::Path,
    repeats: usize,
) -> Result<[Found; 2]> {
    let index = subject.index(folder, Limits { height: 0, ..limits })?;
    let (points, root) = index.points_and_root()?;
    let (object, view) = (subject.object(), (&subject.camera, &subject.settings, subject.step));
    let mut first = None;
    let mut of = |division| -> Result<Found> {
        let tree = Cells::build(points.clone(), root, limits, division);
        let (mut times, mut taken, mut worst) = (Vec::new(), Taken::default(), 0.0);
        for _ in 0..repeats {
            let field = CellField::new(&tree, &object);
            let given = |_: &CloudObject| &field as &dyn PointField;
            let started = Instant::now();
            let pixels = all_pixels(&subject.settings);
            let picture = engine::render(&subject.scene, view, &RefCell::new(None), given, pixels)?;
            times.push(started.elapsed().as_secs_f64());
            taken = field.taken();
            worst = differing(first.get_or_insert_with(|| picture.clone()), &picture).max(worst);
        }
        let size = tree.size();
        let a_sample = |n: u64| n as f64 / taken.samples.max(1) as f64;
        let references = size.references as f64 / index.summary.points as f64;
        let cells = vec![
            size.leaves.to_string(),
            number(references),
            size.most_in_leaf.to_string(),
            number(a_sample(taken.steps)),
            number(a_sample(taken.looked_at)),
            format!("{:.0} %", 100.0 * taken.reaching as f64 / taken.looked_at.max(1) as f64),
            number(median(&mut times)),
        ];
        Ok(Found { references, looked_at: a_sample(taken.looked_at), cells, differing: worst })
    };
    Ok([of(Division::Octants)?, of(Division::Median)?])
}

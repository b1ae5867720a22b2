//! Fig. 5: a small part of a dense scan at growing radius; what the index takes, the picture and
//! its cost, for both engines.

use std::time::Instant;

use anyhow::Result;
use rayset::geometry::DVec3;
use rayset::octree::Cloud;
use rayset::scene::Camera;

use super::{Setting, Subject, differing, in_core, same_picture_note, source_or};
use crate::engine::all_pixels;
use crate::index::Limits;
use crate::predict::Variant;
use crate::report::{Series, Table, megabytes, number, plot, sheet};

/// The paper's radii; those of the scan are these times the distance that makes its points meet
/// at 2.
const RADII: [f64; 6] = [0.25, 0.5, 1.0, 2.0, 4.0, 6.0];
/// The paper's octrees of this figure have six levels.
const HEIGHT: u32 = 6;
const LEAF_POINTS: u64 = 64;
/// In the paper's units.
const LEAST_STEP: f64 = 0.125;
/// Edge of what is seen, in radii at which points meet.
const SEEN: f64 = 24.0;

pub(super) fn run(setting: &Setting) -> Result<()> {
    let side = setting.pick(24, 80);
    // As many points as the paper's Lucy has.
    let workload = setting.pick("vase-10k", "vase-14027872");
    let source = || source_or(setting.dense_scan.as_deref(), workload);
    let folder = setting.work.join("fig5");
    std::fs::create_dir_all(&folder)?;
    let path = folder.join("c.rset");
    // The radius at which neighbours meet well: what `auto` finds.
    let auto = Subject::build(source()?, None, side, &path)?;
    let unit = auto.cloud.header().radius_mean / 2.0;
    let view = close_up(&auto.cloud, SEEN * 2.0 * unit)?;
    let mut table = Table::new(
        "Fig. 5: growing radius",
        &[
            "r",
            "reference: index MB",
            "references a point",
            "η_max",
            "build s",
            "render s",
            "shipping: file MB",
            "build s",
            "render s",
        ],
    );
    let mut lines =
        ["reference index", "shipping file"].map(|name| Series { name: name.into(), points: vec![] });
    let mut worst: f64 = 0.0;
    let mut pictures = [Vec::new(), Vec::new()];
    for r in RADII {
        let started = Instant::now();
        let mut subject = Subject::build(source()?, Some(r * unit), side, &path)?;
        let build_seconds = started.elapsed().as_secs_f64();
        subject.camera = view;
        subject.set_step((0.25 * r).max(LEAST_STEP) * unit);
        let index = subject.index(&folder, Limits { height: HEIGHT, leaf_points: LEAF_POINTS })?;
        let started = Instant::now();
        let records = in_core(&index)?;
        let (picture, _) = subject.reference(records, Variant::None, all_pixels(&subject.settings))?;
        let reference_seconds = started.elapsed().as_secs_f64();
        let (shipped, shipping_seconds) = subject.shipping()?;
        worst = worst.max(differing(&picture, &shipped));
        pictures[0].push(picture);
        pictures[1].push(shipped);
        let (summary, header) = (index.summary, subject.cloud.header());
        lines[0].points.push((r, summary.index_bytes() as f64 / 1e6));
        lines[1].points.push((r, header.file_bytes as f64 / 1e6));
        table.row([
            r.to_string(),
            megabytes(summary.index_bytes()),
            number(summary.references as f64 / summary.points as f64),
            summary.most_in_leaf.to_string(),
            number(summary.build.as_secs_f64()),
            number(reference_seconds),
            megabytes(header.file_bytes),
            number(build_seconds),
            number(shipping_seconds),
        ]);
    }
    std::fs::remove_dir_all(&folder)?;
    table.note(format!(
        "{} points; r in the paper's units, of which 2 is where neighbouring points meet ({} here). Height {HEIGHT}, as \
         in the paper, and {LEAF_POINTS} points a leaf; {side}×{side} rays of a view of {SEEN} such radii across, in core, one \
         thread, steps of a quarter of r, but at least {LEAST_STEP}; loading is part of the reference's time. The shipping engine's building begins with the points \
         (generated, or read from the scan), the reference's with the file that comes of it. The paper gives no table for this figure; it says that the index \
         grows with r until 1 GB of memory no longer does above r = 6, and that some leaves have over 100 000 points.",
        auto.cloud.header().points,
        number(2.0 * unit)
    ));
    table.note("![the reference engine above, the engine that ships below, r from left to right](fig5.png)");
    table.note(same_picture_note(worst));
    table.write(&setting.out, "fig5")?;
    sheet(&setting.out.join("fig5.png"), side, &pictures)?;
    plot(&setting.out.join("fig5.svg"), "Fig. 5: space by radius", ("r", "MB"), &lines)
}

/// A view of so many units around the point that is nearest to an eye in front of the cloud.
fn close_up(cloud: &Cloud, across: f64) -> Result<Camera> {
    let toward_eye = DVec3::new(0.3, 0.25, 1.0).normalize();
    let (mut nearest, mut target) = (f64::NEG_INFINITY, DVec3::ZERO);
    let header = cloud.header();
    cloud.for_each_run(|_, run| {
        for position in run.positions(header.root_cell()) {
            let along = position.dot(toward_eye);
            if along > nearest {
                (nearest, target) = (along, position);
            }
        }
    })?;
    let fovy = 35_f64.to_radians();
    let eye = target + toward_eye * (0.5 * across / (0.5 * fovy).tan());
    Ok(Camera::look_at(eye, target, DVec3::Y, fovy))
}

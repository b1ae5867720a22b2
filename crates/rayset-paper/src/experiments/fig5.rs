//! Fig. 5: a dense scan at growing radius; what the index takes, and the picture's cost, for both engines.

use std::time::Instant;

use anyhow::Result;

use super::{Setting, Subject, differing, in_core, same_picture_note, scan_or};
use crate::engine::all_pixels;
use crate::index::Limits;
use crate::predict::Variant;
use crate::report::{Series, Table, megabytes, number, plot};

/// The paper's radii; those of the scan are these times the distance that makes its points meet at 2.
const RADII: [f64; 6] = [0.25, 0.5, 1.0, 2.0, 4.0, 6.0];
/// The paper's octrees of this figure have six levels.
const HEIGHT: u32 = 6;
const LEAF_POINTS: u64 = 64;

pub(super) fn run(setting: &Setting) -> Result<()> {
    let workload = setting.pick("vase-10k", "vase-300k");
    let side = setting.pick(24, 96);
    // The radius at which neighbours meet well: what `auto` finds.
    let folder = setting.work.join("fig5");
    std::fs::create_dir_all(&folder)?;
    let path = folder.join("c.rset");
    let auto = Subject::build(scan_or(setting, workload)?, None, side, &path)?;
    let unit = auto.cloud.header().radius_mean / 2.0;
    let view = auto.camera;
    let mut table = Table::new(
        "Fig. 5: growing radius",
        &[
            "r",
            "reference: index MB",
            "references a point",
            "η_max",
            "render s",
            "shipping: file MB",
            "render s",
        ],
    );
    let mut lines =
        ["reference index", "shipping file"].map(|name| Series { name: name.into(), points: vec![] });
    let mut worst: f64 = 0.0;
    for r in RADII {
        let mut subject = Subject::build(scan_or(setting, workload)?, Some(r * unit), side, &path)?;
        // The same view, and steps that the smallest radius would not make endless.
        subject.camera = view;
        let index = subject.index(&folder, Limits { height: HEIGHT, leaf_points: LEAF_POINTS })?;
        let started = Instant::now();
        let (picture, _) =
            subject.reference(in_core(&index)?, Variant::None, all_pixels(&subject.settings))?;
        let reference_seconds = started.elapsed().as_secs_f64();
        let (shipped, shipping_seconds) = subject.shipping()?;
        worst = worst.max(differing(&picture, &shipped));
        let (summary, header) = (index.summary, subject.cloud.header());
        lines[0].points.push((r, summary.index_bytes() as f64 / 1e6));
        lines[1].points.push((r, header.file_bytes as f64 / 1e6));
        table.row([
            r.to_string(),
            megabytes(summary.index_bytes()),
            number(summary.references as f64 / summary.points as f64),
            summary.most_in_leaf.to_string(),
            number(reference_seconds),
            megabytes(header.file_bytes),
            number(shipping_seconds),
        ]);
    }
    std::fs::remove_dir_all(&folder)?;
    table.note(format!(
        "{} points; r in the paper's units, of which 2 is where neighbouring points meet ({} here). Height {HEIGHT}, as \
         in the paper, and {LEAF_POINTS} points a leaf; {side}×{side} rays, in core, one thread. The paper gives no table \
         for this figure; it says that the index grows with r until 1 GB of memory no longer does above r = 6.",
        auto.cloud.header().points,
        number(2.0 * unit)
    ));
    table.note(same_picture_note(worst));
    table.write(&setting.out, "fig5")?;
    plot(&setting.out.join("fig5.svg"), "Fig. 5: space by radius", ("r", "MB"), &lines)
}

//! What each idea is worth: predictors and sizes of batches on the simulated disk.

use anyhow::Result;

use super::{Setting, SimulatedRun, Subject, budget_of, scan_or};
use crate::index::Limits;
use crate::predict::Variant;
use crate::report::{Table, number};

/// Memory is this part of the data.
const MEMORY_PART: u64 = 8;

pub(super) fn run(setting: &Setting) -> Result<()> {
    let side = setting.pick(16, 96);
    let folder = setting.work.join("ablation");
    std::fs::create_dir_all(&folder)?;
    let source = scan_or(setting, setting.pick("vase-8k", "vase-35947"))?;
    let subject = Subject::build(source, None, side, &folder.join("c.rset"))?;
    let index = subject.index(&folder, Limits { height: 6, leaf_points: 32 })?;
    let memory = (index.summary.index_bytes() + index.summary.point_bytes()) / MEMORY_PART;
    let budget = budget_of(memory, index.summary.points);
    let mut table = Table::new(
        "Ablation: predictors and batches",
        &[
            "predictor",
            "reads a call",
            "s",
            "stalled",
            "nodes: misses",
            "late",
            "prefetched",
            "used",
            "points: misses",
            "prefetched",
            "used",
            "reads",
        ],
    );
    for variant in Variant::ALL {
        for batch in [1, 4, 16] {
            if variant == Variant::None && batch > 1 {
                continue;
            }
            let run = SimulatedRun { budget, variant, batch, limit_seconds: f64::INFINITY };
            let (_, seconds, records) = subject.simulated(&index, run)?;
            let [nodes, secondary, points] = records.counts();
            let part = |used: u64, all: u64| {
                (100 * used).checked_div(all).map_or_else(|| "–".into(), |percent| format!("{percent} %"))
            };
            table.row([
                variant.to_string(),
                batch.to_string(),
                number(seconds),
                format!("{:.1} %", 1e-7 * records.stalled_nanoseconds() as f64 / seconds),
                nodes.misses.to_string(),
                nodes.late.to_string(),
                nodes.prefetched.to_string(),
                part(nodes.prefetched_used, nodes.prefetched),
                points.misses.to_string(),
                points.prefetched.to_string(),
                part(points.prefetched_used, points.prefetched),
                (nodes.reads + secondary.reads + points.reads).to_string(),
            ]);
        }
    }
    std::fs::remove_dir_all(&folder)?;
    table.note(format!(
        "{} points, {} nodes, memory an eighth of the data ({} nodes, {} points), {side}×{side} rays, simulated disk. \
         `none` fetches what a sample waits for, and the siblings of a node with it, nothing else.",
        index.summary.points, index.summary.nodes, budget.nodes, budget.points
    ));
    table.write(&setting.out, "ablation")
}

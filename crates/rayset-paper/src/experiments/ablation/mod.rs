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
            "ahead of use",
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
    // Nothing ahead of its use; what a node and a leaf bring with them; and predictors on top of that.
    let mut kinds = vec![("nothing".to_owned(), Variant::None, false, 1)];
    for variant in Variant::ALL {
        let name = if variant == Variant::None { "children and lists".into() } else { variant.to_string() };
        kinds.extend([1, 4, 16].map(|batch| (name.clone(), variant, true, batch)));
    }
    for (name, variant, prefetches, batch) in kinds {
        let run = SimulatedRun { budget, variant, prefetches, batch, limit_seconds: f64::INFINITY };
        let (_, seconds, records) = subject.simulated(&index, run)?;
        let [nodes, secondary, points] = records.counts();
        let part = |used: u64, all: u64| {
            (100 * used).checked_div(all).map_or_else(|| "–".into(), |percent| format!("{percent} %"))
        };
        table.row([
            name,
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
    std::fs::remove_dir_all(&folder)?;
    table.note(format!(
        "{} points, {} nodes, memory an eighth of the data ({} nodes, {} points), {side}×{side} rays, simulated disk. \
         Nothing: what a sample \
         waits for, and the siblings of a node with it. Children and lists: what section 4.2 brings in with a node and a \
         leaf, without any prediction; the predictors have that too.",
        index.summary.points, index.summary.nodes, budget.nodes, budget.points
    ));
    table.write(&setting.out, "ablation")
}

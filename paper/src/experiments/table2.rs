//! Table 2: time for the bunny over node cache by point cache.

use anyhow::Result;

use super::{Setting, SimulatedRun, Subject, differing, same_picture_note, scan_or};
use crate::file_cache::FileCaching;
use crate::index::Limits;
use crate::records::Budget;
use crate::report::{Series, Table, number, plot};

/// The paper's, and two smaller ones.
const NODES: [usize; 7] = [131_072, 65_536, 32_768, 16_384, 8_192, 1_024, 256];
const POINTS: [usize; 6] = [32_768, 16_384, 8_192, 4_096, 1_024, 256];
/// Of the paper's seconds, those of building, about.
const PAPER_BUILDING: f64 = 60.0;
/// Seconds on a PowerMac G5, of which 55 to 65 are for building.
const PAPER: [[f64; 4]; 5] = [
    [94.59, 98.67, 100.31, 107.15],
    [90.67, 96.25, 96.62, 101.63],
    [88.28, 95.20, 94.89, 100.91],
    [88.78, 96.58, 95.84, 103.38],
    [92.39, 98.56, 100.31, 108.25],
];

pub(super) fn run(setting: &Setting) -> Result<()> {
    let side = setting.pick(16, 128);
    let folder = setting.work.join("table2");
    std::fs::create_dir_all(&folder)?;
    let source = scan_or(setting, setting.pick("vase-8k", "vase-35947"))?;
    let subject = Subject::build(source, None, side, &folder.join("c.rset"))?;
    let index = subject.index(&folder, Limits { height: 6, leaf_points: 32 })?;
    // Smaller data, smaller caches, in proportion.
    let part = setting.pick(8, 1);
    let (shipped, _) = subject.shipping()?;
    let mut worst: f64 = 0.0;
    let mut table = Table::new(
        "Table 2: node cache by point cache",
        &[
            "nodes in core",
            "32768 points: paper s",
            "s",
            "16384: paper s",
            "s",
            "8192: paper s",
            "s",
            "4096: paper s",
            "s",
            "1024: paper s",
            "s",
            "256: paper s",
            "s",
        ],
    );
    let mut lines: Vec<Series> = Vec::new();
    for (row, nodes) in NODES.into_iter().enumerate() {
        let mut cells = vec![nodes.to_string()];
        let mut line = Series { name: format!("{nodes} nodes"), points: Vec::new() };
        for (column, points) in POINTS.into_iter().enumerate() {
            let paper = PAPER.get(row).and_then(|row| row.get(column));
            let budget = Budget { nodes: nodes / part, points: points / part };
            let run = SimulatedRun::paper(budget);
            let (picture, seconds, _) = subject.simulated(&index, run)?;
            worst = worst.max(differing(&picture, &shipped));
            cells.extend([paper.map_or_else(|| "–".into(), |s| number(*s)), number(seconds)]);
            line.points.push((points as f64, seconds));
        }
        line.points.reverse();
        table.row(cells);
        lines.push(line);
    }
    // The paper's machine had room for all files in the system's cache.
    let over_file_cache = |nodes: usize, points: usize| -> Result<f64> {
        let budget = Budget { nodes: nodes / part, points: points / part };
        let run = SimulatedRun { caching: FileCaching::by_blocks(1 << 30), ..SimulatedRun::paper(budget) };
        Ok(subject.simulated(&index, run)?.1)
    };
    let [most, paper_least, least] = [
        over_file_cache(NODES[0], POINTS[0])?,
        over_file_cache(NODES[4], POINTS[3])?,
        over_file_cache(NODES[6], POINTS[5])?,
    ];
    // The paper's seconds are of rendering and 55 to 65 of building: without the middle of these.
    for (nodes, row) in NODES.into_iter().zip(PAPER).step_by(2) {
        let points = POINTS.into_iter().zip(row).map(|(points, s)| (points as f64, s - PAPER_BUILDING)).rev();
        lines.push(Series { name: format!("paper, {nodes} nodes"), points: points.collect() });
    }
    std::fs::remove_dir_all(&folder)?;
    table.note(format!(
        "{} points, {} nodes, {} secondary records, {side}×{side} rays; caches are the paper's divided by {part}. Seconds \
         of rendering on the simulated disk, predictor `line`; the paper's include 55 to 65 of building (here {} of the \
         processor).",
        index.summary.points,
        index.summary.nodes,
        index.summary.secondary,
        number(index.summary.build.as_secs_f64())
    ));
    table.note(format!(
        "With a file cache of the system below that holds all files: {} s with the largest caches, {} with the smallest of \
         the paper's, {} with the smallest here.",
        number(most),
        number(paper_least),
        number(least)
    ));
    table.note(same_picture_note(worst));
    table.write(&setting.out, "table2")?;
    plot(&setting.out.join("table2.svg"), "Table 2: time by caches", ("points in core", "seconds"), &lines)
}

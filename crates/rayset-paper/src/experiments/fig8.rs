//! Fig. 8: time over the size of the octree by memory, policy by policy, on the simulated disk of the paper's day.

use anyhow::Result;
use rayset::points::Workload;

use super::{BATCH, Setting, SimulatedRun, Subject, budget_of, differing, same_picture_note, seconds};
use crate::disk::{Clock, SimulatedDisk};
use crate::engine::all_pixels;
use crate::index::Limits;
use crate::predict::Variant;
use crate::records::{Paged, write_image};
use crate::report::{Series, Table, number, plot};

/// The index is so many times as large as the memory.
const RATIOS: [u64; 7] = [1, 2, 4, 8, 16, 32, 64];
/// A run is stopped at so many times the time of the one that prefetches.
const STOPPED_AT: f64 = 20.0;

pub(super) fn run(setting: &Setting) -> Result<()> {
    let (points, height, side) = setting.pick((4_000, 4, 32), (20_000, 5, 80));
    let folder = setting.work.join("fig8");
    std::fs::create_dir_all(&folder)?;
    let workload: Workload = format!("cube-{points}").parse()?;
    let mut subject = Subject::build(workload.source(), workload.radius(), side, &folder.join("c.rset"))?;
    subject.make_translucent();
    let index = subject.index(&folder, Limits { height, leaf_points: 16 })?;
    let whole = index.summary.index_bytes() + index.summary.point_bytes();
    let image = folder.join("image.bin");
    write_image(&index, &image)?;
    let (shipped, _) = subject.shipping()?;
    let mut table = Table::new(
        "Fig. 8: paging against prefetching, on a disk of 8 ms a seek and 50 MB/s",
        &[
            "data / memory",
            "memory KiB",
            "paging s",
            "no prefetch s",
            "line s",
            "line-as-printed s",
            "line+origins s",
            "paging / line",
            "stalled, line",
        ],
    );
    let names = ["operating-system paging", "no prefetch", "line", "line-as-printed", "line+origins"];
    let mut lines = names.map(|name| Series { name: name.into(), points: Vec::new() });
    let mut worst: f64 = 0.0;
    for ratio in RATIOS {
        let memory = whole / ratio;
        let run = |variant, limit_seconds| {
            let budget = budget_of(memory, index.summary.points);
            subject.simulated(
                &index,
                SimulatedRun {
                    budget,
                    variant,
                    prefetches: variant != Variant::None,
                    batch: BATCH,
                    limit_seconds,
                },
            )
        };
        let (picture, line, records) = run(Variant::Line, f64::INFINITY)?;
        worst = worst.max(differing(&picture, &shipped));
        let limit = STOPPED_AT * line;
        let stalled = records.stalled_nanoseconds() as f64 * 1e-9;
        let others = [Variant::None, Variant::LineAsPrinted, Variant::LineOrigins]
            .map(|variant| run(variant, limit).map(|(_, seconds, _)| seconds));
        let [none, printed, origins] = others;
        let clock = Clock::default();
        let disk = SimulatedDisk::open(std::slice::from_ref(&image), clock.clone())?;
        let paged = Paged::new(&index, Box::new(disk), memory, clock.clone())?;
        let watch = clock.clone();
        let pixels = all_pixels(&subject.settings).take_while(move |_| seconds(&watch) < limit);
        subject.reference(paged, Variant::None, pixels)?;
        let paging = seconds(&clock);
        let times = [paging, none?, line, printed?, origins?];
        for (series, time) in lines.iter_mut().zip(times) {
            series.points.push((ratio as f64, time));
        }
        let shown =
            |time: f64| if time >= limit { format!("more than {}", number(limit)) } else { number(time) };
        table.row(
            [ratio.to_string(), (memory / 1024).to_string()]
                .into_iter()
                .chain(times.map(shown))
                .chain([number(paging / line), format!("{:.0} %", 100.0 * stalled / line)]),
        );
    }
    std::fs::remove_dir_all(&folder)?;
    table.note(format!(
        "{points} points at random in a cube, 30 supports overlapping, translucent, height {height}: {} nodes, {} MB of index and points; {side}×{side} \
         rays. One index, and memory that is a part of it: the paper holds the memory and grows the octree. Paging is by \
         4 KiB on demand, least recently used, of the same structures one behind the other. Time is counted, so the table \
         is the same on every machine: 500 ns a sample, 50 ns a point of it, 100 ns a step from node to node. A run is \
         stopped at {STOPPED_AT} times the time of `line`.",
        index.summary.nodes,
        number(whole as f64 / 1e6),
    ));
    table.note(
        "The paper's figure has no numbers to read off; its text says that paging takes more than twice as long as \
         prefetching wherever the octree exceeds memory.",
    );
    table.note(same_picture_note(worst));
    table.write(&setting.out, "fig8")?;
    plot(&setting.out.join("fig8.svg"), "Fig. 8: time by memory", ("data / memory", "seconds"), &lines)
}

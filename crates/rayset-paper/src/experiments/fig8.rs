//! Fig. 8: time over the size of the octree by memory, policy by policy, on the simulated disk of the paper's day.

use std::path::Path;

use anyhow::{Context as _, Result};

use super::growing::{self, Grown, RADIUS};
use super::{Setting, SimulatedRun, Subject, budget_of, differing, same_picture_note, seconds};
use crate::engine::{Picture, all_pixels};
use crate::index::Index;
use crate::memory::Paged;
use crate::predict::{Foresight, Variant};
use crate::report::{Series, Table, megabytes, number, plot};
use crate::simulated::{Clock, SimulatedDisk};
use crate::structures::{Layout, Structures, grow, write_files};
use crate::swap::Swap;

/// A run is stopped at so many times the time of the one that prefetches.
const STOPPED_AT: f64 = 20.0;

pub(super) fn run(setting: &Setting) -> Result<()> {
    let memory: u64 = setting.pick(1 << 20, 32 << 20);
    let side = setting.pick(24, 96);
    let mut table = Table::new(
        "Fig. 8: paging against prefetching, on a disk of 8 ms a seek and 50 MB/s",
        &[
            "points",
            "H",
            "data MB",
            "data / memory",
            "in-core program, paged: build s",
            "render s",
            "render, file order s",
            "out of core: build s",
            "no prefetch s",
            "line s",
            "line-as-printed s",
            "line+origins s",
            "records alone: no prefetch s",
            "line s",
            "paging / line: build and render",
            "render",
            "render, file order",
            "stalled, line",
        ],
    );
    let mut lines = LINES.map(|name| Series { name: name.into(), points: Vec::new() });
    let mut worst: f64 = 0.0;
    for size in growing::sizes(setting) {
        let folder = setting.work.join("fig8");
        let Grown { subject, index, .. } = growing::build(size, side, &folder)?;
        let (shipped, _) = subject.shipping()?;
        let measured = measure(&subject, &index, &folder, memory)?;
        worst = worst.max(differing(&measured.picture, &shipped));
        let whole = index.summary.index_bytes() + index.summary.point_bytes();
        let ratio = whole as f64 / memory as f64;
        let Measured { build, grow, paged, out_of_core, records_alone, stalled, .. } = measured;
        let line = out_of_core[1];
        let shown_until = |limit: f64| {
            move |time: f64| {
                if time >= limit { format!("more than {}", number(limit)) } else { number(time) }
            }
        };
        let of_render = shown_until(STOPPED_AT * line);
        let plotted =
            [grow + paged[0], paged[0], paged[1], build + line, out_of_core[0], line, records_alone[1]];
        for (series, time) in lines.iter_mut().zip(plotted) {
            series.points.push((ratio, time));
        }
        let at_least = |time: f64, other: f64| {
            let sign = if time >= STOPPED_AT * other { "more than " } else { "" };
            format!("{sign}{}", number((time / other).min(STOPPED_AT)))
        };
        table.row(
            [size.points.to_string(), size.height.to_string(), megabytes(whole), number(ratio)]
                .into_iter()
                .chain([shown_until(STOPPED_AT * (build + line))(grow)])
                .chain(paged.map(&of_render))
                .chain([number(build)])
                .chain(out_of_core.map(&of_render))
                .chain(records_alone.map(&of_render))
                .chain([if grow >= STOPPED_AT * (build + line) || paged[0] >= STOPPED_AT * line {
                    format!("more than {}", number(((grow + paged[0]) / (build + line)).min(STOPPED_AT)))
                } else {
                    number((grow + paged[0]) / (build + line))
                }])
                .chain(paged.map(|time| at_least(time, line)))
                .chain([format!("{:.0} %", 100.0 * stalled / line)]),
        );
        std::fs::remove_dir_all(&folder)?;
    }
    table.note(format!(
        "Random points on a sphere, radius {RADIUS}, as in Table 1; {side}×{side} rays; {} MiB of memory, of which out of \
         core a quarter is for records and what goes with them, and the rest the system's file cache; records alone have \
         all of it, and read past any cache. The in-core program takes one point after another into an octree in its heap, \
         which is swapped by 4 KiB, least recently used, while it is built and again, from nothing in memory on, while it is \
         rendered; file order: paging of the same octree as the out-of-core builder orders it. Building out of core is its \
         input and output. Time is counted, so the table is the same on every machine: 500 ns a sample, 50 ns a point of \
         it, 100 ns a step from node to node. A run is stopped at {STOPPED_AT} times the time of `line`, \
         and plotted there. All renderings begin with nothing in memory: the first touch of each page is paid for, also \
         where it would have stayed since it was built.",
        memory >> 20,
    ));
    table.note(
        "The paper's figure has no numbers to read off; its text says that paging takes more than twice as long as \
         prefetching in all cases where the octree exceeds memory. The plot marks that bound.",
    );
    table.note(same_picture_note(worst));
    table.write(&setting.out, "fig8")?;
    let claim: Vec<(f64, f64)> = lines[5].points.iter().map(|&(ratio, line)| (ratio, 2.0 * line)).collect();
    let mut lines: Vec<Series> = lines.into();
    // By the number of points; those by the height stand in the table.
    let by_points = growing::sizes(setting)
        .iter()
        .filter(|size| setting.pick(true, size.height == growing::PLOTTED_HEIGHT))
        .count();
    lines.push(Series { name: "the paper's claim: paging is above this".into(), points: claim });
    lines.iter_mut().for_each(|line| line.points.truncate(by_points));
    plot(&setting.out.join("fig8.svg"), "Fig. 8: time by memory", ("data / memory", "seconds"), &lines)
}

/// Lines of the plot.
const LINES: [&str; 7] = [
    "in-core, paged: build and render",
    "in-core, paged: render",
    "paging, file order: render",
    "line: build and render",
    "no prefetch: render",
    "line: render",
    "line, records alone: render",
];

/// Counted seconds.
struct Measured {
    picture: Picture,
    /// Out of core.
    build: f64,
    /// In core, paged.
    grow: f64,
    /// As grown, and in the order of the files.
    paged: [f64; 2],
    /// No prefetch, line, line as printed, line with origins.
    out_of_core: [f64; 4],
    /// No prefetch, line.
    records_alone: [f64; 2],
    /// Of line.
    stalled: f64,
}

fn measure(subject: &Subject, index: &Index, folder: &Path, memory: u64) -> Result<Measured> {
    let run = |variant, file_cache_bytes, limit_seconds| {
        let budget = budget_of(memory - file_cache_bytes, index.summary.points);
        let prefetches = variant != Variant::None;
        let foresight = Foresight::from(variant);
        let run = SimulatedRun {
            foresight,
            prefetches,
            file_cache_bytes,
            limit_seconds,
            ..SimulatedRun::paper(budget)
        };
        subject.simulated(index, run)
    };
    let cache = memory / 4 * 3;
    let (picture, line, records) = run(Variant::Line, cache, f64::INFINITY)?;
    let limit = STOPPED_AT * line;
    let time = |variant, cache| run(variant, cache, limit).map(|(_, seconds, _)| seconds);
    let image = folder.join("image.bin");
    let layout = write_files(index, &image)?;
    let file_order = paged(subject, &image, layout, memory, limit)?;
    let (heap, layout) = grow(index, &mut |_, _, _| true)?.context("a heap")?;
    std::fs::write(&image, heap)?;
    let grown = paged(subject, &image, layout, memory, limit)?;
    let build = index
        .summary
        .build_seconds(SimulatedDisk::SEEK_NANOSECONDS as f64 * 1e-9, SimulatedDisk::BYTES_PER_SECOND as f64);
    Ok(Measured {
        build,
        grow: growing_seconds(index, memory, STOPPED_AT * (build + line))?,
        paged: [grown, file_order],
        out_of_core: [
            time(Variant::None, cache)?,
            line,
            time(Variant::LineAsPrinted, cache)?,
            time(Variant::LineOrigins, cache)?,
        ],
        records_alone: [time(Variant::None, 0)?, time(Variant::Line, 0)?],
        stalled: records.stalled_nanoseconds() as f64 * 1e-9,
        picture,
    })
}

/// Seconds that the in-core program takes to make its octree while its memory is swapped; it is stopped at a limit.
fn growing_seconds(index: &Index, memory: u64, limit: f64) -> Result<f64> {
    let clock = Clock::default();
    let mut swap = Swap::new(memory, clock.clone());
    grow(index, &mut |at, bytes, writes| {
        swap.touch(at, bytes, writes);
        seconds(&clock) < limit
    })?;
    Ok(seconds(&clock))
}

/// The in-core program whose memory is paged, from nothing in memory on: seconds of a picture.
fn paged(subject: &Subject, image: &Path, layout: Layout, memory: u64, limit: f64) -> Result<f64> {
    let clock = Clock::default();
    let disk = SimulatedDisk::open(&[image.to_owned()], clock.clone())?;
    let memory = Paged::new(Box::new(disk), layout.bytes(), memory, clock.clone());
    let watch = clock.clone();
    let pixels = all_pixels(&subject.settings).take_while(move |_| seconds(&watch) < limit);
    subject.reference(Structures::new(memory, layout), Variant::None, pixels)?;
    Ok(seconds(&clock))
}

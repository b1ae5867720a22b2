//! Fig. 8: time over the size of the octree by memory, policy by policy, on the simulated disk of
//! the paper's day.

use std::ops::Deref;

use anyhow::Result;

use super::growing::{self, Grown, RADIUS};
use super::{
    READ_AROUND_BYTES, Setting, SimulatedRun, Subject, budget_of, differing, divided, same_picture_note,
    seconds,
};
use crate::engine::{Picture, all_pixels};
use crate::file_cache::FileCaching;
use crate::index::Index;
use crate::memory::Paged;
use crate::predict::{Foresight, Variant};
use crate::report::{Series, Table, megabytes, number, plot};
use crate::simulated::{Clock, SimulatedDisk};
use crate::structures::{Layout, Structures, grow, image_of_files};
use crate::swap::{LastUses, OS_PAGE_BYTES, Swap};

/// A run is stopped at so many times the time of the one that prefetches.
const STOPPED_AT: f64 = 20.0;
/// What is swapped in at a time: a page, what Linux brings in where nobody says otherwise, and as
/// much as out of core.
const SWAPPED_TOGETHER: [u64; 3] = [OS_PAGE_BYTES as u64, 8 * OS_PAGE_BYTES as u64, READ_AROUND_BYTES];

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
            "in-core program, paged by 4 KiB: build s",
            "render s",
            "by 32 KiB: build s",
            "render s",
            "by 64 KiB: build s",
            "render s",
            "file order, by 4 KiB: render s",
            "by 64 KiB s",
            "out of core: build s",
            "no prefetch s",
            "line, by blocks s",
            "around s",
            "around, line s",
            "line-as-printed s",
            "line+origins s",
            "records alone: no prefetch s",
            "line s",
            "paging by 4 KiB / around, line: build and render",
            "render",
            "by 32 KiB: build and render",
            "render",
            "by 64 KiB: build and render",
            "render",
            "file order, by 4 KiB: render",
            "by 64 KiB",
            "stalled, around, line",
        ],
    );
    let mut lines = LINES.map(|name| Series { name: name.into(), points: Vec::new() });
    let mut worst: f64 = 0.0;
    for size in growing::sizes(setting) {
        let folder = setting.work.join("fig8");
        let Grown { subject, index, .. } = growing::build(size, side, &folder)?;
        let (shipped, _) = subject.shipping()?;
        let Measured { picture, in_core, out_of_core, stalled } = measure(&subject, &index, memory)?;
        worst = worst.max(differing(&picture, &shipped));
        let whole = index.summary.index_bytes() + index.summary.point_bytes();
        let ratio = whole as f64 / memory as f64;
        let (render, all) = (out_of_core.around_line(), out_of_core.build + out_of_core.around_line());
        let [by_page, by_group, by_as_much] = in_core.grown;
        let plotted = [
            by_page.build.seconds + by_page.render.seconds,
            by_page.render.seconds,
            by_group.render.seconds,
            by_as_much.render.seconds,
            in_core.file_order[0].seconds,
            all,
            out_of_core.nothing.seconds,
            out_of_core.by_blocks.seconds,
            render,
        ];
        for (series, time) in lines.iter_mut().zip(plotted) {
            series.points.push((ratio, time));
        }
        let ratios = in_core.grown.map(|paged| [paged.whole().ratio(all), paged.render.ratio(render)]);
        table.row(
            [size.points.to_string(), size.height.to_string(), megabytes(whole), number(ratio)]
                .into_iter()
                .chain(in_core.grown.iter().flat_map(|paged| [paged.build.shown(), paged.render.shown()]))
                .chain(in_core.file_order.map(Time::shown))
                .chain([number(out_of_core.build)])
                .chain(out_of_core.renders().map(|time| time.shown()))
                .chain(ratios.into_iter().flatten())
                .chain(in_core.file_order.map(|time| time.ratio(render)))
                .chain([format!("{:.0} %", 100.0 * stalled / render)]),
        );
        std::fs::remove_dir_all(&folder)?;
    }
    note(&mut table, side, memory);
    table.note(same_picture_note(worst));
    table.write(&setting.out, "fig8")?;
    let claim = lines[LINES.len() - 1].points.iter().map(|&(ratio, line)| (ratio, 2.0 * line)).collect();
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
const LINES: [&str; 9] = [
    "paging: build and render",
    "paging: render",
    "paging by 32 KiB: render",
    "paging by 64 KiB: render",
    "paging, file order: render",
    "around, line: build and render",
    "no prefetch: render",
    "line, by blocks: render",
    "around, line: render",
];

fn note(table: &mut Table, side: u32, memory: u64) {
    table.note(format!(
        "Random points on a sphere, radius {RADIUS}, as in Table 1; {side}×{side} rays; {} MiB of memory, of which out of \
         core a quarter is for records and what goes with them, and the rest the system's file cache; where the points \
         alone exceed that, records have three quarters, and points are read past the cache. No prefetch, and line by \
         blocks: the cache reads the blocks of 4 KiB that are asked for; around: with what is absent around them, in \
         aligned groups of {} KiB, of which three could be read in one seek. Records alone have all of the memory, and no \
         cache. The in-core program takes one point after another into an octree in its heap, which is swapped, least \
         recently used, while it is built, and again while it is rendered, by 4 KiB or by aligned groups of 32 or 64 KiB; what \
         it writes takes no time; it renders with what it used last still in memory, unchanged; the program out of core begins with nothing in memory. \
         File order: paging of the same octree as the out-of-core builder orders it, from nothing in memory on. Building \
         out of core is its input and output. Time is counted, so the table is the same on every machine: 500 ns a sample, \
         50 ns a point of it, 100 ns a step from node to node. A run is stopped at {STOPPED_AT} times the time of `around, line`, \
         and plotted there.",
        memory >> 20,
        READ_AROUND_BYTES >> 10,
    ));
    table.note(
        "The paper's figure has no numbers to read off; its text says that paging takes more than twice as long as \
         prefetching in all cases where the octree exceeds memory. The plot marks that bound.",
    );
}

/// Counted seconds, or the limit at which a run was stopped.
#[derive(Clone, Copy)]
struct Time {
    seconds: f64,
    is_stopped: bool,
}

impl Time {
    fn of(clock: &Clock, limit: f64) -> Self {
        let seconds = seconds(clock);
        Self { seconds: seconds.min(limit), is_stopped: seconds >= limit }
    }

    fn said(self, text: &str) -> String {
        if self.is_stopped { format!("more than {text}") } else { text.to_owned() }
    }

    fn shown(self) -> String {
        self.said(&number(self.seconds))
    }

    fn ratio(self, other: f64) -> String {
        self.said(&number(self.seconds / other))
    }
}

/// The in-core program, paged.
#[derive(Clone, Copy)]
struct InCoreTimes {
    build: Time,
    render: Time,
}

impl InCoreTimes {
    fn whole(self) -> Time {
        Time {
            seconds: self.build.seconds + self.render.seconds,
            is_stopped: self.build.is_stopped || self.render.is_stopped,
        }
    }
}

struct AllInCore {
    /// By what is swapped in at a time.
    grown: [InCoreTimes; 3],
    /// Rendering from the order of the files, by pages and by as much as out of core.
    file_order: [Time; 2],
}

/// The program out of core.
struct OutOfCoreTimes {
    build: f64,
    /// No prefetch, block by block.
    nothing: Time,
    /// `line`, block by block.
    by_blocks: Time,
    /// Reading around: no prefetch besides, line, line as printed, line with origins.
    around: [Time; 4],
    /// No prefetch, line.
    records_alone: [Time; 2],
}

impl OutOfCoreTimes {
    fn around_line(&self) -> f64 {
        self.around[1].seconds
    }

    fn renders(&self) -> impl Iterator<Item = Time> {
        [self.nothing, self.by_blocks].into_iter().chain(self.around).chain(self.records_alone)
    }
}

struct Measured {
    picture: Picture,
    in_core: AllInCore,
    out_of_core: OutOfCoreTimes,
    /// Of `around, line`.
    stalled: f64,
}

fn measure(subject: &Subject, index: &Index, memory: u64) -> Result<Measured> {
    let run = |variant, (budget, caching), limit_seconds| {
        let run = SimulatedRun {
            foresight: Foresight::from(variant),
            prefetches: variant != Variant::None,
            caching,
            limit_seconds,
            ..SimulatedRun::paper(budget)
        };
        subject.simulated(index, run)
    };
    let (budget, around) = divided(memory, index.summary.points);
    let (picture, line, records) = run(Variant::Line, (budget, around), f64::INFINITY)?;
    let limit = STOPPED_AT * line;
    let time = |variant, division| {
        let (_, seconds, _) = run(variant, division, limit)?;
        anyhow::Ok(Time { seconds: seconds.min(limit), is_stopped: seconds >= limit })
    };
    let by_blocks = FileCaching { around_bytes: FileCaching::NONE.around_bytes, ..around };
    let alone = (budget_of(memory, index.summary.points), FileCaching::NONE);
    let build = index
        .summary
        .build_seconds(SimulatedDisk::SEEK_NANOSECONDS as f64 * 1e-9, SimulatedDisk::BYTES_PER_SECOND as f64);
    Ok(Measured {
        picture,
        stalled: records.stalled_nanoseconds() as f64 * 1e-9,
        in_core: in_core(subject, index, memory, (limit, STOPPED_AT * (build + line)))?,
        out_of_core: OutOfCoreTimes {
            build,
            nothing: time(Variant::None, (budget, by_blocks))?,
            by_blocks: time(Variant::Line, (budget, by_blocks))?,
            around: [
                time(Variant::None, (budget, around))?,
                Time { seconds: line, is_stopped: false },
                time(Variant::LineAsPrinted, (budget, around))?,
                time(Variant::LineOrigins, (budget, around))?,
            ],
            records_alone: [time(Variant::None, alone)?, time(Variant::Line, alone)?],
        },
    })
}

/// The in-core program whose memory is swapped; it is stopped at limits of a picture, and of all.
fn in_core(
    subject: &Subject,
    index: &Index,
    memory: u64,
    (render_limit, whole_limit): (f64, f64),
) -> Result<AllInCore> {
    let mut uses = LastUses::default();
    let mut growing = SWAPPED_TOGETHER.map(|together| {
        let clock = Clock::default();
        (Swap::new(memory, clock.clone()).reading_around(together), clock)
    });
    let (heap, layout) = grow(index, &mut |at, bytes, writes| {
        uses.touch(at, bytes);
        for (swap, clock) in &mut growing {
            if seconds(clock) < whole_limit {
                clock.advance(crate::records::Work::Step.nanoseconds());
                swap.touch(at, bytes, writes);
            }
        }
    })?;
    let builds = growing.map(|(_, clock)| Time::of(&clock, whole_limit));
    let renders = SWAPPED_TOGETHER.map(|together| {
        let swap = |clock| Swap::new(memory, clock).reading_around(together).left_by(&uses);
        paged(subject, heap.as_slice(), layout, swap, render_limit)
    });
    let [by_page, by_group, by_as_much] = renders;
    let renders = [by_page?, by_group?, by_as_much?];
    drop(heap);
    let (files, layout) = image_of_files(index)?;
    let in_file_order = |together| {
        let swap = |clock| Swap::new(memory, clock).reading_around(together).swapped_out(layout.bytes());
        paged(subject, files.as_slice(), layout, swap, render_limit)
    };
    Ok(AllInCore {
        grown: [0, 1, 2].map(|i| InCoreTimes { build: builds[i], render: renders[i] }),
        file_order: [in_file_order(SWAPPED_TOGETHER[0])?, in_file_order(READ_AROUND_BYTES)?],
    })
}

/// A picture by the in-core program whose memory is paged.
fn paged<B: Deref<Target = [u8]>>(
    subject: &Subject,
    all: B,
    layout: Layout,
    swap: impl FnOnce(Clock) -> Swap,
    limit: f64,
) -> Result<Time> {
    let clock = Clock::default();
    let memory = Paged::new(all, swap(clock.clone()), clock.clone());
    let watch = clock.clone();
    let pixels = all_pixels(&subject.settings).take_while(move |_| seconds(&watch) < limit);
    subject.reference(Structures::new(memory, layout), Variant::None, pixels)?;
    Ok(Time::of(&clock, limit))
}

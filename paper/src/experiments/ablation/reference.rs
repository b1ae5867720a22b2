//! The reference engine with one thing changed at a time, on the simulated disk and on that of this
//! machine.

use std::time::Instant;

use anyhow::{Context as _, Result};
use rayset::working_set::read::BackendKind;

use super::super::{
    BATCH, Setting, SimulatedRun, Subject, budget_of, differing, median, same_picture_note, scan_or, seconds,
};
use crate::disk::RealDisk;
use crate::engine::all_pixels;
use crate::file_cache::FileCaching;
use crate::index::{Index, Limits, stream_points};
use crate::predict::{Foresight, Variant};
use crate::records::OutOfCore;
use crate::report::{Table, bars, number};
use crate::simulated::{Clock, SimulatedDisk};

/// A run is stopped at so many times the time of the usual.
const STOPPED_AT: f64 = 5.0;
/// Memory is this part of the data.
const MEMORY_PART: u64 = 8;

pub(super) fn run(setting: &Setting) -> Result<()> {
    let side = setting.pick(16, 64);
    let folder = setting.work.join("ablation");
    std::fs::create_dir_all(&folder)?;
    let source = scan_or(setting, setting.pick("vase-8k", "vase-35947"))?;
    let subject = Subject::build(source, None, side, &folder.join("c.rset"))?;
    let index = subject.index(&folder, Limits { height: 6, leaf_points: 32 })?;
    let memory = (index.summary.index_bytes() + index.summary.point_bytes()) / MEMORY_PART;
    let usual = SimulatedRun::paper(budget_of(memory, index.summary.points));
    let mut table = Table::new(
        "Ablation: the reference engine",
        &[
            "what is varied",
            "",
            "simulated disk s",
            "stalled",
            "reads",
            "MB read",
            "nodes: misses",
            "late",
            "prefetched and used",
            "points: misses",
            "prefetched and used",
            "this machine's disk s",
            "stalled",
        ],
    );
    let (shipped, _) = subject.shipping()?;
    let limit = STOPPED_AT * subject.simulated(&index, usual)?.1;
    let real_limit = STOPPED_AT * real(&subject, &index, usual, BackendKind::Auto, f64::INFINITY)?.seconds;
    let changes = changes(setting, usual, (memory, index.summary.points));
    let repeats = setting.pick(1, 3);
    let on_disk = on_disk(&subject, &index, &changes, (repeats, real_limit))?;
    let (mut worst, mut shown): (f64, _) = (0.0, Vec::new());
    for (Change { what, value, run, .. }, on_disk) in changes.into_iter().zip(on_disk) {
        let run = SimulatedRun { limit_seconds: limit, ..run };
        let (picture, simulated, records) = subject.simulated(&index, run)?;
        if simulated < limit {
            worst = worst.max(differing(&picture, &shipped));
        }
        let [nodes, secondary, points] = records.counts();
        let used = |used: u64, all: u64| {
            (100 * used).checked_div(all).map_or_else(|| "–".into(), |percent| format!("{percent} %"))
        };
        let [real_seconds, real_stalled] = on_disk.map_or_else(
            || ["–"; 2].map(ToOwned::to_owned),
            |run| [shown_until(real_limit, run.seconds), format!("{:.0} %", 100.0 * run.stalled)],
        );
        table.row([
            what.to_owned(),
            value.clone(),
            shown_until(limit, simulated),
            format!("{:.1} %", 1e-7 * records.stalled_nanoseconds() as f64 / simulated),
            (nodes.reads + secondary.reads + points.reads).to_string(),
            number((nodes.bytes + secondary.bytes + points.bytes) as f64 / 1e6),
            nodes.misses.to_string(),
            nodes.late.to_string(),
            used(nodes.prefetched_used, nodes.prefetched),
            points.misses.to_string(),
            used(points.prefetched_used, points.prefetched),
            real_seconds,
            real_stalled,
        ]);
        shown.push((format!("{what}: {value}"), simulated));
    }
    std::fs::remove_dir_all(&folder)?;
    table.note(format!(
        "{} points, {} nodes, memory an eighth of the data, with what goes with a record ({} nodes, {} points), {side}×{side} rays. One thing is changed at \
         a time; the usual is `line`, the next leaf, {BATCH} reads a call, the paper's groups (eight children together, all \
         else record by record), no file cache. Bytes a read: of nodes, lists and points alike. Nothing: what a sample waits for, and the siblings of a node with it. \
         Children and lists: what section 4.2 brings in with a node and a leaf, without any prediction; the predictors have \
         that too. The real disk is read past the page cache; medians of {repeats} that take turns. Reading around: the file cache brings what \
         is absent around what is asked for, in aligned groups of so many bytes. A run \
         is stopped at {STOPPED_AT} times the usual.",
        index.summary.points, index.summary.nodes, usual.budget.nodes, usual.budget.points
    ));
    table.note(same_picture_note(worst));
    table.write(&setting.out, "ablation")?;
    bars(&setting.out.join("ablation.svg"), "Ablation: seconds on the simulated disk", "seconds", &shown)
}

struct Change {
    what: &'static str,
    value: String,
    run: SimulatedRun,
    backend: BackendKind,
}

fn changes(setting: &Setting, usual: SimulatedRun, (memory, points): (u64, u64)) -> Vec<Change> {
    let backend = BackendKind::Auto;
    let change = |what, value: String, run| Change { what, value, run, backend };
    let of = |variant| SimulatedRun { foresight: Foresight::from(variant), ..usual };
    let alone = SimulatedRun { prefetches: false, batch: 1, ..of(Variant::None) };
    let mut all = vec![change("ahead of use", "nothing".into(), alone)];
    for variant in Variant::ALL {
        let name = if variant == Variant::None { "children and lists".into() } else { variant.to_string() };
        all.push(change("ahead of use", name, of(variant)));
    }
    for depth in setting.pick(&[4][..], &[2, 4, 8, 16][..]) {
        let foresight = Foresight { variant: Variant::Line, depth: *depth };
        all.push(change("leaves ahead", depth.to_string(), SimulatedRun { foresight, ..usual }));
    }
    for batch in [1, 4, 64] {
        all.push(change("reads a call", batch.to_string(), SimulatedRun { batch, ..usual }));
    }
    for bytes in [244, 1952, 4096, 16 << 10, 64 << 10, 256 << 10] {
        let run = SimulatedRun { read_bytes: Some(bytes), ..usual };
        all.push(change("bytes a read", bytes.to_string(), run));
    }
    for part in [1, 2, 3] {
        let caching = FileCaching::by_blocks(memory / 4 * part);
        let budget = budget_of(memory - caching.bytes, points);
        let run = SimulatedRun { budget, caching, ..usual };
        all.push(change("file cache, of the memory", format!("{part}/4"), run));
    }
    for around_bytes in [16 << 10, 64 << 10, 256 << 10] {
        let caching = FileCaching { around_bytes, ..FileCaching::by_blocks(memory / 4 * 3) };
        let budget = budget_of(memory - caching.bytes, points);
        for variant in [Variant::None, Variant::Line] {
            let run = SimulatedRun { budget, caching, ..of(variant) };
            let name =
                if variant == Variant::None { "children and lists".into() } else { variant.to_string() };
            all.push(change("3/4, reading around", format!("{} KiB, {name}", around_bytes >> 10), run));
        }
    }
    for (name, backend) in [("io_uring", BackendKind::Uring), ("threads", BackendKind::Pool)] {
        // Not every system has the first.
        if rayset::working_set::read::backend(backend).is_ok() {
            all.push(Change { what: "I/O backend", value: name.into(), run: usual, backend });
        }
    }
    all
}

fn shown_until(limit: f64, time: f64) -> String {
    if time >= limit { format!("more than {}", number(limit)) } else { number(time) }
}

/// A run on the disk there is.
#[derive(Clone, Copy)]
struct OnDisk {
    seconds: f64,
    /// Of these, waited.
    stalled: f64,
}

/// Medians on the disk there is, of runs that take turns, so that what else the machine does meets
/// all alike. Nothing for changes of the file cache: that of the system at hand is not ours to
/// limit.
fn on_disk(
    subject: &Subject,
    index: &Index,
    changes: &[Change],
    (repeats, limit): (usize, f64),
) -> Result<Vec<Option<OnDisk>>> {
    let mut runs = vec![Vec::new(); changes.len()];
    for _ in 0..repeats {
        for (runs, change) in runs.iter_mut().zip(changes) {
            if change.run.caching == FileCaching::NONE {
                runs.push(real(subject, index, change.run, change.backend, limit)?);
            }
        }
    }
    let of =
        |runs: &Vec<OnDisk>, what: fn(&OnDisk) -> f64| median(&mut runs.iter().map(what).collect::<Vec<_>>());
    let medians =
        |runs: &Vec<OnDisk>| OnDisk { seconds: of(runs, |r| r.seconds), stalled: of(runs, |r| r.stalled) };
    Ok(runs.iter().map(|runs| (!runs.is_empty()).then(|| medians(runs))).collect())
}

fn real(
    subject: &Subject,
    index: &Index,
    run: SimulatedRun,
    backend: BackendKind,
    limit: f64,
) -> Result<OnDisk> {
    let disk = RealDisk::open(&index.files(), true, backend)?;
    let mut records = OutOfCore::new(Box::new(disk), run.budget, run.batch, run.prefetches, None);
    if let Some(bytes) = run.read_bytes {
        records = records.reading(bytes);
    }
    let started = Instant::now();
    let pixels = all_pixels(&subject.settings).take_while(|_| started.elapsed().as_secs_f64() < limit);
    let (_, records) = subject.reference(records, run.foresight, pixels)?;
    let seconds = started.elapsed().as_secs_f64();
    Ok(OnDisk { seconds, stalled: records.stalled_nanoseconds() as f64 * 1e-9 / seconds })
}

/// The point controller while points are streamed, with and without its predictor of regular
/// accesses.
pub(super) fn streaming(setting: &Setting) -> Result<()> {
    let points = setting.pick(20_000, 1_000_000);
    let folder = setting.work.join("streaming");
    std::fs::create_dir_all(&folder)?;
    let workload: rayset::points::Workload = format!("sphere-{points}").parse()?;
    let subject = Subject::build(workload.source(), workload.radius(), 8, &folder.join("c.rset"))?;
    let index = subject.index(&folder, Limits { height: 1, leaf_points: u64::from(u32::MAX) })?;
    let [_, _, file] = index.files();
    let mut table = Table::new(
        "Ablation: streaming points",
        &["predictor", "simulated disk s", "misses", "late", "in time", "this machine's disk s", "stalled"],
    );
    for (name, predicts) in [("none", false), ("regular accesses", true)] {
        let clock = Clock::default();
        let mut disk = SimulatedDisk::open(std::slice::from_ref(&file), clock.clone())?;
        let process = |_: u32, _: &crate::record::Point| {
            clock.advance(PROCESSING_NANOSECONDS);
            Ok(())
        };
        let counts = stream_points(&mut disk, 0, index.summary.points, predicts, process)?;
        let mut real = RealDisk::open(std::slice::from_ref(&file), true, BackendKind::Auto)?;
        let started = Instant::now();
        stream_points(&mut real, 0, index.summary.points, predicts, |_, _| Ok(()))?;
        let real_seconds = started.elapsed().as_secs_f64();
        let stalled = crate::disk::Disk::stalled_nanoseconds(&real) as f64 * 1e-9;
        table.row([
            name.to_owned(),
            number(seconds(&clock)),
            counts.misses.to_string(),
            counts.late.to_string(),
            counts.prefetched_used.saturating_sub(counts.late).to_string(),
            number(real_seconds),
            format!("{:.0} %", 100.0 * stalled / real_seconds),
        ]);
    }
    std::fs::remove_dir_all(&folder).context("temporary files")?;
    table.note(format!(
        "{points} points of 32 bytes, one after another, {PROCESSING_NANOSECONDS} ns for each on the simulated disk; a block of \
         4 KiB a read, {} points ahead where three accesses in a row are as far apart from each other.",
        crate::predict::Regular::AHEAD
    ));
    table.write(&setting.out, "ablation-streaming")
}

/// What a processor of the paper's day does with a point of an octree that is built.
const PROCESSING_NANOSECONDS: u64 = 500;

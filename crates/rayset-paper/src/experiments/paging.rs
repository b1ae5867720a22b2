//! Fig. 8 on the disk there is, for both engines: each run in a process of its own under a hard cap on memory, page cache
//! cold and counted.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context as _, Result, ensure};
use rayset::points::Workload;

use super::growing::{self, Grown};
use super::render::layout_file;
use super::{Setting, Subject, budget_of, median};
use crate::cap::Cap;
use crate::mapped::make_cold;
use crate::report::{Series, Table, megabytes, number, plot};
use crate::structures::{Layout, grow, write_files};

/// What a process may use, page cache included.
const CAP_BYTES: u64 = 32 << 20;
/// Of that, what is not records or pages.
const PROCESS_BYTES: u64 = 14 << 20;
/// Of that, where the system's file cache is to have a part: what caches of records have.
const BESIDE_FILE_CACHE_BYTES: u64 = 6 << 20;
/// Larger octrees take hours, point by point past the page cache.
const MOST_POINTS: u64 = 300_000;
/// What a process may take before it begins to render.
const START_SECONDS: f64 = 1.0;
/// A run that takes so many seconds is made once.
const LONG: f64 = 20.0;
/// A run is ended when it has taken so many times as long as the one that prefetches.
const STOPPED_AT: f64 = 20.0;

const REFERENCE_TITLE: &str = "Paging on this machine's disk, under a cap of 32 MiB: the reference engine";

/// The reference engine.
pub(super) fn reference(setting: &Setting) -> Result<()> {
    if left_out(setting, "paging", REFERENCE_TITLE)? {
        return Ok(());
    }
    let side = setting.pick(24, 96);
    let repeats = setting.pick(1, 3);
    let mut table = Table::new(
        REFERENCE_TITLE,
        &[
            "points",
            "H",
            "data MB",
            "data / cap",
            "map, grown s",
            "with random advice s",
            "map, file order s",
            "with random advice s",
            "no prefetch s",
            "line s",
            "line, file cache s",
            "shipping s",
            "least paging, grown / least line",
            "least paging of all / least line",
            "least paging of all / shipping",
        ],
    );
    let names = [
        "map, grown",
        "map, grown, random advice",
        "map, file order",
        "map, file order, random advice",
        "no prefetch",
        "line",
        "line, file cache",
        "shipping",
    ];
    let mut lines = names.map(|name| Series { name: name.into(), points: Vec::new() });
    for size in growing::sizes(setting).into_iter().filter(|size| size.points <= MOST_POINTS) {
        let folder = setting.work.join("paging");
        let Grown { subject, index, .. } = growing::build(size, side, &folder)?;
        std::fs::write(folder.join("index.json"), serde_json::to_string(&index.summary)?)?;
        let whole = index.summary.index_bytes() + index.summary.point_bytes();
        let (file_order, grown) = (folder.join("files.bin"), folder.join("heap.bin"));
        write_layout(&file_order, write_files(&index, &file_order)?)?;
        let (heap, layout) = grow(&index, &mut |_, _, _| {})?;
        std::fs::write(&grown, heap)?;
        write_layout(&grown, layout)?;
        let cloud = folder.join("c.rset");
        let cold: Vec<PathBuf> =
            index.files().into_iter().chain([cloud.clone(), file_order.clone(), grown.clone()]).collect();
        drop(subject);
        let capped = |arguments: &[&str], limit| {
            let side = side.to_string();
            let all = [&["--side", &side], arguments].concat();
            capped_seconds(&cloud, Some(&folder), &all, &cold, limit)
        };
        let caches = |bytes: u64, more: &[&str], limit| {
            let budget = budget_of(bytes, index.summary.points);
            let (nodes, points) = (budget.nodes.to_string(), budget.points.to_string());
            let caches = ["--records", "caches", "--nodes", &nodes, "--points", &points];
            capped(&[&caches[..], more].concat(), limit)
        };
        let map = |kind: &str, image: &Path, limit| {
            capped(&["--records", kind, "--image", &image.display().to_string()], limit)
        };
        let for_records = CAP_BYTES - PROCESS_BYTES;
        let cached = ["--predictor", "line", "--buffered"];
        let line = caches(for_records, &["--predictor", "line"], None)?.seconds;
        let limit = Some(STOPPED_AT * line);
        let mut engines = ["reference"; 8];
        engines[7] = "shipping";
        let times = in_turn(
            repeats,
            engines,
            [
                &|| map("map", &grown, limit),
                &|| map("map-random", &grown, limit),
                &|| map("map", &file_order, limit),
                &|| map("map-random", &file_order, limit),
                &|| caches(for_records, &["--predictor", "none"], limit),
                &|| caches(for_records, &["--predictor", "line"], None),
                &|| caches(BESIDE_FILE_CACHE_BYTES, &cached, limit),
                &|| capped(&["--records", "shipping", "--page-bytes", &for_records.to_string()], limit),
            ],
        )?;
        let ratio = whole as f64 / CAP_BYTES as f64;
        // By the number of points; those by the height stand in the table.
        let is_plotted = setting.pick(true, size.height == growing::PLOTTED_HEIGHT);
        for (series, time) in lines.iter_mut().zip(times).filter(|_| is_plotted) {
            series.points.push((ratio, time));
        }
        let least = |some: &[f64]| some.iter().copied().fold(f64::INFINITY, f64::min);
        let (least_line, least_paging) = (least(&times[5..7]), least(&times[..4]));
        table.row(
            [size.points.to_string(), size.height.to_string(), megabytes(whole), number(ratio)]
                .into_iter()
                .chain(times.map(|time| shown(time, limit)))
                .chain([number(least(&times[..2]) / least_line), number(least_paging / least_line)])
                .chain([number(least_paging / times[7])]),
        );
        std::fs::remove_dir_all(&folder)?;
    }
    table.note(format!(
        "Octrees of Table 1's spheres, {side}×{side} rays. Grown: structures as an in-core program leaves them in its heap; \
         file order: as the files of the index have them. Each run is a process of its own in a control group whose limit \
         counts page cache too; files are driven out of the page cache first. Caches have {} MiB for records and what goes \
         with them, read past the page cache; with a file cache {} MiB, and the rest of the cap is the system's. The engine \
         that ships has {} MiB for pages. Medians of {repeats} that take turns, runs of {LONG} s and more once; a run is ended at {STOPPED_AT} times the time of `line`.",
        (CAP_BYTES - PROCESS_BYTES) >> 20,
        BESIDE_FILE_CACHE_BYTES >> 20,
        (CAP_BYTES - PROCESS_BYTES) >> 20
    ));
    table.write(&setting.out, "paging")?;
    plot(&setting.out.join("paging.svg"), "Paging on a real disk, 32 MiB", ("data / cap", "seconds"), &lines)
}

const SHIPPING_TITLE: &str = "Paging on this machine's disk, under a cap of 32 MiB: the engine that ships";

/// The engine that ships.
pub(super) fn shipping(setting: &Setting) -> Result<()> {
    if left_out(setting, "paging-shipping", SHIPPING_TITLE)? {
        return Ok(());
    }
    let side = setting.pick(32, 128);
    let repeats = setting.pick(1, 3);
    let sizes: &[u64] = setting.pick(&[20_000], &[1_200_000, 5_000_000, 20_000_000, 80_000_000]);
    let mut table = Table::new(
        SHIPPING_TITLE,
        &[
            "points",
            "file MB",
            "file / cap",
            "rays",
            "map s",
            "map, random s",
            "no prefetch s",
            "packet s",
            "map / packet",
            "map, random / packet",
        ],
    );
    let kinds = [("opaque", None), ("translucent", Some("--translucent"))];
    let policies = ["map", "map, random advice", "packet"];
    let mut lines: Vec<Series> = kinds
        .iter()
        .flat_map(|(kind, _)| policies.map(|policy| format!("{kind}: {policy}")))
        .map(|name| Series { name, points: Vec::new() })
        .collect();
    for &points in sizes {
        let folder = setting.work.join("paging-shipping");
        std::fs::create_dir_all(&folder)?;
        let workload: Workload = format!("sphere-{points}").parse()?;
        let cloud = folder.join("c.rset");
        let subject = Subject::build(workload.source(), workload.radius(), side, &cloud)?;
        let file_bytes = subject.cloud.header().file_bytes;
        drop(subject);
        let ratio = file_bytes as f64 / CAP_BYTES as f64;
        for ((kind, more), lines) in kinds.iter().zip(lines.chunks_mut(policies.len())) {
            let cold = [cloud.clone()];
            let side = side.to_string();
            let capped = |records: &str, predictor: &str, bytes: u64, limit| {
                let bytes = bytes.to_string();
                let mut all = vec!["--side", &side, "--records", records, "--page-bytes", &bytes];
                all.extend(["--ship-predictor", predictor]);
                all.extend(more);
                capped_seconds(&cloud, None, &all, &cold, limit)
            };
            let pages = CAP_BYTES - PROCESS_BYTES;
            let limit = Some(STOPPED_AT * capped("shipping", "packet", pages, None)?.seconds);
            let times = in_turn(
                repeats,
                ["shipping"; 4],
                [
                    &|| capped("shipping-map", "none", MAPPED_BYTES, limit),
                    &|| capped("shipping-map-random", "none", MAPPED_BYTES, limit),
                    &|| capped("shipping", "none", pages, limit),
                    &|| capped("shipping", "packet", pages, None),
                ],
            )?;
            for (series, time) in lines.iter_mut().zip([times[0], times[1], times[3]]) {
                series.points.push((ratio, time));
            }
            table.row(
                [points.to_string(), megabytes(file_bytes), number(ratio), (*kind).to_owned()]
                    .into_iter()
                    .chain(times.map(|time| shown(time, limit)))
                    .chain([number(times[0] / times[3]), number(times[1] / times[3])]),
            );
        }
        std::fs::remove_dir_all(&folder)?;
    }
    table.note(format!(
        "Spheres, about 40 supports overlapping, {side}×{side} rays, one thread. Map: the same engine over the same file, \
         whose pages are used where the system maps them, without copies; each is checked when it is first used, and again \
         once {} MiB of others have been. Otherwise {} MiB for pages, direct reads. Page cache cold and counted; medians of \
         {repeats} that take turns, runs of {LONG} s and more once; a run is ended at {STOPPED_AT} times the time of `packet`.",
        MAPPED_BYTES >> 20,
        (CAP_BYTES - PROCESS_BYTES) >> 20
    ));
    table.write(&setting.out, "paging-shipping")?;
    plot(
        &setting.out.join("paging-shipping.svg"),
        "The engine that ships against its own file in a map, 32 MiB",
        ("file / cap", "seconds"),
        &lines,
    )
}

/// Says so where memory cannot be capped here.
fn left_out(setting: &Setting, name: &str, title: &str) -> Result<bool> {
    if Cap::new(CAP_BYTES).is_some() {
        return Ok(false);
    }
    let mut table = Table::new(title, &["not measured"]);
    table.note("This system lets nobody cap the memory of a process by control groups: left out.");
    table.write(&setting.out, name)?;
    Ok(true)
}

/// Pages of a map that the working set knows of at a time; they take none of its memory.
const MAPPED_BYTES: u64 = 256 << 20;

fn write_layout(image: &Path, layout: Layout) -> Result<()> {
    Ok(std::fs::write(layout_file(image), serde_json::to_string(&layout)?)?)
}

fn shown(time: f64, limit: Option<f64>) -> String {
    if limit.is_some_and(|limit| time >= limit) {
        format!("more than {}", number(time))
    } else {
        number(time)
    }
}

/// A run: how long it took, and what its picture is, where it came to an end.
struct Run {
    seconds: f64,
    picture: Option<String>,
}

/// Medians of runs that take turns, so that what else the machine does meets all alike.
fn in_turn<const N: usize>(
    repeats: usize,
    engines: [&str; N],
    runs: [&dyn Fn() -> Result<Run>; N],
) -> Result<[f64; N]> {
    let mut times: [Vec<f64>; N] = std::array::from_fn(|_| Vec::new());
    let mut pictures: HashMap<&str, String> = HashMap::new();
    for _ in 0..repeats {
        for ((times, run), engine) in times.iter_mut().zip(runs).zip(engines) {
            if times.first().is_some_and(|first| *first >= LONG) {
                continue;
            }
            let Run { seconds, picture } = run()?;
            times.push(seconds);
            // One engine makes one picture, wherever its data are.
            if let Some(picture) = picture {
                let known = pictures.entry(engine).or_insert_with(|| picture.clone());
                ensure!(*known == picture, "the {engine} engine made two different pictures");
            }
        }
    }
    Ok(times.map(|mut times| median(&mut times)))
}

/// Seconds of a render in a process under the cap, or the limit where it is ended there.
fn capped_seconds(
    cloud: &Path,
    index: Option<&Path>,
    arguments: &[&str],
    cold: &[PathBuf],
    limit: Option<f64>,
) -> Result<Run> {
    make_cold(cold)?;
    let cap = Cap::new(CAP_BYTES).context("a control group")?;
    let program = std::env::current_exe().context("cannot find this program's own file")?;
    let mut command = Command::new(if limit.is_some() { "timeout".as_ref() } else { program.as_os_str() });
    if let Some(limit) = limit {
        command.arg(format!("{:.3}", limit + START_SECONDS)).arg(&program);
    }
    command.arg("render").arg(cloud).args(arguments);
    if let Some(index) = index {
        command.arg("--index").arg(index);
    }
    let output = cap.run(&command).context("cannot start a render")?;
    // `timeout` ends with 124.
    if let (Some(limit), Some(124)) = (limit, output.status.code()) {
        return Ok(Run { seconds: limit, picture: None });
    }
    let error = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "{arguments:?}: {} {error}", output.status);
    let peak = cap.peak_bytes().unwrap_or(0);
    ensure!(peak > 0, "nothing was counted in the group: the process was not in it");
    ensure!(peak <= CAP_BYTES, "{peak} bytes were used under a cap of {CAP_BYTES}");
    let found: serde_json::Value = serde_json::from_slice(&output.stdout)?;
    let seconds = found["seconds"].as_f64().context("a report without seconds")?;
    Ok(Run { seconds, picture: found["picture"].as_str().map(ToOwned::to_owned) })
}

//! The reference engine on the disk there is, its caches against paging of its structures.

use std::path::{Path, PathBuf};

use anyhow::Result;

use super::super::growing::{self, Grown};
use super::super::render::layout_file;
use super::super::{READ_AROUND_BYTES, Setting, budget_of};
use super::{CAP_BYTES, LONG, PROCESS_BYTES, STOPPED_AT, capped_seconds, in_turn, left_out, ratio, shown};
use crate::report::{Series, Table, megabytes, number, plot};
use crate::structures::{Layout, grow, write_files};

/// What caches of records have where the system's file cache is to have a part of the cap.
const BESIDE_FILE_CACHE_BYTES: u64 = 6 << 20;
/// Larger octrees take hours, point by point past the page cache.
const MOST_POINTS: u64 = 300_000;

const TITLE: &str = "Paging on this machine's disk, under a cap of 32 MiB: the reference engine";

/// Every octree, every policy.
pub(in super::super) fn run(setting: &Setting) -> Result<()> {
    if left_out(setting, "paging", TITLE)? {
        return Ok(());
    }
    let side = setting.pick(24, 96);
    let repeats = setting.pick(1, 3);
    let mut table = Table::new(
        TITLE,
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
            "around, line, file cache s",
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
        "around, line, file cache",
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
        let around_bytes = READ_AROUND_BYTES.to_string();
        let around = [&cached[..], &["--around", &around_bytes]].concat();
        let line = caches(for_records, &["--predictor", "line"], None)?.seconds;
        let limit = Some(STOPPED_AT * line);
        let mut engines = ["reference"; 9];
        engines[8] = "shipping";
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
                &|| caches(BESIDE_FILE_CACHE_BYTES, &around, limit),
                &|| capped(&["--records", "shipping", "--page-bytes", &for_records.to_string()], limit),
            ],
        )?;
        let by_cap = whole as f64 / CAP_BYTES as f64;
        // By the number of points; those by the height stand in the table.
        let is_plotted = setting.pick(true, size.height == growing::PLOTTED_HEIGHT);
        for (series, time) in lines.iter_mut().zip(times).filter(|_| is_plotted) {
            series.points.push((by_cap, time));
        }
        let least = |some: &[f64]| some.iter().copied().fold(f64::INFINITY, f64::min);
        let (least_line, least_paging) = (least(&times[5..8]), least(&times[..4]));
        table.row(
            [size.points.to_string(), size.height.to_string(), megabytes(whole), number(by_cap)]
                .into_iter()
                .chain(times.map(|time| shown(time, limit)))
                .chain([ratio(least(&times[..2]), least_line, limit)])
                .chain([ratio(least_paging, least_line, limit), ratio(least_paging, times[8], limit)]),
        );
        std::fs::remove_dir_all(&folder)?;
    }
    table.note(format!(
        "Octrees of Table 1's spheres, {side}×{side} rays. Grown: structures as an in-core program leaves them in its heap; \
         file order: as the files of the index have them. Each run is a process of its own in a control group whose limit \
         counts page cache too; files are driven out of the page cache first. Caches have {} MiB for records and what goes \
         with them, read past the page cache; with a file cache {} MiB, and the rest of the cap is the system's; around: which is told to bring aligned groups of \
         {} KiB (`posix_fadvise`). The engine that ships has {} MiB for pages. Medians of {repeats} that take turns, runs of {LONG} s and more once; a run is ended at {STOPPED_AT} times the time of `line`.",
        (CAP_BYTES - PROCESS_BYTES) >> 20,
        BESIDE_FILE_CACHE_BYTES >> 20,
        READ_AROUND_BYTES >> 10,
        (CAP_BYTES - PROCESS_BYTES) >> 20
    ));
    table.write(&setting.out, "paging")?;
    plot(&setting.out.join("paging.svg"), "Paging on a real disk, 32 MiB", ("data / cap", "seconds"), &lines)
}

fn write_layout(image: &Path, layout: Layout) -> Result<()> {
    Ok(std::fs::write(layout_file(image), serde_json::to_string(&layout)?)?)
}

//! The engine that ships on the disk there is, its working set against a map of its own file.

use anyhow::Result;
use rayset::points::Workload;

use super::super::{Setting, Subject};
use super::{CAP_BYTES, LONG, STOPPED_AT, capped_seconds, in_turn, left_out, ratio, shown};
use crate::report::{Series, Table, megabytes, number, plot};

/// What the process takes beside pages is under 8 MB; this is room for what else is counted in its
/// group.
const BESIDE_PAGES_BYTES: u64 = 10 << 20;

const TITLE: &str = "Paging on this machine's disk, under a cap of 32 MiB: the engine that ships";

/// Every cloud, every policy.
pub(in super::super) fn run(setting: &Setting) -> Result<()> {
    if left_out(setting, "paging-shipping", TITLE)? {
        return Ok(());
    }
    let side = setting.pick(32, 128);
    let repeats = setting.pick(1, 3);
    let sizes: &[u64] = setting.pick(&[20_000], &[1_200_000, 5_000_000, 20_000_000, 80_000_000, 340_000_000]);
    let mut table = Table::new(
        TITLE,
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
        let by_cap = file_bytes as f64 / CAP_BYTES as f64;
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
            let pages = CAP_BYTES - BESIDE_PAGES_BYTES;
            let limit = Some(STOPPED_AT * capped("shipping", "packet", pages, None)?.seconds);
            let times = in_turn(
                repeats,
                ["shipping"; 4],
                [
                    &|| capped("shipping-map", "none", 0, limit),
                    &|| capped("shipping-map-random", "none", 0, limit),
                    &|| capped("shipping", "none", pages, limit),
                    &|| capped("shipping", "packet", pages, None),
                ],
            )?;
            for (series, time) in lines.iter_mut().zip([times[0], times[1], times[3]]) {
                series.points.push((by_cap, time));
            }
            table.row(
                [points.to_string(), megabytes(file_bytes), number(by_cap), (*kind).to_owned()]
                    .into_iter()
                    .chain(times.map(|time| shown(time, limit)))
                    .chain([times[0], times[1]].map(|map| ratio(map, times[3], limit))),
            );
        }
        std::fs::remove_dir_all(&folder)?;
    }
    table.note(format!(
        "Spheres, about 40 supports overlapping, {side}×{side} rays, one thread. Map: the same engine over the same file, \
         whose pages are used where the system maps them, without copies; each is checked when it is first used. Otherwise {} MiB for pages, direct reads. Page cache cold and counted; medians of \
         {repeats} that take turns, runs of {LONG} s and more once; a run is ended at {STOPPED_AT} times the time of `packet`.",
        (CAP_BYTES - BESIDE_PAGES_BYTES) >> 20
    ));
    table.write(&setting.out, "paging-shipping")?;
    plot(
        &setting.out.join("paging-shipping.svg"),
        "The engine that ships against its own file in a map, 32 MiB",
        ("file / cap", "seconds"),
        &lines,
    )
}

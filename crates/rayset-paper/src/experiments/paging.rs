//! Fig. 8 on the disk there is: the same policies, each in a process of its own under a hard cap on memory, page cache cold
//! and counted.

use std::path::Path;
use std::process::Command;

use anyhow::{Context as _, Result};
use rayset::points::Workload;

use super::{Setting, Subject};
use crate::cache::OVERHEAD_BYTES;
use crate::cap::Cap;
use crate::index::{Index, Limits};
use crate::mapped::make_cold;
use crate::record::{NODE_BYTES, POINT_BYTES};
use crate::records::Budget;
use crate::report::{Series, Table, number, plot};

/// What a process may use, page cache included.
const CAP_BYTES: u64 = 32 << 20;
/// Of that, what is not records or pages.
const PROCESS_BYTES: u64 = 14 << 20;
/// A run is ended when it has taken so many times as long as the one that prefetches.
const STOPPED_AT: f64 = 20.0;

pub(super) fn run(setting: &Setting) -> Result<()> {
    if Cap::new(CAP_BYTES).is_none() {
        let mut table = Table::new("Paging on this machine's disk", &["not measured"]);
        table.note("This system lets nobody cap the memory of a process by control groups: the experiment was left out.");
        return table.write(&setting.out, "paging");
    }
    let (points, side) = setting.pick((5_000, 24), (100_000, 128));
    let heights = setting.pick(5..7, 4..8);
    let mut table = Table::new(
        "Paging on this machine's disk, under a cap of 32 MiB",
        &[
            "H",
            "data MB",
            "data / cap",
            "map s",
            "map, random s",
            "no prefetch s",
            "line s",
            "shipping s",
            "least paging / line",
            "least paging / shipping",
        ],
    );
    let names = ["map", "map, random advice", "no prefetch", "line", "shipping"];
    let mut lines = names.map(|name| Series { name: name.into(), points: Vec::new() });
    for height in heights {
        let folder = setting.work.join(format!("paging-{height}"));
        std::fs::create_dir_all(&folder)?;
        let workload: Workload = format!("sphere-{points}").parse()?;
        let cloud = folder.join("c.rset");
        let subject = Subject::build(workload.source(), Some(0.1), side, &cloud)?;
        let index = subject.index(&folder, Limits { height, leaf_points: 1 })?;
        std::fs::write(folder.join("index.json"), serde_json::to_string(&index.summary)?)?;
        let whole = index.summary.index_bytes() + index.summary.point_bytes();
        let budget = budget_with_overhead(CAP_BYTES - PROCESS_BYTES, points);
        let (nodes, points_in_core) = (budget.nodes.to_string(), budget.points.to_string());
        let caches = ["--records", "caches", "--nodes", &nodes, "--points", &points_in_core];
        let page_bytes = (CAP_BYTES - PROCESS_BYTES).to_string();
        let one = |arguments: &[&str], limit| capped(&cloud, &index, side, arguments, limit);
        let line = one(&[&caches[..], &["--predictor", "line"]].concat(), None)?;
        let limit = Some(STOPPED_AT * line);
        let times = [
            one(&["--records", "map"], limit)?,
            one(&["--records", "map-random"], limit)?,
            one(&[&caches[..], &["--predictor", "none"]].concat(), limit)?,
            line,
            one(&["--records", "shipping", "--page-bytes", &page_bytes], limit)?,
        ];
        let ratio = whole as f64 / CAP_BYTES as f64;
        for (series, time) in lines.iter_mut().zip(times) {
            series.points.push((ratio, time));
        }
        let least = times[0].min(times[1]);
        let shown = |time: f64| {
            if limit.is_some_and(|limit| time >= limit) {
                format!("more than {}", number(time))
            } else {
                number(time)
            }
        };
        table.row(
            [height.to_string(), number(whole as f64 / 1e6), number(ratio)]
                .into_iter()
                .chain(times.map(shown))
                .chain([number(least / line), number(least / times[4])]),
        );
        std::fs::remove_dir_all(&folder)?;
    }
    table.note(format!(
        "{points} points on a sphere, radius 0.1, {side}×{side} rays. Each run is a process of its own in a control group \
         whose limit counts page cache too; the files are driven out of the page cache first. Caches have {} MiB for \
         records, the engine that ships as much for pages. Direct reads, one run each; a run is ended at {STOPPED_AT} times \
         the time of `line`.",
        (CAP_BYTES - PROCESS_BYTES) >> 20
    ));
    table.write(&setting.out, "paging")?;
    plot(&setting.out.join("paging.svg"), "Paging on a real disk, 32 MiB", ("data / cap", "seconds"), &lines)
}

/// As [`budget_of`](super::budget_of), with what caches take besides the records.
fn budget_with_overhead(bytes: u64, points: u64) -> Budget {
    let (node, point) = ((NODE_BYTES + OVERHEAD_BYTES) as u64, (POINT_BYTES + OVERHEAD_BYTES) as u64);
    let for_points = (bytes / 2).min(points * point);
    Budget { nodes: ((bytes - for_points) / node) as usize, points: (for_points / point) as usize }
}

/// Seconds of a render in a process under the cap, or the limit where it is ended there.
fn capped(cloud: &Path, index: &Index, side: u32, arguments: &[&str], limit: Option<f64>) -> Result<f64> {
    make_cold(&index.files())?;
    make_cold(&[cloud.to_owned()])?;
    let cap = Cap::new(CAP_BYTES).context("a control group")?;
    let program = std::env::current_exe().context("cannot find this program's own file")?;
    let mut command = Command::new(if limit.is_some() { "timeout".as_ref() } else { program.as_os_str() });
    if let Some(limit) = limit {
        command.arg(format!("{limit:.3}")).arg(&program);
    }
    command.arg("render").arg(cloud).arg("--index").arg(&index.folder);
    command.args(["--side", &side.to_string()]).args(arguments);
    let output = cap.run(&command).context("cannot start a render")?;
    // `timeout` ends with 124.
    if let (Some(limit), Some(124)) = (limit, output.status.code()) {
        return Ok(limit);
    }
    let error = String::from_utf8_lossy(&output.stderr);
    anyhow::ensure!(output.status.success(), "{arguments:?}: {} {error}", output.status);
    let peak = cap.peak_bytes().unwrap_or(0);
    anyhow::ensure!(peak <= CAP_BYTES, "{peak} bytes were used under a cap of {CAP_BYTES}");
    let found: serde_json::Value = serde_json::from_slice(&output.stdout)?;
    found["seconds"].as_f64().context("a report without seconds")
}

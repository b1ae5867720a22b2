//! Fig. 8 on the disk there is, for both engines: each run in a process of its own under a hard cap
//! on memory, page cache cold and counted.

mod reference;
mod shipping;

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context as _, Result, ensure};

use super::{Setting, median};
use crate::cap::Cap;
use crate::mapped::make_cold;
use crate::report::{Table, number};

pub(super) use reference::run as reference;
pub(super) use shipping::run as shipping;

/// What a process may use, page cache included.
const CAP_BYTES: u64 = 32 << 20;
/// Of that, what is not records or pages.
const PROCESS_BYTES: u64 = 14 << 20;
/// What a process may take before it begins to render.
const START_SECONDS: f64 = 1.0;
/// A run that takes so many seconds is made once.
const LONG: f64 = 20.0;
/// A run is ended when it has taken so many times as long as the one that prefetches.
const STOPPED_AT: f64 = 20.0;

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

/// A time, which is at least that where it was ended at the limit.
fn shown(time: f64, limit: Option<f64>) -> String {
    ratio(time, 1.0, limit)
}

/// The same by another time.
fn ratio(time: f64, other: f64, limit: Option<f64>) -> String {
    let sign = if limit.is_some_and(|limit| time >= limit) { "more than " } else { "" };
    format!("{sign}{}", number(time / other))
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

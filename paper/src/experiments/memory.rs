//! Whole-process peaks for the bunny, in core and out of core, each in a process of its own.

use std::process::Command;

use anyhow::{Context as _, Result, ensure};

use super::{Setting, Subject, differing, in_core, same_picture_note, scan_or};
use crate::engine::all_pixels;
use crate::index::Limits;
use crate::predict::Variant;
use crate::report::{Table, bars, megabytes, number};

pub(super) fn run(setting: &Setting) -> Result<()> {
    let side = setting.pick(16, 256);
    let folder = setting.work.join("memory");
    std::fs::create_dir_all(&folder)?;
    let cloud = folder.join("c.rset");
    let source = scan_or(setting, setting.pick("vase-8k", "vase-35947"))?;
    let subject = Subject::build(source, None, side, &cloud)?;
    let index = subject.index(&folder, Limits { height: 6, leaf_points: 32 })?;
    let (picture, _) = subject.reference(in_core(&index)?, Variant::None, all_pixels(&subject.settings))?;
    let (shipped, _) = subject.shipping()?;
    let worst = differing(&picture, &shipped);
    let summary = folder.join("index.json");
    std::fs::write(&summary, serde_json::to_string(&index.summary)?)?;
    let mut table = Table::new(
        "Memory: whole-process peaks",
        &["engine", "paper MB", "peak MB", "render s", "nodes in core", "points in core"],
    );
    let program = std::env::current_exe().context("cannot find this program's own file")?;
    let runs = [
        ("reference, in core", "300", None),
        ("reference, out of core", "under 20", Some((8192, 4096))),
        ("reference, out of core", "under 20", Some((1024, 1024))),
    ];
    let mut bars_shown =
        vec![("paper, in core".to_owned(), 300.0), ("paper, out of core: under".to_owned(), 20.0)];
    let mut first_picture: Option<String> = None;
    for (name, paper, caches) in runs {
        let mut command = Command::new(&program);
        command.arg("render").arg(&cloud).arg("--index").arg(&folder).args(["--side", &side.to_string()]);
        match caches {
            Some((nodes, points)) => {
                command.args(["--nodes", &nodes.to_string(), "--points", &points.to_string()]);
            }
            None => drop(command.args(["--records", "in-core"])),
        }
        let output = command.output().context("cannot start a render")?;
        ensure!(output.status.success(), "no picture: {}", String::from_utf8_lossy(&output.stderr));
        let found: serde_json::Value = serde_json::from_slice(&output.stdout)?;
        let picture = found["picture"].as_str().unwrap_or_default().to_owned();
        let first = first_picture.get_or_insert_with(|| picture.clone());
        ensure!(*first == picture, "{name}: another picture than in core");
        let peak = found["peak_rss_bytes"].as_u64().unwrap_or(0);
        bars_shown.push((
            format!("{name}, {}", caches.map_or("all".into(), |c| format!("{} and {}", c.0, c.1))),
            peak as f64 / 1e6,
        ));
        let shown = |n: Option<usize>| n.map_or_else(|| "all".into(), |n| n.to_string());
        table.row([
            name.into(),
            paper.into(),
            megabytes(peak),
            number(found["seconds"].as_f64().unwrap_or(0.0)),
            shown(caches.map(|c| c.0)),
            shown(caches.map(|c| c.1)),
        ]);
    }
    std::fs::remove_dir_all(&folder)?;
    table.note(format!(
        "{} points, {} nodes, {} MB of index; {side}×{side} rays on this machine's disk, direct reads, predictor `line`. \
         The peak is the largest resident set of the process, as the system counts it.",
        index.summary.points,
        index.summary.nodes,
        megabytes(index.summary.index_bytes())
    ));
    table.note(same_picture_note(worst));
    table.write(&setting.out, "memory")?;
    bars(&setting.out.join("memory.svg"), "Memory: whole-process peaks", "MB", &bars_shown)
}

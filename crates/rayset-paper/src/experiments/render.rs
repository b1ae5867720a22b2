//! One picture by the reference engine, in a process whose memory can be watched.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context as _, Result};
use rayset::working_set::read::BackendKind;
use serde::Serialize;

use super::{BATCH, Subject, in_core};
use crate::cache::CacheCounts;
use crate::disk::RealDisk;
use crate::engine::all_pixels;
use crate::index::Index;
use crate::predict::Variant;
use crate::records::{Budget, OutOfCore};

/// What to render, and in how much memory.
#[derive(clap::Args)]
pub struct RenderArgs {
    /// Cloud file
    cloud: PathBuf,
    /// Folder of its index, with `index.json`
    #[arg(long)]
    index: PathBuf,
    /// Pixels along each side
    #[arg(long, default_value_t = 64)]
    side: u32,
    /// Nodes in core; everything is, where neither this nor --points is given
    #[arg(long)]
    nodes: Option<usize>,
    /// Points in core
    #[arg(long)]
    points: Option<usize>,
    /// none, line, line-as-printed or line+origins
    #[arg(long, default_value = "line")]
    predictor: Variant,
}

#[derive(Serialize)]
struct Found {
    seconds: f64,
    peak_rss_bytes: Option<u64>,
    stalled_seconds: f64,
    /// Of nodes, secondary records and points.
    caches: Vec<CacheCounts>,
}

/// Renders, and says as JSON what it took.
///
/// # Errors
/// Whatever stopped it.
pub fn run(args: &RenderArgs) -> Result<String> {
    let subject = Subject::open(&args.cloud, args.side)?;
    let path = args.index.join("index.json");
    let text = std::fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
    let index = Index { folder: args.index.clone(), summary: serde_json::from_str(&text)? };
    let started = Instant::now();
    let pixels = all_pixels(&subject.settings);
    let (stalled, caches) = if args.nodes.is_none() && args.points.is_none() {
        subject.reference(in_core(&index)?, args.predictor, pixels)?;
        (0, Vec::new())
    } else {
        let budget = Budget { nodes: args.nodes.unwrap_or(8192), points: args.points.unwrap_or(4096) };
        let disk = RealDisk::open(&index.files(), true, BackendKind::Auto)?;
        let prefetches = args.predictor != Variant::None;
        let records = OutOfCore::new(Box::new(disk), budget, BATCH, prefetches, None);
        let (_, records) = subject.reference(records, args.predictor, pixels)?;
        (records.stalled_nanoseconds(), records.counts().to_vec())
    };
    let found = Found {
        seconds: started.elapsed().as_secs_f64(),
        peak_rss_bytes: peak_rss(),
        stalled_seconds: stalled as f64 * 1e-9,
        caches,
    };
    Ok(serde_json::to_string(&found)?)
}

/// Largest resident set of this process, where the system says.
fn peak_rss() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with("VmHWM:"))?;
    line.split_ascii_whitespace().nth(1)?.parse::<u64>().ok().map(|kib| kib << 10)
}

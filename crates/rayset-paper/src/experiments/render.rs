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
use crate::mapped::{self, Access};
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
    /// Where the records are
    #[arg(long, value_enum, default_value = "caches")]
    records: Kept,
    /// Nodes in core, of caches
    #[arg(long, default_value_t = 8192)]
    nodes: usize,
    /// Points in core, of caches
    #[arg(long, default_value_t = 4096)]
    points: usize,
    /// Bytes for pages, of the engine that ships
    #[arg(long, default_value_t = 8 << 20)]
    page_bytes: u64,
    /// none, line, line-as-printed or line+origins
    #[arg(long, default_value = "line")]
    predictor: Variant,
}

/// Where records are while they are rendered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Kept {
    /// All in memory.
    InCore,
    /// In record caches over the disk.
    Caches,
    /// In a memory map.
    Map,
    /// In a memory map that is said to be used at random.
    MapRandom,
    /// Nowhere: the engine that ships renders, from its own file.
    Shipping,
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
    let mut cost = (0, Vec::new());
    match args.records {
        Kept::InCore => drop(subject.reference(in_core(&index)?, args.predictor, pixels)?),
        Kept::Map => drop(subject.reference(mapped::open(&index, Access::Plain)?, args.predictor, pixels)?),
        Kept::MapRandom => {
            drop(subject.reference(mapped::open(&index, Access::Random)?, args.predictor, pixels)?);
        }
        Kept::Shipping => drop(subject.shipping_in(args.page_bytes)?),
        Kept::Caches => {
            let budget = Budget { nodes: args.nodes, points: args.points };
            let disk = RealDisk::open(&index.files(), true, BackendKind::Auto)?;
            let prefetches = args.predictor != Variant::None;
            let records = OutOfCore::new(Box::new(disk), budget, BATCH, prefetches, None);
            let (_, records) = subject.reference(records, args.predictor, pixels)?;
            cost = (records.stalled_nanoseconds(), records.counts().to_vec());
        }
    }
    let (stalled, caches) = cost;
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

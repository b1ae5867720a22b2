//! One picture by the reference engine, in a process whose memory can be watched.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context as _, Result};
use memmap2::Mmap;
use rayset::trace::predict::{LinePredictor, NoPredictor, PacketPredictor, Predictor};
use rayset::working_set::read::{self, BackendKind};
use serde::Serialize;

use super::{BATCH, Subject, in_core};
use crate::cache::CacheCounts;
use crate::disk::RealDisk;
use crate::engine::{Picture, all_pixels};
use crate::index::Index;
use crate::mapped::{self, Access};
use crate::memory::Flat;
use crate::predict::Variant;
use crate::records::{Budget, OutOfCore};
use crate::structures::Structures;

/// What to render, and in how much memory.
#[derive(clap::Args)]
pub struct RenderArgs {
    /// Cloud file
    cloud: PathBuf,
    /// Folder of its index, with `index.json`; the engine that ships needs none
    #[arg(long)]
    index: Option<PathBuf>,
    /// Pixels along each side
    #[arg(long, default_value_t = 64)]
    side: u32,
    /// Where the records are
    #[arg(long, value_enum, default_value = "caches")]
    records: Kept,
    /// Image of memory, beside which a file that ends in .bin.json says what lies where; of maps
    #[arg(long)]
    image: Option<PathBuf>,
    /// Nodes in core, of caches
    #[arg(long, default_value_t = 8192)]
    nodes: usize,
    /// Points in core, of caches
    #[arg(long, default_value_t = 4096)]
    points: usize,
    /// Bytes for pages, of the engine that ships
    #[arg(long, default_value_t = 8 << 20)]
    page_bytes: u64,
    /// none, line, line-as-printed or line+origins; of caches
    #[arg(long, default_value = "line")]
    predictor: Variant,
    /// none, line or packet, of the engine that ships
    #[arg(long, value_enum, default_value = "packet")]
    ship_predictor: ShipPredictor,
    /// How the disk is read, by caches and by the engine that ships
    #[arg(long, value_enum, default_value = "auto")]
    backend: Backend,
    /// Read through the system's file cache, by caches
    #[arg(long)]
    buffered: bool,
    /// Have that cache read so many bytes around what is asked for, by caches
    #[arg(long, requires = "buffered")]
    around: Option<u64>,
    /// Let rays through, so that they need all of the cloud
    #[arg(long)]
    translucent: bool,
}

/// Predictors of the engine that ships.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum ShipPredictor {
    /// Nothing.
    None,
    /// The paper's.
    Line,
    /// Where packets go.
    Packet,
}

/// Ways to read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Backend {
    /// The best there is.
    Auto,
    /// io_uring.
    Uring,
    /// Threads.
    Pool,
}

impl From<Backend> for BackendKind {
    fn from(backend: Backend) -> Self {
        match backend {
            Backend::Auto => Self::Auto,
            Backend::Uring => Self::Uring,
            Backend::Pool => Self::Pool,
        }
    }
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
    /// The same, its file in a memory map.
    ShippingMap,
    /// That map said to be used at random.
    ShippingMapRandom,
}

#[derive(Serialize)]
struct Found {
    seconds: f64,
    peak_rss_bytes: Option<u64>,
    stalled_seconds: f64,
    /// Of the picture's bits: FNV-1a, 64 bits.
    picture: String,
    /// Of nodes, secondary records and points.
    caches: Vec<CacheCounts>,
}

/// Renders, and says as JSON what it took.
///
/// # Errors
/// Whatever stopped it.
pub fn run(args: &RenderArgs) -> Result<String> {
    let mut subject = Subject::open(&args.cloud, args.side)?;
    if args.translucent {
        subject.make_translucent();
    }
    let started = Instant::now();
    let pixels = all_pixels(&subject.settings);
    let mut cost = (0, Vec::new());
    let picture = match args.records {
        Kept::InCore => subject.reference(in_core(&index(args)?)?, Variant::None, pixels)?.0,
        Kept::Map | Kept::MapRandom => {
            let access = if args.records == Kept::Map { Access::Plain } else { Access::Random };
            let records = image(args.image.as_deref(), access)?;
            subject.reference(records, Variant::None, pixels)?.0
        }
        Kept::ShippingMap => subject.shipping_from_map(Access::Plain)?.0,
        Kept::ShippingMapRandom => subject.shipping_from_map(Access::Random)?.0,
        Kept::Shipping => {
            let backend = read::backend(args.backend.into())?;
            let predictor: Arc<dyn Predictor> = match args.ship_predictor {
                ShipPredictor::None => Arc::new(NoPredictor),
                ShipPredictor::Line => Arc::new(LinePredictor),
                ShipPredictor::Packet => Arc::new(PacketPredictor::default()),
            };
            let (picture, _, statistics) = subject.shipping_by(args.page_bytes, backend, predictor)?;
            cost.0 = statistics.total(|kind| kind.stall_nanoseconds);
            picture
        }
        Kept::Caches => {
            let budget = Budget { nodes: args.nodes, points: args.points };
            let files = index(args)?.files();
            let mut disk = RealDisk::open(&files, !args.buffered, args.backend.into())?;
            if let Some(bytes) = args.around {
                disk = disk.reading_around(&files, bytes)?;
            }
            let prefetches = args.predictor != Variant::None;
            let records = OutOfCore::new(Box::new(disk), budget, BATCH, prefetches, None);
            let (picture, records) = subject.reference(records, args.predictor, pixels)?;
            cost = (records.stalled_nanoseconds(), records.counts().to_vec());
            picture
        }
    };
    let (stalled, caches) = cost;
    let found = Found {
        seconds: started.elapsed().as_secs_f64(),
        peak_rss_bytes: peak_rss(),
        picture: fingerprint(&picture),
        stalled_seconds: stalled as f64 * 1e-9,
        caches,
    };
    Ok(serde_json::to_string(&found)?)
}

fn fingerprint(picture: &Picture) -> String {
    let mut hash: u64 = 0xcbf2_9ce4_8422_2325;
    for byte in picture.iter().flatten().flat_map(|v| v.to_bits().to_le_bytes()) {
        hash = (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
    }
    format!("{hash:016x}")
}

/// The index that was named.
fn index(args: &RenderArgs) -> Result<Index> {
    let folder = args.index.clone().context("--index: these records are those of an index")?;
    let path = folder.join("index.json");
    let text = std::fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
    Ok(Index { folder, summary: serde_json::from_str(&text)? })
}

/// Structures in a map of their image.
fn image(path: Option<&Path>, access: Access) -> Result<Structures<Flat<Mmap>>> {
    let path = path.context("--image: a map is of an image of memory")?;
    let layout = layout_file(path);
    let text = std::fs::read(&layout).with_context(|| format!("cannot read {}", layout.display()))?;
    let map = mapped::open(path, access).with_context(|| format!("cannot map {}", path.display()))?;
    Ok(Structures::new(map, serde_json::from_slice(&text)?))
}

/// The file that says what lies where in an image of memory.
pub(crate) fn layout_file(image: &Path) -> PathBuf {
    image.with_extension("bin.json")
}

/// Largest resident set of this process, where the system says.
fn peak_rss() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with("VmHWM:"))?;
    line.split_ascii_whitespace().nth(1)?.parse::<u64>().ok().map(|kib| kib << 10)
}

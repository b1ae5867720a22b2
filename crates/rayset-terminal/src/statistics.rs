//! The cost of rendering in numbers, with the same names in every report.

use rayset::RenderCounts;
use rayset::SplatCounts;
use rayset::memory::{Kind, Statistics};

/// Work of a render.
#[derive(serde::Serialize, Clone)]
pub struct WorkStatistics {
    /// Kernels evaluated: pairs of a point and a sample.
    pub kernel_evaluations: u64,
    pairs_tested: u64,
    samples: u64,
    /// Samples with an opacity above 0.
    pub nonzero_samples: u64,
    packets: u64,
    /// Rays to lights.
    pub shadow_rays: u64,
    /// Mirrored and bent rays.
    pub bounced_rays: u64,
    /// Pairs of a ray and a point, by kind of ray: those that are tested but not added are wasted.
    primary_pairs: Pairs,
    shadow_pairs: Pairs,
    bounced_pairs: Pairs,
    tiles_put_off: u64,
    slabs: u64,
    runs_decoded: u64,
    /// Estimates of how wrong opacities are because of what is seen from afar.
    pub lod_errors: LodErrors,
}

/// Estimated errors of the opacities of pixels.
#[derive(serde::Serialize, Clone)]
pub struct LodErrors {
    /// The part of the pixels of which something is seen from afar; `None` if none was looked at.
    pub pixels: Option<f64>,
    /// The mean error over these.
    pub mean: Option<f64>,
}

/// Pairs of one kind of ray.
#[derive(serde::Serialize, Clone)]
struct Pairs {
    tested: u64,
    added: u64,
    kernel_evaluations: u64,
}

impl From<SplatCounts> for Pairs {
    fn from(counts: SplatCounts) -> Self {
        Self {
            tested: counts.pairs_tested,
            added: counts.pairs_added,
            kernel_evaluations: counts.kernel_evaluations,
        }
    }
}

impl From<RenderCounts> for WorkStatistics {
    fn from(counts: RenderCounts) -> Self {
        Self {
            kernel_evaluations: counts.splats.kernel_evaluations,
            pairs_tested: counts.splats.pairs_tested,
            samples: counts.samples,
            nonzero_samples: counts.nonzero_samples,
            packets: counts.packets,
            shadow_rays: counts.shadow_rays,
            bounced_rays: counts.bounced_rays,
            primary_pairs: (counts.splats - counts.shadow_splats - counts.bounced_splats).into(),
            shadow_pairs: counts.shadow_splats.into(),
            bounced_pairs: counts.bounced_splats.into(),
            tiles_put_off: counts.deferred,
            slabs: counts.slabs,
            runs_decoded: counts.runs,
            lod_errors: LodErrors {
                pixels: (counts.lod_errors.pixels > 0)
                    .then(|| counts.lod_errors.from_afar as f64 / counts.lod_errors.pixels as f64),
                mean: counts.lod_errors.mean(),
            },
        }
    }
}

/// Statistics of a working set.
#[derive(serde::Serialize, Clone)]
pub struct PageStatistics {
    /// Time that threads have waited for pages, of all threads together.
    pub stall_seconds: f64,
    /// Bytes read, divided by the bytes of the distinct pages read.
    pub reads_per_page: f64,
    /// Most bytes of pages in memory at a time.
    pub working_set_peak_bytes: u64,
    /// Over all kinds of pages.
    pub working_set: PageCounts,
    working_set_by_kind: Vec<KindCounts>,
}

/// Statistics of the pages of one kind.
#[derive(serde::Serialize, Clone)]
struct KindCounts {
    kind: &'static str,
    peak_bytes: u64,
    #[serde(flatten)]
    counts: PageCounts,
}

/// What happened to pages.
#[derive(serde::Serialize, Clone)]
pub struct PageCounts {
    /// Requests for a page in memory.
    pub hits: u64,
    /// Requests for a page that was absent.
    pub misses: u64,
    late: u64,
    hinted: u64,
    hinted_in_time: u64,
    stalls: u64,
    stall_nanoseconds: u64,
    /// Pages read.
    pub reads: u64,
    bytes_read: u64,
    bytes_unique: u64,
    /// Pages evicted.
    pub evictions: u64,
}

impl PageCounts {
    /// Counts of the pages of those kinds for which `wanted` holds.
    fn new(set: &Statistics, wanted: impl Fn(Kind) -> bool) -> Self {
        let sum = |number: fn(&rayset::memory::KindStatistics) -> u64| {
            Kind::ALL.iter().copied().filter(|&kind| wanted(kind)).map(|kind| number(set.kind(kind))).sum()
        };
        Self {
            hits: sum(|k| k.hits),
            misses: sum(|k| k.misses),
            late: sum(|k| k.late),
            hinted: sum(|k| k.hinted),
            hinted_in_time: sum(|k| k.hinted_in_time),
            stalls: sum(|k| k.stalls),
            stall_nanoseconds: sum(|k| k.stall_nanoseconds),
            reads: sum(|k| k.reads),
            bytes_read: sum(|k| k.bytes_read),
            bytes_unique: sum(|k| k.bytes_unique),
            evictions: sum(|k| k.evictions),
        }
    }
}

impl From<&Statistics> for PageStatistics {
    fn from(set: &Statistics) -> Self {
        let all = PageCounts::new(set, |_| true);
        let used = Kind::ALL.iter().copied().filter(|&kind| set.kind(kind).hits + set.kind(kind).misses > 0);
        let by_kind = used.map(|kind| KindCounts {
            kind: kind.name(),
            peak_bytes: set.kind(kind).peak_bytes,
            counts: PageCounts::new(set, |k| k == kind),
        });
        let reads_per_page =
            if all.bytes_unique > 0 { all.bytes_read as f64 / all.bytes_unique as f64 } else { 0.0 };
        Self {
            stall_seconds: all.stall_nanoseconds as f64 / 1e9,
            reads_per_page,
            working_set_peak_bytes: set.peak_bytes,
            working_set_by_kind: by_kind.collect(),
            working_set: all,
        }
    }
}

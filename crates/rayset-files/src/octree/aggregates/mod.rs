//! Aggregates: for each cell of an octree, and of its leaves, what stands for its points where the
//! cell is small to who sees it.
//!
//! A record has the moments of the points' mass (a Gaussian), and how that mass is distributed over
//! densities. With weights v, kernels ω and a density D = Σ vᵢωᵢ, the vᵢωᵢ/D sum to one everywhere.
//! So the optical mass that a transfer function g makes of points is ∫g(D) dV = Σᵢ ∫vᵢωᵢ g(D)/D dV:
//! the mean of g(D)/D over the mass, times the mass, for any g.
//!
//! [`add_to_file`] makes them of a finished file, in bounded memory (`build`): own points of nodes
//! (`points`) are measured (`places`, `density`, `near_points`), leaves are divided into `cells`,
//! and sums of all (`moments`, `histogram`) become a `record` each (`records`, `scale`). They are
//! kept (`store`) until all are known, and written into a file (`write`), of which `header` says
//! what it has; or compared with those of a file (`compare`).

mod build;
mod cells;
mod compare;
mod density;
mod error;
pub mod header;
mod histogram;
mod moments;
mod near_points;
mod options;
pub mod page;
mod places;
mod points;
mod record;
mod records;
mod scale;
mod store;
mod write;

use std::io::{BufWriter, Write};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use self::build::Maker;
use self::compare::Comparison;
pub use self::error::AggregateError;
use self::header::LEAST_FEW;
pub use self::header::{AggregateHeader, LEVELS};
pub use self::histogram::{BINS, DensityBins, Width};
use self::moments::Carried;
pub use self::options::AggregateOptions;
pub use self::page::AggregatePage;
pub use self::record::{AGGREGATE_BYTES, Aggregate, CellPlace};
use self::records::{RecordMaker, RecordSink};
use self::store::StoredRecords;
use super::file::Cloud;
use crate::paged_file::FilePages;
use rayset_base::cancel::CancelToken;
use rayset_base::kernel::Kernel;
use rayset_store::output::{Destination, OutputFile, remove_leftovers};
use rayset_store::spill::Spill;
use rayset_store::storage::local::{BackendKind, backend};
use rayset_store::storage::{FileStorage, Storage};
use rayset_store::working_set::{Limits, WorkingSet};

/// Writes the cloud of a file with aggregates to `output`, which may be the same file. Those that
/// it has are made anew.
///
/// `progress` is called with the number of points done and that of all, from one thread at a time.
///
/// # Errors
/// [`AggregateError`]; an existing file at `output` is then unchanged.
pub fn add_to_file(
    input: &Path,
    output: &Path,
    options: &AggregateOptions,
    progress: &(dyn Fn(u64, u64) + Sync),
    cancel: &CancelToken,
) -> Result<AggregateHeader, AggregateError> {
    let cloud = Arc::new(Cloud::open(input)?);
    let destination = Destination::new(output)?;
    destination.require_file()?;
    let temp_dir = options.temp_dir.clone().unwrap_or_else(|| destination.folder().to_owned());
    let file = OutputFile::create(&destination)?;
    remove_leftovers(&temp_dir, &destination);
    let spill = || {
        Spill::create(&destination, &temp_dir).map_err(AggregateError::temporary("create temporary files"))
    };
    let mut records = StoredRecords::new(record_bytes(&cloud), spill)?;
    make(&cloud, options, progress, cancel, &mut records)?;
    if records.is_empty() {
        return Err(nothing(&cloud));
    }
    let mut buffer = BufWriter::with_capacity(1 << 20, file.writer());
    write::write(&cloud, &records, options, cancel, &mut buffer)?;
    let failed = |source| AggregateError::Io { action: "write", path: Some(output.to_owned()), source };
    buffer.flush().map_err(failed)?;
    drop(buffer);
    file.publish()?;
    let written = Cloud::open(output)?;
    written.header().aggregates.clone().ok_or_else(|| nothing(&cloud))
}

/// Bytes of the records of a cloud.
fn record_bytes(cloud: &Cloud) -> usize {
    AggregateHeader::bytes_of_record(cloud.header().has_color, cloud.header().attributes.len())
}

/// Makes the records of a cloud.
fn make(
    cloud: &Arc<Cloud>,
    options: &AggregateOptions,
    progress: &(dyn Fn(u64, u64) + Sync),
    cancel: &CancelToken,
    sink: &mut dyn RecordSink,
) -> Result<(), AggregateError> {
    check(cloud, options)?;
    let header = cloud.header();
    let page_bytes = u64::from(header.page_bytes);
    let overhead = WorkingSet::overhead_bytes(header.pages());
    let too_little = || AggregateError::Memory {
        given: options.memory_bytes,
        needed: AggregateOptions::least_bytes(page_bytes) + overhead,
    };
    let shares = options.shares(page_bytes, overhead).ok_or_else(too_little)?;
    let failed = |source| AggregateError::Io { action: "read", path: Some(cloud.path().to_owned()), source };
    let storage: Arc<dyn Storage> = match cloud.storage() {
        Some(storage) => storage.clone(),
        None => Arc::new(FileStorage::open(cloud.path(), false).map_err(failed)?),
    };
    let pages =
        WorkingSet::new(Limits::total(shares.pages_bytes), backend(BackendKind::Pool).map_err(failed)?);
    let object = pages.add(Arc::new(FilePages::new(cloud.clone(), storage)));
    let client = pages.client(cancel);
    let done = AtomicU64::new(0);
    let maker = Maker {
        cloud,
        client: &client,
        object: &object,
        options,
        threads: shares.threads,
        records: RecordMaker {
            root: header.root_cell(),
            carried: Carried {
                color: header.has_color,
                classes: header.attributes.iter().map(|attribute| attribute.is_class).collect(),
            },
        },
        near: Mutex::default(),
        progress: &|points| {
            let done = done.fetch_add(points, Ordering::Relaxed) + points;
            progress(done, header.points);
        },
    };
    maker.run(sink)
}

/// Makes the aggregates of a file again, and compares them with its own, whose pages have been
/// checked; returns their number.
pub(super) fn compare(cloud: &Cloud) -> Result<u32, AggregateError> {
    let Some(known) = &cloud.header().aggregates else { return Ok(0) };
    let header = cloud.header();
    let defaults = AggregateOptions::default();
    let least =
        AggregateOptions::least_bytes(header.page_bytes.into()) + WorkingSet::overhead_bytes(header.pages());
    let memory = defaults.memory_bytes.max(least);
    let options = defaults
        .with_memory_bytes(memory)
        .with_kernel(known.kernel)
        .with_normalised(known.normalised)
        .with_few_points(known.few_points);
    let mut comparison = Comparison::new(cloud, known)?;
    make(&Arc::new(cloud.again()), &options, &|_, _| {}, &CancelToken::new(), &mut comparison)?;
    comparison.finish()
}

/// Whether there can be aggregates of a cloud.
fn check(cloud: &Cloud, options: &AggregateOptions) -> Result<(), AggregateError> {
    let unsupported = |what| Err(AggregateError::Unsupported { path: cloud.path().to_owned(), what });
    let header = cloud.header();
    if options.kernel == Kernel::Splat || header.harmonics > 0 {
        return unsupported(
            "there are no aggregates of Gaussian splats yet; they are rendered splat by splat",
        );
    }
    if header.weight.min() < 0.0 {
        return unsupported(
            "there are no aggregates of points with negative weights; they are rendered point by point",
        );
    }
    if options.few_points < LEAST_FEW {
        return unsupported("cells of fewer than four points need no aggregates");
    }
    if header.points <= u64::from(options.few_points) {
        return Err(nothing(cloud));
    }
    Ok(())
}

fn nothing(cloud: &Cloud) -> AggregateError {
    let what = "so few points, points without weight, or points larger than their cloud need no aggregates";
    AggregateError::Unsupported { path: cloud.path().to_owned(), what }
}

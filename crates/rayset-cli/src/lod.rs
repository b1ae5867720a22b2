//! `rayset lod`

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Result, bail};
use clap::Args;
use rayset::build::{self, AggregateOptions, Progress, Stage};
use rayset::scene::Kernel;
use rayset::{CancelToken, Cloud};

use crate::aggregates::name_smallest_budget;
use crate::budget::Budget;
use rayset_inputs::style::Style;
use rayset_inputs::{Built, look, values};
use rayset_terminal::memory::peak_rss;
use rayset_terminal::outputs::Outputs;
use rayset_terminal::progress::Meter;
use rayset_terminal::report;

/// Add to a cloud file what stands for its points from afar.
///
/// The result is the same, byte for byte, for any --memory and --threads. What the file has of this
/// is made anew.
#[derive(Args)]
pub(crate) struct LodArgs {
    /// Cloud file
    cloud: PathBuf,
    /// Cloud file to write; the same by default
    #[arg(short, long)]
    output: Option<PathBuf>,
    /// Kernel of the densities; by default, kernel and normalisation are those of the cloud's look
    #[arg(long)]
    kernel: Option<Kernel>,
    /// Divide weights by what their kernels integrate to (of the kernel wyvill, if none is named)
    #[arg(long)]
    normalised: bool,
    /// Memory for the whole process
    #[arg(long, value_parser = values::size, default_value = "256MiB")]
    pub(crate) memory: u64,
    /// Threads; as many as there are processors by default
    #[arg(long)]
    threads: Option<usize>,
    /// Folder for temporary files; that of the output by default
    #[arg(long)]
    temp_dir: Option<PathBuf>,
    /// Report as JSON
    #[arg(long)]
    json: bool,
}

/// What was made, in numbers.
#[derive(serde::Serialize)]
struct Summary {
    points: u64,
    aggregates: u32,
    aggregate_bytes: u64,
    file_bytes: u64,
    seconds: f64,
    peak_rss_bytes: Option<u64>,
}

pub(crate) fn run(args: &LodArgs) -> Result<()> {
    let output = args.output.as_deref().unwrap_or(&args.cloud);
    let Built::Cloud(cloud) = rayset_inputs::open_built(&args.cloud)? else {
        bail!("{} is a grid; only clouds have aggregates", args.cloud.display());
    };
    let (kernel, normalised) = match args.kernel {
        None if !args.normalised => look::of_cloud(&cloud, &Style::default(), (64, 64))?.kernel(),
        kernel => (kernel.unwrap_or_default(), args.normalised),
    };
    Outputs::beside::<PathBuf>([]).add(output, args.temp_dir.as_deref())?.require_file()?;
    let budget = Budget::of(args.memory, [args.cloud.as_path(), output]);
    let defaults = AggregateOptions::default();
    let threads = args.threads.unwrap_or(defaults.threads);
    let options = defaults
        .with_kernel(kernel)
        .with_normalised(normalised)
        .with_memory_bytes(budget.left())
        .with_threads(threads)
        .with_temp_dir(args.temp_dir.clone());
    let started = Instant::now();
    let meter = Meter::new("points", args.json);
    let progress = |done, total| meter.update(Stage::Aggregate, done, total);
    let made = build::add_aggregates(&args.cloud, output, &options, &progress, &CancelToken::new());
    meter.finish();
    let made = made.map_err(|error| name_smallest_budget(error, budget))?;
    let seconds = started.elapsed().as_secs_f64();
    present(output, &made, seconds, args.json)
}

fn present(output: &Path, made: &build::AggregateHeader, seconds: f64, json: bool) -> Result<()> {
    let header = Cloud::open(output)?.header().clone();
    let bytes = u64::from(made.pages) * u64::from(header.page_bytes);
    let summary = Summary {
        points: header.points,
        aggregates: made.records(),
        aggregate_bytes: bytes,
        file_bytes: header.file_bytes,
        seconds,
        peak_rss_bytes: peak_rss(),
    };
    if json {
        return report::json(&summary);
    }
    report::say(format_args!(
        "{}: {} aggregates of {} points, {} ({:.1} % of the file), for the kernel {}{}",
        output.display(),
        report::count(summary.aggregates.into()),
        report::count(header.points),
        report::bytes(bytes),
        100.0 * bytes as f64 / header.file_bytes as f64,
        made.kernel,
        if made.normalised { ", normalised" } else { "" }
    ));
    let peak =
        summary.peak_rss_bytes.map_or_else(String::new, |b| format!(", peak memory {}", report::bytes(b)));
    report::say(format_args!("{seconds:.2} s{peak}"));
    Ok(())
}

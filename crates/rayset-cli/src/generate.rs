//! `rayset generate`

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Args;
use rayset::points::{PlyWriter, PointBatch, Workload};

use crate::report;

/// Write a generated cloud as a binary PLY file.
///
/// sphere-N and cube-N are the workloads of the benchmark (points on the unit sphere, in the unit cube), knot-N and
/// galaxy-N are to look at; N is a number like 5000, 100k or 1m.
#[derive(Args)]
pub(crate) struct GenerateArgs {
    /// sphere-N, cube-N, knot-N or galaxy-N
    workload: Workload,
    /// File to write; NAME.ply by default
    #[arg(short, long)]
    output: Option<PathBuf>,
}

pub(crate) fn run(args: &GenerateArgs) -> Result<()> {
    let path = args.output.clone().unwrap_or_else(|| format!("{}.ply", args.workload).into());
    let count = write(&args.workload, &path)?;
    report::say(format_args!("{}: {} points", path.display(), report::count(count)));
    if let Some(radius) = args.workload.radius() {
        report::say(format_args!("build it with --radius {radius}"));
    }
    Ok(())
}

/// Writes a workload to a file; returns the number of points.
pub(crate) fn write(workload: &Workload, path: &Path) -> Result<u64> {
    let doing = || format!("cannot write {}", path.display());
    let mut source = workload.source();
    let attributes = source.schema().attributes.clone();
    source.select(&(0..attributes.len()).collect::<Vec<_>>());
    let mut writer = PlyWriter::create(path, &attributes).with_context(doing)?;
    let mut batch = PointBatch::default();
    loop {
        source.fill(&mut batch, 1 << 14)?;
        if batch.is_empty() {
            return writer.finish().with_context(doing);
        }
        writer.write(&batch).with_context(doing)?;
    }
}

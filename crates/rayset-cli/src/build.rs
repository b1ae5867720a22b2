//! `rayset build`

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use clap::{Args, ValueEnum};
use rayset::Cloud;
use rayset::build::GridBuildOptions;
use rayset::build::{self, BuildOptions, BuildReport, InvalidPolicy, Precision};
use rayset::output::Destination;
use rayset::points::ReadError;
use rayset::volumes;

use crate::aggregates::{self, AggregateArgs, Means};
use crate::budget::{Budget, name_smallest_budget, name_smallest_grid_budget};
use crate::build_parts::{self, PartArgs, PartOf, Work};
use crate::option_args::{ChoiceArgs, OfBuild};
use rayset_inputs::{Files, Points, values};
use rayset_terminal::memory::peak_rss;
use rayset_terminal::outputs::Outputs;
use rayset_terminal::progress::Meter;

use crate::input::Program;
use rayset_terminal::report;

/// Build a cloud file from points, or a grid file from a volume.
///
/// Several inputs of points make one cloud. The result is the same, byte for byte, for any --memory
/// and --threads.
#[derive(Args)]
pub(crate) struct BuildArgs {
    /// Points: PLY, LAS, LAZ, COPC, E57, PCD, PTX, PTS, XYZ, TXT, CSV, ASC, NPY, NPZ, VTK, VTP or
    /// VTU files; BIN of KITTI and nuScenes; snapshots of simulations (HDF5 of GADGET, SWIFT,
    /// AREPO, EAGLE, Illustris; GADGET 1 and 2); Gaussian splats (PLY, SPZ, glTF, SOG, SPLAT,
    /// KSPLAT); meshes (OBJ, OFF, STL); text, PLY, PTX and PCD in gzip or zstd; folders and
    /// patterns of such. Or one volume: NRRD, MetaImage (MHA, MHD), NIfTI, VTI, VTR, VTK, VDB, DX,
    /// SLC, NPY or NPZ
    #[arg(required = true)]
    inputs: Vec<PathBuf>,
    #[command(flatten)]
    choices: ChoiceArgs<OfBuild>,
    /// Cloud or grid file to write
    #[arg(short, long)]
    output: PathBuf,
    /// Factor on the radius, wherever it comes from
    #[arg(long, default_value_t = 1.0)]
    radius_scale: f64,
    /// Factor on the weight, wherever it comes from
    #[arg(long, default_value_t = 1.0)]
    weight_scale: f64,
    /// Stop at the first damaged file of a folder or pattern, instead of leaving it out and naming
    /// it at the end. Builds in parts always do
    #[arg(long)]
    strict: bool,
    /// What to do with records whose position, radius or weight is no usable number
    #[arg(long, value_enum, default_value = "skip")]
    invalid: Invalid,
    /// Largest position error as a fraction of the radius, or `exact`
    #[arg(long, default_value = "0.000244140625")]
    precision: String,
    /// Memory for the whole process
    #[arg(long, value_parser = values::size, default_value = "256MiB")]
    pub(crate) memory: u64,
    /// Threads; as many as there are processors by default
    #[arg(long)]
    threads: Option<usize>,
    /// Bytes of a page, a multiple of 4096
    #[arg(long, value_parser = values::size)]
    page_size: Option<u64>,
    /// Memory to render with, stored in the file as its default
    #[arg(long, value_parser = values::size)]
    render_memory: Option<u64>,
    /// Folder for temporary files; that of the output by default
    #[arg(long)]
    temp_dir: Option<PathBuf>,
    #[command(flatten)]
    aggregates: AggregateArgs,
    #[command(flatten)]
    parts: PartArgs,
    /// Report as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum Invalid {
    /// Count what is no number and go on; stop where numbers are too large or too small to be
    /// stored
    Skip,
    /// Count these, too, and go on
    SkipAll,
    /// Stop with an error
    Reject,
}

pub(crate) fn run(args: &BuildArgs) -> Result<()> {
    let host = Program::quiet();
    let inputs = rayset_inputs::expand(&args.inputs, &host)?;
    if args.choices.0.raw.is_some() || rayset_inputs::has_volume(&inputs.paths)? {
        if args.parts.asked().is_some() {
            bail!("--part is for clouds; a grid is built by one process");
        }
        if let Some(option) = args.aggregates.given() {
            bail!("{option} is for clouds; grids have no aggregates");
        }
        return build_grid(args, &inputs.paths);
    }
    let options = options(args)?;
    build_parts::check(&args.parts, &args.output)?;
    let output = Outputs::beside(&inputs.paths).add(&args.output, args.temp_dir.as_deref())?;
    output.require_file()?;
    if let Some(part) = args.parts.asked() {
        return run_part(args, part, &inputs, options);
    }
    if let Some(index) = args.choices.0.volume_index {
        bail!("--volume-index {index} is for volumes, and these are points");
    }
    let (Points { sources, left_out }, options) = open(args, &inputs, options, args.strict)?;
    let meter = Meter::new("points", args.json);
    let leaves_out = |source: usize, error: &ReadError| left_out.takes(source, error);
    let control = build::BuildControl::from(&meter as &dyn build::Progress).with_leaving_out(&leaves_out);
    let built = Cloud::builder().sources(sources).options(options).control(control).write(&args.output);
    meter.finish();
    let mut built = built.map_err(|e| name_smallest_budget(e, budget(args)))?;
    let means = Means {
        budget: budget(args),
        threads: args.threads,
        temp_dir: args.temp_dir.clone(),
        quiet: args.json,
    };
    let aggregated = aggregates::add(&args.output, &mut built, &args.aggregates, means);
    // What was built is told in any case.
    present(&args.output, &built, args.json)?;
    left_out.remark().into_iter().for_each(report::remark);
    aggregated
}

fn budget(args: &BuildArgs) -> Budget {
    Budget::of(args.memory, args.inputs.iter().chain([&args.output]))
}

/// Opens the points, and chooses the attributes that are kept of them.
fn open(
    args: &BuildArgs,
    inputs: &Files,
    options: BuildOptions,
    strict: bool,
) -> Result<(Points, BuildOptions)> {
    let points =
        rayset_inputs::open_points(inputs, &args.choices.0.read_options(), strict, &Program::quiet())?;
    let points = Points { sources: rayset_inputs::with_speeds(points.sources), ..points };
    let columns = rayset_inputs::wanted_columns(args.choices.0.attributes.as_deref(), &points.sources);
    columns.remark().into_iter().for_each(report::remark);
    rayset_inputs::remark_on_normals(&points.sources, &options).into_iter().for_each(report::remark);
    Ok((points, options.with_attributes(columns.kept)))
}

/// Does a step of a part.
fn run_part(args: &BuildArgs, part: PartOf, inputs: &Files, options: BuildOptions) -> Result<()> {
    if let Some(option) = args.aggregates.given() {
        bail!("{option} is for `rayset merge`, which makes the file, and its aggregates");
    }
    let nothing = BuildOptions::default();
    let chosen = options.clone().with_memory_bytes(nothing.memory_bytes).with_threads(1).with_temp_dir(None);
    let said = format!("{chosen:?} {:?} {:?}", args.choices.0.attributes, args.choices.0.read_options());
    let work = Work {
        args: &args.parts,
        output: &args.output,
        request: rayset_inputs::fingerprint(&inputs.paths, &said)?,
        options: options.clone(),
        budget: budget(args),
        json: args.json,
    };
    // All parts must agree on what the inputs are, so that none may leave one out by itself.
    build_parts::run(&work, part, || {
        let (points, options) = open(args, inputs, options, true)?;
        Destination::new(&args.output)?.refuse_inputs(points.files())?;
        Ok((points, options))
    })
}

/// Says what was built.
pub(crate) fn present(output: &Path, built: &BuildReport, json: bool) -> Result<()> {
    built.remarks.iter().for_each(report::remark);
    if json { report::json(&Summary::of(built)) } else { describe(output, built) }
}

/// The result of building a volume, as JSON.
#[derive(serde::Serialize)]
struct GridSummary {
    size: [u64; 3],
    voxels: &'static str,
    value_range: (f64, f64),
    file_bytes: u64,
    pages: u64,
    seconds: f64,
    peak_rss_bytes: Option<u64>,
}

fn build_grid(args: &BuildArgs, inputs: &[PathBuf]) -> Result<()> {
    let [input] = inputs else { bail!("a grid is built from one volume at a time") };
    let output = Outputs::beside(inputs).add(&args.output, args.temp_dir.as_deref())?;
    output.require_file()?;
    let source = match &args.choices.0.raw()? {
        Some(layout) => layout.open(input)?,
        None => volumes::open(input, args.choices.0.volume_index)?,
    };
    rayset_inputs::remark_about(input, &source, &Program::quiet());
    let meter = Meter::new("slices", args.json);
    let started = std::time::Instant::now();
    let options = GridBuildOptions::default()
        .with_memory_bytes(budget(args).left())
        .with_temp_dir(args.temp_dir.clone());
    let control = build::BuildControl::from(&meter as &dyn build::Progress);
    let built = build::grid_to_file(source, &args.output, &options, &control);
    meter.finish();
    let header = built.map_err(|e| name_smallest_grid_budget(e, budget(args)))?;
    if args.json {
        return report::json(&GridSummary {
            size: header.size,
            voxels: header.kind.name(),
            value_range: header.value_range(),
            file_bytes: header.file_bytes,
            pages: header.pages(),
            seconds: started.elapsed().as_secs_f64(),
            peak_rss_bytes: peak_rss(),
        });
    }
    let (low, high) = header.value_range();
    report::say(format_args!(
        "{}: {} x {} x {} voxels of {}, values {low} to {high}, {} in {} pages",
        args.output.display(),
        header.size[0],
        header.size[1],
        header.size[2],
        header.kind.name(),
        report::bytes(header.file_bytes),
        header.pages()
    ));
    let seconds = started.elapsed().as_secs_f64();
    let peak = peak_rss().map_or_else(String::new, |b| format!(", peak memory {}", report::bytes(b)));
    report::say(format_args!("{seconds:.2} s{peak}"));
    Ok(())
}

fn options(args: &BuildArgs) -> Result<BuildOptions> {
    let precision = match args.precision.as_str() {
        "exact" => Precision::Exact,
        number => match number.parse() {
            Ok(p) => Precision::Relative(p),
            Err(_) => {
                bail!("--precision {number}: expected a fraction of the radius, as in 0.001, or `exact`")
            }
        },
    };
    let options = args.choices.0.applied(BuildOptions::default())?;
    let threads = args.threads.unwrap_or(options.threads);
    Ok(options
        .with_radius_scale(args.radius_scale)
        .with_weight_scale(args.weight_scale)
        .with_invalid(match args.invalid {
            Invalid::Skip => InvalidPolicy::Skip,
            Invalid::SkipAll => InvalidPolicy::SkipAll,
            Invalid::Reject => InvalidPolicy::Reject,
        })
        .with_precision(precision)
        .with_page_bytes(args.page_size.map(|n| u32::try_from(n).unwrap_or(u32::MAX)))
        .with_render_memory(args.render_memory)
        .with_memory_bytes(budget(args).left())
        .with_threads(threads)
        .with_temp_dir(args.temp_dir.clone()))
}

/// The result of building a cloud, in numbers.
#[derive(serde::Serialize)]
pub(crate) struct Summary {
    points: u64,
    copies: u64,
    skipped_position: u64,
    skipped_radius: u64,
    skipped_weight: u64,
    file_bytes: u64,
    point_data_bytes: u64,
    index_fraction: f64,
    page_bytes: u32,
    pages: u32,
    nodes: u64,
    aggregates: u32,
    aggregate_bytes: u64,
    position_error: f64,
    position_error_radii: f64,
    seconds: f64,
    read_seconds: f64,
    spacing_seconds: f64,
    write_seconds: f64,
    aggregate_seconds: f64,
    points_per_second: f64,
    peak_rss_bytes: Option<u64>,
}

impl Summary {
    pub(crate) fn of(built: &BuildReport) -> Self {
        let header = &built.header;
        let stage = |stage| {
            let of_stage = built.times.iter().filter(|(s, _)| *s == stage);
            of_stage.map(|(_, t)| t.as_secs_f64()).sum::<f64>()
        };
        let [read, spacing, write, aggregate] =
            [build::Stage::Read, build::Stage::Spacing, build::Stage::Write, build::Stage::Aggregate]
                .map(stage);
        let seconds = read + spacing + write + aggregate;
        let aggregate_pages = header.aggregates.as_ref().map_or(0, |aggregates| aggregates.pages);
        let aggregate_bytes = u64::from(aggregate_pages) * u64::from(header.page_bytes);
        let without_aggregates = header.file_bytes - aggregate_bytes;
        Self {
            points: built.points,
            copies: header.copies,
            skipped_position: built.skipped.position,
            skipped_radius: built.skipped.radius,
            skipped_weight: built.skipped.weight,
            file_bytes: header.file_bytes,
            point_data_bytes: header.point_data_bytes,
            index_fraction: 1.0 - header.point_data_bytes as f64 / without_aggregates as f64,
            page_bytes: header.page_bytes,
            pages: header.pages(),
            nodes: header.nodes,
            aggregates: header.aggregates.as_ref().map_or(0, build::AggregateHeader::records),
            aggregate_bytes,
            position_error: header.position_error,
            position_error_radii: header.position_error_radii,
            seconds,
            read_seconds: read,
            spacing_seconds: spacing,
            write_seconds: write,
            aggregate_seconds: aggregate,
            points_per_second: built.points as f64 / seconds,
            peak_rss_bytes: peak_rss(),
        }
    }
}

fn describe(output: &Path, built: &BuildReport) -> Result<()> {
    let summary = Summary::of(built);
    report::say(format_args!(
        "{}: {} points, {} in {} pages, {:.1} % index",
        output.display(),
        report::count(built.points),
        report::bytes(summary.file_bytes),
        summary.pages,
        100.0 * summary.index_fraction
    ));
    if summary.aggregates > 0 {
        report::say(format_args!(
            "{} aggregates, which stand for points from afar, are {:.1} % of the file ({})",
            report::count(summary.aggregates.into()),
            100.0 * summary.aggregate_bytes as f64 / summary.file_bytes as f64,
            report::bytes(summary.aggregate_bytes)
        ));
    }
    if built.header.copies > 0 {
        report::say(format_args!(
            "{} more points were equal to one of these, and their weights are in its own",
            report::count(built.header.copies)
        ));
    }
    let skipped = built.skipped;
    if skipped.total() > 0 {
        report::say(format_args!(
            "skipped {} invalid records: {} positions, {} radii, {} weights",
            report::count(skipped.total()),
            skipped.position,
            skipped.radius,
            skipped.weight
        ));
    }
    report::say(format_args!(
        "{:.2} s, {} points a second{}",
        summary.seconds,
        report::count(summary.points_per_second as u64),
        summary.peak_rss_bytes.map_or_else(String::new, |b| format!(", peak memory {}", report::bytes(b)))
    ));
    Ok(())
}

//! `rayset demo`

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Result;
use clap::Args;
use rayset::Cloud;
use rayset::build::{self, BuildOptions};
use rayset::output::Destination;
use rayset::points::Workload;

use crate::budget::Budget;
use crate::render;
use rayset_inputs::style::Style;
use rayset_inputs::values;
use rayset_terminal::interrupts::TemporaryFolder;
use rayset_terminal::progress::Meter;

use rayset_terminal::ply;

use rayset_terminal::report;

/// Make a cloud larger than its memory budget, build it, render it, and say what the working set
/// did.
///
/// Needs nothing but this program and about 400 MB of disk for a minute.
#[derive(Args)]
pub(crate) struct DemoArgs {
    /// Picture to write
    #[arg(short, long, default_value = "demo.png")]
    output: PathBuf,
    /// What to make: knot-N or galaxy-N, sphere-N or cube-N
    #[arg(long, default_value = "knot-4m")]
    workload: Workload,
    /// Memory for the whole process
    #[arg(long, value_parser = values::size, default_value = "32MiB")]
    memory: u64,
    /// Picture size
    #[arg(long, value_parser = values::dimensions, default_value = "960x720")]
    size: (u32, u32),
}

/// Radii of workloads are for measuring; a surface without pores needs larger ones.
const RADIUS_SCALE: f64 = 1.3;

pub(crate) fn run(args: &DemoArgs) -> Result<()> {
    let started = Instant::now();
    // Checked first, although it is written last.
    Destination::new(&args.output)?;
    let folder = TemporaryFolder::new("demo")?;
    make(args, folder.path())?;
    report::say(format_args!(
        "{:.1} s in all. Now look at {}",
        started.elapsed().as_secs_f64(),
        args.output.display()
    ));
    Ok(())
}

fn make(args: &DemoArgs, folder: &Path) -> Result<()> {
    let workload = &args.workload;
    let cloud = make_cloud(workload, args.memory, folder)?;

    report::say(format_args!("3. render them, within {}", report::bytes(args.memory)));
    let view = workload.view();
    let camera = Style {
        position: Some(view.position.to_array()),
        look_at: Some(view.look_at.to_array()),
        up: Some(view.up.to_array()),
        fovy: Some(view.fovy_degrees),
        ..Style::default()
    };
    let (width, height) = args.size;
    let render = render::defaults(&cloud, &args.output)?;
    render::run(&render.with_memory(args.memory).with_style(&camera).with_size(width, height))
}

/// Generates points and builds their cloud in a folder, within a budget.
pub(crate) fn make_cloud(workload: &Workload, memory: u64, folder: &Path) -> Result<PathBuf> {
    let (points, cloud) = (folder.join("points.ply"), folder.join("cloud.rset"));
    report::say(format_args!("1. generate {} points", report::count(workload.points())));
    ply::write_source(&mut *workload.source(), &Destination::new(&points)?)?;

    report::say(format_args!("2. build their octree on disk, within {}", report::bytes(memory)));
    let options = BuildOptions::default()
        .with_radius(workload.radius().map(build::Rule::Number))
        .with_radius_scale(RADIUS_SCALE)
        .with_memory_bytes(Budget::near(memory).left());
    let source = rayset::points::open(&points, &rayset::points::ReadOptions::default())?;
    let meter = Meter::new("points", false);
    let control = build::BuildControl::from(&meter as &dyn build::Progress);
    let built = (Cloud::builder().sources([source]).options(options).control(control).write(&cloud))
        .map_err(|e| crate::budget::name_smallest_budget(e, Budget::near(memory)))?;
    meter.finish();
    report::say(format_args!(
        "   {} of pages, {:.1} times the memory that may be used",
        report::bytes(built.header.file_bytes),
        built.header.file_bytes as f64 / memory as f64
    ));
    Ok(cloud)
}

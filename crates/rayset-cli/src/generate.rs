//! `rayset generate`

use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::Args;
use rayset::points::{MeshSource, Workload};
use rayset_terminal::ply::write_source;

use rayset_terminal::outputs::Outputs;
use rayset_terminal::report;

/// Write a generated cloud as a binary PLY file.
///
/// sphere-N and cube-N are the workloads of the benchmark (points on the unit sphere, in the unit
/// cube), knot-N, galaxy-N and vase-N are to look at; N is a number like 5000, 100k or 1m. Or
/// points on the triangles of a mesh.
#[derive(Args)]
pub(crate) struct GenerateArgs {
    /// sphere-N, cube-N, knot-N, galaxy-N or vase-N
    #[arg(required_unless_present = "from_mesh")]
    workload: Option<Workload>,
    /// Points on the faces of this PLY, OBJ or STL file instead, evenly by area
    #[arg(long, requires = "points", conflicts_with = "workload")]
    from_mesh: Option<PathBuf>,
    /// How many
    #[arg(long, requires = "from_mesh")]
    points: Option<u64>,
    /// File to write; NAME.ply by default
    #[arg(short, long)]
    output: Option<PathBuf>,
}

pub(crate) fn run(args: &GenerateArgs) -> Result<()> {
    let Some(workload) = &args.workload else { return from_mesh(args) };
    let path = args.output.clone().unwrap_or_else(|| format!("{workload}.ply").into());
    let to = Outputs::default().add(&path, None)?;
    let count = write_source(&mut *workload.source(), &to)?;
    report::say(format_args!("{}: {} points", path.display(), report::count(count)));
    if let Some(radius) = workload.radius() {
        report::say(format_args!("build it with --radius {radius}"));
    }
    Ok(())
}

fn from_mesh(args: &GenerateArgs) -> Result<()> {
    let (Some(mesh), Some(points)) = (&args.from_mesh, args.points) else {
        bail!("--from-mesh needs --points")
    };
    let path = args.output.clone().unwrap_or_else(|| "points.ply".into());
    let to = Outputs::beside([mesh]).add(&path, None)?;
    let count = write_source(&mut MeshSource::open(mesh, points)?, &to)?;
    report::say(format_args!("{}: {} points", path.display(), report::count(count)));
    Ok(())
}

//! `rayset verify`

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use rayset::Grid;
use rayset::file::Depth;

use rayset_inputs::Built;
use rayset_terminal::report;

/// Check a cloud or grid file: by default every page's checksum and records
#[derive(Args)]
pub(crate) struct VerifyArgs {
    /// Cloud or grid file
    cloud: PathBuf,
    /// Only header, footer and length
    #[arg(long, conflicts_with = "deep")]
    quick: bool,
    /// Also every bound and total against the points
    #[arg(long)]
    deep: bool,
}

pub(crate) fn run(args: &VerifyArgs) -> Result<()> {
    let cloud = match rayset_inputs::open_built(&args.cloud)? {
        Built::Cloud(cloud) => cloud,
        Built::Grid(grid) => return verify_grid(args, &grid),
    };
    let depth = match (args.quick, args.deep) {
        (true, _) => Depth::Quick,
        (_, true) => Depth::Deep,
        _ => Depth::Pages,
    };
    let found = cloud.verify(depth)?;
    report::say(match depth {
        Depth::Quick => "ok: header, footer and length".to_owned(),
        Depth::Pages => format!("ok: {} pages, {} points", found.pages, report::count(found.points)),
        _ => format!(
            "ok: {} pages, {} points, bounds and totals of {} runs and {} nodes{}",
            found.pages,
            report::count(found.points),
            found.runs,
            found.nodes,
            match found.aggregates {
                0 => String::new(),
                aggregates => format!(", {} aggregates", report::count(aggregates.into())),
            }
        ),
    });
    Ok(())
}

fn verify_grid(args: &VerifyArgs, grid: &Grid) -> Result<()> {
    if args.quick {
        report::say("ok: header, footer and length");
        return Ok(());
    }
    let pages = grid.verify()?;
    report::say(format_args!("ok: {pages} pages"));
    Ok(())
}

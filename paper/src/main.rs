//! `rayset-paper`: the paper's engine and its experiments.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context as _, Result};
use clap::{Parser, Subcommand};
use rayset_paper::experiments::{self, Experiment, Setting, Size};

/// The engine of the paper, and its experiments, beside the engine that ships.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Run an experiment; write its table, its plot and its figures
    Run {
        /// Which
        experiment: Experiment,
        /// How much is measured
        #[arg(long, value_enum, default_value = "quick")]
        size: Size,
        /// Folder for results
        #[arg(long, default_value = "docs/paper")]
        out: PathBuf,
        /// Scan to use in place of generated points
        #[arg(long)]
        scan: Option<PathBuf>,
        /// Dense scan to use in place of the generated points of Fig. 5
        #[arg(long)]
        dense_scan: Option<PathBuf>,
    },
    /// Render a cloud with the reference engine, and say what it took
    Render(rayset_paper::experiments::render::RenderArgs),
    /// Render Table 3's scene of some clouds with the engine that ships, once cold and once warm;
    /// to be profiled
    Sets(rayset_paper::experiments::sets::SetsArgs),
}

fn main() -> Result<()> {
    match Arguments::parse().command {
        Command::Run { experiment, size, out, scan, dense_scan } => {
            let work = tempfile::tempdir().context("cannot make a temporary folder")?;
            let setting = Setting { size, out, scan, dense_scan, work: work.path().to_owned() };
            let started = Instant::now();
            experiments::run(experiment, &setting)?;
            say(&format!("{}: {:.1} s", setting.out.display(), started.elapsed().as_secs_f64()));
            Ok(())
        }
        Command::Render(args) => {
            say(&experiments::render::run(&args)?);
            Ok(())
        }
        Command::Sets(args) => {
            say(&experiments::sets::run(&args)?);
            Ok(())
        }
    }
}

#[expect(clippy::print_stdout, reason = "this is what the program is for")]
fn say(text: &str) {
    println!("{text}");
}

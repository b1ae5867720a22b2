//! `rayset`: ray-traces point clouds larger than memory, as volumes, inside a memory budget that
//! holds.

mod aggregates;
mod annotate;
mod budget;
mod build;
mod build_parts;
mod check;
mod demo;
#[cfg(test)]
mod documents;
mod generate;
mod histogram;
mod info;
mod input;
mod input_args;
mod lod;
mod manual;
mod merge;
mod option_args;
mod part_note;
mod remote;
mod render;
mod verify;
#[cfg(feature = "view")]
mod view;

use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};
use rayset_terminal::{interrupts, memory, report};

/// Ray-traces point clouds larger than memory, as volumes, inside a memory budget that holds.
///
/// A cloud file is built once from scans, simulations or tables (`build`). Scenes of clouds and
/// other objects, or clouds alone, are rendered any number of times (`render`) within the memory
/// that you allow. Start with `rayset demo`.
#[derive(Parser)]
#[command(name = "rayset", version, arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    #[command(flatten)]
    remote: remote::RemoteArgs,
}

#[derive(Subcommand)]
enum Command {
    /// Make a cloud larger than its memory budget, build it, render it, and say what the working
    /// set did
    Demo(demo::DemoArgs),
    /// Write a generated cloud as a PLY file
    Generate(generate::GenerateArgs),
    /// Build a cloud file from points, or a grid file from a volume
    Build(Box<build::BuildArgs>),
    /// Say what is in a cloud or grid, or in any file of points or voxels, and how much memory it
    /// wants
    Info(info::InfoArgs),
    /// Add to a cloud file what stands for its points from afar
    Lod(lod::LodArgs),
    /// Check a cloud file
    Verify(verify::VerifyArgs),
    /// Check a scene file before it is rendered
    Check(check::CheckArgs),
    /// Render a scene, a cloud, a grid, or any file of points or voxels to a picture
    Render(Box<render::RenderArgs>),
    /// Join the parts of a picture or of a cloud, which `render --part` or `build --part` wrote
    Merge(merge::MergeArgs),
    /// Look around in a scene, a cloud, a grid, or any file of points or voxels, in a browser
    #[cfg(feature = "view")]
    View(Box<view::ViewArgs>),
    /// Make a figure of the paper
    #[cfg(feature = "lab")]
    Figure(rayset_lab::figure::FigureArgs),
    /// Build and render the standard workloads, and say how long it took
    #[cfg(feature = "lab")]
    Bench(rayset_lab::bench::BenchArgs),
    /// Write a completion script for a shell to standard output
    Completions(manual::CompletionsArgs),
    /// Write the manual pages
    Man(manual::ManArgs),
}

fn main() -> ExitCode {
    memory::tame_allocator();
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        // The user has asked for help or the version.
        Err(answer) if !answer.use_stderr() => return ended(report::answer(&answer)),
        Err(error) => {
            report::misused(error, &Cli::command());
            return ExitCode::from(2);
        }
    };
    let outcome = interrupts::install()
        .and_then(|()| cli.remote.open(cli.command.memory()))
        .and_then(|()| run(cli.command))
        .and_then(|()| report::check_results());
    interrupts::wait_if_ending();
    ended(outcome)
}

impl Command {
    /// The memory for the whole process, of commands whose outputs are large.
    fn memory(&self) -> Option<u64> {
        match self {
            Self::Build(args) => Some(args.memory),
            Self::Merge(args) => Some(args.memory),
            Self::Lod(args) => Some(args.memory),
            _ => None,
        }
    }
}

fn run(command: Command) -> anyhow::Result<()> {
    match command {
        Command::Demo(args) => demo::run(&args),
        Command::Generate(args) => generate::run(&args),
        Command::Build(args) => build::run(&args),
        Command::Info(args) => info::run(&args),
        Command::Lod(args) => lod::run(&args),
        Command::Verify(args) => verify::run(&args),
        Command::Check(args) => check::run(&args),
        Command::Render(args) => render::run(&args),
        Command::Merge(args) => merge::run(&args),
        #[cfg(feature = "view")]
        Command::View(args) => view::run(&args),
        #[cfg(feature = "lab")]
        Command::Figure(args) => rayset_lab::figure::run(&args),
        #[cfg(feature = "lab")]
        Command::Bench(args) => rayset_lab::bench::run(&args),
        Command::Completions(args) => manual::completions(&args, Cli::command()),
        Command::Man(args) => manual::man(&args, Cli::command()),
    }
}

fn ended(outcome: anyhow::Result<()>) -> ExitCode {
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => match error.downcast_ref::<interrupts::Stopped>() {
            Some(stopped) => {
                report::remark(stopped);
                ExitCode::from(stopped.status())
            }
            None => {
                report::fail(&error);
                ExitCode::FAILURE
            }
        },
    }
}

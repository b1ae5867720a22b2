//! Joining the parts of a picture.

use std::time::Instant;

use anyhow::{Result, anyhow, ensure};
use rayset::parts::{Joined, Part, PartError};

use super::args::MergeArgs;
use crate::budget::Budget;
use crate::render::{self, Format, Joining};
use rayset_terminal::memory::peak_rss;
use rayset_terminal::outputs::Outputs;
use rayset_terminal::report::{bytes, say};

pub(super) fn run(args: &MergeArgs) -> Result<()> {
    let started = Instant::now();
    let output = Outputs::beside(&args.parts).add(&args.output, None)?;
    let format = Format::of(&output)?;
    let parts = args.parts.iter().map(Part::open);
    let budget = Budget::of(args.memory, args.parts.iter().chain([&args.output]));
    let joined = Joined::join(parts, budget.left()).map_err(|error| name_smallest_budget(error, budget))?;
    ensure!(
        format == Format::Png || joined.has_layers(),
        "{} is to have layers, and the parts have none: render them with --layers, or merge them to a .png",
        args.output.display()
    );
    render::write_joined(&joined, &output, Joining { doing: "merging", census: None, comment: "" })?;
    say(format_args!(
        "{}: {} parts, {:.2} s{}",
        args.output.display(),
        args.parts.len(),
        started.elapsed().as_secs_f64(),
        peak_rss().map_or_else(String::new, |peak| format!(", peak memory {}", bytes(peak)))
    ));
    Ok(())
}

/// The library is given the budget less the memory of the process itself; its error must state the
/// whole budget.
fn name_smallest_budget(error: PartError, budget: Budget) -> anyhow::Error {
    match error {
        PartError::Memory { needed, .. } => {
            let least = budget.leaving(needed);
            anyhow!(
                "--memory {} is too small for these parts; the smallest that would do is {least} bytes ({})",
                budget.in_words(),
                bytes(least)
            )
        }
        other => other.into(),
    }
}

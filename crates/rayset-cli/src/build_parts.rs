//! `rayset build --part`: a step of a build that is divided among processes.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::{Context, Result, ensure};
use clap::Args;
use rayset::build::{BuildControl, BuildOptions, BuildParts, BuildStep, Progress};
use rayset::output::Destination;
use rayset::storage::address_of;
use rayset_inputs::Points;

use crate::budget::{Budget, name_smallest_budget};
use rayset_terminal::memory::peak_rss;
use rayset_terminal::progress::Meter;
use rayset_terminal::{interrupts, report};

/// Which part of a build is to be done.
#[derive(Args)]
pub(crate) struct PartArgs {
    /// Do a step of one part of a build that is divided among processes, as in 3/8; `rayset merge`
    /// then makes the file
    #[arg(long)]
    part: Option<PartOf>,
    /// The step: read, spacing-count, spacing-scatter, spacing-sort, spacing-measure, count,
    /// scatter or order. By default the first that this part has not done
    #[arg(long, requires = "part")]
    step: Option<BuildStep>,
    /// Folder through which the parts exchange their results, seen by all of them; OUTPUT.parts by
    /// default. An output at an address needs one
    #[arg(long, requires = "part")]
    exchange: Option<PathBuf>,
}

/// A part, as in 3/8.
#[derive(Clone, Copy)]
pub(crate) struct PartOf {
    part: u32,
    parts: u32,
}

impl FromStr for PartOf {
    type Err = String;

    fn from_str(s: &str) -> Result<Self, String> {
        let numbers =
            s.split_once('/').and_then(|(part, parts)| Some((part.parse().ok()?, parts.parse().ok()?)));
        match numbers {
            Some((part, parts)) if (1..=parts).contains(&part) => Ok(Self { part, parts }),
            _ => Err("expected a part and the number of parts, from 1/8 to 8/8".into()),
        }
    }
}

impl PartArgs {
    /// The part that is asked for, if any.
    pub(crate) fn asked(&self) -> Option<PartOf> {
        self.part
    }

    /// The folder through which the parts of a build to `output` exchange their results.
    ///
    /// # Errors
    /// If it would be an address: parts exchange files.
    fn folder(&self, output: &Path) -> Result<PathBuf> {
        if let Some(folder) = &self.exchange {
            ensure!(
                address_of(folder).is_none(),
                "--exchange {}: parts exchange files, in a folder that all of them see; an address has none",
                folder.display()
            );
            return Ok(folder.clone());
        }
        ensure!(
            address_of(output).is_none(),
            "{} is an address, beside which parts cannot exchange files: give --exchange FOLDER, which all of them see, and then \
             `rayset merge FOLDER -o {}`",
            output.display(),
            output.display()
        );
        Ok(default_folder(output))
    }
}

/// Refuses a part of a build, before anything is done, that has no folder to exchange files
/// through.
pub(crate) fn check(args: &PartArgs, output: &Path) -> Result<()> {
    if args.part.is_some() { args.folder(output).map(drop) } else { Ok(()) }
}

/// What a step of a part is made of.
pub(crate) struct Work<'a> {
    pub(crate) args: &'a PartArgs,
    pub(crate) output: &'a Path,
    /// What inputs and options are, the same for all parts.
    pub(crate) request: String,
    /// The resources, and what else is known before the input is opened.
    pub(crate) options: BuildOptions,
    pub(crate) budget: Budget,
    pub(crate) json: bool,
}

/// What was done, as JSON.
#[derive(serde::Serialize)]
struct Done {
    step: Option<&'static str>,
    part: u32,
    parts: u32,
    seconds: f64,
    peak_rss_bytes: Option<u64>,
}

/// Does a step of a part. `open` opens the input, which the first step alone needs.
pub(crate) fn run(
    work: &Work<'_>,
    PartOf { part, parts }: PartOf,
    open: impl FnOnce() -> Result<(Points, BuildOptions)>,
) -> Result<()> {
    let started = std::time::Instant::now();
    let folder = work.args.folder(work.output)?;
    let build = BuildParts::new(&folder, parts)?.with_request(work.request.clone());
    let step = match work.args.step {
        Some(step) => Some(step),
        None => build.next_step(part)?,
    };
    if let Some(step) = step {
        create_folder(&folder)?;
        for file in build.files(step, part) {
            interrupts::watch(&Destination::new(&file)?, work.options.temp_dir.as_deref());
        }
        let meter = Meter::new("points", work.json);
        let control = BuildControl::from(&meter as &dyn Progress);
        let outcome = if step == BuildStep::Read {
            let (points, options) = open()?;
            build.read(part, points.sources, &options, &control)
        } else {
            build.run(step, part, &work.options, &control)
        };
        meter.finish();
        outcome.map_err(|e| name_smallest_budget(e, work.budget))?;
    }
    let seconds = started.elapsed().as_secs_f64();
    if work.json {
        let step = step.map(BuildStep::name);
        return report::json(&Done { step, part, parts, seconds, peak_rss_bytes: peak_rss() });
    }
    match step {
        Some(step) => {
            let peak = peak_rss().map_or_else(String::new, |b| format!(", peak memory {}", report::bytes(b)));
            report::say(format_args!("part {part} of {parts}: {step} done in {seconds:.2} s{peak}"));
        }
        None => report::say(format_args!(
            "part {part} of {parts} has done all steps; once all have: rayset merge {} -o {}",
            folder.display(),
            work.output.display()
        )),
    }
    Ok(())
}

/// `OUTPUT.parts`.
fn default_folder(output: &Path) -> PathBuf {
    let mut name = output.as_os_str().to_owned();
    name.push(".parts");
    name.into()
}

fn create_folder(folder: &Path) -> Result<()> {
    match std::fs::create_dir(folder) {
        Err(e) if e.kind() != std::io::ErrorKind::AlreadyExists => {
            Err(e).with_context(|| format!("cannot create the folder {}", folder.display()))
        }
        _ => Ok(()),
    }
}

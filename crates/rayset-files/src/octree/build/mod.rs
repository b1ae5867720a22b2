//! Building a cloud from points, in bounded memory.
//!
//! [`run`] gives the overview. In order, records are
//! - read and checked (`ingest`);
//! - given radii, if they have none (`spacing`);
//! - merged where they are equal, if that is many of them (`copies`), which is first estimated
//!   (`distinct`);
//! - sorted into file order, in buckets that fit in memory (`partition`);
//! - turned into runs and nodes (`subtree`), and these laid out in pages (`assemble`).
//!
//! The result depends only on the input and on [`BuildOptions`] other than `memory_bytes`,
//! `threads` and `temp_dir`.

mod assemble;
mod builder;
mod columns;
mod context;
mod control;
mod copies;
mod curve;
mod depths;
mod distinct;
mod error;
mod fluid;
mod ingest;
mod neighbourhood;
mod neighbours;
mod options;
mod partition;
#[cfg(feature = "parts")]
mod parts;
mod pieces;
mod plan;
mod record;
mod region;
mod shapes_of;
mod sorted;
mod spacing;
mod subtree;
mod survey;
mod typical;

use std::path::Path;
use std::time::Duration;

use self::assemble::{Assembler, Output};
pub use self::builder::CloudBuilder;
use self::context::{BuildPlace, Context};
pub use self::control::{BuildControl, NoProgress, Progress, Stage};
pub use self::error::{BuildError, Quantity, Skipped};
use self::ingest::Ingested;
use self::options::check_options;
pub use self::options::{BuildOptions, InvalidPolicy, Precision, Rule, ShapeRule, minimum_memory};
use self::partition::Partition;
#[cfg(feature = "parts")]
pub use self::parts::{BuildParts, BuildStep};
use self::region::Region;
use super::file::Cloud;
use crate::points::PointSource;
use rayset_store::output::{Destination, OutputFile, remove_leftovers};

/// The result of a build.
#[derive(Clone, Debug)]
#[cfg_attr(not(feature = "internals"), non_exhaustive)]
pub struct BuildReport {
    /// Number of points stored.
    pub points: u64,
    /// Skipped records, by reason.
    pub skipped: Skipped,
    /// The header of the cloud.
    pub header: super::format::Header,
    /// Time of each stage.
    pub times: Vec<(Stage, Duration)>,
    /// What was decided about colours without asking, in sentences for the person who builds.
    pub remarks: Vec<String>,
}

/// Builds one cloud from all `sources`, in memory. No file is created; the cloud is the same, byte
/// for byte, as one that is built into a file.
///
/// # Errors
/// [`BuildError`].
pub fn run_in_memory(
    sources: Vec<Box<dyn PointSource + '_>>,
    options: &BuildOptions,
    control: &BuildControl<'_>,
) -> Result<(Cloud, BuildReport), BuildError> {
    check_options(options, &sources)?;
    let context = Context { place: BuildPlace::Memory, options, control };
    let (output, report) = build(&context, sources, Output::in_memory())?;
    let cloud = Cloud::from_bytes(output.into_bytes()).map_err(BuildError::Open)?;
    Ok((cloud, report))
}

/// Builds one cloud file from all `sources`, at `output`.
///
/// # Errors
/// [`BuildError`]; an existing file at `output` is then unchanged.
pub fn run(
    sources: Vec<Box<dyn PointSource + '_>>,
    output: &Path,
    options: &BuildOptions,
    control: &BuildControl<'_>,
) -> Result<BuildReport, BuildError> {
    check_options(options, &sources)?;
    let destination = Destination::new(output)?;
    destination.require_file()?;
    destination.refuse_inputs(sources.iter().flat_map(|source| source.files()))?;
    let temp_dir = options.temp_dir.clone().unwrap_or_else(|| destination.folder().to_owned());
    // Before any work, so that an unwritable output is detected immediately.
    let file = OutputFile::create(&destination)?;
    remove_leftovers(&temp_dir, &destination);
    let context = Context { place: BuildPlace::Disk { output: &destination, temp_dir }, options, control };
    let (output, report) = build(&context, sources, Output::to_file(file))?;
    context.check()?;
    output.publish()?;
    Ok(report)
}

/// Runs the stages in order.
fn build(
    context: &Context<'_>,
    sources: Vec<Box<dyn PointSource + '_>>,
    output: Output,
) -> Result<(Output, BuildReport), BuildError> {
    let mut clock = StageClock::start();
    let ingested = ingest::run(context, sources)?;
    clock.lap(Stage::Read);
    let ingested = if ingested.survey.measures_radii() {
        let with_radius = spacing::assign_radii(context, ingested)?;
        clock.lap(Stage::Spacing);
        with_radius
    } else if ingested.survey.may_have_copies {
        let without_copies = copies::find(context, ingested)?;
        clock.lap(Stage::Spacing);
        without_copies
    } else {
        ingested
    };
    let mut assembler = Assembler::create(context, &ingested.survey, output)?;
    order_and_pack(context, &ingested, &mut assembler)?;
    let (output, header) = assembler.finish(context, &ingested.survey)?;
    clock.lap(Stage::Write);
    let survey = &ingested.survey;
    let (points, skipped, times) = (header.points, survey.skipped, clock.laps);
    let remarks = survey.depths.remarks();
    Ok((output, BuildReport { points, skipped, header, times, remarks }))
}

/// Sorts the records into file order, bucket by bucket, and passes runs and nodes to the assembler.
fn order_and_pack(
    context: &Context<'_>,
    ingested: &Ingested,
    assembler: &mut Assembler,
) -> Result<(), BuildError> {
    let Ingested { spill, survey } = ingested;
    let packer = subtree::Packer::new(survey, context.options.precision, &context.control.cancel);
    let partition =
        Partition::new(context, survey.layout.stride(), survey.keys(), survey.count, Stage::Write);
    partition.run(Region::all(spill, survey.count), &packer, assembler)
}

struct StageClock {
    last: std::time::Instant,
    laps: Vec<(Stage, Duration)>,
}

impl StageClock {
    fn start() -> Self {
        Self { last: std::time::Instant::now(), laps: Vec::new() }
    }

    fn lap(&mut self, stage: Stage) {
        self.laps.push((stage, self.last.elapsed()));
        self.last = std::time::Instant::now();
    }
}

//! From points to a cloud file, in bounded memory.
//!
//! [`run`] is the table of contents: records are read and checked (`ingest`), given a radius where they have none
//! (`spacing`), put in the order of the file by buckets that fit in memory (`partition`), turned into runs and nodes
//! (`subtree`), and laid out in pages (`assemble`). The result depends on the input and on [`BuildOptions`] apart
//! from `memory_bytes`, `threads` and `temp_dir`, and on nothing else.

mod assemble;
mod columns;
mod depths;
mod ingest;
mod partition;
mod pipeline;
mod plan;
mod record;
mod spacing;

mod subtree;

use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use self::assemble::{Assembler, Output};
use self::ingest::Ingested;
use self::partition::{Partition, Region};
use self::record::KeyMaker;
use super::file::Cloud;
use super::format::{Column, MAX_ATTRIBUTES, NAME_BYTES};
use crate::cancel::CancelToken;
use crate::container::{MAX_PAGE_BYTES, OpenError};
use crate::output::{Destination, OutputError, OutputFile, remove_leftovers};
use crate::points::{PointSource, ReadError};
use crate::spill::Spill;

/// Where a number of each point comes from.
#[derive(Clone, Debug, PartialEq)]
pub enum Rule {
    /// The same for every point.
    Number(f64),
    /// A column of the input, by its name.
    Attribute(String),
    /// Radius only: from the local spacing of the points.
    Auto,
}

/// What to do with a record whose position, radius or weight is no usable number.
///
/// A record is invalid where a coordinate is not finite, a radius is not a positive number, or a weight is not finite.
/// Coordinates, radii and weights beyond 1e18 in size, and radii below 1e-18, are out of range: they cannot be stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum InvalidPolicy {
    /// Count invalid records and go on; stop where any is out of range, with the factor that would bring them into it.
    #[default]
    Skip,
    /// Count invalid records and those out of range, and go on.
    SkipAll,
    /// Stop with an error that names the first such record.
    Reject,
}

/// A number that is out of range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// A coordinate beyond 1e18.
    Position,
    /// A radius beyond 1e18.
    Radius,
    /// A radius below 1e-18.
    SmallRadius,
    /// A weight beyond 1e18.
    Weight,
}

impl Quantity {
    const ALL: [Self; 4] = [Self::Position, Self::Radius, Self::SmallRadius, Self::Weight];

    /// The option that would bring it into range.
    #[must_use]
    pub fn option(self) -> &'static str {
        match self {
            Self::Position | Self::Radius | Self::SmallRadius => "length_scale",
            Self::Weight => "weight_scale",
        }
    }

    /// What the option should be instead of `present`: a power of ten that brings `farthest` well into range. `None` where
    /// no number does.
    fn factor(self, farthest: f64, present: f64) -> Option<f64> {
        let exponent = (farthest / present).log10();
        let by = if self == Self::SmallRadius { -6.0 - exponent.floor() } else { 6.0 - exponent.ceil() };
        Some(10_f64.powi(by as i32)).filter(|factor| *factor > 0.0 && factor.is_finite())
    }
}

impl std::fmt::Display for Quantity {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Position => "coordinates beyond 1e18, up to",
            Self::Radius => "radii beyond 1e18, up to",
            Self::SmallRadius => "radii below 1e-18, down to",
            Self::Weight => "weights beyond 1e18, up to",
        })
    }
}

/// How exactly positions are stored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Precision {
    /// Within this fraction of the smallest radius of the 128 points of a run.
    Relative(f64),
    /// As read, bit for bit.
    Exact,
}

impl Default for Precision {
    /// 1/4096 of the radius: the error of the density stays about 1e-5 of its maximum where supports overlap.
    fn default() -> Self {
        Self::Relative(1.0 / 4096.0)
    }
}

/// How to build a cloud.
#[derive(Clone, Debug)]
pub struct BuildOptions {
    /// Radius of influence. `None`: the column `radius` where every input has one, else [`Rule::Auto`].
    pub radius: Option<Rule>,
    /// Factor on every radius, whatever `radius` is.
    pub radius_scale: f64,
    /// Factor on every coordinate, and on radii that come from a column.
    pub length_scale: f64,
    /// Weight. `None`: the column `weight` where every input has one, else 1.
    pub weight: Option<Rule>,
    /// Factor on every weight, whatever `weight` is.
    pub weight_scale: f64,
    /// Further columns to keep.
    pub attributes: Vec<String>,
    /// Whether to keep colours where every input has them.
    pub keep_color: bool,
    /// What to do with invalid records.
    pub invalid: InvalidPolicy,
    /// How exactly to store positions.
    pub precision: Precision,
    /// Bytes of a page, a multiple of 4096 up to 262144. `None`: 32768, or 16384 below 500 000 points, or as many as a run
    /// of so many columns needs.
    pub page_bytes: Option<u32>,
    /// Memory to render with, stored in the file as a default.
    pub render_memory: Option<u64>,
    /// Bytes that the build may allocate. Changes nothing in the file.
    pub memory_bytes: u64,
    /// Threads. Changes nothing in the file.
    pub threads: usize,
    /// Where temporary files go; beside the output by default. Changes nothing in the file.
    pub temp_dir: Option<PathBuf>,
}

impl Default for BuildOptions {
    fn default() -> Self {
        Self {
            radius: None,
            radius_scale: 1.0,
            length_scale: 1.0,
            weight: None,
            weight_scale: 1.0,
            attributes: Vec::new(),
            keep_color: true,
            invalid: InvalidPolicy::Skip,
            precision: Precision::default(),
            page_bytes: None,
            render_memory: None,
            memory_bytes: 256 << 20,
            threads: std::thread::available_parallelism().map_or(1, usize::from),
            temp_dir: None,
        }
    }
}

/// What the first pass takes besides the source that it reads: a batch of points and a buffer of records.
const READING_BYTES: u64 = 6 << 20;

/// More threads than any machine has processors.
const MOST_THREADS: usize = 4096;

/// Smallest `memory_bytes` a build with `threads` threads runs in.
#[must_use]
pub fn minimum_memory(threads: usize) -> u64 {
    (4 << 20) + (threads as u64) * (2 << 20)
}

/// The parts of a build, for progress.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Reading and checking the input.
    Read,
    /// Measuring the spacing of points.
    Spacing,
    /// Ordering points and writing pages.
    Write,
}

/// Hears how a build gets on. Called from one thread at a time, a few times a second.
pub trait Progress: Sync {
    /// `done` of `total` points (0 where unknown) have passed a stage.
    fn update(&self, stage: Stage, done: u64, total: u64);
}

/// Hears nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoProgress;

impl Progress for NoProgress {
    fn update(&self, _: Stage, _: u64, _: u64) {}
}

/// Who hears how a build gets on, and who may stop it.
#[derive(Clone)]
pub struct BuildControl<'a> {
    /// Hears how it gets on.
    pub progress: &'a dyn Progress,
    /// Stops it: the build then returns [`BuildError::Cancelled`] and leaves no file behind.
    pub cancel: CancelToken,
}

impl Default for BuildControl<'_> {
    /// Nobody.
    fn default() -> Self {
        Self { progress: &NoProgress, cancel: CancelToken::new() }
    }
}

impl<'a> From<&'a dyn Progress> for BuildControl<'a> {
    fn from(progress: &'a dyn Progress) -> Self {
        Self { progress, ..Self::default() }
    }
}

/// What a build did.
#[derive(Clone, Debug)]
pub struct BuildReport {
    /// Points stored.
    pub points: u64,
    /// Invalid records, by reason.
    pub skipped: Skipped,
    /// The header of the file written.
    pub header: super::format::Header,
    /// Time of each stage.
    pub times: Vec<(Stage, Duration)>,
}

/// Invalid records that were counted and skipped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Skipped {
    /// Position not finite, or too large.
    pub position: u64,
    /// Radius not a positive number in range.
    pub radius: u64,
    /// Weight not finite, or too large.
    pub weight: u64,
}

impl Skipped {
    /// All of them.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.position + self.radius + self.weight
    }
}

/// Why a build failed. Nothing is left under the name of the output, except what stood there before.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BuildError {
    /// The input could not be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// A temporary file could not be written or read.
    #[error("cannot {action} {}: {source}", path.display())]
    Io {
        /// What was attempted.
        action: &'static str,
        /// The file, or the folder of the temporary files.
        path: PathBuf,
        /// The system's reason.
        r#source: io::Error,
    },
    /// The output cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// A source has handed out a batch that is not what was asked of it: a defect of the source.
    #[error(
        "input {input} handed out a batch of {columns} columns where {selected} were selected, or of columns that are not \
         as long as its positions"
    )]
    Source {
        /// Which input, from 1.
        input: usize,
        /// Columns of the batch.
        columns: usize,
        /// Columns that were selected.
        selected: usize,
    },
    /// No input was given.
    #[error("no input files")]
    NoInput,
    /// A named column is missing.
    #[error("input {input} has no column `{name}`; it has: {available}")]
    NoSuchColumn {
        /// Which input, from 1.
        input: usize,
        /// The name asked for.
        name: String,
        /// The columns there are.
        available: String,
    },
    /// An option out of its range.
    #[error("{option}: {what}")]
    Option {
        /// The option.
        option: &'static str,
        /// What is wrong with its value, and what is expected.
        what: String,
    },
    /// An invalid record, under [`InvalidPolicy::Reject`].
    #[error("record {index} of input {input}: {what}")]
    InvalidRecord {
        /// Which input, from 1.
        input: usize,
        /// Which record of it, from 0.
        index: u64,
        /// What is wrong.
        what: String,
    },
    /// Numbers that are finite and cannot be stored.
    #[error(
        "{count} of {records} records have {quantity} {farthest:e}, which cannot be stored: {}skip them if they stand \
         for missing values", factor.map_or(String::new(), |factor| format!("set {} to {factor:e}, or ", quantity.option()))
    )]
    OutOfRange {
        /// Which numbers.
        quantity: Quantity,
        /// How many records have such.
        count: u64,
        /// Records of the whole input.
        records: u64,
        /// The farthest out of range.
        farthest: f64,
        /// What [`Quantity::option`] should be to bring them into range; `None` where no number does.
        factor: Option<f64>,
    },
    /// Not one record can be used.
    #[error(
        "none of the {records} records is valid: {} have no usable position, {} no positive radius, {} no finite \
         weight", skipped.position, skipped.radius, skipped.weight
    )]
    NothingValid {
        /// Records of the whole input.
        records: u64,
        /// Why they are not.
        skipped: Skipped,
    },
    /// What was built in memory does not open: a defect of the builder.
    #[error(transparent)]
    Open(OpenError),
    /// The build was cancelled.
    #[error("cancelled")]
    Cancelled,
    /// The budget is too small.
    #[error("a memory budget of {given} bytes is too small: this build needs at least {needed}")]
    Memory {
        /// The budget.
        given: u64,
        /// The smallest that would do.
        needed: u64,
    },
}

/// What every stage of one build shares.
struct Context<'a> {
    place: Place<'a>,
    options: &'a BuildOptions,
    control: &'a BuildControl<'a>,
}

/// Where the cloud is made, and records wait.
enum Place<'a> {
    Disk { output: &'a Destination, temp_dir: PathBuf },
    Memory,
}

impl Context<'_> {
    /// The folder of temporary files.
    fn temp_dir(&self) -> PathBuf {
        match &self.place {
            Place::Disk { temp_dir, .. } => temp_dir.clone(),
            Place::Memory => "memory".into(),
        }
    }

    fn io(&self, action: &'static str) -> impl Fn(io::Error) -> BuildError + use<'_> {
        move |source| BuildError::Io { action, path: self.temp_dir(), source }
    }

    fn spill(&self) -> Result<Spill, BuildError> {
        match &self.place {
            Place::Disk { output, temp_dir } => {
                Spill::create(output, temp_dir).map_err(self.io("create a temporary file in"))
            }
            Place::Memory => Ok(Spill::in_memory()),
        }
    }

    fn is_cancelled(&self) -> bool {
        self.control.cancel.is_cancelled()
    }

    /// Ends the build where it is cancelled. Called every few thousand records.
    fn check(&self) -> Result<(), BuildError> {
        if self.is_cancelled() { Err(BuildError::Cancelled) } else { Ok(()) }
    }

    fn progress(&self, stage: Stage, done: u64, total: u64) {
        self.control.progress.update(stage, done, total);
    }
}

/// Builds a cloud in memory from `sources`, which together make one cloud. No file is made; the cloud is the same, byte
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
    let context = Context { place: Place::Memory, options, control };
    let (output, report) = build(&context, sources, Output::in_memory())?;
    let cloud = Cloud::from_bytes(output.into_bytes()).map_err(BuildError::Open)?;
    Ok((cloud, report))
}

/// Builds a cloud from `sources`, which together make one cloud, at `output`.
///
/// # Errors
/// [`BuildError`]; the output is then as it was before.
pub fn run(
    sources: Vec<Box<dyn PointSource + '_>>,
    output: &Path,
    options: &BuildOptions,
    control: &BuildControl<'_>,
) -> Result<BuildReport, BuildError> {
    check_options(options, &sources)?;
    let destination = Destination::new(output)?;
    destination.require_file()?;
    destination.refuse_inputs(sources.iter().filter_map(|source| source.path()))?;
    let temp_dir = options.temp_dir.clone().unwrap_or_else(|| destination.folder().to_owned());
    // Before any work, so that what cannot be written is known at once.
    let file = OutputFile::create(&destination)?;
    remove_leftovers(&temp_dir, &destination);
    let context = Context { place: Place::Disk { output: &destination, temp_dir }, options, control };
    let (output, report) = build(&context, sources, Output::to_file(file))?;
    context.check()?;
    output.publish()?;
    Ok(report)
}

/// The stages, one after another.
fn build(
    context: &Context<'_>,
    sources: Vec<Box<dyn PointSource + '_>>,
    output: Output,
) -> Result<(Output, BuildReport), BuildError> {
    let mut clock = StageClock::start();
    let ingested = ingest::run(context, sources)?;
    clock.lap(Stage::Read);
    let ingested = if ingested.radius.is_none() && !ingested.layout.has_radius {
        let with_radius = spacing::assign_radii(context, ingested)?;
        clock.lap(Stage::Spacing);
        with_radius
    } else {
        ingested
    };
    let mut assembler = Assembler::create(context, &ingested, output)?;
    order_and_pack(context, &ingested, &mut assembler)?;
    let (output, header) = assembler.finish(context, &ingested)?;
    clock.lap(Stage::Write);
    let (points, skipped, times) = (header.points, ingested.skipped, clock.laps);
    Ok((output, BuildReport { points, skipped, header, times }))
}

/// Puts the records in the order of the file, bucket by bucket, and hands runs and nodes to the assembler.
fn order_and_pack(
    context: &Context<'_>,
    ingested: &Ingested,
    assembler: &mut Assembler,
) -> Result<(), BuildError> {
    let keys = KeyMaker { root: ingested.root, radius: ingested.radius };
    let packer = subtree::Packer::new(ingested, keys, context.options.precision, &context.control.cancel);
    let partition = Partition::new(context, ingested.layout.stride(), keys, ingested.count, Stage::Write);
    partition.run(Region::all(&ingested.spill, ingested.count), &packer, assembler)
}

fn check_options(options: &BuildOptions, sources: &[Box<dyn PointSource + '_>]) -> Result<(), BuildError> {
    let wrong = |option, what: String| Err(BuildError::Option { option, what });
    if sources.is_empty() {
        return Err(BuildError::NoInput);
    }
    if options.threads > MOST_THREADS {
        return wrong("threads", format!("{} are more than {MOST_THREADS}", options.threads));
    }
    // Sources are read one after another, before anything else takes much, but all are open.
    let reading: u64 = sources.iter().map(|s| s.memory_needed()).sum();
    let needed = minimum_memory(options.threads.max(1)).max(READING_BYTES + reading);
    if options.memory_bytes < needed {
        return Err(BuildError::Memory { given: options.memory_bytes, needed });
    }
    if let Some(page) = options.page_bytes
        && (page == 0 || page % 4096 != 0 || page as usize > MAX_PAGE_BYTES || page < 16384)
    {
        return wrong(
            "page size",
            format!("{page} is no multiple of 4096 between 16384 and {MAX_PAGE_BYTES}"),
        );
    }
    if options.attributes.len() > MAX_ATTRIBUTES {
        return wrong("attributes", format!("at most {MAX_ATTRIBUTES} can be kept"));
    }
    if let Some(name) = options.attributes.iter().find(|a| a.is_empty() || a.len() > NAME_BYTES) {
        return wrong("attributes", format!("`{name}` has not 1 to {NAME_BYTES} bytes"));
    }
    let mut names: Vec<&String> = options.attributes.iter().collect();
    names.sort();
    if let Some(pair) = names.windows(2).find(|pair| pair[0] == pair[1]) {
        return wrong("attributes", format!("`{}` is named twice", pair[0]));
    }
    if let Precision::Relative(p) = options.precision
        && !(p > 0.0 && p <= 0.5)
    {
        return wrong("precision", format!("{p} is not in (0, 0.5] of a radius"));
    }
    for (option, scale) in [
        ("radius scale", options.radius_scale),
        ("length scale", options.length_scale),
        ("weight scale", options.weight_scale),
    ] {
        if !(scale > 0.0 && scale.is_finite()) {
            return wrong(option, format!("{scale} is not a positive number"));
        }
    }
    match options.radius {
        Some(Rule::Number(r)) if !(1e-18..=1e18).contains(&(r * options.radius_scale)) => {
            return wrong("radius", format!("{} is not between 1e-18 and 1e18", r * options.radius_scale));
        }
        _ => {}
    }
    match options.weight {
        Some(Rule::Number(w)) if !((w * options.weight_scale).abs() <= 1e18) => {
            return wrong("weight", format!("{} is not a number of at most 1e18", w * options.weight_scale));
        }
        Some(Rule::Auto) => return wrong("weight", "only a radius can be `auto`".into()),
        _ => {}
    }
    Ok(())
}

/// A column that turned out to be the same everywhere is stored once.
fn settled(min: f32, max: f32) -> Column {
    if min == max { Column::Constant(min) } else { Column::Varying { min, max } }
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

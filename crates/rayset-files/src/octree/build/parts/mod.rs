//! Builds that are divided among processes, which may run on different machines.
//!
//! Every [`BuildStep`] is done in parts, one process each, and the parts of the last step are
//! merged to the file that a local build writes, byte for byte. Parts exchange their results
//! through a folder (`exchange`), which all of them see.
//!
//! `read` reads and checks a share of the input (`share`). Its totals, merged, give the root cell,
//! so that `count` can count points by octree cells. From these counts all parts derive the same
//! division of the octree into ranges of buckets (`divide`): exact counts, so no leaf is cut.
//! `scatter` distributes the records of each share to the ranges, `order` sorts a range and encodes
//! its pieces (`work`), and the merge lays these out in pages (`frames`).

mod divide;
mod exchange;
mod frames;
mod job;
mod share;
mod spacing;
pub(super) mod step;
mod summary;
mod work;

use std::io::Read;
use std::path::{Path, PathBuf};

use self::exchange::{Exchange, Head, MOST_PARTS};
use self::frames::{FrameError, FrameWriter};
use self::job::{Job, Overview};
pub use self::step::BuildStep;
use self::summary::Summary;
use self::work::{Records, Sorting};
use super::BuildReport;
use super::assemble::{Assembler, Output};
use super::context::{BuildPlace, Context};
use super::control::{BuildControl, Stage};
use super::error::BuildError;
use super::ingest::{self, Stretch};
use super::options::{BuildOptions, check_options};
use super::subtree::Packer;
use super::survey::{Form, Survey};
use crate::points::PointSource;
use rayset_store::output::{Destination, OutputFile, remove_leftovers};

/// A build that is divided among processes: the folder through which they exchange their results,
/// and their number.
///
/// Each [`BuildStep`] has as many parts as there are processes, numbered from 1. All parts of one
/// step are done before any of the next begins; within a step they run in any order, or at once, in
/// any processes that see the folder. A part can be run again, whatever became of an earlier run of
/// it. [`merge`](Self::merge) makes the cloud file, which is the same as that of
/// [`to_file`](super::run), byte for byte.
///
/// The folder takes up to twice the size of the records, 24 bytes a point and what is stored with
/// it.
#[derive(Clone, Debug)]
pub struct BuildParts {
    exchange: Exchange,
    request: String,
}

impl BuildParts {
    /// A build in `parts` parts, 1 to 512. The folder is created when it is needed; that which
    /// contains it must exist.
    ///
    /// # Errors
    /// [`BuildError::Option`] if there are too many parts, or none.
    pub fn new(folder: &Path, parts: u32) -> Result<Self, BuildError> {
        if !(1..=MOST_PARTS).contains(&parts) {
            let what = format!("{parts} is not a number from 1 to {MOST_PARTS}");
            return Err(BuildError::Option { option: "parts", what });
        }
        Ok(Self { exchange: Exchange { folder: folder.to_owned(), parts }, request: String::new() })
    }

    /// The build of which a folder has parts.
    ///
    /// # Errors
    /// [`BuildError::Io`] if the folder cannot be read, [`BuildError::Part`] if it has no parts, or
    /// parts of several builds.
    pub fn open(folder: &Path) -> Result<Self, BuildError> {
        let wrong = |what: String| Err(BuildError::Part { path: folder.to_owned(), what });
        match Exchange::found(folder)?.as_slice() {
            [parts] => Self::new(folder, *parts),
            [] => wrong("it has no parts of a build".into()),
            several => wrong(format!("it has parts of builds in {} and in {} parts", several[0], several[1])),
        }
    }

    /// Sets a text that says what the inputs and the options are. Parts that were made with another
    /// one are refused, and a share that has been read with the same one is not read again. Without
    /// any, nothing is compared.
    #[must_use]
    pub fn with_request(self, request: String) -> Self {
        Self { request, ..self }
    }

    /// The number of parts.
    #[must_use]
    pub fn parts(&self) -> u32 {
        self.exchange.parts
    }

    /// The files that a part of a step writes, so that a process which is ended can remove what it
    /// has begun.
    #[must_use]
    pub fn files(&self, step: BuildStep, part: u32) -> [PathBuf; 2] {
        [self.exchange.part_path(step, part), self.exchange.data_path(step, part)]
    }

    /// The first step that has not been done by a part; `None` once all have.
    ///
    /// # Errors
    /// [`BuildError::MissingParts`] if the step must wait for other parts; [`BuildError`] if a file
    /// cannot be used.
    pub fn next_step(&self, part: u32) -> Result<Option<BuildStep>, BuildError> {
        self.check_part(part)?;
        let Some(read) = self.exchange.read(BuildStep::Read, part)? else { return Ok(Some(BuildStep::Read)) };
        job::check_request(&read, &self.request)?;
        let overview = Overview::load(&self.exchange, &self.request)?;
        let follows = overview.survey.follows_curve();
        let is_of_run = |part: &exchange::Part| part.head.run == overview.run;
        for step in BuildStep::ALL.into_iter().skip(1).filter(|step| follows || !step.is_of_spacing()) {
            if !self.exchange.read(step, part)?.is_some_and(|part| is_of_run(&part)) {
                if let Some(before) = step.before(follows) {
                    self.exchange.read_all(before, |_| Ok(()))?;
                }
                return Ok(Some(step));
            }
        }
        Ok(None)
    }

    /// Does [`BuildStep::Read`] of a part: reads its share of all `sources`, which are the same for
    /// all parts.
    ///
    /// Sources that [can skip](PointSource::can_skip) are divided, and others given to one part
    /// each.
    ///
    /// # Errors
    /// [`BuildError`].
    pub fn read(
        &self,
        part: u32,
        sources: Vec<Box<dyn PointSource + '_>>,
        options: &BuildOptions,
        control: &BuildControl<'_>,
    ) -> Result<(), BuildError> {
        self.check_part(part)?;
        check_options(options, &sources)?;
        let (form, columns) = Form::choose(options, &sources)?;
        let stretches = share::share(sources, part, self.exchange.parts);
        self.read_stretches(part, (&form, &columns), stretches, options, control)
    }

    /// Does [`BuildStep::Read`] of a part whose records are in `sources`, which no other part has.
    /// All parts must have the same columns of the same types.
    ///
    /// # Errors
    /// [`BuildError`].
    pub fn read_own(
        &self,
        part: u32,
        sources: Vec<Box<dyn PointSource + '_>>,
        options: &BuildOptions,
        control: &BuildControl<'_>,
    ) -> Result<(), BuildError> {
        self.check_part(part)?;
        check_options(options, &sources)?;
        let (form, columns) = Form::choose(options, &sources)?;
        let stretches = sources.into_iter().enumerate().map(Stretch::whole).collect();
        self.read_stretches(part, (&form, &columns), stretches, options, control)
    }

    fn read_stretches(
        &self,
        part: u32,
        (form, columns): (&Form, &super::columns::Columns),
        stretches: Vec<Stretch<'_>>,
        options: &BuildOptions,
        control: &BuildControl<'_>,
    ) -> Result<(), BuildError> {
        self.exchange.create()?;
        if !self.request.is_empty()
            && let Some(found) = self.exchange.read(BuildStep::Read, part)?
        {
            return job::check_request(&found, &self.request);
        }
        let data = self.exchange.create_data(BuildStep::Read, part)?;
        let place = BuildPlace::Disk { output: &data.destination, temp_dir: self.exchange.folder.clone() };
        let context = Context { place, options, control };
        let mut output = std::io::BufWriter::with_capacity(1 << 20, data.writer_at(0)?);
        let totals = ingest::read(&context, columns, stretches, |record| {
            std::io::Write::write_all(&mut output, record).map_err(|e| data.failed(e))
        })?;
        std::io::Write::flush(&mut output).map_err(|e| data.failed(e))?;
        drop(output);
        let payload = serde_json::to_vec(&Summary::new(options, form, &totals));
        let payload = payload.map_err(|e| data.failed(e.into()))?;
        let _ = std::fs::remove_file(self.exchange.part_path(BuildStep::Read, part));
        data.publish()?;
        let data_bytes = Some(totals.count * form.layout.stride() as u64);
        let head = Head { request: self.request.clone(), data_bytes, ..Head::default() };
        self.exchange.write(BuildStep::Read, part, head, &payload)
    }

    /// Does a step of a part, other than [`BuildStep::Read`]; one that has been done is not done
    /// again. Of `options` only the resources count: memory, threads and the folder of temporary
    /// files.
    ///
    /// # Errors
    /// [`BuildError::MissingParts`] if parts of the step before have not been done; [`BuildError`].
    pub fn run(
        &self,
        step: BuildStep,
        part: u32,
        options: &BuildOptions,
        control: &BuildControl<'_>,
    ) -> Result<(), BuildError> {
        self.check_part(part)?;
        let overview = Overview::load(&self.exchange, &self.request)?;
        let job = Job::new((&self.exchange, step, part), overview, options, control)?;
        let follows = job.overview.survey.follows_curve();
        if (step.is_of_spacing() && !follows) || job.is_done()? {
            return Ok(());
        }
        match step {
            BuildStep::SpacingCount => count(&job, &spacing::curve_sorting(&job.overview.survey)),
            BuildStep::SpacingScatter => scatter(&job, &spacing::curve_sorting(&job.overview.survey)),
            BuildStep::SpacingSort => spacing::sort(&job),
            BuildStep::SpacingMeasure => spacing::measure(&job),
            BuildStep::Count if follows => spacing::count(&job, &octree_sorting(&job)?),
            BuildStep::Count => count(&job, &octree_sorting(&job)?),
            BuildStep::Scatter => scatter(&job, &octree_sorting(&job)?),
            BuildStep::Order => order(&job),
            _ => Err(BuildError::Option { option: "step", what: format!("`{step}` needs the input") }),
        }
    }

    /// Merges the parts of the last step to a cloud file at `output`. Of `options` only the
    /// resources count.
    ///
    /// # Errors
    /// [`BuildError`]; an existing file at `output` is then unchanged.
    pub fn merge(
        &self,
        output: &Path,
        options: &BuildOptions,
        control: &BuildControl<'_>,
    ) -> Result<BuildReport, BuildError> {
        let started = std::time::Instant::now();
        let destination = Destination::new(output)?;
        destination.require_file()?;
        let overview = Overview::load(&self.exchange, &self.request)?;
        let job = Job::new((&self.exchange, BuildStep::Order, 1), overview, options, control)?;
        let context = job.context(&destination);
        let file = OutputFile::create(&destination)?;
        remove_leftovers(&context.temp_dir(), &destination);
        let survey = octree_survey(&job)?;
        let mut assembler = Assembler::create(&context, &survey, Output::to_file(file))?;
        replay_all(&job, &context, &survey, &mut assembler)?;
        let (output, header) = assembler.finish(&context, &survey)?;
        context.check()?;
        output.publish()?;
        let times = vec![(Stage::Write, started.elapsed())];
        let remarks = survey.depths.remarks();
        Ok(BuildReport { points: header.points, skipped: survey.skipped, header, times, remarks })
    }

    /// Removes everything that the parts have written, and the folder if nothing else is in it.
    ///
    /// # Errors
    /// [`BuildError::Io`].
    pub fn remove(&self) -> Result<(), BuildError> {
        self.exchange.remove()
    }

    fn check_part(&self, part: u32) -> Result<(), BuildError> {
        let parts = self.exchange.parts;
        if (1..=parts).contains(&part) {
            return Ok(());
        }
        Err(BuildError::Option { option: "part", what: format!("{part} is not a number from 1 to {parts}") })
    }
}

/// What is known of all records when they are put into the order of the octree.
fn octree_survey(job: &Job<'_>) -> Result<Survey, BuildError> {
    let survey = &job.overview.survey;
    if survey.follows_curve() { spacing::settled_survey(job) } else { Ok(survey.clone()) }
}

/// The order of the octree; of records with radii and without copies, if they followed the curve.
fn octree_sorting(job: &Job<'_>) -> Result<Sorting, BuildError> {
    let survey = &job.overview.survey;
    let settled = if survey.follows_curve() { Some(spacing::settled_layout(job)?) } else { None };
    // Copies are merged by the step that counts.
    let records = if job.step == BuildStep::Count { survey.count } else { spacing::points(job)? };
    Ok(Sorting {
        keys: survey.keys(),
        records,
        stride: settled.as_ref().unwrap_or(&survey.layout).stride(),
        stage: Stage::Write,
        count: BuildStep::Count,
        scatter: BuildStep::Scatter,
    })
}

/// The records of a part that are counted or scattered, and the step of whose data they are.
fn records(job: &Job<'_>, sorting: &Sorting) -> Result<(Records, BuildStep), BuildError> {
    if job.step == BuildStep::Scatter && job.overview.survey.follows_curve() {
        return Ok((spacing::settled_records(job, sorting.stride)?, BuildStep::Count));
    }
    let part = job.own(BuildStep::Read)?;
    let (summary, form) = job::summary(&part)?;
    let totals = summary.totals();
    let records = (totals.count, totals.sum.to_words()[0]);
    Ok((Records::of(job, &part, records, form.layout.stride())?, BuildStep::Read))
}

fn count(job: &Job<'_>, sorting: &Sorting) -> Result<(), BuildError> {
    let destination = Destination::new(job.exchange.data_path(job.step, job.part))?;
    let (records, _) = records(job, sorting)?;
    let payload = work::count(job, &job.context(&destination), sorting, &records)?;
    job.publish(None, &payload)
}

fn scatter(job: &Job<'_>, sorting: &Sorting) -> Result<(), BuildError> {
    let data = job.create_data()?;
    let destination = data.destination.clone();
    let (records, source) = records(job, sorting)?;
    let (payload, bytes) = work::scatter(job, &job.context(&destination), sorting, &records, &data)?;
    job.publish(Some((data, bytes)), &payload)?;
    job.exchange.remove_data(source, job.part);
    Ok(())
}

fn order(job: &Job<'_>) -> Result<(), BuildError> {
    let data = job.create_data()?;
    let survey = octree_survey(job)?;
    let destination = data.destination.clone();
    let context = job.context(&destination);
    let packer = Packer::new(&survey, job.options.precision, &job.control.cancel);
    let path = destination.path().to_owned();
    let failed = move |source| BuildError::Io { action: "write", path: path.clone(), source };
    let mut frames = FrameWriter::new(data.writer_at(0)?, failed);
    work::order(job, &context, &octree_sorting(job)?, &packer, &mut frames)?;
    let bytes = frames.finish()?;
    job.publish(Some((data, bytes)), &[])
}

/// Hands the pieces of all parts to the assembler.
fn replay_all(
    job: &Job<'_>,
    context: &Context<'_>,
    survey: &Survey,
    assembler: &mut Assembler,
) -> Result<(), BuildError> {
    let (mut is_open, mut done) = (0, 0);
    job.all(BuildStep::Order, |part| {
        let input = job.exchange.open_data(&part)?.take(u64::MAX);
        let path = part.path.with_extension("data");
        let between = |points: u64| {
            done += points;
            context.progress(Stage::Write, done, survey.count);
            context.check()
        };
        frames::replay(input, survey.column_layout(), &mut is_open, assembler, between).map_err(|error| {
            match error {
                FrameError::Io(source) => BuildError::Io { action: "read", path, source },
                FrameError::Damaged(at) => {
                    let what = format!("it is damaged at byte {at}; run step `order` of that part again");
                    BuildError::Part { path, what }
                }
                FrameError::Receiver(error) => error,
            }
        })
    })?;
    if is_open > 0 || done != survey.count {
        let what = format!("the parts of `order` have {done} points, where there are {}", survey.count);
        return Err(BuildError::Part { path: job.exchange.folder.clone(), what });
    }
    Ok(())
}

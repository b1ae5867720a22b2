//! A step of a part, under way: what it knows of the whole build, and the files that it reads and
//! writes.

use super::super::context::{BuildPlace, Context};
use super::super::control::BuildControl;
use super::super::error::BuildError;
use super::super::options::{BuildOptions, check_resources};
use super::super::survey::{Form, Survey, Totals};
use super::exchange::{DataFile, Exchange, Head, Part};
use super::step::BuildStep;
use super::summary::{Choices, Summary};
use rayset_store::container::{Metadata, StreamHash};
use rayset_store::output::Destination;

/// What all parts of `read` say together.
pub(super) struct Overview {
    /// What they are, which every later part states.
    pub(super) run: String,
    pub(super) request: String,
    pub(super) survey: Survey,
    pub(super) choices: Choices,
    /// The smallest memory of a part, and the largest number of threads: records are divided so
    /// that any part can hold its own.
    pub(super) memory_bytes: u64,
    pub(super) threads: usize,
}

/// What has been gathered of the first parts of `read`.
struct Gathered {
    hash: StreamHash,
    request: String,
    form: Form,
    totals: Totals,
    choices: Choices,
    memory_bytes: u64,
    threads: usize,
}

impl Overview {
    /// Reads what all parts of `read` say. `request` is what the caller says of inputs and options;
    /// an empty one is not compared.
    pub(super) fn load(exchange: &Exchange, request: &str) -> Result<Self, BuildError> {
        let mut gathered: Option<Gathered> = None;
        exchange.read_all(BuildStep::Read, |part| {
            check_request(&part, request)?;
            gather(&mut gathered, &part)
        })?;
        // There is at least one part.
        let gathered = gathered.ok_or(BuildError::NoInput)?;
        gathered.totals.refuse_unusable(&gathered.choices.with_resources(&BuildOptions::default()))?;
        Ok(Self {
            run: gathered.hash.identity().to_string(),
            request: gathered.request,
            survey: Survey::new(&gathered.form, &gathered.totals),
            choices: gathered.choices,
            memory_bytes: gathered.memory_bytes,
            threads: gathered.threads,
        })
    }
}

/// An error if a part is of another build than the one that is asked for.
pub(super) fn check_request(part: &Part, request: &str) -> Result<(), BuildError> {
    if request.is_empty() || part.head.request == request {
        return Ok(());
    }
    Err(part
        .wrong("it is of a build of other inputs or with other options; remove its folder, or name another"))
}

/// The summary of a part of `read`.
pub(super) fn summary(part: &Part) -> Result<(Summary, Form), BuildError> {
    let summary: Summary =
        serde_json::from_slice(&part.payload).map_err(|e| part.wrong(format!("its summary: {e}")))?;
    let form = summary.form().ok_or_else(|| part.wrong("its summary names a type that is unknown"))?;
    Ok((summary, form))
}

fn gather(gathered: &mut Option<Gathered>, part: &Part) -> Result<(), BuildError> {
    let (summary, form) = summary(part)?;
    let Some(all) = gathered else {
        let mut hash = StreamHash::new(&format!("{} parts", part.head.parts));
        hash.update(&part.payload);
        *gathered = Some(Gathered {
            hash,
            request: part.head.request.clone(),
            form,
            totals: summary.totals(),
            choices: summary.choices,
            memory_bytes: summary.memory_bytes,
            threads: summary.threads,
        });
        return Ok(());
    };
    let metadata = merged(&all.form.metadata, &form.metadata);
    // Parts that read sources of their own know of no splats among the others'.
    let weights_add = all.form.weights_add && form.weights_add;
    let own = (all.form.metadata.clone(), all.form.weights_add);
    let alike = Form { metadata: own.0, weights_add: own.1, ..form } == all.form;
    if !alike || summary.choices != all.choices || part.head.request != all.request {
        let what = "its inputs have other columns than those of part 1, or it was read with other options";
        return Err(part.wrong(format!("{what}; remove its folder and begin again")));
    }
    all.hash.update(&part.payload);
    all.form.metadata = metadata;
    all.form.weights_add = weights_add;
    all.totals.merge(&summary.totals());
    all.memory_bytes = all.memory_bytes.min(summary.memory_bytes);
    all.threads = all.threads.max(summary.threads);
    Ok(())
}

/// The description of the sources of both.
fn merged(a: &Metadata, b: &Metadata) -> Metadata {
    let crs = if a.crs == b.crs { a.crs.as_str() } else { "" };
    let sources = a.sources.iter().chain(&b.sources).cloned().collect();
    let up = a.up.filter(|_| a.up == b.up);
    let step = Metadata::common_step(a.step, b.step);
    Metadata { up, step, ..Metadata::new(crs, sources) }
}

/// A step of a part, under way.
pub(super) struct Job<'a> {
    pub(super) exchange: &'a Exchange,
    pub(super) step: BuildStep,
    pub(super) part: u32,
    pub(super) overview: Overview,
    pub(super) options: BuildOptions,
    pub(super) control: &'a BuildControl<'a>,
}

impl<'a> Job<'a> {
    pub(super) fn new(
        (exchange, step, part): (&'a Exchange, BuildStep, u32),
        overview: Overview,
        resources: &BuildOptions,
        control: &'a BuildControl<'a>,
    ) -> Result<Self, BuildError> {
        check_resources(resources, overview.memory_bytes)?;
        let options = overview.choices.with_resources(resources);
        Ok(Self { exchange, step, part, overview, options, control })
    }

    /// The context of work whose temporary files belong to `output`.
    pub(super) fn context<'b>(&'b self, output: &'b Destination) -> Context<'b> {
        let temp_dir = self.options.temp_dir.clone().unwrap_or_else(|| output.folder().to_owned());
        let place = BuildPlace::Disk { output, temp_dir };
        Context { place, options: &self.options, control: self.control }
    }

    /// Whether this part has been done.
    pub(super) fn is_done(&self) -> Result<bool, BuildError> {
        let found = self.exchange.read(self.step, self.part)?;
        Ok(found.is_some_and(|part| part.head.run == self.overview.run))
    }

    /// All parts of another step.
    pub(super) fn all(
        &self,
        step: BuildStep,
        mut visit: impl FnMut(Part) -> Result<(), BuildError>,
    ) -> Result<(), BuildError> {
        self.exchange.read_all(step, |part| {
            self.check(&part)?;
            visit(part)
        })
    }

    /// This part of another step.
    pub(super) fn own(&self, step: BuildStep) -> Result<Part, BuildError> {
        let missing = || BuildError::MissingParts {
            folder: self.exchange.folder.clone(),
            step,
            parts: self.exchange.parts,
            missing: vec![self.part],
        };
        let part = self.exchange.read(step, self.part)?.ok_or_else(missing)?;
        if step != BuildStep::Read {
            self.check(&part)?;
        }
        Ok(part)
    }

    fn check(&self, part: &Part) -> Result<(), BuildError> {
        if part.head.run == self.overview.run {
            return Ok(());
        }
        Err(part.wrong("it was made of other parts of `read`; run that step again"))
    }

    /// A file for the data of this part, which take the place of those of an earlier run.
    pub(super) fn create_data(&self) -> Result<DataFile, BuildError> {
        self.exchange.create_data(self.step, self.part)
    }

    /// Gives data and part their names, in this order.
    pub(super) fn publish(&self, data: Option<(DataFile, u64)>, payload: &[u8]) -> Result<(), BuildError> {
        let data_bytes = data.as_ref().map(|(_, bytes)| *bytes);
        if let Some((data, _)) = data {
            // Of two runs of the same step of the same part, the head of one must not stand beside
            // the data of the other.
            let _ = std::fs::remove_file(self.exchange.part_path(self.step, self.part));
            data.publish()?;
        }
        let head = Head {
            request: self.overview.request.clone(),
            run: self.overview.run.clone(),
            data_bytes,
            ..Head::default()
        };
        self.exchange.write(self.step, self.part, head, payload)
    }
}

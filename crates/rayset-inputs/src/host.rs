//! Who asks for an input.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use anyhow::Result;
use rayset::CancelToken;
use rayset::build::{Progress, Stage};

/// The program or package that asks for an input: it hears what there is to say, and looks after
/// what is not finished.
pub trait Host: Sync {
    /// Something that a person should know.
    fn remark(&self, text: &str);

    /// What was done, from which nothing follows for what is seen: where an input is kept. A
    /// remark, unless the host has a place for it.
    fn note(&self, text: &str) {
        self.remark(text);
    }

    /// How far a build is: what is counted, what is being done, how much of it is done, and how
    /// much there is.
    fn progress(&self, unit: &'static str, doing: &'static str, done: u64, total: u64);

    /// What a build asks whether it is still wanted.
    fn cancel(&self) -> CancelToken {
        CancelToken::new()
    }

    /// A folder for what is not to be kept, which is removed when the value is dropped.
    ///
    /// # Errors
    /// If it cannot be made.
    fn temporary_folder(&self) -> Result<Box<dyn TemporaryFolder>>;

    /// Is told of a file that is about to be written, of what it is made.
    ///
    /// # Errors
    /// If it must not be written.
    fn writes(&self, output: &Path, inputs: &[PathBuf]) -> Result<()>;
}

/// The resources that building may use.
#[derive(Clone, Copy)]
pub struct Resources<'a> {
    /// Most bytes that a build allocates.
    pub memory: u64,
    /// As many as there are processors if `None`.
    pub threads: Option<usize>,
    /// Who asks.
    pub host: &'a dyn Host,
}

/// A folder that is removed when this is dropped.
pub trait TemporaryFolder: Send + Sync {
    /// Where it is.
    fn path(&self) -> &Path;
}

/// A host that remembers what it was told, so that it can be said again when what was built is used
/// again.
pub(crate) struct Remembering<'a> {
    host: &'a dyn Host,
    remarks: Mutex<Vec<String>>,
}

impl<'a> Remembering<'a> {
    pub(crate) fn of(host: &'a dyn Host) -> Self {
        Self { host, remarks: Mutex::default() }
    }

    fn remarks(&self) -> MutexGuard<'_, Vec<String>> {
        self.remarks.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Forgets what was said so far.
    pub(crate) fn forget(&self) {
        self.remarks().clear();
    }

    /// What was said.
    pub(crate) fn into_inner(self) -> Vec<String> {
        self.remarks.into_inner().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Host for Remembering<'_> {
    fn remark(&self, text: &str) {
        self.remarks().push(text.to_owned());
        self.host.remark(text);
    }

    fn note(&self, text: &str) {
        self.host.note(text);
    }

    fn progress(&self, unit: &'static str, doing: &'static str, done: u64, total: u64) {
        self.host.progress(unit, doing, done, total);
    }

    fn cancel(&self) -> CancelToken {
        self.host.cancel()
    }

    fn temporary_folder(&self) -> Result<Box<dyn TemporaryFolder>> {
        self.host.temporary_folder()
    }

    fn writes(&self, output: &Path, inputs: &[PathBuf]) -> Result<()> {
        self.host.writes(output, inputs)
    }
}

/// The progress of a build, as hosts are told of it.
pub(crate) struct Reported<'a> {
    pub(crate) host: &'a dyn Host,
    pub(crate) unit: &'static str,
}

impl Progress for Reported<'_> {
    fn update(&self, stage: Stage, done: u64, total: u64) {
        self.host.progress(self.unit, stage_name(stage), done, total);
    }
}

/// What is done in a stage of a build, in a word.
#[must_use]
pub fn stage_name(stage: Stage) -> &'static str {
    match stage {
        Stage::Read => "reading",
        Stage::Spacing => "spacing",
        Stage::Write => "writing",
        Stage::Aggregate => "aggregating",
        _ => "building",
    }
}

//! The state that all stages of a build share.

use std::io;
use std::path::PathBuf;

use super::control::{BuildControl, Stage};
use super::error::BuildError;
use super::options::BuildOptions;
use rayset_store::output::Destination;
use rayset_store::spill::Spill;

/// The state that all stages of a build share.
pub(super) struct Context<'a> {
    pub(super) place: BuildPlace<'a>,
    pub(super) options: &'a BuildOptions,
    pub(super) control: &'a BuildControl<'a>,
}

/// Where the cloud is built, and where records are stored temporarily.
pub(super) enum BuildPlace<'a> {
    Disk { output: &'a Destination, temp_dir: PathBuf },
    Memory,
}

impl Context<'_> {
    /// The folder of temporary files.
    pub(super) fn temp_dir(&self) -> PathBuf {
        match &self.place {
            BuildPlace::Disk { temp_dir, .. } => temp_dir.clone(),
            BuildPlace::Memory => "memory".into(),
        }
    }

    pub(super) fn io(&self, action: &'static str) -> impl Fn(io::Error) -> BuildError + use<'_> {
        move |source| BuildError::Io { action, path: self.temp_dir(), source }
    }

    pub(super) fn spill(&self) -> Result<Spill, BuildError> {
        match &self.place {
            BuildPlace::Disk { output, temp_dir } => {
                Spill::create(output, temp_dir).map_err(self.io("create a temporary file in"))
            }
            BuildPlace::Memory => Ok(Spill::in_memory()),
        }
    }

    pub(super) fn is_cancelled(&self) -> bool {
        self.control.cancel.is_cancelled()
    }

    /// An error if the build is cancelled. Called every few thousand records.
    pub(super) fn check(&self) -> Result<(), BuildError> {
        if self.is_cancelled() { Err(BuildError::Cancelled) } else { Ok(()) }
    }

    pub(super) fn progress(&self, stage: Stage, done: u64, total: u64) {
        self.control.progress.update(stage, done, total);
    }
}

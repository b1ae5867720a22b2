//! The memory that a command may use; budgets that are too small, said with the options that help.

use std::path::Path;

use rayset::build::{self, GridBuildError};
use rayset::storage::address_of;

use rayset_terminal::memory::PROCESS_BYTES;
use rayset_terminal::report;

/// Memory for the whole process, and what the process takes of it besides the work.
#[derive(Clone, Copy)]
pub(crate) struct Budget {
    memory: u64,
    process_bytes: u64,
}

impl Budget {
    /// For work on some files: where one of them is at an address, requests take their part.
    pub(crate) fn of<P: AsRef<Path>>(memory: u64, files: impl IntoIterator<Item = P>) -> Self {
        let remote = files.into_iter().any(|file| address_of(file.as_ref()).is_some());
        Self { memory, process_bytes: PROCESS_BYTES + if remote { rayset_remote::REQUESTS_BYTES } else { 0 } }
    }

    /// For work on files on a disk.
    pub(crate) fn near(memory: u64) -> Self {
        Self { memory, process_bytes: PROCESS_BYTES }
    }

    /// What is left for the work.
    pub(crate) fn left(self) -> u64 {
        self.memory.saturating_sub(self.process_bytes)
    }

    /// The budget, in words.
    pub(crate) fn in_words(self) -> String {
        report::bytes(self.memory)
    }

    /// The budget that leaves so much.
    pub(crate) fn leaving(self, bytes: u64) -> u64 {
        bytes + self.process_bytes
    }
}

/// As [`name_smallest_budget`], for a volume.
pub(crate) fn name_smallest_grid_budget(error: GridBuildError, budget: Budget) -> anyhow::Error {
    match error {
        GridBuildError::Memory { needed, .. } => anyhow::anyhow!(
            "--memory {} is too small; the smallest that would do is {} bytes",
            budget.in_words(),
            budget.leaving(needed)
        ),
        other => other.into(),
    }
}

/// The library is given the budget less the memory of the process itself; its error must state the
/// whole budget.
pub(crate) fn name_smallest_budget(error: build::BuildError, budget: Budget) -> anyhow::Error {
    match error {
        build::BuildError::Memory { needed, .. } => {
            let needed = budget.leaving(needed);
            anyhow::anyhow!(
                "--memory {} is too small; the smallest that would do is {needed} bytes ({})",
                budget.in_words(),
                report::bytes(needed)
            )
        }
        build::BuildError::OutOfRange { quantity, count, records, farthest, factor } => {
            let option = quantity.option().replace('_', "-");
            let scale = factor.map_or_else(String::new, |factor| format!("--{option} {factor:e}, or "));
            anyhow::anyhow!(
                "{count} of {records} records have {quantity} {farthest:e}, which cannot be stored; say {scale}--invalid \
                 skip-all if these stand for missing values"
            )
        }
        other => other.into(),
    }
}

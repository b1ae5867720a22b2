//! Budgets that are too small, said with the options that help.

use rayset::build::{self, GridBuildError};

use crate::memory::PROCESS_BYTES;
use crate::report;

/// As [`name_smallest_budget`], for a volume.
pub(crate) fn name_smallest_grid_budget(error: GridBuildError, memory: u64) -> anyhow::Error {
    match error {
        GridBuildError::Memory { needed, .. } => anyhow::anyhow!(
            "--memory {} is too small; the smallest that would do is {} bytes",
            report::bytes(memory),
            needed + PROCESS_BYTES
        ),
        other => other.into(),
    }
}

/// The library is given the budget less the memory of the process itself; its error must state the whole budget.
pub(crate) fn name_smallest_budget(error: build::BuildError, memory: u64) -> anyhow::Error {
    match error {
        build::BuildError::Memory { needed, .. } => {
            let needed = needed + PROCESS_BYTES;
            anyhow::anyhow!(
                "--memory {} is too small; the smallest that would do is {needed} bytes ({})",
                report::bytes(memory),
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

//! Why a build fails, and counts of the records that it skips.

use std::io;
use std::path::PathBuf;

#[cfg(feature = "parts")]
use super::parts::step::BuildStep;
use crate::points::ReadError;
use rayset_store::container::OpenError;
use rayset_store::output::OutputError;
use rayset_store::storage::shown;

/// A kind of number that is out of range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
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
    pub(super) const ALL: [Self; 4] = [Self::Position, Self::Radius, Self::SmallRadius, Self::Weight];

    /// The option that can bring it into range.
    #[must_use]
    pub fn option(self) -> &'static str {
        match self {
            Self::Position | Self::Radius | Self::SmallRadius => "length_scale",
            Self::Weight => "weight_scale",
        }
    }

    /// A better value of the option than `present`: a power of ten that brings `farthest` well into
    /// range. `None` if there is none.
    pub(super) fn factor(self, farthest: f64, present: f64) -> Option<f64> {
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

/// Invalid records that were counted and skipped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(not(feature = "internals"), non_exhaustive)]
pub struct Skipped {
    /// Records whose position is not finite or is too large.
    pub position: u64,
    /// Records whose radius is not a positive number in range, or whose semi-axes and rotation are
    /// of no ellipsoid.
    pub radius: u64,
    /// Records whose weight is not finite or is too large, or of whose colours coefficients are not
    /// finite.
    pub weight: u64,
}

impl Skipped {
    /// The number of all skipped records.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.position + self.radius + self.weight
    }
}

/// The first few of some numbers.
#[cfg(feature = "parts")]
fn list(numbers: &[u32]) -> String {
    const MOST: usize = 12;
    let named: Vec<String> = numbers.iter().take(MOST).map(u32::to_string).collect();
    let more = if numbers.len() > MOST { " …" } else { "" };
    format!("{}{more}", named.join(", "))
}

/// Why a build failed. An existing file at the path of the output is unchanged, and no other is
/// left there.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BuildError {
    /// The input could not be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// A temporary file could not be written or read.
    #[error("cannot {action} {}: {source}", shown(path))]
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
    /// A source returned a batch that does not match the selected columns, which is a defect of the
    /// source.
    #[error(
        "input {input} handed out a batch of {columns} columns where {selected} were selected, or of columns that are not \
         as long as its positions"
    )]
    Source {
        /// The number of the input, from 1.
        input: usize,
        /// Number of columns of the batch.
        columns: usize,
        /// Number of columns that were selected.
        selected: usize,
    },
    /// No input was given.
    #[error("no input files")]
    NoInput,
    /// A named column is missing.
    #[error("input {input} has no column `{name}`; it has: {available}")]
    NoSuchColumn {
        /// The number of the input, from 1.
        input: usize,
        /// The requested name.
        name: String,
        /// The columns that the input has.
        available: String,
    },
    /// An option is out of range.
    #[error("{option}: {what}")]
    Option {
        /// The option.
        option: &'static str,
        /// What is wrong with its value, and what is expected.
        what: String,
    },
    /// An invalid record, under [`InvalidPolicy::Reject`](super::InvalidPolicy::Reject).
    #[error("record {index} of input {input}: {what}")]
    InvalidRecord {
        /// The number of the input, from 1.
        input: usize,
        /// The number of the record in the input, from 0.
        index: u64,
        /// What is wrong.
        what: String,
    },
    /// Numbers are finite but out of the range that can be stored.
    #[error(
        "{count} of {records} records have {quantity} {farthest:e}, which cannot be stored: {}skip them if they stand \
         for missing values", factor.map_or(String::new(), |factor| format!("set {} to {factor:e}, or ", quantity.option()))
    )]
    OutOfRange {
        /// The kind of the numbers.
        quantity: Quantity,
        /// Number of records concerned.
        count: u64,
        /// Number of records of the whole input.
        records: u64,
        /// The value farthest out of range.
        farthest: f64,
        /// A value for [`Quantity::option`] that brings them into range; `None` if there is none.
        factor: Option<f64>,
    },
    /// No record of the input is valid.
    #[error(
        "none of the {records} records is valid: {} have no usable position, {} no positive radius, {} no finite \
         weight", skipped.position, skipped.radius, skipped.weight
    )]
    NothingValid {
        /// Number of records of the whole input.
        records: u64,
        /// The records by reason.
        skipped: Skipped,
    },
    /// The cloud built in memory cannot be opened, which is a defect of the builder.
    #[error(transparent)]
    Open(OpenError),
    /// A file of a part of a build cannot be used.
    #[cfg(feature = "parts")]
    #[error("cannot use {}: {what}", shown(path))]
    Part {
        /// The file.
        path: PathBuf,
        /// What is wrong with it, and what can be done.
        what: String,
    },
    /// Parts of a step, which the next one needs, have not been done.
    #[cfg(feature = "parts")]
    #[error(
        "{} {} of {parts} of step `{step}` {} not been done, or not in {}",
        if missing.len() == 1 { "part" } else { "parts" }, list(missing), if missing.len() == 1 { "has" } else { "have" },
        shown(folder)
    )]
    MissingParts {
        /// The folder of the parts.
        folder: PathBuf,
        /// The step.
        step: BuildStep,
        /// Number of all parts.
        parts: u32,
        /// The numbers of those that are missing, from 1.
        missing: Vec<u32>,
    },
    /// The build was cancelled.
    #[error("cancelled")]
    Cancelled,
    /// The memory budget is too small.
    #[error("a memory budget of {given} bytes is too small: this build needs at least {needed}")]
    Memory {
        /// The budget in bytes.
        given: u64,
        /// The smallest sufficient budget in bytes.
        needed: u64,
    },
}

//! Why a build fails, and what of its input it counts.

use std::io;
use std::path::PathBuf;

use crate::container::OpenError;
use crate::output::OutputError;
use crate::points::ReadError;

/// A number that is out of range.
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

    /// The option that would bring it into range.
    #[must_use]
    pub fn option(self) -> &'static str {
        match self {
            Self::Position | Self::Radius | Self::SmallRadius => "length_scale",
            Self::Weight => "weight_scale",
        }
    }

    /// What the option should be instead of `present`: a power of ten that brings `farthest` well into range. `None` if
    /// no number does.
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
    /// An invalid record, under [`InvalidPolicy::Reject`](super::InvalidPolicy::Reject).
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
        /// What [`Quantity::option`] should be to bring them into range; `None` if no number does.
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

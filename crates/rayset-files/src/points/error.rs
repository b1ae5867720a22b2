//! Why points cannot be read, and where.

use std::path::{Path, PathBuf};
use std::{fmt, io};

use rayset_store::storage::shown;

/// A position in a file, for messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// One-based line of a text file.
    Line(u64),
    /// Byte offset from the start of the file.
    Byte(u64),
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Line(n) => write!(f, "line {n}"),
            Self::Byte(n) => write!(f, "byte {n}"),
        }
    }
}

/// Why points could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReadError {
    /// The operating system refused.
    #[error("cannot read {}: {source}", shown(path))]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        r#source: io::Error,
    },
    /// The file breaks the rules of its own format.
    #[error("{}, {place}: {what}", shown(path))]
    Malformed {
        /// The file.
        path: PathBuf,
        /// The place in the file.
        place: Place,
        /// What was found and what was expected.
        what: String,
    },
    /// Points of a LAS or LAZ file could not be decoded.
    #[error("{}, byte {byte}: {what}; {read} of {count} points could be read", shown(path))]
    Las {
        /// The file.
        path: PathBuf,
        /// Byte offset in the file, near the damage.
        byte: u64,
        /// What is wrong.
        what: String,
        /// Number of points before the damage.
        read: u64,
        /// Number of points that the header claims.
        count: u64,
    },
    /// Reading was cancelled by the token that the source [watches](super::PointSource::watch).
    #[error("cancelled")]
    Cancelled,
    /// This build of the library cannot read the format.
    #[error("{}: this build cannot read such files; compile it with the feature `{feature}`", shown(path))]
    NotCompiled {
        /// The file.
        path: PathBuf,
        /// The cargo feature that is needed.
        feature: &'static str,
    },
    /// The file is of no format that can be read.
    #[error("{}: {advice}", shown(path))]
    UnknownFormat {
        /// The file.
        path: PathBuf,
        /// What it is, as far as that can be seen, and what makes a file that opens.
        advice: String,
    },
}

impl ReadError {
    /// What the system says of a file, as an error in reading it.
    #[doc(hidden)]
    pub fn io(path: &Path) -> impl Fn(io::Error) -> Self + Copy + '_ {
        |source| Self::Io { path: path.to_owned(), source }
    }

    /// What is wrong at a place of a file.
    #[doc(hidden)]
    pub fn malformed(path: &Path, place: Place, what: impl Into<String>) -> Self {
        Self::Malformed { path: path.to_owned(), place, what: what.into() }
    }
}

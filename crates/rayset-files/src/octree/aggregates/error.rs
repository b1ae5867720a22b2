//! Why aggregates cannot be made.

use std::io;
use std::path::{Path, PathBuf};

use rayset_store::container::{OpenError, PageError, ScanError};
use rayset_store::output::OutputError;
use rayset_store::storage::shown;
use rayset_store::working_set::PageFault;

/// Why aggregates cannot be made. An existing file at the path of the output is unchanged.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AggregateError {
    /// The file cannot be opened.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// A page cannot be read, or is damaged.
    #[error(transparent)]
    Scan(#[from] ScanError),
    /// The same, of a page that was read for many uses.
    #[error(transparent)]
    Page(PageFault),
    /// The output cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// A file cannot be read or written.
    #[error("cannot {action}{}: {source}", path.as_ref().map_or(String::new(), |path| format!(" {}", shown(path))))]
    Io {
        /// What was attempted.
        action: &'static str,
        /// The file; `None` if it is a temporary one.
        path: Option<PathBuf>,
        /// The system's reason.
        r#source: io::Error,
    },
    /// Points for which there are no aggregates.
    #[error("{}: {what}", shown(path))]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// What they are, and what there is instead.
        what: &'static str,
    },
    /// Too little memory.
    #[error("{given} bytes of memory are too few; {needed} are needed")]
    Memory {
        /// The memory that was given, in bytes.
        given: u64,
        /// What is needed.
        needed: u64,
    },
    /// An aggregate of a file is not what its points make.
    #[error("aggregate {number}, of level {level}, is not what its points make")]
    Differs {
        /// The number of the record.
        number: u32,
        /// The level of its cell.
        level: u8,
    },
    /// The hash of a file's aggregates is another than it says.
    #[error("the hash of the aggregates is not the one that the file says")]
    Hash,
    /// It was cancelled.
    #[error("cancelled")]
    Cancelled,
}

impl From<PageFault> for AggregateError {
    fn from(fault: PageFault) -> Self {
        if matches!(fault, PageFault::Cancelled) { Self::Cancelled } else { Self::Page(fault) }
    }
}

impl AggregateError {
    /// The error for a page that is intact but contradicts another page.
    pub(super) fn broken(path: PathBuf, page: u32, offset: u64) -> Self {
        let source = PageError::Content { what: "nodes that are no tree" };
        Self::Scan(ScanError::Damaged { path, page, offset, source })
    }

    /// That of more cells than there are numbers.
    pub(super) fn too_many(path: &Path) -> Self {
        let what = "more than 4294967295 aggregates; make them of cells of more points";
        Self::Unsupported { path: path.to_owned(), what }
    }

    /// That of a temporary file.
    pub(super) fn temporary(action: &'static str) -> impl Fn(io::Error) -> Self {
        move |source| Self::Io { action, path: None, source }
    }
}

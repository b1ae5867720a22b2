//! Outputs: files that have their name only when they are whole.
//!
//! [`Destination::new`] looks at a path before any work begins: links are followed to the file that is to be replaced,
//! folders and disks are refused, devices and pipes are told from files. An [`OutputFile`] then grows beside its name, in a
//! partial file of its own, and [`publish`](OutputFile::publish) renames it, so that of several runs with one output the
//! last to finish wins, whole.
//!
//! A partial file is locked as long as it is being written. One that is not was left by a process that was killed: whoever
//! writes to the same destination next removes it.

mod destination;
mod partial;
mod writer;

use std::io;
use std::path::{Path, PathBuf};

pub use self::destination::Destination;
pub(crate) use self::partial::{Purpose, create_unique, remove_leftovers};
pub use self::writer::{OutputFile, OutputWriter};

/// Why an output cannot be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OutputError {
    /// The operating system refused.
    #[error("cannot {action} {}: {source}", path.display())]
    Io {
        /// What was attempted.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// The system's reason.
        r#source: io::Error,
    },
    /// The path ends in no name.
    #[error("`{}` is no name of a file", path.display())]
    NoName {
        /// The path.
        path: PathBuf,
    },
    /// The folder is missing.
    #[error("cannot write {}: there is no folder {}", path.display(), folder.display())]
    NoFolder {
        /// The output.
        path: PathBuf,
        /// What should have been a folder.
        folder: PathBuf,
    },
    /// The path names something that is not to be replaced by a file, nor written to.
    #[error("{} is {what}; {expected}", path.display())]
    NotAFile {
        /// The path.
        path: PathBuf,
        /// What it is.
        what: &'static str,
        /// What would do.
        expected: &'static str,
    },
    /// The output is the input.
    #[error("{} is an input of this run{}; name another file to write", path.display(), named(path, input))]
    IsInput {
        /// The output.
        path: PathBuf,
        /// The input, as it was named.
        input: PathBuf,
    },
}

/// How the input is called, where it is another name.
fn named(output: &Path, input: &Path) -> String {
    if output == input { String::new() } else { format!(", called {}", input.display()) }
}

//! Outputs: files that get their names only once they are complete.
//!
//! [`Destination::new`] examines a path before any work begins: it follows links to the file that
//! is to be replaced, refuses folders and disks, and distinguishes devices and pipes from files. An
//! [`OutputFile`] is then written to a partial file of its own beside the destination, and
//! [`publish`](OutputFile::publish) renames it. If several runs have the same output, the one that
//! finishes last wins, and its file is complete.
//!
//! A partial file is locked while it is being written. One that is not locked was left behind by a
//! process that was killed; the next run that writes to the same destination removes it.

mod destination;
mod partial;
mod writer;

use std::io;
use std::path::{Path, PathBuf};

use crate::storage::shown;

pub use self::destination::Destination;
pub use self::partial::{Access, Purpose, create_unique, remove_leftovers, remove_partials};
pub use self::writer::{OutputFile, OutputWriter};

/// Why an output cannot be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OutputError {
    /// The operating system refused.
    #[error("cannot {action} {}: {source}", shown(path))]
    Io {
        /// What was attempted.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// The system's reason.
        r#source: io::Error,
    },
    /// The path does not end in a file name.
    #[error("`{}` is no name of a file", shown(path))]
    NoName {
        /// The path.
        path: PathBuf,
    },
    /// The folder is missing.
    #[error("cannot write {}: there is no folder {}", shown(path), shown(folder))]
    NoFolder {
        /// The output.
        path: PathBuf,
        /// The path that should be a folder.
        folder: PathBuf,
    },
    /// The path names something that cannot be replaced by a file or written to.
    #[error("{} is {what}; {expected}", shown(path))]
    NotAFile {
        /// The path.
        path: PathBuf,
        /// What it is.
        what: &'static str,
        /// What is expected instead.
        expected: &'static str,
    },
    /// The output is the input.
    #[error("{} is an input of this run{}; name another file to write", shown(path), named(path, input))]
    IsInput {
        /// The output.
        path: PathBuf,
        /// The input, as it was named.
        input: PathBuf,
    },
}

/// The name of the input, if it differs from that of the output.
fn named(output: &Path, input: &Path) -> String {
    if output == input { String::new() } else { format!(", called {}", shown(input)) }
}

//! Why an array, or an archive of arrays, cannot be read.

use std::io;

/// Why an array, or an archive of arrays, cannot be read.
#[derive(Debug)]
pub(crate) enum Fault {
    /// The operating system refused.
    Io(io::Error),
    /// The file breaks the rules of its format.
    Wrong {
        /// The byte of the file.
        at: u64,
        what: String,
    },
}

impl From<io::Error> for Fault {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

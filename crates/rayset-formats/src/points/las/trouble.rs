//! Why compressed points could not be read.

use std::io;

use rayset_store::storage::is_of_reading;

/// Why compressed points could not be read.
#[derive(Debug)]
pub(super) enum Trouble {
    Io(io::Error),
    /// They are invalid, near a byte of the file.
    Damaged {
        byte: u64,
        what: String,
    },
}

impl Trouble {
    pub(super) fn at(byte: u64, what: impl Into<String>) -> Self {
        Self::Damaged { byte, what: what.into() }
    }

    /// Distinguishes errors of reading from errors in the data.
    pub(super) fn from_io(error: io::Error, byte: u64, what: &str) -> Self {
        if is_of_reading(&error) { Self::Io(error) } else { Self::at(byte, what) }
    }
}

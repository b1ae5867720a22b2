//! Why a file of VTK in XML cannot be read.

use std::io::{self, BufReader, Seek, SeekFrom};
use std::path::Path;

use rayset_store::storage::input_file::InputFile;

/// Why a file of VTK in XML cannot be read.
#[derive(Debug)]
pub(crate) enum Fault {
    /// The operating system refused.
    Io(io::Error),
    /// The elements are invalid, or describe something that is not supported.
    Header {
        /// The byte, the element and the attribute.
        place: String,
        what: String,
    },
    /// The numbers of an array end early, or are damaged.
    Data(String),
}

impl From<io::Error> for Fault {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

/// A description of an error in the data that is more specific than the system's.
pub(crate) fn what_of(error: &io::Error) -> String {
    if error.kind() == io::ErrorKind::UnexpectedEof {
        "the file ends before all numbers are there".into()
    } else {
        error.to_string()
    }
}

/// A buffered reader that starts at a byte of a regular file.
pub(super) fn data_at(path: &Path, offset: u64) -> Result<BufReader<InputFile>, Fault> {
    let mut file = InputFile::open(path)?;
    file.seek(SeekFrom::Start(offset))?;
    Ok(BufReader::with_capacity(1 << 16, file))
}

//! Why a picture could not be written.

use std::io;

use rayset_store::output::OutputError;

/// Why a picture could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImageError {
    /// The encoder reported an error.
    #[error("{0}")]
    Encode(String),
    /// The system reported an error.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// The file cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// A band for OpenEXR has no layers, a different width, or too many rows.
    #[error("bands have to come from the top, with their layers")]
    Band,
}

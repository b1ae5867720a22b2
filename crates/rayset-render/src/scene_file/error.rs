//! Errors of scene files, with their places.

use std::path::PathBuf;

use rayset_store::storage::shown;

/// What is wrong with a scene file, and where.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{}:{line}:{column}: {}{what}", shown(file), if key.is_empty() { String::new() } else { format!("{key}: ") })]
#[cfg_attr(not(feature = "internals"), non_exhaustive)]
pub struct SceneFileError {
    /// The file.
    pub file: PathBuf,
    /// Line, counted from 1.
    pub line: usize,
    /// Column, counted from 1 in characters.
    pub column: usize,
    /// Path of the value in the document, for example `root.children[1].radius`; empty for the
    /// document as a whole.
    pub key: String,
    /// What is wrong, what was expected and what to do.
    pub what: String,
}

/// Why a scene could not be loaded.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LoadError {
    /// The file cannot be read.
    #[error("cannot read {}: {source}", shown(path))]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's error.
        r#source: std::io::Error,
    },
    /// The contents of the file are invalid.
    #[error(transparent)]
    Content(#[from] SceneFileError),
}

//! What is wrong with a scene file, and where.

use std::path::PathBuf;

/// What is wrong with a scene file, and where.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{}:{line}:{column}: {}{what}", file.display(), if key.is_empty() { String::new() } else { format!("{key}: ") })]
#[cfg_attr(not(feature = "internals"), non_exhaustive)]
pub struct SceneFileError {
    /// The file.
    pub file: PathBuf,
    /// Line, counted from 1.
    pub line: usize,
    /// Column, counted from 1 in characters.
    pub column: usize,
    /// The way to the value, as `root.children[1].radius`; empty where it is the whole file.
    pub key: String,
    /// What is wrong, what was expected and what to do.
    pub what: String,
}

/// Why there is no scene.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LoadError {
    /// The operating system refused.
    #[error("cannot read {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        r#source: std::io::Error,
    },
    /// Something in the file.
    #[error(transparent)]
    Content(#[from] SceneFileError),
}

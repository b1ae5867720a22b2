//! What is wrong with a style.

/// An option with a value that it does not have, or beside one that excludes it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StyleError {
    /// The option as it was spelt; on the command line without its dashes.
    pub option: String,
    /// What is wrong, and what was expected.
    pub what: String,
}

impl std::fmt::Display for StyleError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: {}", self.option, self.what)
    }
}

impl std::error::Error for StyleError {}

//! The error of reading a style.

/// An invalid value of an option, or an option that another one excludes or requires.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StyleError {
    /// The name of the option, as the caller spelt it.
    pub option: String,
    /// The problem, and the expected value.
    pub what: String,
}

impl std::fmt::Display for StyleError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: {}", self.option, self.what)
    }
}

impl std::error::Error for StyleError {}

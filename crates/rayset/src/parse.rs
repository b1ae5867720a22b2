//! Names and short texts that stand for something: kernels, colour maps, workloads, layouts.

/// A text that stands for nothing of the kind that was expected.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct ParseError {
    given: String,
    message: String,
}

impl ParseError {
    /// What was given, and a sentence that says what was expected.
    pub(crate) fn new(given: &str, message: impl FnOnce(&str) -> String) -> Self {
        Self { given: given.to_owned(), message: message(given) }
    }

    /// The text.
    #[must_use]
    pub fn given(&self) -> &str {
        &self.given
    }
}

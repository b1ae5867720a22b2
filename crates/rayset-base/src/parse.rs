//! Errors of parsing names and short texts: of kernels, colour maps, workloads and layouts.

/// A text that is not a valid value of the expected kind.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct ParseError {
    given: String,
    message: String,
}

impl ParseError {
    /// From the text that was given, and a function that makes the message from it.
    #[doc(hidden)]
    pub fn new(given: &str, message: impl FnOnce(&str) -> String) -> Self {
        Self { given: given.to_owned(), message: message(given) }
    }

    /// The text that was given.
    #[must_use]
    pub fn given(&self) -> &str {
        &self.given
    }
}

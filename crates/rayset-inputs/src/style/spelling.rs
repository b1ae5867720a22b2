//! Spellings of option names.

use std::borrow::Cow;

use super::table::{OPTIONS, StyleOption};

/// A convention for the names of options.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Spelling {
    /// `--radius-scale`, on a command line.
    Dashed,
    /// `radiusScale`, in JSON.
    Camel,
    /// `radius_scale`, in Python.
    Snake,
}

impl Spelling {
    /// Finds an option by its name in this spelling.
    #[must_use]
    pub fn option(self, spelt: &str) -> Option<&'static StyleOption> {
        OPTIONS.iter().find(|option| self.of(option.name) == spelt)
    }

    /// Converts a name from the command line, without dashes in front, to this spelling.
    #[must_use]
    pub fn of(self, name: &str) -> Cow<'_, str> {
        match self {
            Self::Dashed => format!("--{name}").into(),
            Self::Snake => name.replace('-', "_").into(),
            Self::Camel => {
                let mut parts = name.split('-');
                let first = parts.next().unwrap_or_default().to_owned();
                parts
                    .fold(first, |all, part| {
                        let (letter, rest) = part.split_at(part.len().min(1));
                        all + &letter.to_ascii_uppercase() + rest
                    })
                    .into()
            }
        }
    }
}

//! Listing, merging and checking the options of a style.

use super::error::StyleError;
use super::option::Group;
use super::spelling::Spelling;
use super::table::{OPTIONS, Style, StyleOption};

impl Style {
    /// The first option of a group that is set.
    #[must_use]
    pub fn given(&self, group: Group) -> Option<&'static StyleOption> {
        OPTIONS.iter().find(|option| option.group == group && option.is_given(self))
    }

    /// The options of `self`; options that `self` leaves out are taken from `other`.
    #[must_use]
    pub fn or(&self, other: &Self) -> Self {
        let mut both = other.clone();
        OPTIONS.iter().filter(|option| option.is_given(self)).for_each(|option| option.copy(self, &mut both));
        both
    }

    /// Checks that no option excludes another one, and that required options are set.
    ///
    /// # Errors
    /// The first option that breaks a rule.
    pub fn check(&self, spelling: Spelling) -> Result<(), StyleError> {
        for option in OPTIONS.iter().filter(|option| option.is_given(self)) {
            let is_given = |name: &&&str| StyleOption::find(name).is_some_and(|other| other.is_given(self));
            let wrong =
                |what: String| Err(StyleError { option: spelling.of(option.name).into_owned(), what });
            if let Some(other) = option.excludes.iter().find(is_given) {
                return wrong(format!("cannot be used with {}", spelling.of(other)));
            }
            if let Some(other) = option.needs.iter().find(|name| !is_given(name)) {
                return wrong(format!("needs {}", spelling.of(other)));
            }
        }
        Ok(())
    }
}

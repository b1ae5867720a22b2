//! Files of a folder that turn out to be damaged: left out, counted, and named when the others have
//! been read.

use std::fmt::Display;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use rayset::points::ReadError;

/// Most files that are named; the others are counted.
const MOST_NAMED: usize = 5;

/// The files of one cloud without which it can be built, and those without which it was.
#[derive(Default)]
pub struct LeftOut {
    /// Of each source in order, its file and whether the build may go on without it.
    sources: Vec<(PathBuf, bool)>,
    /// What was said of each file that is left out. The error names it.
    found: Mutex<Vec<String>>,
    /// The number of all files.
    files: usize,
}

impl LeftOut {
    pub(crate) fn of(files: usize) -> Self {
        Self { files, ..Self::default() }
    }

    /// The next source, and whether the build may go on without it.
    pub(crate) fn expect(&mut self, path: &Path, may_leave_out: bool) {
        self.sources.push((path.to_owned(), may_leave_out));
    }

    /// Whether an error is damage of the file itself. What else goes wrong, such as a connection
    /// that breaks, may be over when the build is run again, and must not make it another cloud.
    pub(crate) fn is_damage(error: &ReadError) -> bool {
        match error {
            ReadError::Malformed { .. } | ReadError::Las { .. } | ReadError::UnknownFormat { .. } => true,
            ReadError::Io { source, .. } => {
                matches!(source.kind(), ErrorKind::UnexpectedEof | ErrorKind::InvalidData)
            }
            _ => false,
        }
    }

    /// Whether a build goes on without a source, which is then noted.
    pub fn takes(&self, source: usize, error: &ReadError) -> bool {
        let Some((path, true)) = self.sources.get(source) else { return false };
        if Self::is_damage(error) {
            self.note(path, error);
            return true;
        }
        false
    }

    pub(crate) fn note(&self, path: &Path, error: &dyn Display) {
        let (said, name) = (error.to_string(), path.display().to_string());
        let said = if said.contains(&name) { said } else { format!("{name}: {said}") };
        self.found.lock().unwrap_or_else(PoisonError::into_inner).push(said);
    }

    /// What was said of each file that was left out.
    #[must_use]
    pub fn named(&self) -> Vec<String> {
        self.found.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub(crate) fn first(&self) -> Option<String> {
        self.named().into_iter().next()
    }

    /// Whether no file is left.
    #[must_use]
    pub fn is_everything(&self) -> bool {
        let found = self.named().len();
        found > 0 && found == self.files
    }

    /// What to say when all files have been read; `None` if none was left out.
    #[must_use]
    pub fn remark(&self) -> Option<String> {
        let named = self.named();
        let more = named.len().saturating_sub(MOST_NAMED);
        let mut list = named.iter().take(MOST_NAMED).cloned().collect::<Vec<_>>().join("; ");
        if more > 0 {
            list += &format!("; and {more} more");
        }
        (!named.is_empty()).then(|| {
            let (count, files) = (named.len(), self.files);
            format!("left out {count} of {files} files as damaged (--strict stops at the first): {list}")
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn damage_is_left_out_and_a_connection_that_breaks_is_not() {
        let io = |kind: ErrorKind| ReadError::Io { path: "a".into(), source: kind.into() };
        assert!(LeftOut::is_damage(&io(ErrorKind::UnexpectedEof)));
        for kind in [ErrorKind::ConnectionReset, ErrorKind::PermissionDenied, ErrorKind::NotFound] {
            assert!(!LeftOut::is_damage(&io(kind)), "{kind:?}");
        }
        assert!(!LeftOut::is_damage(&ReadError::Cancelled));
    }
}

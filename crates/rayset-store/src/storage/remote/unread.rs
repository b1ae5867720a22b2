//! Errors of reading remote objects, which are told from errors in what has been read.

use std::io;

/// Why a remote object could not be read.
#[derive(Clone, Debug)]
struct Unread(String);

impl std::fmt::Display for Unread {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.fmt(f)
    }
}

impl std::error::Error for Unread {}

/// The error of a remote object that could not be read. Its kind is none of those that readers of
/// formats take to be about the bytes.
pub(super) fn unread(kind: io::ErrorKind, what: String) -> io::Error {
    let kind = match kind {
        io::ErrorKind::UnexpectedEof => io::ErrorKind::ConnectionAborted,
        io::ErrorKind::InvalidData | io::ErrorKind::Interrupted => io::ErrorKind::Other,
        kind => kind,
    };
    io::Error::new(kind, Unread(what))
}

/// Whether something could not be read, whatever its bytes are: the error is the system's, or that
/// of a remote object.
pub fn is_of_reading(error: &io::Error) -> bool {
    error.raw_os_error().is_some() || said(error).is_some()
}

/// A copy of such an error; `None` if it is another.
pub fn copy_of_reading(error: &io::Error) -> Option<io::Error> {
    let system = || error.raw_os_error().map(io::Error::from_raw_os_error);
    said(error).map(|said| io::Error::new(error.kind(), said.clone())).or_else(system)
}

fn said(error: &io::Error) -> Option<&Unread> {
    error.get_ref()?.downcast_ref()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_read_is_not_taken_for_what_is_damaged() {
        let remote = unread(io::ErrorKind::UnexpectedEof, "host: cut".to_owned());
        let system = io::Error::from_raw_os_error(5);
        for error in [&remote, &system] {
            let copy = copy_of_reading(error).expect("it is of reading");
            assert!(is_of_reading(error) && is_of_reading(&copy));
            assert_eq!((copy.kind(), copy.to_string()), (error.kind(), error.to_string()));
        }
        assert_ne!(remote.kind(), io::ErrorKind::UnexpectedEof);
        let damaged = io::Error::new(io::ErrorKind::InvalidData, "a bad byte");
        assert!(!is_of_reading(&damaged) && copy_of_reading(&damaged).is_none());
    }
}

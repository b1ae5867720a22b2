//! Outputs: files that get their names only once they are complete.
//!
//! [`Destination::new`] examines a path before any work begins: it follows links to the file that
//! is to be replaced, refuses folders and disks, and distinguishes devices and pipes from files. An
//! [`OutputFile`] is then written to a partial file of its own beside the destination, and
//! [`publish`](OutputFile::publish) renames it. If several runs have the same output, the one that
//! finishes last wins, and its file is complete.
//!
//! A partial file is locked while it is being written. One that is not locked was left behind by a
//! process that was killed; the next run that writes to the same destination removes it.

#[cfg(feature = "internals")]
#[doc(hidden)]
pub use rayset_store::output::*;
pub use rayset_store::output::{Destination, OutputError, OutputFile, OutputWriter};

//! The outputs of a command, checked before it does anything.

use std::collections::HashSet;
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use rayset::output::{Destination, OutputFile};

use crate::{interrupts, report};

/// The outputs of a command: none of them is one of its inputs or another output, and all are
/// watched for signals.
#[derive(Default)]
pub struct Outputs {
    inputs: Vec<PathBuf>,
    taken: HashSet<PathBuf>,
}

impl Outputs {
    /// For a command that reads `inputs`.
    pub fn beside<P: Into<PathBuf>>(inputs: impl IntoIterator<Item = P>) -> Self {
        Self { inputs: inputs.into_iter().map(Into::into).collect(), taken: HashSet::new() }
    }

    /// Adds an output, with the folder of its temporary files if it differs from its own.
    pub fn add(&mut self, path: &Path, temp_dir: Option<&Path>) -> Result<Destination> {
        let destination = Destination::new(path)?;
        destination.refuse_inputs(&self.inputs)?;
        let place = destination.canonical().with_context(|| format!("cannot write {}", path.display()))?;
        if let Some(place) = place
            && !self.taken.insert(place)
        {
            bail!("{} would be written twice in this run; name another file", path.display());
        }
        if destination.is_stream() && is_standard_output(path) {
            report::leave_standard_output();
        }
        interrupts::watch(&destination, temp_dir);
        Ok(destination)
    }
}

/// Writes a whole file.
pub fn write(to: &Destination, bytes: &[u8]) -> Result<()> {
    let file = OutputFile::create(to)?;
    file.writer().write_all(bytes).with_context(|| format!("cannot write {}", to.path().display()))?;
    Ok(file.publish()?)
}

/// Whether a path leads to standard output, where results are printed.
fn is_standard_output(path: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::fd::AsFd;
        use std::os::unix::fs::MetadataExt;
        let own = std::io::stdout().as_fd().try_clone_to_owned().map(std::fs::File::from);
        let (Ok(path), Ok(own)) = (std::fs::metadata(path), own.and_then(|file| file.metadata())) else {
            return false;
        };
        (path.dev(), path.ino()) == (own.dev(), own.ino())
    }
    #[cfg(not(unix))]
    {
        let _ = path;
        false
    }
}

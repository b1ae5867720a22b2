//! The options of what is built of inputs that have not been built before, and of where it is kept.

use std::path::PathBuf;

use clap::Args;
use rayset_inputs::{Cache, values};

use crate::option_args::{ChoiceArgs, OfInput};

/// Options of what is built of inputs, and of where it is kept.
#[derive(Args, Clone, Default)]
#[command(next_help_heading = "Cache of inputs that were not built before")]
pub(crate) struct InputArgs {
    /// Folder that keeps what is built of points or voxels; the user's folder for caches by default
    #[arg(long, conflicts_with = "no_cache")]
    cache: Option<PathBuf>,
    /// Build into a temporary folder, and keep nothing
    #[arg(long)]
    no_cache: bool,
    /// Most bytes that the cache keeps; 20GiB by default
    #[arg(long, value_parser = values::size)]
    cache_limit: Option<u64>,
    /// Stop at the first damaged file of a folder or pattern, instead of leaving it out and naming
    /// it at the end
    #[arg(long, help_heading = "Folders of files")]
    strict: bool,
    #[command(flatten)]
    choices: ChoiceArgs<OfInput>,
}

impl InputArgs {
    /// What the options say.
    pub(crate) fn cache(&self) -> Cache {
        let Self { cache, no_cache, cache_limit, strict, choices } = self.clone();
        Cache { folder: cache, keeps_nothing: no_cache, limit: cache_limit, strict, choices: choices.0 }
    }
}

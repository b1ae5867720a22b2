//! The arguments of `rayset merge`.

use std::path::PathBuf;

use clap::Args;

use crate::aggregates::AggregateArgs;
use rayset_inputs::values;

/// Join the parts of a picture, which `render --part` wrote, or of a cloud, which `build --part`
/// made, to the very file that one `render` or `build` writes: for that, --lod and --no-lod are
/// given here.
///
/// All parts have to be there, once, and of one picture or cloud; the input need not.
#[derive(Args)]
pub(crate) struct MergeArgs {
    /// The parts of a picture, in any order, or the folder of the parts of a cloud
    #[arg(required = true)]
    pub(super) parts: Vec<PathBuf>,
    /// Picture to write: PNG, or OpenEXR (.exr) if the parts have layers; or the cloud file
    #[arg(short, long)]
    pub(super) output: PathBuf,
    /// Memory for the whole process
    #[arg(long, value_parser = values::size, default_value = "256MiB")]
    pub(crate) memory: u64,
    /// Keep the parts of a cloud, which are removed once the file is whole
    #[arg(long)]
    pub(super) keep: bool,
    #[command(flatten)]
    pub(super) aggregates: AggregateArgs,
    /// Report on a cloud as JSON
    #[arg(long)]
    pub(super) json: bool,
}

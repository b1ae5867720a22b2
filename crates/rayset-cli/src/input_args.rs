//! The options of what is built of inputs that have not been built before, and of where it is kept.

use std::path::PathBuf;

use clap::Args;
use rayset::volumes::RawLayout;
use rayset_inputs::{BuildChoices, Cache, values};

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
    choices: ChoiceArgs,
}

/// Options of what is built of an input; clouds, grids and scenes have been built with theirs.
#[derive(Args, Clone, Default)]
#[command(next_help_heading = "Building of inputs that were not built before")]
struct ChoiceArgs {
    /// Names of the columns of text files, arrays and snapshots in HDF5, as in x,y,z,-,intensity; -
    /// leaves one out
    #[arg(long, value_delimiter = ',', allow_hyphen_values = true)]
    columns: Option<Vec<String>>,
    /// Volume to read of a series of them, as arrays of four dimensions are; the first, 0, by
    /// default
    #[arg(long, value_name = "N")]
    volume_index: Option<u64>,
    /// Types of particles to read of a snapshot, as in gas,stars: gas, dark, disk, bulge, stars,
    /// black-holes or PartType7
    #[arg(long, value_delimiter = ',')]
    particles: Option<Vec<String>>,
    /// Columns to keep, as in intensity,Velocities; `all`, or `none`
    #[arg(long, value_delimiter = ',')]
    attributes: Option<Vec<String>>,
    /// Points to sample on the faces of a mesh
    #[arg(long)]
    mesh_points: Option<u64>,
    /// Radius of influence: a number, a column, or `auto`
    #[arg(long)]
    radius: Option<String>,
    /// Weight: a number or a column
    #[arg(long)]
    weight: Option<String>,
    /// Factor on every coordinate, and on radii of a column
    #[arg(long)]
    length_scale: Option<f64>,
    /// Leave colours out
    #[arg(long)]
    no_color: bool,
    /// The input is nothing but voxels: 256x256x128,u16, then be, skip=512, spacing=1x1x2.5 as need
    /// be
    #[arg(long, value_parser = raw_layout)]
    raw: Option<String>,
}

/// A layout of voxels, as it was written.
fn raw_layout(text: &str) -> Result<String, String> {
    text.parse::<RawLayout>().map(|_| text.to_owned()).map_err(|error| error.to_string())
}

impl InputArgs {
    /// What the options say.
    pub(crate) fn cache(&self) -> Cache {
        let Self { cache, no_cache, cache_limit, strict, choices } = self.clone();
        Cache { folder: cache, keeps_nothing: no_cache, limit: cache_limit, strict, choices: choices.into() }
    }
}

impl From<ChoiceArgs> for BuildChoices {
    fn from(args: ChoiceArgs) -> Self {
        let ChoiceArgs { columns, volume_index, particles, attributes, mesh_points, .. } = args;
        let ChoiceArgs { radius, weight, length_scale, no_color, raw, .. } = args;
        Self {
            columns,
            volume_index,
            particles,
            attributes,
            mesh_points,
            radius,
            weight,
            length_scale,
            no_color,
            raw,
        }
    }
}

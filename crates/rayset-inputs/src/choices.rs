//! How inputs are built that have not been built before: the options of `rayset build` that decide
//! what is seen.

use clap::Args;
use rayset::build::BuildOptions;
use rayset::points::ReadOptions;
use rayset::volumes::RawLayout;

use crate::values;

/// Options of what is built of an input; clouds, grids and scenes have been built with theirs.
#[derive(Args, Clone, Default, Debug)]
#[command(next_help_heading = "Building of inputs that were not built before")]
pub struct BuildChoices {
    /// Names of the columns of text files, arrays and snapshots in HDF5, as in x,y,z,-,intensity; -
    /// leaves one out
    #[arg(long, value_delimiter = ',', allow_hyphen_values = true)]
    pub(crate) columns: Option<Vec<String>>,
    /// Volume to read of a series of them, as arrays of four dimensions are; the first, 0, by
    /// default
    #[arg(long, value_name = "N")]
    pub(crate) volume_index: Option<u64>,
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

impl BuildChoices {
    /// Those that name the columns of text files and of arrays.
    pub(crate) fn of_columns(columns: Option<Vec<String>>) -> Self {
        Self { columns, ..Self::default() }
    }

    /// The first option that was given.
    pub(crate) fn given(&self) -> Option<&'static str> {
        let options = [
            ("--columns", self.columns.is_some()),
            ("--volume-index", self.volume_index.is_some()),
            ("--particles", self.particles.is_some()),
            ("--attributes", self.attributes.is_some()),
            ("--mesh-points", self.mesh_points.is_some()),
            ("--radius", self.radius.is_some()),
            ("--weight", self.weight.is_some()),
            ("--length-scale", self.length_scale.is_some()),
            ("--no-color", self.no_color),
            ("--raw", self.raw.is_some()),
        ];
        options.into_iter().find(|(_, given)| *given).map(|(name, _)| name)
    }

    /// The options as one would type them.
    pub(crate) fn words(&self) -> Vec<String> {
        let list = |names: &Option<Vec<String>>| names.as_ref().map(|names| names.join(","));
        let number = |value: Option<f64>| value.map(|value| value.to_string());
        let texts = [
            ("columns", list(&self.columns)),
            ("volume-index", self.volume_index.map(|index| index.to_string())),
            ("particles", list(&self.particles)),
            ("attributes", list(&self.attributes)),
            ("mesh-points", self.mesh_points.map(|points| points.to_string())),
            ("radius", self.radius.clone()),
            ("weight", self.weight.clone()),
            ("length-scale", number(self.length_scale)),
            ("raw", self.raw.clone()),
        ];
        let with_values = texts.into_iter().filter_map(|(name, text)| Some(format!("--{name}={}", text?)));
        with_values.chain(self.no_color.then(|| "--no-color".to_owned())).collect()
    }

    /// A text that is another for other choices.
    pub(crate) fn key(&self) -> String {
        if self.given().is_some() { format!("{self:?}") } else { "default".to_owned() }
    }

    /// How points are read.
    pub(crate) fn read_options(&self) -> ReadOptions {
        ReadOptions::default()
            .with_text_columns(self.columns.clone())
            .with_mesh_points(self.mesh_points)
            .with_particles(self.particles.clone())
    }

    /// The same build with these choices, besides attributes.
    pub(crate) fn applied(&self, options: BuildOptions) -> anyhow::Result<BuildOptions> {
        let mut options = options.with_keep_color(!self.no_color);
        if let Some(radius) = &self.radius {
            options = options.with_radius(Some(values::rule(radius)?));
        }
        if let Some(weight) = &self.weight {
            options = options.with_weight(Some(values::rule(weight)?));
        }
        Ok(options.with_length_scale(self.length_scale.unwrap_or(1.0)))
    }

    /// The columns that were asked for.
    pub(crate) fn attributes(&self) -> Option<&[String]> {
        self.attributes.as_deref()
    }

    /// The layout of voxels without a header.
    pub(crate) fn raw(&self) -> Option<RawLayout> {
        // It was read when it was given.
        self.raw.as_ref().and_then(|text| text.parse().ok())
    }
}

//! How inputs are built that have not been built before: choices of a build that decide what is
//! seen.

use anyhow::Context;
use rayset::build::BuildOptions;
use rayset::points::ReadOptions;
use rayset::volumes::RawLayout;

use crate::values;

/// What is built of an input; clouds, grids and scenes have been built with theirs. `None` leaves a
/// choice to the input. The cache tells choices by their `Debug` text.
#[derive(Clone, Default, Debug)]
pub struct BuildChoices {
    /// Names of the columns of text files, arrays and snapshots in HDF5; `-` leaves one out.
    pub columns: Option<Vec<String>>,
    /// Volume to read of a series of them.
    pub volume_index: Option<u64>,
    /// Types of particles to read of a snapshot.
    pub particles: Option<Vec<String>>,
    /// Columns to keep; `all`, or `none`.
    pub attributes: Option<Vec<String>>,
    /// Points to sample on the faces of a mesh.
    pub mesh_points: Option<u64>,
    /// Radius of influence: a number, a column, or `auto`.
    pub radius: Option<String>,
    /// Weight: a number or a column.
    pub weight: Option<String>,
    /// Factor on every coordinate, and on radii of a column.
    pub length_scale: Option<f64>,
    /// Whether colours are left out.
    pub no_color: bool,
    /// The layout of an input that is nothing but voxels.
    pub raw: Option<String>,
}

impl BuildChoices {
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
    pub(crate) fn raw(&self) -> anyhow::Result<Option<RawLayout>> {
        let layout = self.raw.as_ref().map(|text| text.parse()).transpose();
        layout.context("the layout of voxels (--raw)")
    }
}

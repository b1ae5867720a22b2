//! How inputs are built that have not been built before: choices of a build that decide what is
//! seen.

use anyhow::Context;
use rayset::build::{BuildOptions, ShapeRule};
use rayset::points::ReadOptions;
use rayset::volumes::RawLayout;

use crate::style::Flag;
use crate::style::kinds::{Checked, Count, Kind, List, POSITIVE, Switch, Text};
use crate::style::option::{OptionOf, Options, options};
use crate::values;

options! {
    /// What is built of an input; clouds, grids and scenes have been built with theirs. `None`
    /// leaves a choice to the input. The cache tells choices by their `Debug` text.
    BuildChoices
    Build {
        /// Names of the columns of text files, arrays and snapshots in HDF5, as in
        /// x,y,z,-,intensity; - leaves one out
        columns: Vec<String> = List { dashes: true };
        /// Volume to read of a series of them, as arrays of four dimensions are; the first, 0, by
        /// default
        volume_index: u64 = Count;
        /// Types of particles to read of a snapshot, as in gas,stars: gas, dark, disk, bulge,
        /// stars, black-holes or PartType7. By default gas where there is any, else all
        particles: Vec<String> = List { dashes: false };
        /// Columns to keep besides positions, radii, weights and colours, as in
        /// intensity,classification or Velocities; `all`, or `none`. By default all that together
        /// take at most 16 bytes a point, vectors whole
        attributes: Vec<String> = List { dashes: false };
        /// Points to sample on the faces of a mesh. By default ten a triangle, 1 to 20 million; of
        /// PLY with 20 000 vertices or more, or with measurements of each, the vertices are the
        /// points
        mesh_points: u64 = Count;
        /// Radius of influence: a number, a column, or `auto` (from the local spacing). By default
        /// the column `radius` where there is one, else auto
        radius: String = Text;
        /// Shapes of points: `auto`, by which points whose radii are measured are discs on
        /// surfaces, across normals if there are any, rods along wires and small balls where they
        /// are scattered; `fluid` for particles of a liquid, which are flat along its surface; or
        /// `round`. By default auto
        shape: String = Checked(shape);
        /// Weight: a number or a column. By default the column `weight` where there is one, else 1
        weight: String = Text;
        /// Factor on every coordinate, and on radii of a column: for data in units that make them
        /// very large or small; 1 by default
        length_scale: f64 = POSITIVE;
        /// Leave colours out
        no_color: Flag = Switch;
        /// The input is nothing but voxels: 256x256x128,u16, then be, skip=512, spacing=1x1x2.5 as
        /// need be
        raw: String = Checked(raw_layout);
    }
}

/// Checks the shapes of points.
fn shape(text: &str) -> Result<(), String> {
    match text {
        "auto" | "round" | "fluid" => Ok(()),
        _ => {
            let text = text.escape_debug();
            Err(format!("`{text}` is no shape of points; expected `auto`, `round` or `fluid`"))
        }
    }
}

/// Checks a layout of voxels.
fn raw_layout(text: &str) -> Result<(), String> {
    text.parse::<RawLayout>().map(drop).map_err(|error| error.to_string())
}

impl BuildChoices {
    /// The first option that was given.
    pub(crate) fn given(&self) -> Option<&'static OptionOf<Self>> {
        Self::TABLE.iter().find(|option| option.is_given(self))
    }

    /// A text that is another for other choices.
    pub(crate) fn key(&self) -> String {
        if self.given().is_some() { format!("{self:?}") } else { "default".to_owned() }
    }

    /// How points are read.
    #[must_use]
    pub fn read_options(&self) -> ReadOptions {
        ReadOptions::default()
            .with_text_columns(self.columns.clone())
            .with_mesh_points(self.mesh_points)
            .with_particles(self.particles.clone())
    }

    /// The same build with these choices, besides attributes.
    ///
    /// # Errors
    /// If the radius or the weight is an empty text.
    pub fn applied(&self, options: BuildOptions) -> anyhow::Result<BuildOptions> {
        let mut options = options.with_keep_color(self.no_color.is_none());
        if let Some(radius) = &self.radius {
            options = options.with_radius(Some(values::rule(radius)?));
        }
        if let Some(weight) = &self.weight {
            options = options.with_weight(Some(values::rule(weight)?));
        }
        options = options.with_shape(match self.shape.as_deref() {
            Some("round") => ShapeRule::Round,
            Some("fluid") => ShapeRule::Fluid,
            _ => ShapeRule::Auto,
        });
        Ok(options.with_length_scale(self.length_scale.unwrap_or(1.0)))
    }

    /// The layout of voxels without a header.
    ///
    /// # Errors
    /// If it is none.
    pub fn raw(&self) -> anyhow::Result<Option<RawLayout>> {
        let layout = self.raw.as_ref().map(|text| text.parse()).transpose();
        layout.context("the layout of voxels (--raw)")
    }
}

//! Gaussian splats as PLY, in the layout of INRIA's trainer: colours as coefficients `f_dc_0` to
//! `f_dc_2` of the spherical harmonics, and `f_rest_0` and so on; `opacity` before the logistic
//! function; and the logarithms of the deviations in `scale_0` to `scale_2`, of which flat splats
//! (2DGS) have two. Rotations are in `rot_0` to `rot_3`.

use std::path::Path;

use super::gaussian::{self, Gaussian, color_of};
use super::harmonics::{self, Harmonics};
use crate::points::file_source::{FileSource, RecordReader, Request};
use crate::points::ply::PlyReader;
use crate::points::{ColorDepth, HARMONIC, PointBatch, PointSource, ReadError};
use rayset_base::geometry::DVec3;
use rayset_files::points::harmonics::{CHANNELS, coefficients};

/// Gaussians decoded at a time.
const CHUNK: usize = 4096;
/// Columns of the file that a Gaussian is made of, besides its rotation. The last may be missing.
const PARTS: [&str; 7] = ["f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"];
/// Its rotation: w, x, y and z of a quaternion, of any length. All four or none.
const ROTATION: [&str; 4] = ["rot_0", "rot_1", "rot_2", "rot_3"];
/// Up in files of INRIA's trainer, whose cameras look along z with y down, if a file does not say
/// otherwise.
pub(super) const UP: DVec3 = DVec3::NEG_Y;

/// The Gaussians of a PLY file.
pub(in crate::points) struct GaussianPlyReader {
    file: FileSource<PlyReader>,
    /// Indices of [`PARTS`], and of [`ROTATION`] if the file has it, in its schema.
    parts: Vec<usize>,
    /// Number of deviations.
    deviations: usize,
    has_rotation: bool,
    /// Degree of its harmonics.
    degree: u8,
    /// The first column of the file's own.
    own: usize,
    /// Indices of the further columns in the file's schema.
    others: Vec<usize>,
    /// Of the file: the parts and the coefficients, then the selected ones of the others.
    raw: PointBatch,
}

impl GaussianPlyReader {
    /// Whether vertices with these properties are Gaussians.
    pub(in crate::points) fn has_layout(names: &[&str]) -> bool {
        PARTS[..PARTS.len() - 1].iter().all(|part| names.contains(part))
    }

    /// Opens a file whose vertices [are Gaussians](Self::has_layout).
    ///
    /// # Errors
    /// As [`PlyReader::open`].
    pub(in crate::points) fn open(path: &Path) -> Result<FileSource<Self>, ReadError> {
        let file = PlyReader::open(path)?;
        let names: Vec<&str> = file.schema().names().collect();
        let place = |part: &&str| names.iter().position(|name| name == part);
        let mut parts: Vec<usize> = PARTS.iter().filter_map(place).collect();
        let deviations = parts.len() - 4;
        let rotation: Vec<usize> = ROTATION.iter().filter_map(place).collect();
        let has_rotation = rotation.len() == ROTATION.len();
        if has_rotation {
            parts.extend(rotation);
        }
        let is_harmonic = |name: &str| name.starts_with(HARMONIC);
        let rest: Vec<usize> = (0..).map_while(|i| place(&&*format!("{HARMONIC}{i}"))).collect();
        let per_channel = rest.len() / CHANNELS;
        let degree = harmonics::degree(per_channel);
        // Of each channel those up to the degree.
        let kept = harmonics::rest(degree) / CHANNELS;
        parts.extend((0..harmonics::rest(degree)).map(|i| rest[i / kept * per_channel + i % kept]));
        // Normals are written as zeros.
        let is_left_out = |name: &str| is_harmonic(name) || matches!(name, "nx" | "ny" | "nz");
        let is_own = |name: &str| !is_left_out(name) && !gaussian::has(name);
        let others: Vec<usize> =
            (0..names.len()).filter(|index| !parts.contains(index) && is_own(names[*index])).collect();
        let what = file.schema().description.clone();
        let up = file.schema().up.unwrap_or(UP);
        let mut schema = gaussian::schema(&what, ColorDepth::Unit, degree, up);
        if gaussian::is_antialiased(&what) {
            gaussian::say_antialiased(&mut schema);
        }
        if per_channel + 1 > coefficients(degree) {
            schema.warnings = vec![harmonics::left_out(degree)];
        }
        let own = schema.columns.len();
        schema.columns.extend(others.iter().map(|&index| file.schema().columns[index].clone()));
        let count = file.count_hint();
        let raw = PointBatch::default();
        let reader = Self { file, parts, deviations, has_rotation, degree, own, others, raw };
        Ok(FileSource::new(path, schema, count, reader))
    }

    /// Gaussian `index` of the raw batch.
    fn gaussian(&self, index: usize) -> Gaussian {
        let part = |part: usize| self.raw.columns[part].get(index);
        // A flat splat has no third deviation.
        let deviation = |axis: usize| if axis < self.deviations { part(4 + axis).exp() } else { 0.0 };
        let first = 4 + self.deviations;
        let rotation = match self.has_rotation {
            true => [1, 2, 3, 0].map(|component| part(first + component)),
            false => [0.0, 0.0, 0.0, 1.0],
        };
        let rest = &self.raw.columns[self.parts.len() - harmonics::rest(self.degree)..self.parts.len()];
        let mut harmonics = Harmonics { constant: [0, 1, 2].map(part), ..Harmonics::NONE };
        harmonics.rest.iter_mut().zip(rest).for_each(|(to, from)| *to = from.get(index) as f32);
        Gaussian {
            position: self.raw.position[index],
            color: [0, 1, 2].map(|channel| color_of(part(channel))),
            harmonics,
            opacity: 1.0 / (1.0 + (-part(3)).exp()),
            deviations: [0, 1, 2].map(deviation),
            rotation,
        }
    }
}

impl RecordReader for GaussianPlyReader {
    fn memory_needed(&self) -> u64 {
        let values = (3 + self.parts.len() + self.others.len()) as u64;
        self.file.memory_needed() + CHUNK as u64 * values * 8
    }

    fn select(&mut self, columns: &[usize]) {
        let others = columns.iter().filter_map(|index| index.checked_sub(self.own));
        let from_file: Vec<usize> =
            self.parts.iter().copied().chain(others.map(|other| self.others[other])).collect();
        self.file.select(&from_file);
    }

    fn read(&mut self, request: &Request<'_>, batch: &mut PointBatch) -> Result<(), ReadError> {
        self.file.fill(&mut self.raw, CHUNK.min(request.most))?;
        for index in 0..self.raw.len() {
            self.gaussian(index).append(self.own, request.selected, batch);
        }
        let own = batch.columns.iter_mut().zip(request.selected);
        let own = own.filter(|(_, index)| **index >= self.own).map(|(column, _)| column);
        for (to, from) in own.zip(&self.raw.columns[self.parts.len()..]) {
            (0..from.len()).for_each(|index| to.push(from.get(index)));
        }
        Ok(())
    }
}

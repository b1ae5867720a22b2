//! Gaussian splats as PLY, in the layout of INRIA's trainer: colours as coefficients `f_dc_0` to
//! `f_dc_2` of the spherical harmonics, `opacity` before the logistic function, and the logarithms
//! of the deviations in `scale_0` to `scale_2`, of which flat splats (2DGS) have two.

use std::path::Path;

use super::gaussian::{Gaussian, GaussianColumns, color_of_harmonic};
use crate::points::ply::PlySource;
use crate::points::{ColorDepth, PointBatch, PointSource, ReadError, Schema};

/// Gaussians decoded at a time.
const CHUNK: usize = 4096;
/// Columns of the file that a Gaussian is made of. The last may be missing.
const PARTS: [&str; 7] = ["f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"];
/// Up in files of INRIA's trainer, whose cameras look along z with y down, if a file does not say
/// otherwise.
pub(super) const UP: [f64; 3] = [0.0, -1.0, 0.0];

/// The Gaussians of a PLY file.
#[derive(Debug)]
pub(in crate::points) struct GaussianPlySource {
    file: PlySource,
    /// Indices of [`PARTS`] in the file's schema.
    parts: Vec<usize>,
    /// Indices of the further columns in the file's schema.
    others: Vec<usize>,
    columns: GaussianColumns,
    /// Of the file: the parts, then the selected ones of the others.
    raw: PointBatch,
}

impl GaussianPlySource {
    /// Whether vertices with these properties are Gaussians.
    pub(in crate::points) fn has_layout(names: &[&str]) -> bool {
        PARTS[..PARTS.len() - 1].iter().all(|part| names.contains(part))
    }

    /// Opens a file whose vertices [are Gaussians](Self::has_layout).
    ///
    /// # Errors
    /// As [`PlySource::open`].
    pub(in crate::points) fn open(path: &Path) -> Result<Self, ReadError> {
        let file = PlySource::open(path)?;
        let names: Vec<&str> = file.schema().names().collect();
        let parts: Vec<usize> =
            PARTS.iter().filter_map(|part| names.iter().position(|name| name == part)).collect();
        let is_harmonic = |name: &str| name.starts_with("f_rest_");
        // Normals are written as zeros.
        let is_left_out = |name: &str| is_harmonic(name) || matches!(name, "nx" | "ny" | "nz");
        let is_own = |name: &str| !is_left_out(name) && !GaussianColumns::has(name);
        let others: Vec<usize> =
            (0..names.len()).filter(|index| !parts.contains(index) && is_own(names[*index])).collect();
        let what = file.schema().description.clone();
        let view_dependent = names.iter().any(|name| is_harmonic(name));
        let up = file.schema().up.unwrap_or(UP);
        let mut columns = GaussianColumns::new(&what, ColorDepth::Unit, view_dependent, up);
        columns.schema.columns.extend(others.iter().map(|&index| file.schema().columns[index].clone()));
        let mut source = Self { file, parts, others, columns, raw: PointBatch::default() };
        source.select(&[]);
        Ok(source)
    }

    /// Gaussian `index` of the raw batch.
    fn gaussian(&self, index: usize) -> Gaussian {
        let part = |part: usize| self.raw.columns[part].get(index);
        // A flat splat has no third deviation.
        let deviation = |axis: usize| if 4 + axis < self.parts.len() { part(4 + axis).exp() } else { 0.0 };
        Gaussian {
            position: self.raw.position[index],
            color: [0, 1, 2].map(|channel| color_of_harmonic(part(channel))),
            opacity: 1.0 / (1.0 + (-part(3)).exp()),
            deviations: [0, 1, 2].map(deviation),
        }
    }
}

impl PointSource for GaussianPlySource {
    fn schema(&self) -> &Schema {
        &self.columns.schema
    }

    fn count_hint(&self) -> Option<u64> {
        self.file.count_hint()
    }

    fn path(&self) -> Option<&Path> {
        self.file.path()
    }

    fn memory_needed(&self) -> u64 {
        let values = (3 + self.parts.len() + self.others.len()) as u64;
        self.file.memory_needed() + CHUNK as u64 * values * 8
    }

    fn select(&mut self, columns: &[usize]) {
        self.columns.selected = columns.to_vec();
        let others = columns.iter().filter_map(|index| index.checked_sub(GaussianColumns::COUNT));
        let from_file: Vec<usize> =
            self.parts.iter().copied().chain(others.map(|other| self.others[other])).collect();
        self.file.select(&from_file);
    }

    fn fill(&mut self, batch: &mut PointBatch, limit: usize) -> Result<(), ReadError> {
        batch.reset(&self.columns.schema, &self.columns.selected);
        while batch.len() < limit {
            self.file.fill(&mut self.raw, CHUNK.min(limit - batch.len()))?;
            if self.raw.is_empty() {
                break;
            }
            for index in 0..self.raw.len() {
                self.columns.append(&self.gaussian(index), batch);
            }
            let own = batch.columns.iter_mut().zip(&self.columns.selected);
            let own = own.filter(|(_, index)| **index >= GaussianColumns::COUNT).map(|(column, _)| column);
            for (to, from) in own.zip(&self.raw.columns[self.parts.len()..]) {
                (0..from.len()).for_each(|index| to.push(from.get(index)));
            }
        }
        Ok(())
    }
}

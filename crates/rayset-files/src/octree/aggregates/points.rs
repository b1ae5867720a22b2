//! Points as aggregates are made of them, by columns.

use crate::octree::format::Header;
use crate::octree::page::Run;
use crate::octree::shape::StoredShape;
use rayset_base::geometry::{DMat3, DVec3, Shape};
use rayset_base::srgb::linear_from_srgb;

/// Points, in the order of the file.
#[derive(Clone, Debug, Default)]
pub(super) struct Points {
    /// World space.
    pub(super) position: Vec<DVec3>,
    /// World space.
    pub(super) radius: Vec<f64>,
    /// As densities have them.
    pub(super) weight: Vec<f64>,
    /// s₁ s₂ s₃.
    pub(super) volume: Vec<f64>,
    /// Empty if all points are balls.
    pub(super) shape: Vec<Shape>,
    /// Linear light; empty if points have none.
    pub(super) color: Vec<[f32; 3]>,
    /// A column for each attribute.
    pub(super) attributes: Vec<Vec<f32>>,
}

/// Decodes runs.
pub(super) struct Decoder<'a> {
    header: &'a Header,
    /// 1/∫ω dV over the unit ball, if weights are to be normalised.
    normalisation: Option<f64>,
    /// The linear light of each byte of a colour.
    light: [f32; 256],
}

impl<'a> Decoder<'a> {
    pub(super) fn new(header: &'a Header, normalisation: Option<f64>) -> Self {
        let light = std::array::from_fn(|byte| linear_from_srgb(byte as f64 / 255.0) as f32);
        Self { header, normalisation, light }
    }

    /// Appends what densities depend on.
    pub(super) fn append_solid(&self, run: &Run<'_>, points: &mut Points) {
        let (header, n) = (self.header, run.head.len());
        let first = points.position.len();
        points.position.extend(run.positions(header.root_cell()));
        match run.radii(header) {
            Some(radii) => points.radius.extend(radii.map(f64::from)),
            None => points.radius.extend(std::iter::repeat_n(f64::from(header.radius.min()), n)),
        }
        match run.weights(header) {
            Some(weights) => points.weight.extend(weights.map(f64::from)),
            None => points.weight.extend(std::iter::repeat_n(f64::from(header.weight.min()), n)),
        }
        points.shape.extend(run.shapes(header).into_iter().flatten().map(StoredShape::decode));
        for index in first..points.position.len() {
            let radius = points.radius[index];
            let ratio = points.shape.get(index).map_or(1.0, Shape::volume);
            points.volume.push(radius * radius * radius * ratio);
        }
        if let Some(factor) = self.normalisation {
            let weights = points.weight[first..].iter_mut().zip(&points.volume[first..]);
            weights.for_each(|(weight, volume)| *weight *= factor / volume);
        }
    }

    /// Appends everything.
    pub(super) fn append(&self, run: &Run<'_>, points: &mut Points) {
        self.append_solid(run, points);
        let colors = run.colors(self.header).into_iter().flatten();
        points.color.extend(colors.map(|color| color.map(|byte| self.light[usize::from(byte)])));
        points.attributes.resize_with(self.header.attributes.len(), Vec::new);
        for (index, column) in points.attributes.iter_mut().enumerate() {
            column.extend(run.attribute(self.header, index));
        }
    }
}

impl Points {
    pub(super) fn len(&self) -> usize {
        self.position.len()
    }

    pub(super) fn clear(&mut self) {
        self.position.clear();
        self.radius.clear();
        self.weight.clear();
        self.volume.clear();
        self.shape.clear();
        self.color.clear();
        self.attributes.clear();
    }

    /// v s₁ s₂ s₃.
    pub(super) fn mass(&self, index: usize) -> f64 {
        self.weight[index] * self.volume[index]
    }

    /// r²: of ellipsoids the harmonic mean of the squares of the semi-axes. By volume and surface,
    /// a ray goes about as far through such an ellipsoid as through a ball of that radius, in the
    /// mean of directions.
    pub(super) fn radius_squared(&self, index: usize) -> f64 {
        let squared = self.radius[index] * self.radius[index];
        match self.shape.get(index) {
            None => squared,
            Some(shape) => {
                let inverse: f64 = shape.ratios.map(|ratio| 1.0 / (ratio * ratio)).iter().sum();
                3.0 * squared / (1.0 + inverse)
            }
        }
    }

    /// The map from places relative to a point to its unit ball; of balls none is needed.
    pub(super) fn unit_from_local(&self, index: usize) -> Option<DMat3> {
        let shape = self.shape.get(index)?;
        Some(shape.unit_from_local() * self.radius[index].recip())
    }

    /// x² of a place in a point.
    pub(super) fn square(&self, index: usize, place: DVec3) -> f64 {
        let offset = place - self.position[index];
        match self.unit_from_local(index) {
            Some(map) => (map * offset).length_squared(),
            None => {
                let inverse = self.radius[index].recip();
                offset.length_squared() * (inverse * inverse)
            }
        }
    }

    /// R diag(s²) Rᵀ: of a kernel of variance 1 over the unit ball, the covariance in space.
    pub(super) fn extent(&self, index: usize) -> DMat3 {
        let radius = self.radius[index];
        match self.shape.get(index) {
            None => DMat3::from_diagonal(DVec3::splat(radius * radius)),
            Some(shape) => {
                let axes = shape.semi_axes() * radius;
                axes * axes.transpose()
            }
        }
    }
}

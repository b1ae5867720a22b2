//! The reference field: every point against every sample, in `f64`, from the points as stored in the file.

use super::kernel::Kernel;
use super::run::{AttributeColumns, linear_from_srgb};
use crate::container::ScanError;
use crate::geometry::{DVec3, Ray};
use crate::octree::Cloud;

/// A point in double precision.
#[derive(Clone, Debug, PartialEq)]
pub struct JudgePoint {
    /// Position in the cloud's space.
    pub position: DVec3,
    /// Radius.
    pub radius: f64,
    /// Weight.
    pub weight: f64,
    /// One value for each channel of [`AttributeColumns`].
    pub attributes: Vec<f64>,
}

/// The field at one sample.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReferenceSample {
    /// The density, Σ v·ω.
    pub density: f64,
    /// Its gradient, Σ v·∇ω.
    pub gradient: DVec3,
    /// Σ v·ω·a for each channel; empty if no point reaches the sample.
    pub attributes: Vec<f64>,
}

/// The points of a cloud without any acceleration structure.
#[derive(Clone, Debug)]
pub struct ReferenceField {
    /// The points.
    pub points: Vec<JudgePoint>,
    /// The kernel.
    pub kernel: Kernel,
    /// Whether kernels are normalised to integrate to one.
    pub normalised: bool,
}

impl ReferenceField {
    /// Reads all points of a cloud.
    ///
    /// # Errors
    /// [`ScanError`] if the file cannot be read or is damaged.
    pub fn load(
        cloud: &Cloud,
        kernel: Kernel,
        normalised: bool,
        columns: &AttributeColumns,
    ) -> Result<Self, ScanError> {
        let header = cloud.header();
        let mut points = Vec::new();
        cloud.for_each_run(|_, run| {
            let n = run.head.len();
            let constant = |v: f32| vec![v; n];
            let radii = run.radii(header).map_or_else(|| constant(header.radius.min()), Iterator::collect);
            let weights =
                run.weights(header).map_or_else(|| constant(header.weight.min()), Iterator::collect);
            let mut attributes = vec![Vec::new(); n];
            if columns.color {
                for (a, c) in attributes.iter_mut().zip(run.colors(header).into_iter().flatten()) {
                    a.extend(c.map(|v| linear_from_srgb(f64::from(v) / 255.0)));
                }
            }
            for &index in &columns.scalars {
                for (a, v) in attributes.iter_mut().zip(run.attribute(header, index)) {
                    a.push(if v.is_finite() { f64::from(v) } else { 0.0 });
                }
            }
            for (i, position) in run.positions(header.root_cell()).into_iter().enumerate() {
                let (radius, weight) = (f64::from(radii[i]), f64::from(weights[i]));
                let attributes = std::mem::take(&mut attributes[i]);
                points.push(JudgePoint { position, radius, weight, attributes });
            }
        })?;
        Ok(Self { points, kernel, normalised })
    }

    /// The points that reach a ray anywhere, and so any of its samples.
    #[must_use]
    pub fn near(&self, ray: &Ray) -> Self {
        let reaches = |p: &&JudgePoint| {
            let c = p.position - ray.origin;
            let across = c - ray.direction * c.dot(ray.direction);
            across.length_squared() <= p.radius * p.radius * (1.0 + 1e-9)
        };
        Self { points: self.points.iter().filter(reaches).cloned().collect(), ..*self }
    }

    /// The field at the position `q`, in the cloud's space.
    #[must_use]
    pub fn sample(&self, q: DVec3) -> ReferenceSample {
        let mut sum = ReferenceSample::default();
        for p in &self.points {
            let offset = q - p.position;
            let inverse = 1.0 / (p.radius * p.radius);
            let s = offset.length_squared() * inverse;
            if s >= 1.0 {
                continue;
            }
            let norm = if self.normalised { 1.0 / (p.radius.powi(3) * self.kernel.integral()) } else { 1.0 };
            let weight = p.weight * norm;
            let value = weight * self.kernel.value(s);
            sum.density += value;
            sum.gradient += offset * (weight * self.kernel.slope_over_x(s) * inverse);
            sum.attributes.resize(p.attributes.len(), 0.0);
            for (sum, a) in sum.attributes.iter_mut().zip(&p.attributes) {
                *sum += value * a;
            }
        }
        sum
    }
}

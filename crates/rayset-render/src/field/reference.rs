//! The reference field: every point against every sample, in `f64`, from the points as stored in
//! the file.

use super::kernel::Kernel;
use super::run::{AttributeColumns, linear_from_srgb};
use rayset_base::geometry::{DVec3, Ray};
use rayset_files::octree::Cloud;
use rayset_store::container::ScanError;

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
    /// Channels of class labels.
    labels: Vec<usize>,
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
            let positions = run.positions(header.root_cell());
            for &number in &columns.scalars {
                if let Some(axis) = number.checked_sub(header.attributes.len()) {
                    attributes.iter_mut().zip(&positions).for_each(|(a, p)| a.push(p[axis]));
                    continue;
                }
                for (a, v) in attributes.iter_mut().zip(run.attribute(header, number)) {
                    a.push(if v.is_finite() { f64::from(v) } else { 0.0 });
                }
            }
            for (i, position) in positions.into_iter().enumerate() {
                let (radius, weight) = (f64::from(radii[i]), f64::from(weights[i]));
                let attributes = std::mem::take(&mut attributes[i]);
                points.push(JudgePoint { position, radius, weight, attributes });
            }
        })?;
        let is_label = |&number: &usize| header.attributes.get(number).is_some_and(|a| a.is_class);
        let first = columns.first_scalar();
        let labels = (columns.scalars.iter().enumerate())
            .filter_map(|(place, number)| is_label(number).then_some(first + place))
            .collect();
        Ok(Self { points, kernel, normalised, labels })
    }

    /// The points that reach a ray anywhere, and so any of its samples.
    #[must_use]
    pub fn near(&self, ray: &Ray) -> Self {
        let reaches = |p: &&JudgePoint| {
            let c = p.position - ray.origin;
            let across = c - ray.direction * c.dot(ray.direction);
            across.length_squared() <= p.radius * p.radius * (1.0 + 1e-9)
        };
        let points = self.points.iter().filter(reaches).cloned().collect();
        Self { points, labels: self.labels.clone(), ..*self }
    }

    /// The field at the position `q`, in the cloud's space.
    #[must_use]
    pub fn sample(&self, q: DVec3) -> ReferenceSample {
        let mut sum = ReferenceSample::default();
        // The largest contribution of a point, and the point's attributes.
        let mut most: (f64, &[f64]) = (0.0, &[]);
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
            if value > most.0 {
                most = (value, &p.attributes);
            }
        }
        // Labels are not averaged; divided by the density, as all attributes are, each is that of
        // one point.
        for &label in &self.labels {
            if let (Some(sum_of_labels), Some(own)) = (sum.attributes.get_mut(label), most.1.get(label)) {
                *sum_of_labels = own * sum.density;
            }
        }
        sum
    }
}

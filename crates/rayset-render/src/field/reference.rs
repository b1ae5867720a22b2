//! The reference field: every point against every sample, in `f64`, from the points as stored in
//! the file.

use super::columns::AttributeColumns;
use super::gaussian_splat::MOST_OPAQUE;
use super::gaussian_splat::exact::{self, splat_radius};
use super::harmonics;
use super::sight::Sight;
use super::splat_filter::SplatFilter;
use crate::math::linear_from_srgb;
use rayset_base::geometry::{DMat3, DVec3, Ray, Shape};
use rayset_base::kernel::Kernel;
use rayset_files::octree::Cloud;
use rayset_files::octree::format::Header;
use rayset_files::octree::page::Run;
use rayset_files::octree::shape::StoredShape;
use rayset_store::container::ScanError;

/// A point in double precision.
#[derive(Clone, Debug, PartialEq)]
pub struct JudgePoint {
    /// Position in the cloud's space.
    pub position: DVec3,
    /// Radius: the longest semi-axis.
    pub radius: f64,
    /// Shape; `None` for a ball.
    pub shape: Option<Shape>,
    /// Weight.
    pub weight: f64,
    /// One value for each channel of [`AttributeColumns`].
    pub attributes: Vec<f64>,
    /// How the colour among them changes with the direction, if it does.
    pub harmonics: Option<JudgeHarmonics>,
}

/// How the colour of a point changes with the direction from which it is seen.
#[derive(Clone, Debug, PartialEq)]
pub struct JudgeHarmonics {
    /// The colour that is stored, 0 to 1, as displays are given it.
    stored: [f64; 3],
    /// The bytes of the coefficients.
    bytes: Vec<u8>,
    degree: u8,
    /// Whether the attributes are display values.
    as_displayed: bool,
}

impl JudgePoint {
    /// Adds to the covariance of a splat what a filter adds where it is; by `mip`, its opacity
    /// becomes less as its area across the way to it becomes larger.
    fn widen(&mut self, filter: SplatFilter, sight: &Sight) {
        let deviations = splat_radius(self.weight);
        if deviations == 0.0 {
            return;
        }
        let shape = self.shape.unwrap_or(Shape::BALL);
        let axes = DMat3::from_quat(shape.rotation);
        let lengths = DVec3::new(1.0, shape.ratios[0], shape.ratios[1]) * (self.radius / deviations);
        let wider =
            (lengths * lengths + filter.variance() * sight.pixel_at(self.position).powi(2)).map(f64::sqrt);
        if filter == SplatFilter::Mip {
            let toward = sight.eye.toward(self.position);
            let (right, up) = toward.any_orthonormal_pair();
            let area = |lengths: DVec3| {
                let covariance = axes * DMat3::from_diagonal(lengths * lengths) * axes.transpose();
                let of = |a: DVec3, b: DVec3| a.dot(covariance * b);
                (of(right, right) * of(up, up) - of(right, up).powi(2)).max(0.0).sqrt()
            };
            self.weight = self.weight.min(MOST_OPAQUE) * (area(lengths) / area(wider));
        }
        let deviations = splat_radius(self.weight);
        if deviations == 0.0 {
            return;
        }
        self.radius = wider.x * deviations;
        self.shape =
            self.shape.map(|shape| Shape { ratios: [wider.y / wider.x, wider.z / wider.x], ..shape });
    }
}

impl JudgeHarmonics {
    /// Those of the points of a run; none if it has none, or colours are not asked for.
    fn of_run(run: &Run<'_>, header: &Header, columns: &AttributeColumns) -> Vec<Option<Self>> {
        let (Some(colors), Some(bytes)) = (run.colors(header), run.harmonics(header)) else {
            return Vec::new();
        };
        let of_point = |(stored, bytes): ([u8; 3], &[u8])| {
            columns.color.then(|| Self {
                stored: stored.map(|byte| f64::from(byte) / 255.0),
                bytes: bytes.to_vec(),
                degree: header.harmonics,
                as_displayed: columns.color_as_displayed,
            })
        };
        colors.zip(harmonics::of_points(bytes, header.harmonics)).map(of_point).collect()
    }
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
        let color =
            |display: f64| if columns.color_as_displayed { display } else { linear_from_srgb(display) };
        cloud.for_each_run(|_, run| {
            let n = run.head.len();
            let constant = |v: f32| vec![v; n];
            let radii = run.radii(header).map_or_else(|| constant(header.radius.min()), Iterator::collect);
            let weights =
                run.weights(header).map_or_else(|| constant(header.weight.min()), Iterator::collect);
            let shapes = run.shapes(header).map(|shapes| shapes.map(StoredShape::decode).collect::<Vec<_>>());
            let mut attributes = vec![Vec::new(); n];
            if columns.color {
                for (a, c) in attributes.iter_mut().zip(run.colors(header).into_iter().flatten()) {
                    a.extend(c.map(|v| color(f64::from(v) / 255.0)));
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
            let mut harmonics = JudgeHarmonics::of_run(&run, header, columns);
            for (i, position) in positions.into_iter().enumerate() {
                let (radius, weight) = (f64::from(radii[i]), f64::from(weights[i]));
                let attributes = std::mem::take(&mut attributes[i]);
                let shape = shapes.as_ref().map(|shapes| shapes[i]);
                let harmonics = harmonics.get_mut(i).and_then(Option::take);
                points.push(JudgePoint { position, radius, shape, weight, attributes, harmonics });
            }
        })?;
        let is_label = |&number: &usize| header.attributes.get(number).is_some_and(|a| a.is_class);
        let first = columns.first_scalar();
        let labels = (columns.scalars.iter().enumerate())
            .filter_map(|(place, number)| is_label(number).then_some(first + place))
            .collect();
        Ok(Self { points, kernel, normalised, labels })
    }

    /// The points that reach a ray anywhere, and so any of its samples, if each reaches farther by
    /// what is said of its place.
    #[must_use]
    pub fn near(&self, ray: &Ray, farther: impl Fn(DVec3) -> f64) -> Self {
        let reaches = |p: &&JudgePoint| {
            let c = p.position - ray.origin;
            let across = c - ray.direction * c.dot(ray.direction);
            let radius = p.radius + farther(p.position);
            across.length_squared() <= radius * radius * (1.0 + 1e-9)
        };
        let points = self.points.iter().filter(reaches).cloned().collect();
        Self { points, labels: self.labels.clone(), ..*self }
    }

    /// The same points in the colours that an eye in the cloud's space sees, and splats as wide as
    /// a filter makes them for it.
    #[must_use]
    pub fn seen(mut self, filter: SplatFilter, sight: Option<&Sight>) -> Self {
        for point in &mut self.points {
            if let Some(sight) = sight.filter(|_| filter != SplatFilter::None) {
                point.widen(filter, sight);
            }
            let Some(of) = &point.harmonics else { continue };
            let toward = sight.map(|sight| sight.eye.toward(point.position));
            let color = harmonics::color_toward(of.stored, &of.bytes, toward, of.degree);
            let color = if of.as_displayed { color } else { color.map(linear_from_srgb) };
            point.attributes[..3].copy_from_slice(&color);
        }
        self
    }

    /// The field at the position `q`, in the cloud's space: with A as
    /// [`unit_from_local`](Shape::unit_from_local) says, x = |A(q − p)|/r, D = Σ v·ω(x) and
    /// ∇D = Σ v·(ω′/x)·AᵀA(q − p)/r². Normalised, v is divided by ∫ω dV over the ellipsoid.
    #[must_use]
    pub fn sample(&self, q: DVec3) -> ReferenceSample {
        let mut sum = ReferenceSample::default();
        // The largest contribution of a point, and the point's attributes.
        let mut most: (f64, &[f64]) = (0.0, &[]);
        for p in &self.points {
            let offset = q - p.position;
            let inverse = 1.0 / (p.radius * p.radius);
            let unit_from_local = p.shape.map(|shape| shape.unit_from_local());
            let place = unit_from_local.map_or(offset, |unit_from_local| unit_from_local * offset);
            let s = place.length_squared() * inverse;
            if s >= 1.0 {
                continue;
            }
            let volume = p.radius.powi(3) * p.shape.map_or(1.0, |shape| shape.volume());
            let norm = if self.normalised { 1.0 / (volume * self.kernel.integral()) } else { 1.0 };
            let weight = p.weight * norm;
            let value = weight * self.kernel.value(s);
            sum.density += value;
            let slope = weight * self.kernel.slope_over_x(s) * inverse;
            let back = unit_from_local.map_or(place, |unit_from_local| unit_from_local.transpose() * place);
            sum.gradient += back * slope;
            sum.attributes.resize(p.attributes.len(), 0.0);
            for (sum, a) in sum.attributes.iter_mut().zip(&p.attributes) {
                *sum += value * a;
            }
            if value > most.0 {
                most = (value, &p.attributes);
            }
        }
        self.choose_labels(&mut sum, most);
        sum
    }

    /// Of splats, the mean extinction of an interval of a ray, in the cloud's space: of each its
    /// optical depth, by the formula, divided by the length of the interval. In place of the
    /// gradient there is the sum of the vectors −D·AᵀA(q − p)/r² of each, where q is where the
    /// interval begins in it.
    #[must_use]
    pub fn interval(&self, ray: &Ray, (from, to): (f64, f64)) -> ReferenceSample {
        let mut sum = ReferenceSample::default();
        let mut most: (f64, &[f64]) = (0.0, &[]);
        for p in &self.points {
            let map = p.shape.map_or(DMat3::IDENTITY, |shape| shape.unit_from_local()) * (1.0 / p.radius);
            let (origin, direction) = (map * (ray.origin - p.position), map * ray.direction);
            let scale = direction.length();
            let nearest = -origin.dot(direction) / (scale * scale);
            let distance = (origin + direction * nearest).length();
            // Deviations in a radius.
            let deviations = splat_radius(p.weight);
            let along = |t: f64| (t - nearest) * scale * deviations;
            let depth = exact::depth(p.weight, distance * deviations, along(from), along(to));
            if !(depth > 0.0) {
                continue;
            }
            let value = depth / (to - from);
            sum.density += value;
            let half = (1.0 - distance * distance).max(0.0).sqrt() / scale;
            let front = origin + direction * from.max(nearest - half);
            sum.gradient -= map.transpose() * front * value;
            sum.attributes.resize(p.attributes.len(), 0.0);
            for (sum, a) in sum.attributes.iter_mut().zip(&p.attributes) {
                *sum += value * a;
            }
            if value > most.0 {
                most = (value, &p.attributes);
            }
        }
        self.choose_labels(&mut sum, most);
        sum
    }

    /// Labels are not averaged; divided by the density, as all attributes are, each is that of one
    /// point, the one that contributes most.
    fn choose_labels(&self, sum: &mut ReferenceSample, most: (f64, &[f64])) {
        for &label in &self.labels {
            if let (Some(sum_of_labels), Some(own)) = (sum.attributes.get_mut(label), most.1.get(label)) {
                *sum_of_labels = own * sum.density;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rayset_base::geometry::DQuat;

    fn field(kernel: Kernel, normalised: bool, radius: f64, shape: Option<Shape>) -> ReferenceField {
        let position = DVec3::new(0.3, -0.2, 0.1);
        let point =
            JudgePoint { position, radius, shape, weight: 1.5, attributes: vec![2.0], harmonics: None };
        ReferenceField { points: vec![point], kernel, normalised, labels: Vec::new() }
    }

    fn shape() -> impl Strategy<Value = Shape> {
        let numbers = (prop::array::uniform3(0.05..1.0_f64), prop::array::uniform4(-1.0..1.0_f64));
        numbers.prop_filter_map("a rotation", |(lengths, q)| {
            Shape::of_semi_axes(lengths, DQuat::from_array(q)).map(|(_, shape)| shape)
        })
    }

    proptest! {
        #[test]
        fn the_gradient_of_an_ellipsoid_is_that_of_its_density(
            kernel in prop::sample::select(Kernel::OF_DENSITIES),
            shape in shape(),
            at in prop::array::uniform3(-0.6..0.6_f64),
        ) {
            let field = field(kernel, false, 1.7, Some(shape));
            let to = shape.semi_axes() * DVec3::from_array(at) * 1.7;
            let q = field.points[0].position + to;
            let step = 1e-5 * 1.7 * shape.ratios[1];
            let density = |q: DVec3| field.sample(q).density;
            let differences = DVec3::AXES.map(|axis| density(q + axis * step) - density(q - axis * step));
            let expected = DVec3::from_array(differences) / (2.0 * step);
            let gradient = field.sample(q).gradient;
            let error = gradient.distance(expected);
            prop_assert!(error < 1e-3 * (1.0 / shape.ratios[1]), "{gradient} and {expected}");
        }

        #[test]
        fn a_normalised_ellipsoid_has_the_mass_of_its_weight(
            kernel in prop::sample::select(Kernel::OF_DENSITIES),
            shape in shape(),
        ) {
            let field = field(kernel, true, 1.7, Some(shape));
            // Cells of a lattice in the ellipsoid's own space.
            let cells = 40_i32;
            let cell = |i: i32| (f64::from(i) + 0.5) * 2.0 / f64::from(cells) - 1.0;
            let mut sum = 0.0;
            for i in 0..cells.pow(3) {
                let place = DVec3::new(cell(i % cells), cell(i / cells % cells), cell(i / cells / cells));
                sum += field.sample(field.points[0].position + shape.semi_axes() * place * 1.7).density;
            }
            let mass = sum * (2.0 / f64::from(cells)).powi(3) * 1.7_f64.powi(3) * shape.volume();
            prop_assert!((mass / 1.5 - 1.0).abs() < 3e-3, "{mass}");
        }

        #[test]
        fn a_shape_that_is_a_ball_is_one(
            kernel in prop::sample::select(Kernel::OF_DENSITIES),
            at in prop::array::uniform3(-1.0..1.0_f64),
        ) {
            let q = DVec3::from_array(at);
            let of = |shape| field(kernel, true, 1.1, shape).sample(q);
            prop_assert_eq!(of(Some(Shape::BALL)), of(None));
        }
    }
}

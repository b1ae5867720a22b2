//! Solids with hard or soft edges.

use super::{Pattern, Procedural, ProceduralSample};
use rayset_base::geometry::{Aabb, DVec3, Ray};

/// Shapes centred at the origin, with y as the axis of revolution.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Form {
    /// A sphere.
    Sphere {
        /// Radius.
        radius: f64,
    },
    /// A box.
    Box {
        /// Edge lengths.
        size: DVec3,
    },
    /// A cylinder.
    Cylinder {
        /// Radius.
        radius: f64,
        /// Height: it extends from −height/2 to height/2.
        height: f64,
    },
    /// A cone with its tip up.
    Cone {
        /// Radius of the base, at y = −height/2.
        radius: f64,
        /// Height: the tip is at y = height/2.
        height: f64,
    },
    /// A torus.
    Torus {
        /// Radius of the circle at the centre of the tube.
        major: f64,
        /// Radius of the tube.
        minor: f64,
    },
    /// Everything on the side that `normal` points away from.
    HalfSpace {
        /// Outward unit normal.
        normal: DVec3,
        /// Distance of the boundary from the origin along the normal.
        offset: f64,
    },
    /// An ellipsoid.
    Ellipsoid {
        /// Semi-axes.
        radii: DVec3,
    },
}

impl Form {
    /// Signed distance to the boundary, negative inside, and its gradient. For an ellipsoid, a
    /// first-order approximation.
    #[must_use]
    pub fn distance(&self, p: DVec3) -> (f64, DVec3) {
        match *self {
            Self::Sphere { radius } => (p.length() - radius, p.normalize_or(DVec3::Y)),
            Self::Box { size } => box_distance(p, size * 0.5),
            Self::Cylinder { radius, height } => {
                let around = (p.x * p.x + p.z * p.z).sqrt();
                let outward = DVec3::new(p.x, 0.0, p.z).normalize_or(DVec3::X);
                let (d, [radial, axial]) = rectangle_distance(around, p.y, radius, height * 0.5);
                (d, outward * radial + DVec3::Y * axial)
            }
            Self::Cone { radius, height } => cone_distance(p, radius, height),
            Self::Torus { major, minor } => {
                let outward = DVec3::new(p.x, 0.0, p.z).normalize_or(DVec3::X);
                let from_circle = p - outward * major;
                (from_circle.length() - minor, from_circle.normalize_or(DVec3::Y))
            }
            Self::HalfSpace { normal, offset } => (p.dot(normal) - offset, normal),
            Self::Ellipsoid { radii } => {
                // (|p/r| − 1) divided by the length of its gradient.
                let (k0, k1) = ((p / radii).length(), (p / (radii * radii)).length());
                if k1 == 0.0 {
                    return (-radii.min_element(), DVec3::Y);
                }
                (k0 * (k0 - 1.0) / k1, (p / (radii * radii)).normalize())
            }
        }
    }

    fn bounds(&self) -> Aabb {
        let half = match *self {
            Self::Sphere { radius } => DVec3::splat(radius),
            Self::Box { size } => size * 0.5,
            Self::Cylinder { radius, height } | Self::Cone { radius, height } => {
                DVec3::new(radius, height * 0.5, radius)
            }
            Self::Torus { major, minor } => DVec3::new(major + minor, minor, major + minor),
            Self::Ellipsoid { radii } => radii,
            Self::HalfSpace { normal, offset } => {
                // Bounded on one side if the normal is parallel to an axis.
                let mut bounds = Aabb::new(DVec3::NEG_INFINITY, DVec3::INFINITY);
                for axis in 0..3 {
                    if normal[axis] == 1.0 {
                        bounds.max[axis] = offset;
                    } else if normal[axis] == -1.0 {
                        bounds.min[axis] = -offset;
                    }
                }
                return bounds;
            }
        };
        Aabb::new(-half, half)
    }

    /// An interval of a ray outside which it is farther than `reach` from the shape, or `None`.
    fn span(&self, ray: &Ray, reach: f64) -> Option<(f64, f64)> {
        let within = self.bounds().inflated(reach).clip(ray)?;
        let round = match *self {
            Self::Sphere { radius } => near_origin(ray.origin, ray.direction, radius + reach)?,
            Self::Cylinder { radius, .. } | Self::Cone { radius, .. } => near_axis(ray, radius + reach)?,
            Self::Torus { major, minor } => near_axis(ray, major + minor + reach)?,
            // Its distance is not exact: only where it is negative or 0 is the ellipsoid certain.
            Self::Ellipsoid { radii } if reach == 0.0 => {
                near_origin(ray.origin / radii, ray.direction / radii, 1.0)?
            }
            Self::HalfSpace { normal, offset } => beyond_plane(ray, normal, offset + reach)?,
            Self::Ellipsoid { .. } | Self::Box { .. } => within,
        };
        let (enter, exit) = (within.0.max(round.0), within.1.min(round.1));
        (enter <= exit).then_some((enter, exit))
    }

    /// The smallest extent of the shape.
    fn thickness(&self) -> f64 {
        match *self {
            Self::Torus { minor, .. } => 2.0 * minor,
            Self::HalfSpace { .. } => f64::INFINITY,
            _ => self.bounds().size().min_element(),
        }
    }
}

/// Where a line is within a distance of the origin, or a little farther.
fn near_origin(origin: DVec3, direction: DVec3, distance: f64) -> Option<(f64, f64)> {
    let squared = direction.length_squared();
    if squared == 0.0 {
        return Some((f64::NEG_INFINITY, f64::INFINITY));
    }
    // From the point of the line that is nearest: the difference of squares of large numbers would
    // lose all digits.
    let middle = -origin.dot(direction) / squared;
    let away = (origin + direction * middle).length_squared();
    let distance = distance * (1.0 + 1e-9) + origin.length() * 1e-12;
    let half = ((distance * distance - away) / squared).sqrt();
    (half >= 0.0).then_some((middle - half, middle + half))
}

/// Where a line is within a distance of the y axis, or a little farther.
fn near_axis(ray: &Ray, distance: f64) -> Option<(f64, f64)> {
    let across = |v: DVec3| DVec3::new(v.x, 0.0, v.z);
    let (origin, direction) = (across(ray.origin), across(ray.direction));
    if direction == DVec3::ZERO {
        return (origin.length() <= distance * (1.0 + 1e-9)).then_some((f64::NEG_INFINITY, f64::INFINITY));
    }
    near_origin(origin, direction, distance)
}

/// Where a line is on the side of a plane that its normal points away from.
fn beyond_plane(ray: &Ray, normal: DVec3, offset: f64) -> Option<(f64, f64)> {
    let (height, slope) = (ray.origin.dot(normal) - offset, ray.direction.dot(normal));
    if slope == 0.0 {
        return (height <= 0.0).then_some((f64::NEG_INFINITY, f64::INFINITY));
    }
    let at = -height / slope;
    Some(if slope > 0.0 { (f64::NEG_INFINITY, at) } else { (at, f64::INFINITY) })
}

/// Signed distance to a rectangle with half sizes `a` and `b` centred at the origin, and its
/// gradient.
fn rectangle_distance(x: f64, y: f64, a: f64, b: f64) -> (f64, [f64; 2]) {
    let (qx, qy) = (x.abs() - a, y.abs() - b);
    let (sx, sy) = (1_f64.copysign(x), 1_f64.copysign(y));
    if qx > 0.0 && qy > 0.0 {
        let d = (qx * qx + qy * qy).sqrt();
        (d, [sx * qx / d, sy * qy / d])
    } else if qx > qy {
        (qx, [sx, 0.0])
    } else {
        (qy, [0.0, sy])
    }
}

fn box_distance(p: DVec3, half: DVec3) -> (f64, DVec3) {
    let (q, sign) = (p.abs() - half, p.map(|v| 1_f64.copysign(v)));
    let outside = q.max(DVec3::ZERO);
    if outside != DVec3::ZERO {
        let d = outside.length();
        return (d, sign * outside / d);
    }
    let largest = q.max_element();
    let axis = (0..3).find(|&axis| q[axis] == largest).unwrap_or(0);
    let mut gradient = DVec3::ZERO;
    gradient[axis] = sign[axis];
    (largest, gradient)
}

fn cone_distance(p: DVec3, radius: f64, height: f64) -> (f64, DVec3) {
    // In the half-plane through the axis, the cone is the triangle of axis, slant and base.
    let outward = DVec3::new(p.x, 0.0, p.z).normalize_or(DVec3::X);
    let x = (p.x * p.x + p.z * p.z).sqrt();
    let y = p.y + 0.5 * height;
    let slant = (radius * radius + height * height).sqrt();
    // Outward normal of the slant, and the signed distances from its line and from the base.
    let (nx, ny) = (height / slant, radius / slant);
    let from_slant = (x - radius) * nx + y * ny;
    let (d, gx, gy) = if from_slant.max(-y) <= 0.0 {
        if from_slant > -y { (from_slant, nx, ny) } else { (-y, 0.0, -1.0) }
    } else {
        // The nearest point of the triangle's outline.
        let along = (((x - radius) * -radius + y * height) / (slant * slant)).clamp(0.0, 1.0);
        let on_slant = (radius * (1.0 - along), height * along);
        let on_base = (x.clamp(0.0, radius), 0.0);
        let distance = |(px, py): (f64, f64)| ((x - px).powi(2) + (y - py).powi(2)).sqrt();
        let nearest = if distance(on_slant) <= distance(on_base) { on_slant } else { on_base };
        let d = distance(nearest);
        if d > 0.0 { (d, (x - nearest.0) / d, (y - nearest.1) / d) } else { (0.0, nx, ny) }
    };
    (d, outward * gx + DVec3::Y * gy)
}

/// A solid.
#[derive(Clone, Debug, PartialEq)]
pub struct Solid {
    /// The shape.
    pub form: Form,
    /// Opacity inside, 0 to 1.
    pub opacity: f64,
    /// Width of the region over which the opacity falls to 0, half of it inside the boundary; 0 for
    /// a hard edge.
    pub edge: f64,
    /// The colour.
    pub pattern: Pattern,
}

impl Solid {
    /// An opaque white solid with hard edges.
    #[must_use]
    pub fn new(form: Form) -> Self {
        Self { form, opacity: 1.0, edge: 0.0, pattern: Pattern::Uniform([1.0; 3]) }
    }

    /// The same solid in a uniform colour, linear light.
    #[must_use]
    pub fn colored(self, color: [f64; 3]) -> Self {
        Self { pattern: Pattern::Uniform(color), ..self }
    }
}

impl Procedural for Solid {
    fn bounds(&self) -> Aabb {
        self.form.bounds().inflated(0.5 * self.edge)
    }

    fn span(&self, ray: &Ray) -> Option<(f64, f64)> {
        self.form.span(ray, 0.5 * self.edge)
    }

    fn detail(&self) -> f64 {
        // Silhouettes of hard edges are only as accurate as the step.
        let hard = self.form.thickness() / 16.0;
        let pattern = match &self.pattern {
            Pattern::Checker { size, .. } => *size,
            Pattern::Uniform(_) | Pattern::Gradient { .. } => f64::INFINITY,
        };
        let soft = if self.edge > 0.0 { self.edge } else { f64::INFINITY };
        hard.min(pattern).min(soft)
    }

    fn uniform_color(&self) -> Option<[f64; 3]> {
        self.pattern.uniform()
    }

    fn attributes(&self) -> &[&str] {
        self.pattern.attributes()
    }

    fn attribute(&self, _index: usize, p: DVec3) -> f32 {
        self.pattern.value(p) as f32
    }

    fn sample(&self, p: DVec3) -> ProceduralSample {
        let (implicit, gradient) = self.form.distance(p);
        let inside = if self.edge > 0.0 {
            let x = (0.5 - implicit / self.edge).clamp(0.0, 1.0);
            x * x * (3.0 - 2.0 * x)
        } else if implicit <= 0.0 {
            1.0
        } else {
            0.0
        };
        let color = if inside > 0.0 { self.pattern.color(p) } else { [0.0; 3] };
        ProceduralSample { opacity: self.opacity * inside, implicit, gradient, color }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn forms() -> impl Strategy<Value = Form> {
        let length = || 0.2_f64..2.0;
        prop_oneof![
            length().prop_map(|radius| Form::Sphere { radius }),
            prop::array::uniform3(length()).prop_map(|s| Form::Box { size: DVec3::from_array(s) }),
            (length(), length()).prop_map(|(radius, height)| Form::Cylinder { radius, height }),
            (length(), length()).prop_map(|(radius, height)| Form::Cone { radius, height }),
            (length(), 0.1_f64..0.2).prop_map(|(major, minor)| Form::Torus { major, minor }),
            length().prop_map(|offset| Form::HalfSpace { normal: DVec3::Y, offset }),
            prop::array::uniform3(length()).prop_map(|s| Form::Ellipsoid { radii: DVec3::from_array(s) }),
        ]
    }

    proptest! {
        #[test]
        fn the_gradient_of_a_form_is_that_of_its_distance(
            form in forms(),
            p in prop::array::uniform3(-2.0_f64..2.0),
        ) {
            let p = DVec3::from_array(p);
            let h = 1e-6;
            let (_, gradient) = form.distance(p);
            let slope = |axis: DVec3| (form.distance(p + axis * h).0 - form.distance(p - axis * h).0) / (2.0 * h);
            let numeric = DVec3::new(slope(DVec3::X), slope(DVec3::Y), slope(DVec3::Z));
            // At creases the gradient is undefined; there the numerical one is shorter than 1.
            if let Form::Ellipsoid { .. } = form {
                prop_assume!(form.distance(p).0.abs() < 1e-2);
                prop_assert!(gradient.dot(numeric.normalize()) > 0.99, "{gradient} {numeric}");
            } else {
                prop_assume!((numeric.length() - 1.0).abs() < 1e-4);
                prop_assert!((gradient - numeric).length() < 1e-3, "{gradient} {numeric}");
            }
        }

        #[test]
        fn a_solid_is_transparent_outside_its_span_along_a_ray(
            form in forms(),
            edge in prop::sample::select(vec![0.0, 0.3]),
            origin in prop::array::uniform3(-3.0_f64..3.0),
            through in prop::array::uniform3(-1.0_f64..1.0),
            far in prop::sample::select(vec![1.0, 1e6]),
            axis in 0_usize..6,
        ) {
            let solid = Solid { edge, ..Solid::new(form) };
            let through = DVec3::from_array(through);
            // In any direction, or along an axis.
            let mut direction = through - DVec3::from_array(origin);
            if axis < 3 {
                direction = DVec3::AXES[axis];
            }
            let direction = direction * 0.7;
            let ray = Ray { origin: through - direction * far, direction };
            let span = solid.span(&ray);
            for i in 0..400 {
                // A ray begins at 0.
                let t = (far + (f64::from(i) - 200.0) * 0.02).max(0.0);
                // The rounding error of positions so far away.
                let slack = 1e-9 * far;
                let inside = span.is_some_and(|(enter, exit)| (enter - slack..=exit + slack).contains(&t));
                let place = ray.at(t);
                let opacity = solid.sample(place).opacity;
                // Outside its bounds nothing is ever sampled: the distance of a soft ellipsoid is
                // not exact there.
                let bounded = solid.bounds().contains(place);
                prop_assert!(inside || opacity <= 1e-3 || !bounded, "{opacity} at {t}, {span:?}");
            }
        }

        #[test]
        fn a_solid_is_transparent_outside_its_bounds(
            form in forms(),
            edge in prop::sample::select(vec![0.0, 0.3]),
            p in prop::array::uniform3(-3.0_f64..3.0),
        ) {
            let solid = Solid { edge, ..Solid::new(form) };
            let p = DVec3::from_array(p);
            prop_assert!(solid.bounds().contains(p) || solid.sample(p).opacity == 0.0);
        }
    }
}

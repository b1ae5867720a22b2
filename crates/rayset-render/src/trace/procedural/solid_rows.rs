//! Solids at eight places at a time: the same numbers, bit for bit, as [`Solid`] gives for one
//! place.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f64x8};

use crate::field::BLOCK_SAMPLES;
use crate::scene::{Form, Solid};
use rayset_base::geometry::DVec3;

/// Eight places or vectors, by columns.
pub(super) type Vectors<S> = [f64x8<S>; 3];

/// A solid at eight places.
pub(super) struct SolidRows<S: Simd> {
    /// Opacity, 0 to 1.
    pub(super) opacity: f64x8<S>,
    /// Signed distance to the boundary, negative inside.
    pub(super) implicit: f64x8<S>,
    pub(super) gradient: Vectors<S>,
}

impl<S: Simd> SolidRows<S> {
    /// A solid at places in its own space.
    #[inline(always)]
    pub(super) fn new(simd: S, solid: &Solid, places: Vectors<S>) -> Self {
        let (implicit, gradient) = distances(simd, &solid.form, places);
        let splat = |v| f64x8::splat(simd, v);
        let inside = if solid.edge > 0.0 {
            let x = (splat(0.5) - implicit / splat(solid.edge)).max(splat(0.0)).min(splat(1.0));
            x * x * (splat(3.0) - splat(2.0) * x)
        } else {
            implicit.simd_le(splat(0.0)).select(splat(1.0), splat(0.0))
        };
        Self { opacity: splat(solid.opacity) * inside, implicit, gradient }
    }
}

/// [`Form::distance`] at eight places.
#[inline(always)]
fn distances<S: Simd>(simd: S, form: &Form, p: Vectors<S>) -> (f64x8<S>, Vectors<S>) {
    let splat = |v| f64x8::splat(simd, v);
    let across = [p[0], splat(0.0), p[2]];
    match *form {
        Form::Sphere { radius } => from_sphere(simd, p, radius, DVec3::Y),
        Form::Box { size } => from_box(simd, p, size * 0.5),
        Form::Cylinder { radius, height } => {
            let (around, outward) = from_sphere(simd, across, 0.0, DVec3::X);
            let (distance, [radial, axial]) = from_rectangle(simd, around, p[1], radius, height * 0.5);
            (distance, [outward[0] * radial, axial, outward[2] * radial])
        }
        Form::Torus { major, minor } => {
            let (_, outward) = from_sphere(simd, across, 0.0, DVec3::X);
            let major = splat(major);
            let from_circle = [p[0] - outward[0] * major, p[1], p[2] - outward[2] * major];
            from_sphere(simd, from_circle, minor, DVec3::Y)
        }
        Form::HalfSpace { normal, offset } => {
            let gradient = [splat(normal.x), splat(normal.y), splat(normal.z)];
            (p[0] * gradient[0] + p[1] * gradient[1] + p[2] * gradient[2] - splat(offset), gradient)
        }
        Form::Ellipsoid { radii } => from_ellipsoid(simd, p, radii),
        Form::Cone { .. } => one_by_one(simd, form, p),
    }
}

/// Forms with many cases.
fn one_by_one<S: Simd>(simd: S, form: &Form, p: Vectors<S>) -> (f64x8<S>, Vectors<S>) {
    let (mut distance, mut gradient) = ([0.0; BLOCK_SAMPLES], [[0.0; BLOCK_SAMPLES]; 3]);
    for i in 0..BLOCK_SAMPLES {
        let (d, g) = form.distance(DVec3::new(p[0][i], p[1][i], p[2][i]));
        distance[i] = d;
        (gradient[0][i], gradient[1][i], gradient[2][i]) = (g.x, g.y, g.z);
    }
    (f64x8::from_slice(simd, &distance), gradient.map(|row| f64x8::from_slice(simd, &row)))
}

#[inline(always)]
pub(super) fn length<S: Simd>([x, y, z]: Vectors<S>) -> f64x8<S> {
    (x * x + y * y + z * z).sqrt()
}

/// Distance from a sphere around the origin, and its gradient; `at_centre` is the gradient where
/// there is none.
#[inline(always)]
fn from_sphere<S: Simd>(simd: S, p: Vectors<S>, radius: f64, at_centre: DVec3) -> (f64x8<S>, Vectors<S>) {
    let splat = |v| f64x8::splat(simd, v);
    let length = length(p);
    let per_length = splat(1.0) / length;
    let exists = per_length.simd_gt(splat(0.0)) & per_length.simd_lt(splat(f64::INFINITY));
    let unit = |axis: usize| exists.select(p[axis] * per_length, splat(at_centre[axis]));
    (length - splat(radius), [unit(0), unit(1), unit(2)])
}

#[inline(always)]
fn from_box<S: Simd>(simd: S, p: Vectors<S>, half: DVec3) -> (f64x8<S>, Vectors<S>) {
    let splat = |v| f64x8::splat(simd, v);
    let (zero, one) = (splat(0.0), splat(1.0));
    let q = [p[0].abs() - splat(half.x), p[1].abs() - splat(half.y), p[2].abs() - splat(half.z)];
    let largest = q[0].max(q[1]).max(q[2]);
    let is_outside = largest.simd_gt(zero);
    // The first axis along which a place inside is nearest to a face.
    let x = q[0].simd_eq(largest);
    let y = q[1].simd_eq(largest) & !x;
    let nearest = [x, y, !x & !y];
    let signs = [one.copysign(p[0]), one.copysign(p[1]), one.copysign(p[2])];
    let toward = |axis: usize| nearest[axis].select(signs[axis], zero);
    let mut gradient = [toward(0), toward(1), toward(2)];
    let mut distance = largest;
    if is_outside.any_true() {
        let outside = [q[0].max(zero), q[1].max(zero), q[2].max(zero)];
        let away = length(outside);
        distance = is_outside.select(away, largest);
        for axis in 0..3 {
            gradient[axis] = is_outside.select(signs[axis] * outside[axis] / away, gradient[axis]);
        }
    }
    (distance, gradient)
}

/// Signed distance to a rectangle with half sizes `a` and `b` centred at the origin, and its
/// gradient.
#[inline(always)]
fn from_rectangle<S: Simd>(simd: S, x: f64x8<S>, y: f64x8<S>, a: f64, b: f64) -> (f64x8<S>, [f64x8<S>; 2]) {
    let splat = |v| f64x8::splat(simd, v);
    let (zero, one) = (splat(0.0), splat(1.0));
    let (qx, qy) = (x.abs() - splat(a), y.abs() - splat(b));
    let (sx, sy) = (one.copysign(x), one.copysign(y));
    let d = (qx * qx + qy * qy).sqrt();
    let at_corner = qx.simd_gt(zero) & qy.simd_gt(zero);
    let first = qx.simd_gt(qy);
    let distance = at_corner.select(d, first.select(qx, qy));
    let gradient = [
        at_corner.select(sx * qx / d, first.select(sx, zero)),
        at_corner.select(sy * qy / d, first.select(zero, sy)),
    ];
    (distance, gradient)
}

#[inline(always)]
fn from_ellipsoid<S: Simd>(simd: S, p: Vectors<S>, radii: DVec3) -> (f64x8<S>, Vectors<S>) {
    let splat = |v| f64x8::splat(simd, v);
    let scaled = [p[0] / splat(radii.x), p[1] / splat(radii.y), p[2] / splat(radii.z)];
    let squared = radii * radii;
    let twice = [p[0] / splat(squared.x), p[1] / splat(squared.y), p[2] / splat(squared.z)];
    let (k0, k1) = (length(scaled), length(twice));
    let is_centre = k1.simd_eq(splat(0.0));
    let distance = is_centre.select(splat(-radii.min_element()), k0 * (k0 - splat(1.0)) / k1);
    let per_length = splat(1.0) / k1;
    let unit = |axis: usize| is_centre.select(splat(DVec3::Y[axis]), twice[axis] * per_length);
    (distance, [unit(0), unit(1), unit(2)])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::field::{SimdLevel, dispatch};
    use crate::scene::Procedural;

    type Row = [f64; BLOCK_SAMPLES];

    fn numbers<S: Simd>(simd: S, solid: &Solid, places: &[Row; 3]) -> (Row, Row, [Row; 3]) {
        let places = places.map(|row| f64x8::from_slice(simd, &row));
        let SolidRows { opacity, implicit, gradient } = SolidRows::new(simd, solid, places);
        (opacity.into(), implicit.into(), gradient.map(Into::into))
    }

    fn forms() -> impl Strategy<Value = Form> {
        let length = || prop::sample::select(vec![0.25_f64, 0.5, 0.7, 1.3]);
        prop_oneof![
            length().prop_map(|radius| Form::Sphere { radius }),
            prop::array::uniform3(length()).prop_map(|s| Form::Box { size: DVec3::from_array(s) }),
            (length(), length()).prop_map(|(radius, height)| Form::Cylinder { radius, height }),
            (length(), length()).prop_map(|(radius, height)| Form::Cone { radius, height }),
            (length(), length()).prop_map(|(major, minor)| Form::Torus { major, minor }),
            length().prop_map(|offset| Form::HalfSpace { normal: DVec3::new(0.6, 0.0, -0.8), offset }),
            prop::array::uniform3(length()).prop_map(|s| Form::Ellipsoid { radii: DVec3::from_array(s) }),
        ]
    }

    proptest! {
        #[test]
        fn eight_places_at_a_time_give_the_same_numbers_as_one(
            form in forms(),
            edge in prop::sample::select(vec![0.0, 0.2]),
            // Among them the centre, axes, faces and edges.
            places in prop::array::uniform8(prop::array::uniform3(prop_oneof![
                -1.0_f64..1.0, prop::sample::select(vec![0.0, -0.0, 0.125, -0.25, 0.5])
            ])),
        ) {
            let solid = Solid { edge, opacity: 0.7, ..Solid::new(form) };
            let columns = [0, 1, 2].map(|axis| places.map(|p| p[axis]));
            for simd in SimdLevel::available() {
                let (opacity, implicit, gradient) = dispatch!(simd.level(), simd => numbers(simd, &solid, &columns));
                for (i, place) in places.into_iter().enumerate() {
                    let one = solid.sample(DVec3::from_array(place));
                    let gradient = DVec3::new(gradient[0][i], gradient[1][i], gradient[2][i]);
                    prop_assert_eq!((opacity[i], implicit[i]), (one.opacity, one.implicit));
                    prop_assert_eq!(gradient, one.gradient, "{:?} at {:?}", form, place);
                }
            }
        }
    }
}

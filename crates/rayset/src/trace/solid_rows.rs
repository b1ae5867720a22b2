//! Solids at eight places at a time: the same numbers, bit for bit, as [`Solid`] gives for one place.

use crate::field::BLOCK_SAMPLES;
use crate::geometry::DVec3;
use crate::scene::{Form, Solid};

/// One number for each of eight places.
pub(super) type Row = [f64; BLOCK_SAMPLES];

/// A solid at eight places.
pub(super) struct SolidRows {
    /// Opacity, 0 to 1.
    pub(super) opacity: Row,
    /// Signed distance to the boundary, negative inside.
    pub(super) implicit: Row,
    pub(super) gradient: [Row; 3],
}

// Loops instead of closures: closures are not always inlined where vector code requires it.

impl SolidRows {
    /// A solid at places in its own space, given by columns.
    #[inline(always)]
    pub(super) fn new(solid: &Solid, places: &[Row; 3]) -> Self {
        let (implicit, gradient) = distances(&solid.form, places);
        let mut opacity = [0.0; BLOCK_SAMPLES];
        if solid.edge > 0.0 {
            for i in 0..BLOCK_SAMPLES {
                let x = (0.5 - implicit[i] / solid.edge).clamp(0.0, 1.0);
                opacity[i] = solid.opacity * (x * x * (3.0 - 2.0 * x));
            }
        } else {
            for i in 0..BLOCK_SAMPLES {
                opacity[i] = solid.opacity * if implicit[i] <= 0.0 { 1.0 } else { 0.0 };
            }
        }
        Self { opacity, implicit, gradient }
    }
}

/// [`Form::distance`] at eight places.
#[inline(always)]
fn distances(form: &Form, p: &[Row; 3]) -> (Row, [Row; 3]) {
    match *form {
        Form::Sphere { radius } => from_sphere(p, radius, [0.0, 1.0, 0.0]),
        Form::Box { size } => from_box(p, size * 0.5),
        Form::Cylinder { radius, height } => from_cylinder(p, radius, height * 0.5),
        Form::Torus { major, minor } => {
            let (_, outward) = from_sphere(&[p[0], [0.0; BLOCK_SAMPLES], p[2]], 0.0, [1.0, 0.0, 0.0]);
            let mut from_circle = *p;
            for axis in 0..3 {
                for i in 0..BLOCK_SAMPLES {
                    from_circle[axis][i] = p[axis][i] - outward[axis][i] * major;
                }
            }
            from_sphere(&from_circle, minor, [0.0, 1.0, 0.0])
        }
        Form::HalfSpace { normal, offset } => {
            let mut distance = [0.0; BLOCK_SAMPLES];
            for i in 0..BLOCK_SAMPLES {
                distance[i] = p[0][i] * normal.x + p[1][i] * normal.y + p[2][i] * normal.z - offset;
            }
            (distance, [[normal.x; BLOCK_SAMPLES], [normal.y; BLOCK_SAMPLES], [normal.z; BLOCK_SAMPLES]])
        }
        Form::Ellipsoid { radii } => from_ellipsoid(p, radii),
        Form::Cone { .. } => one_by_one(form, p),
    }
}

/// Forms with many cases.
fn one_by_one(form: &Form, p: &[Row; 3]) -> (Row, [Row; 3]) {
    let (mut distance, mut gradient) = ([0.0; BLOCK_SAMPLES], [[0.0; BLOCK_SAMPLES]; 3]);
    for i in 0..BLOCK_SAMPLES {
        let (d, g) = form.distance(DVec3::new(p[0][i], p[1][i], p[2][i]));
        distance[i] = d;
        (gradient[0][i], gradient[1][i], gradient[2][i]) = (g.x, g.y, g.z);
    }
    (distance, gradient)
}

#[inline(always)]
fn lengths([x, y, z]: &[Row; 3]) -> Row {
    let mut length = [0.0; BLOCK_SAMPLES];
    for i in 0..BLOCK_SAMPLES {
        length[i] = (x[i] * x[i] + y[i] * y[i] + z[i] * z[i]).sqrt();
    }
    length
}

/// Distance from a sphere around the origin, and its gradient; `at_centre` is the gradient where there is none.
#[inline(always)]
fn from_sphere(p: &[Row; 3], radius: f64, at_centre: [f64; 3]) -> (Row, [Row; 3]) {
    let length = lengths(p);
    let (mut distance, mut gradient) = ([0.0; BLOCK_SAMPLES], [[0.0; BLOCK_SAMPLES]; 3]);
    for i in 0..BLOCK_SAMPLES {
        distance[i] = length[i] - radius;
    }
    for axis in 0..3 {
        for i in 0..BLOCK_SAMPLES {
            let per_length = 1.0 / length[i];
            let exists = per_length > 0.0 && per_length < f64::INFINITY;
            gradient[axis][i] = if exists { p[axis][i] * per_length } else { at_centre[axis] };
        }
    }
    (distance, gradient)
}

#[inline(always)]
fn from_box(p: &[Row; 3], half: DVec3) -> (Row, [Row; 3]) {
    let (mut q, mut outside) = ([[0.0; BLOCK_SAMPLES]; 3], [[0.0; BLOCK_SAMPLES]; 3]);
    for axis in 0..3 {
        for i in 0..BLOCK_SAMPLES {
            q[axis][i] = p[axis][i].abs() - half[axis];
            outside[axis][i] = q[axis][i].max(0.0);
        }
    }
    let away = lengths(&outside);
    let (mut distance, mut gradient) = ([0.0; BLOCK_SAMPLES], [[0.0; BLOCK_SAMPLES]; 3]);
    for i in 0..BLOCK_SAMPLES {
        let largest = q[0][i].max(q[1][i].max(q[2][i]));
        let is_outside = largest > 0.0;
        distance[i] = if is_outside { away[i] } else { largest };
        // The first axis along which it is nearest to a face.
        let x = q[0][i] == largest;
        let y = !x & (q[1][i] == largest);
        let nearest = [x, y, !x & !y];
        for axis in 0..3 {
            let sign = 1_f64.copysign(p[axis][i]);
            let toward_face = if nearest[axis] { sign } else { 0.0 };
            gradient[axis][i] = if is_outside { sign * outside[axis][i] / away[i] } else { toward_face };
        }
    }
    (distance, gradient)
}

#[inline(always)]
fn from_cylinder(p: &[Row; 3], radius: f64, half_height: f64) -> (Row, [Row; 3]) {
    let across = [p[0], [0.0; BLOCK_SAMPLES], p[2]];
    let (around, outward) = from_sphere(&across, 0.0, [1.0, 0.0, 0.0]);
    let (mut distance, mut gradient) = ([0.0; BLOCK_SAMPLES], [[0.0; BLOCK_SAMPLES]; 3]);
    for i in 0..BLOCK_SAMPLES {
        let (qx, qy) = (around[i] - radius, p[1][i].abs() - half_height);
        let (sx, sy) = (1_f64.copysign(around[i]), 1_f64.copysign(p[1][i]));
        let at_corner = (qx > 0.0) & (qy > 0.0);
        let d = (qx * qx + qy * qy).sqrt();
        let radially = qx > qy;
        distance[i] = if at_corner { d } else { qx.max(qy) };
        let radial = if at_corner { sx * qx / d } else { f64::from(u8::from(radially)) * sx };
        let axial = if at_corner { sy * qy / d } else { f64::from(u8::from(!radially)) * sy };
        gradient[0][i] = outward[0][i] * radial;
        gradient[1][i] = axial;
        gradient[2][i] = outward[2][i] * radial;
    }
    (distance, gradient)
}

#[inline(always)]
fn from_ellipsoid(p: &[Row; 3], radii: DVec3) -> (Row, [Row; 3]) {
    let (mut scaled, mut twice) = (*p, *p);
    for axis in 0..3 {
        for i in 0..BLOCK_SAMPLES {
            scaled[axis][i] = p[axis][i] / radii[axis];
            twice[axis][i] = p[axis][i] / (radii[axis] * radii[axis]);
        }
    }
    let (k0, k1) = (lengths(&scaled), lengths(&twice));
    let (mut distance, mut gradient) = ([0.0; BLOCK_SAMPLES], [[0.0; BLOCK_SAMPLES]; 3]);
    let at_centre = [0.0, 1.0, 0.0];
    for i in 0..BLOCK_SAMPLES {
        let is_centre = k1[i] == 0.0;
        distance[i] = if is_centre { -radii.min_element() } else { k0[i] * (k0[i] - 1.0) / k1[i] };
        for axis in 0..3 {
            let per_length = 1.0 / k1[i];
            gradient[axis][i] = if is_centre { at_centre[axis] } else { twice[axis][i] * per_length };
        }
    }
    (distance, gradient)
}

#[cfg(test)]
mod tests {
    use fearless_simd::dispatch;
    use proptest::prelude::*;

    use super::*;
    use crate::field::SimdLevel;
    use crate::scene::Procedural;

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
                let rows = dispatch!(simd.level(), _simd => SolidRows::new(&solid, &columns));
                for (i, place) in places.into_iter().enumerate() {
                    let one = solid.sample(DVec3::from_array(place));
                    let gradient = DVec3::new(rows.gradient[0][i], rows.gradient[1][i], rows.gradient[2][i]);
                    prop_assert_eq!((rows.opacity[i], rows.implicit[i]), (one.opacity, one.implicit));
                    prop_assert_eq!(gradient, one.gradient, "{:?} at {:?}", form, place);
                }
            }
        }
    }
}

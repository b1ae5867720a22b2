//! The shape of a point: the semi-axes of its ellipsoid, relative to its radius, and their
//! directions.

use super::{DMat3, DQuat, DVec3};

/// The shape of a point of radius r: an ellipsoid of semi-axes r, r·a₂ and r·a₃. The largest is the
/// radius, so that bounds by radius hold whatever the shape is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shape {
    /// Turns the axes x, y and z to the directions of the semi-axes, longest first. Of length one.
    pub rotation: DQuat,
    /// a₂ and a₃: 1 ≥ a₂ ≥ a₃ > 0.
    pub ratios: [f64; 2],
}

impl Shape {
    /// That of a ball.
    pub const BALL: Self = Self { rotation: DQuat::IDENTITY, ratios: [1.0; 2] };

    /// The radius and the shape of an ellipsoid with semi-axes of these lengths, in any order,
    /// along the axes x, y and z turned by a rotation, which need not be of length one. `None` if a
    /// length is not a finite number above 0, or the rotation is none.
    #[must_use]
    pub fn of_semi_axes(lengths: [f64; 3], rotation: DQuat) -> Option<(f64, Self)> {
        let largest = rotation.to_array().into_iter().fold(0.0, |largest: f64, v| largest.max(v.abs()));
        let is_usable = lengths.iter().all(|&length| length > 0.0 && length.is_finite())
            && largest > 0.0
            && rotation.is_finite();
        if !is_usable {
            return None;
        }
        // Divided first, because squares of numbers that are small or large enough are 0 or
        // infinite.
        let axes = DMat3::from_quat((rotation / largest).normalize());
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| lengths[b].total_cmp(&lengths[a]));
        let [longest, middle, shortest] = order;
        let (x, y) = (axes.col(longest), axes.col(middle));
        let radius = lengths[longest];
        let ratios = [lengths[middle] / radius, lengths[shortest] / radius];
        // An axis may point either way: the third so that the three are a rotation.
        let rotation = DQuat::from_mat3(&DMat3::from_cols(x, y, x.cross(y)));
        (ratios[1] > 0.0).then_some((radius, Self { rotation, ratios }))
    }

    /// Whether it is a ball.
    #[must_use]
    pub fn is_ball(&self) -> bool {
        self.ratios == [1.0; 2]
    }

    /// The semi-axes of a point of radius one, as columns, longest first.
    #[must_use]
    pub fn semi_axes(&self) -> DMat3 {
        let axes = DMat3::from_quat(self.rotation);
        DMat3::from_cols(axes.x_axis, axes.y_axis * self.ratios[0], axes.z_axis * self.ratios[1])
    }

    /// A = diag(1, 1/a₂, 1/a₃) Rᵀ: for a point of radius one at the origin, |A q| is the distance
    /// of q in its units, 1 on the surface of its ellipsoid.
    #[must_use]
    pub fn unit_from_local(&self) -> DMat3 {
        let axes = DMat3::from_quat(self.rotation);
        let [a2, a3] = self.ratios;
        DMat3::from_cols(axes.x_axis, axes.y_axis / a2, axes.z_axis / a3).transpose()
    }

    /// Half the edges of the smallest box around a point of radius one: along axis k it is
    /// √Σⱼ(Rₖⱼ aⱼ)².
    #[must_use]
    pub fn half_extent(&self) -> DVec3 {
        let rows = self.semi_axes().transpose();
        DVec3::new(rows.x_axis.length(), rows.y_axis.length(), rows.z_axis.length())
    }

    /// The volume of the ellipsoid as a part of that of the ball of its radius.
    #[must_use]
    pub fn volume(&self) -> f64 {
        self.ratios[0] * self.ratios[1]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn vector(size: f64) -> impl Strategy<Value = DVec3> {
        prop::array::uniform3(-size..size).prop_map(DVec3::from_array)
    }

    fn lengths() -> impl Strategy<Value = [f64; 3]> {
        prop::array::uniform3((-4.0..0.0_f64).prop_map(|exponent| 10_f64.powf(exponent)))
    }

    fn quaternion() -> impl Strategy<Value = DQuat> {
        let numbers = prop::array::uniform4(-1.0..1.0_f64);
        let far_from_zero = numbers.prop_filter("a rotation", |q| q.iter().any(|v| v.abs() > 0.1));
        (far_from_zero, prop::sample::select(vec![1.0, 1e-200, 1e200]))
            .prop_map(|(q, scale)| DQuat::from_array(q.map(|v| v * scale)))
    }

    proptest! {
        #[test]
        fn an_ellipsoid_is_the_same_set_of_places_whatever_the_order_of_its_axes(
            lengths in lengths(),
            rotation in quaternion(),
            place in vector(2.0),
        ) {
            let (radius, shape) = Shape::of_semi_axes(lengths, rotation).unwrap();
            prop_assert!(shape.ratios[0] <= 1.0 && shape.ratios[1] <= shape.ratios[0]);
            prop_assert!((shape.rotation.length() - 1.0).abs() < 1e-12);
            let largest = rotation.to_array().into_iter().fold(0.0, |a: f64, v| a.max(v.abs()));
            let turned = (rotation / largest).normalize().inverse() * place;
            let expected = (turned / DVec3::from_array(lengths)).length();
            let distance = (shape.unit_from_local() * place / radius).length();
            prop_assert!((distance - expected).abs() <= 1e-9 * expected, "{distance} and {expected}");
            let volume = shape.volume() * radius.powi(3);
            prop_assert!((volume / lengths.iter().product::<f64>() - 1.0).abs() < 1e-12);
        }

        #[test]
        fn a_box_touches_its_ellipsoid_on_every_side(lengths in lengths(), rotation in quaternion()) {
            let (_, shape) = Shape::of_semi_axes(lengths, rotation).unwrap();
            let axes = shape.semi_axes();
            for axis in 0..3 {
                // The place farthest along an axis is the image of that axis, by the transpose.
                let farthest = axes * (axes.transpose().col(axis)).normalize();
                let half = shape.half_extent()[axis];
                prop_assert!((farthest[axis] / half - 1.0).abs() < 1e-12);
                prop_assert!(((shape.unit_from_local() * farthest).length() - 1.0).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn what_is_no_ellipsoid_has_no_shape() {
        let rotation = DQuat::from_rotation_x(0.3);
        for length in [0.0, -1.0, f64::NAN, f64::INFINITY, -0.0] {
            assert_eq!(Shape::of_semi_axes([1.0, length, 1.0], rotation), None, "{length}");
        }
        assert_eq!(Shape::of_semi_axes([1e300, 1.0, 1e-300], rotation), None, "a ratio of zero");
        for q in [[0.0; 4], [f64::NAN, 0.0, 0.0, 1.0], [f64::INFINITY, 0.0, 0.0, 1.0]] {
            assert_eq!(Shape::of_semi_axes([1.0; 3], DQuat::from_array(q)), None, "{q:?}");
        }
        let (radius, shape) = Shape::of_semi_axes([2.0; 3], rotation).unwrap();
        assert!(radius == 2.0 && shape.is_ball());
    }
}

//! Shapes of points as files store them: ten bytes each.
//!
//! Of a rotation the three smallest components of its quaternion are stored, 15 bits each: they err
//! by half of 1/(16383·√2) at most, the axes by less than a hundredth of a degree. A ratio is
//! stored as a number of 4 bits of exponent and 12 of mantissa, of 2⁻¹⁶ to 1: it errs by 1/8192 of
//! itself.

use rayset_base::geometry::{DQuat, DVec3, Shape};

/// Columns of two bytes a point that a shape takes.
pub const SHAPE_COLUMNS: usize = 5;

/// The least ratio that is stored. Thinner axes become so thick.
pub const LEAST_RATIO: f64 = 1.0 / 65_536.0 * (1.0 + 1.0 / 4096.0);

/// A shape as it is stored: three words of the rotation, two of the ratios.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StoredShape(pub [u16; SHAPE_COLUMNS]);

/// The largest size of a component that is not the largest, as a 15-bit number about [`ZERO`].
const MOST: f64 = 16_383.0;
const ZERO: i32 = 16_384;

/// Of a ratio in single precision, the bits of 2⁻¹⁶, and how many are left out.
const LEAST_BITS: u32 = (127 - 16) << 23;
const LEFT_OUT: u32 = 23 - 12;

impl StoredShape {
    /// That of a ball.
    pub const BALL: Self =
        Self([ZERO as u16 | 1 << 15, ZERO as u16 | 1 << 15, ZERO as u16, u16::MAX, u16::MAX]);

    /// Its ten bytes.
    #[must_use]
    pub fn to_bytes(self) -> [u8; 2 * SHAPE_COLUMNS] {
        std::array::from_fn(|i| self.0[i / 2].to_le_bytes()[i % 2])
    }

    /// That of ten bytes.
    #[must_use]
    pub fn from_bytes(bytes: [u8; 2 * SHAPE_COLUMNS]) -> Self {
        Self(std::array::from_fn(|word| u16::from_le_bytes([bytes[2 * word], bytes[2 * word + 1]])))
    }

    /// The nearest shape that can be stored.
    #[must_use]
    pub fn encode(shape: &Shape) -> Self {
        let q = shape.rotation.to_array();
        let largest = (1..4).fold(0, |largest, i| if q[i].abs() > q[largest].abs() { i } else { largest });
        // A quaternion and its opposite are one rotation: the largest component is positive.
        let sign = 1_f64.copysign(q[largest]);
        let small = smaller(largest).map(|i| {
            let number = (q[i] * sign * std::f64::consts::SQRT_2 * MOST).round().clamp(-MOST, MOST);
            (number as i32 + ZERO) as u16
        });
        let [low, high] = [largest & 1, largest >> 1].map(|bit| (bit as u16) << 15);
        let [a2, a3] = shape.ratios.map(code_of_ratio);
        Self([small[0] | low, small[1] | high, small[2], a2, a3])
    }

    /// The shape.
    #[must_use]
    #[inline]
    pub fn decode(self) -> Shape {
        let Self([a, b, c, a2, a3]) = self;
        let largest = usize::from(a >> 15 | b >> 15 << 1);
        let small = [a, b, c].map(|word| f64::from(Self::component(word)));
        let squares = small.iter().map(|v| v * v).sum::<f64>();
        let mut q = [0.0; 4];
        smaller(largest).into_iter().zip(small).for_each(|(i, v)| q[i] = v);
        q[largest] = (1.0 - squares).max(0.0).sqrt();
        // Of length one, unless the words are of no rotation.
        let rotation = DQuat::from_array(q).normalize();
        let [a2, a3] = [a2, a3].map(|code| f64::from(Self::ratio(code)));
        Shape { rotation, ratios: [a2, a3.min(a2)] }
    }

    /// A component of the rotation that is not the largest, from its word: exact, but for one
    /// rounding.
    #[must_use]
    #[inline(always)]
    pub fn component(word: u16) -> f32 {
        const UNIT: f32 = (1.0 / (MOST * std::f64::consts::SQRT_2)) as f32;
        (i32::from(word & 0x7fff) - ZERO) as f32 * UNIT
    }

    /// A ratio, from its word: exact.
    #[must_use]
    #[inline(always)]
    pub fn ratio(code: u16) -> f32 {
        f32::from_bits(LEAST_BITS + ((u32::from(code) + 1) << LEFT_OUT))
    }

    /// The detail of a point of this radius, of which steps are a part: twice the shortest
    /// semi-axis, but no more than the radius. Twice, because most rays cross what is flat
    /// obliquely or end in it: so pictures of discs err less than those of balls do at their radius
    /// (docs/benchmarks.md, "Automatic radii and shapes").
    #[must_use]
    #[inline]
    pub fn detail(self, radius: f32) -> f32 {
        let [_, _, _, a2, a3] = self.0;
        radius * (2.0 * Self::ratio(a3.min(a2))).min(1.0)
    }

    /// Half the edges of the smallest box around a point of this radius.
    #[must_use]
    pub fn half_extent(self, radius: f32) -> DVec3 {
        self.decode().half_extent() * f64::from(radius)
    }
}

/// The components of a quaternion besides one.
#[inline]
fn smaller(largest: usize) -> [usize; 3] {
    [1, 2, 3].map(|further| (largest + further) % 4)
}

fn code_of_ratio(ratio: f64) -> u16 {
    let bits = (ratio.clamp(LEAST_RATIO, 1.0) as f32).to_bits() - LEAST_BITS;
    let rounded = (bits + (1 << (LEFT_OUT - 1))) >> LEFT_OUT;
    (rounded.saturating_sub(1)).min(u32::from(u16::MAX)) as u16
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_stored_shape_is_close_to_its_own_and_stored_again_it_is_close_to_that(
            q in prop::array::uniform4(-1.0..1.0_f64),
            exponents in prop::array::uniform2(-16.0..0.0_f64),
        ) {
            prop_assume!(q.iter().any(|v| v.abs() > 0.1));
            let rotation = DQuat::from_array(q).normalize();
            let [a, b] = exponents.map(f64::exp2);
            let shape = Shape { rotation, ratios: [a.max(b), a.min(b)] };
            let stored = StoredShape::encode(&shape);
            let decoded = stored.decode();
            prop_assert!((decoded.rotation.length() - 1.0).abs() < 1e-12);
            let turn = 2.0 * decoded.rotation.dot(rotation).abs().min(1.0).acos();
            prop_assert!(turn.to_degrees() < 0.01, "{} degrees", turn.to_degrees());
            for (is, was) in decoded.ratios.iter().zip(shape.ratios) {
                prop_assert!((is / was.max(LEAST_RATIO) - 1.0).abs() <= 1.0 / 8192.0, "{is} of {was}");
            }
            // Where two components are about the same, the other one may be left out then.
            let again = StoredShape::encode(&decoded).decode();
            prop_assert!(again.rotation.dot(decoded.rotation).abs().min(1.0).acos().to_degrees() < 0.01);
            prop_assert_eq!(again.ratios, decoded.ratios);
        }

        #[test]
        fn any_ten_bytes_are_a_shape(words in prop::array::uniform5(any::<u16>())) {
            let Shape { rotation, ratios: [a2, a3] } = StoredShape(words).decode();
            prop_assert!((rotation.length() - 1.0).abs() < 1e-12);
            prop_assert!(LEAST_RATIO <= a3 && a3 <= a2 && a2 <= 1.0);
        }
    }

    #[test]
    fn the_words_of_a_shape_are_those_that_the_format_says() {
        let shape = Shape { rotation: DQuat::from_xyzw(0.0, 0.0, 0.8, 0.6), ratios: [0.5, 0.25] };
        // The largest is number 2; behind it follow w, x and y.
        let words = [16_384 + 13_901, 16_384 | 1 << 15, 16_384, (15 << 12) - 1, (14 << 12) - 1];
        assert_eq!(StoredShape::encode(&shape).0, words);
        let opposite = Shape { rotation: -shape.rotation, ..shape };
        assert_eq!(StoredShape::encode(&opposite).0, words);
        assert_eq!(StoredShape([16_384, 16_384, 16_384, 65_535, 0]).decode().ratios, [1.0, LEAST_RATIO]);
    }

    #[test]
    fn a_ball_and_axes_that_are_x_y_and_z_in_this_order_are_stored_exactly() {
        assert_eq!(StoredShape::encode(&Shape::BALL), StoredShape::BALL);
        assert_eq!(StoredShape::BALL.decode(), Shape::BALL);
        assert_eq!(
            (StoredShape::BALL.detail(0.3), StoredShape::BALL.half_extent(2.0)),
            (0.3, DVec3::splat(2.0))
        );
        let half = Shape { rotation: DQuat::IDENTITY, ratios: [0.5, 0.25] };
        assert_eq!(StoredShape::encode(&half).decode(), half);
        let turned = Shape { rotation: DQuat::from_xyzw(1.0, 0.0, 0.0, 0.0), ..half };
        assert_eq!(StoredShape::encode(&turned).decode(), turned);
        let thin = StoredShape::encode(&Shape { ratios: [1e-30; 2], ..half }).decode();
        assert_eq!(thin.ratios, [LEAST_RATIO; 2]);
    }
}

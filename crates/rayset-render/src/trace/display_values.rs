//! Between linear light and the values that displays are given, in which rays of splats are
//! composited ([`Compositing::Display`](crate::scene::Compositing)).

use crate::math::{display_from_linear, linear_from_display};

/// Converts many numbers from linear light.
#[inline(always)]
pub(super) fn all_from_linear<const N: usize>(values: &mut [f32; N]) {
    for v in values {
        *v = display_from_linear(*v);
    }
}

/// Converts many numbers to linear light.
#[inline(always)]
pub(super) fn all_to_linear<const N: usize>(values: &mut [f32; N]) {
    for v in values {
        *v = linear_from_display(*v);
    }
}

/// A pixel in linear light, of one in display values: premultiplied, with its opacity.
pub(super) fn pixel_to_linear([red, green, blue, opacity]: [f32; 4]) -> [f32; 4] {
    if opacity <= 0.0 {
        return [red, green, blue, opacity];
    }
    let [red, green, blue] = [red, green, blue].map(|v| linear_from_display(v / opacity) * opacity);
    [red, green, blue, opacity]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::linear_from_srgb;
    use crate::image::srgb_from_linear;

    #[test]
    fn light_and_display_values_are_those_of_the_standard_and_undo_each_other() {
        for i in 0..=200_000_u32 {
            let x = f64::from(i) * 1e-5 + f64::from(i).powi(3) * 1e-13;
            let (display, linear) = (srgb_from_linear(x), linear_from_srgb(x));
            let close = |found: f32, exact: f64| (f64::from(found) - exact).abs() <= 4e-6 * exact;
            assert!(close(display_from_linear(x as f32), display), "{x}: {display}");
            assert!(close(linear_from_display(x as f32), linear), "{x}: {linear}");
            let back = linear_from_display(display_from_linear(x as f32));
            assert!((f64::from(back) - x).abs() <= 2e-5 * x, "{x}: {back}");
        }
    }

    #[test]
    fn a_pixel_that_is_partly_open_keeps_its_opacity_and_the_colour_of_what_covers_it() {
        assert_eq!(pixel_to_linear([0.0; 4]), [0.0; 4]);
        let [red, green, blue, opacity] = pixel_to_linear([0.25, 0.5, 0.0, 0.5]);
        assert_eq!((blue, opacity), (0.0, 0.5));
        assert!((red - 0.5 * linear_from_display(0.5)).abs() < 1e-6, "{red}");
        assert!((green - 0.5).abs() < 1e-6, "{green}");
    }
}

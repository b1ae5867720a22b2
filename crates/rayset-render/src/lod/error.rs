//! How wrong a pixel may be that is seen from afar. The constants are measured: docs/lod.md.

/// Of the deviation of what is either there or not.
const OF_DEVIATION: f64 = 1.25;
/// What is added to it: so much for each of the opacity of lumps, and at most.
const OF_LUMPS: f64 = 5.0;
const MOST_OF_LUMPS: f64 = 0.06;
/// The mean error, as a part of the mean bound.
pub(crate) const MEAN_OF_BOUND: f64 = 0.2;

/// By how much the opacity of a pixel differs from that by many rays at most, but for 5 pixels of
/// 100. `lump_opacity`, 0 to 1, is how opaque the lumps are that make the opacity, in the mean over
/// what the pixel's rays see: of what covers a part of a pixel, and 0 of what is not seen from
/// afar.
///
/// Aggregates know how much of a pixel is covered, and not where. So the error is like that of
/// lumps which are there or not by chance. Of opaque ones in one layer the deviation is
/// √(o·(1 − o)); of the many faint ones of a mist it is smaller by the root of their opacity.
pub(crate) fn bound_of_error(opacity: f64, lump_opacity: f64) -> f64 {
    let (opacity, lump_opacity) = (opacity.clamp(0.0, 1.0), lump_opacity.clamp(0.0, 1.0));
    let deviation = (opacity * (1.0 - opacity) * lump_opacity).sqrt();
    OF_DEVIATION * deviation + (OF_LUMPS * lump_opacity).min(MOST_OF_LUMPS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_bounded_by_more_where_lumps_are_opaque_and_pixels_half_hidden() {
        assert_eq!([0.0, 0.5, 1.0].map(|opacity| bound_of_error(opacity, 0.0)), [0.0; 3]);
        assert_eq!(bound_of_error(1.0, 1.0), MOST_OF_LUMPS);
        assert!((bound_of_error(0.5, 1.0) - 0.685).abs() < 1e-12);
        assert!((bound_of_error(0.5, 0.01) - (0.0625 + 0.05)).abs() < 1e-12);
        assert!([f64::NAN, -1.0].into_iter().all(|odd| !(bound_of_error(0.5, odd) > 0.0)));
    }
}

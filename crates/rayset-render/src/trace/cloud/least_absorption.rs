//! How much samples of a cloud absorb at least, by their densities: what rays are known to have
//! ended by before opacities are computed.

use crate::field::LeastAbsorption;
use crate::scene::{MAX_OPACITY, OpacityRule};
use crate::trace::node_samples::MAX_OPTICAL_DEPTH;

/// What an optical depth may be too little by once an opacity, rounded to single precision, has
/// been in between. Where steps are many unit distances long, it is not little.
const ROUNDED: f64 = 2e-7;
/// The steepest line; far from the largest number, so that no product is NaN.
const STEEPEST: f64 = 1e30;

/// For the opacities of a rule: a lower bound of optical depths per unit distance. `None` if it is
/// 0 everywhere.
pub(super) fn least_absorption(rule: &OpacityRule, unit_distance: f64) -> Option<LeastAbsorption> {
    let (always, most) = (f32::INFINITY, MAX_OPTICAL_DEPTH);
    match rule {
        OpacityRule::Extinction(kappa) => line(0.0, kappa * unit_distance, (always, most)),
        // −ln(1 − D) is more than D.
        OpacityRule::Clamp => line(0.0, 1.0, (MAX_OPACITY as f32, most)),
        OpacityRule::Curve(points) => below_curve(points),
    }
}

/// A line that rises from a density on, and what holds from another density on, where it is more
/// than the line; `None` if neither is above 0.
fn line(from: f64, per_density: f64, (full, when_full): (f32, f32)) -> Option<LeastAbsorption> {
    let per_density = per_density.min(STEEPEST);
    let rises = per_density > 0.0 && per_density as f32 > 0.0;
    // Past where it is rounded to.
    let from = if rises { ((from + ROUNDED / per_density) as f32).next_up() } else { f32::MAX };
    let per_density = if rises { per_density as f32 } else { 0.0 };
    let bound = LeastAbsorption { from, per_density, most: MAX_OPTICAL_DEPTH, full, when_full };
    (rises || when_full > 0.0).then_some(bound)
}

/// Through (density, opacity) pairs: a line from where the curve begins to rise that no point is
/// below, and behind the last point its height. An optical depth is more than its opacity.
fn below_curve(points: &[(f64, f64)]) -> Option<LeastAbsorption> {
    let &(last, height) = points.last()?;
    // Empty space absorbs nothing, whatever the curve says of densities of 0 and below.
    let full = (last as f32).next_up().max(f32::MIN_POSITIVE);
    let when_full = (-(-height.min(MAX_OPACITY)).ln_1p() - ROUNDED).max(0.0) as f32;
    let from = points.iter().take_while(|p| p.1 == 0.0).last().map_or(0.0, |p| p.0.max(0.0));
    let ahead = points.iter().filter(|p| p.0 > from);
    let slope = ahead.map(|&(density, opacity)| opacity / (density - from));
    let slope = slope.fold(f64::INFINITY, f64::min);
    line(from, if slope < f64::INFINITY { slope } else { 0.0 }, (full, when_full))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::ln;
    use crate::trace::knots::Curve;
    use proptest::prelude::*;

    /// The optical depth per unit distance that a picture has at a density, by way of its opacity.
    fn depth(rule: &OpacityRule, unit_distance: f64, density: f32) -> f32 {
        let opacity = match rule {
            _ if !(density > 0.0) => 0.0,
            OpacityRule::Curve(points) => Curve::new(points).at(density).min(MAX_OPACITY) as f32,
            _ => rule.opacity(f64::from(density), unit_distance) as f32,
        };
        if opacity > 0.0 { -ln(1.0 - opacity.min(MAX_OPACITY as f32)) } else { 0.0 }
    }

    fn any_rule() -> impl Strategy<Value = OpacityRule> {
        let points = (
            prop::collection::vec(0_u32..24, 1..9),
            prop::collection::vec(prop::sample::select(vec![0.0, 0.0, 1e-9, 1e-3, 0.3, 0.9, 1.0]), 9),
            prop::sample::select(vec![(0.0, 1.0), (-12.0, 1.0), (-30.0, 1.0), (0.0, 1e-20), (5.0, 1e12)]),
        );
        let curve = points.prop_map(|(mut places, heights, (low, width))| {
            places.sort_unstable();
            let places = places.iter().map(|&p| (low + f64::from(p)) * width);
            OpacityRule::Curve(places.zip(heights).collect())
        });
        prop_oneof![
            4 => curve,
            1 => Just(OpacityRule::Clamp),
            1 => prop::sample::select(vec![0.0, 1e-30, 1e-3, 1.0, 1e9]).prop_map(OpacityRule::Extinction),
        ]
    }

    proptest! {
        #[test]
        fn no_sample_absorbs_less_than_what_is_known_before_its_opacity(
            rule in any_rule(),
            unit_distance in prop::sample::select(vec![1e-6, 1.0, 1e6]),
            places in prop::collection::vec(-0.2_f64..1.3, 32),
        ) {
            let Some(least) = least_absorption(&rule, unit_distance) else { return Ok(()) };
            let points = if let OpacityRule::Curve(points) = &rule { points.clone() } else { vec![(1.0, 1.0)] };
            let (low, high) = (points[0].0.min(0.0), points[points.len() - 1].0);
            let anywhere = places.into_iter().map(|at| low + at * (high - low));
            let small = [f64::NAN, -1.0, 0.0, 1e-40, 1e-12, f64::from(least.from)];
            for density in anywhere.chain(points.iter().map(|p| p.0)).chain(small) {
                let density = density as f32;
                for density in [density.next_down(), density, density.next_up()] {
                    let (least, is) = (least.of(density), depth(&rule, unit_distance, density));
                    // What is known beforehand is held to a thousandth less.
                    prop_assert!(least <= is * 1.0005, "{least} of {is} at {density:e}: {rule:?}");
                }
            }
        }
    }

    #[test]
    fn what_rises_is_foreseen_and_what_stays_empty_is_not() {
        let of = |points: &[(f64, f64)]| least_absorption(&OpacityRule::Curve(points.to_vec()), 1.0);
        let ramp = of(&[(0.5, 0.0), (1.5, 1.0)]).expect("it rises");
        assert!((ramp.of(1.0) - 0.5).abs() < 1e-5 && ramp.of(0.5) == 0.0 && ramp.of(2.0) > 8.3);
        assert!(of(&[(0.5, 0.0), (0.5, 0.9)]).is_some_and(|step| step.of(0.6) > 2.3));
        assert!(of(&[(0.0, 0.0), (1.0, 1.0), (2.0, 0.0)]).is_none());
    }
}

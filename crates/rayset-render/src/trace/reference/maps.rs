//! Evaluation of colour maps and curves, stop by stop.

use crate::field::linear_from_srgb;
use crate::scene::ColorMap;

/// The colour of a value, linear light.
pub(super) fn color(map: &ColorMap, value: f64) -> [f64; 3] {
    let (low, high) = map.range;
    let place = (value - low) / (high - low);
    let place = if place > 0.0 { place.min(1.0) } else { 0.0 };
    let encoded = line(&map.palette.stops(), place, |color| *color);
    encoded.map(linear_from_srgb)
}

/// Linear interpolation at `x` between stops in ascending order of places: between the last stop at
/// or before `x` and the first one after it.
pub(super) fn line<T, const N: usize>(stops: &[(f64, T)], x: f64, of: impl Fn(&T) -> [f64; N]) -> [f64; N] {
    let before = stops.iter().rev().find(|(at, _)| *at <= x);
    let behind = stops.iter().find(|(at, _)| *at > x);
    match (before, behind) {
        (Some((a, from)), Some((b, to))) => {
            let (from, to, part) = (of(from), of(to), (x - a) / (b - a));
            std::array::from_fn(|c| (1.0 - part) * from[c] + part * to[c])
        }
        (Some((_, only)), None) | (None, Some((_, only))) => of(only),
        (None, None) => [0.0; N],
    }
}

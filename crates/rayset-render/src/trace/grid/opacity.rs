//! The opacity rule of a grid for many values at once, and where it shows anything.
//!
//! Values are counted from where the rule begins to show anything, in stored units, so that single
//! precision suffices however large scale, offset and other values are.

use fearless_simd::f32x16;
use fearless_simd::prelude::*;

use crate::math::{exp_minus, ln};
use crate::scene::{MAX_OPACITY, OpacityRule};
use crate::trace::node_samples::{MAX_OPTICAL_DEPTH, Measure};
use rayset_base::bytes::list_bytes;
use rayset_files::grid::format::GridHeader;

/// How stored numbers, counted from the least, become values of the grid.
#[derive(Clone, Copy, Debug)]
pub(super) struct Values {
    /// The stored number that counts as 0.
    pub(super) base: f32,
    pub(super) scale: f64,
    /// The value of `base`.
    pub(super) offset: f64,
}

impl Values {
    /// Numbers are counted from where the rule begins to show anything, within the range of the
    /// grid: marks for places without a value may be so large that nothing else could be told apart
    /// if they were counted from these.
    pub(super) fn new(header: &GridHeader, rule: &OpacityRule) -> Self {
        let begins = match rule {
            OpacityRule::Curve(points) => {
                let begins = points.windows(2).find(|pair| pair[0].1 > 0.0 || pair[1].1 > 0.0);
                begins.map_or_else(|| points.first(), |pair| pair.first()).map_or(0.0, |&(value, _)| value)
            }
            OpacityRule::Clamp | OpacityRule::Extinction(_) => 0.0,
        };
        let number = (begins - header.offset) / header.scale;
        let (low, high) = header.range;
        let base = if number.is_finite() { (number as f32).max(low).min(high) } else { low };
        Self { base, scale: header.scale, offset: header.value(f64::from(base)) }
    }

    /// The value of a stored number less `base`.
    #[inline(always)]
    pub(super) fn value(&self, number: f32) -> f64 {
        self.scale * f64::from(number) + self.offset
    }

    /// The stored number less `base` of a value; not finite if all values are the same.
    pub(super) fn number(&self, value: f64) -> f64 {
        (value - self.offset) / self.scale
    }
}

/// An opacity rule, prepared for rows of stored numbers less the base.
pub(super) struct Opacities {
    rule: Rule,
    /// Where the opacity may be above 0: ranges of numbers, ascending, ends included.
    shown: Vec<(f32, f32)>,
}

enum Rule {
    /// Opacity: factor · number + offset.
    Clamp { factor: f32, offset: f32 },
    /// Optical depth: factor · number + offset.
    Extinction { factor: f32, offset: f32 },
    /// Piecewise linear.
    Curve(Vec<Piece>),
}

/// From `from` on (of −∞ for the first piece), the opacity is `opacity` + `slope` · (number −
/// `start`).
#[derive(Clone, Copy, Debug)]
struct Piece {
    from: f32,
    start: f32,
    opacity: f32,
    slope: f32,
}

impl Opacities {
    /// Bytes that it takes besides itself.
    pub(super) fn bytes(&self) -> usize {
        let pieces = if let Rule::Curve(pieces) = &self.rule { list_bytes(pieces) } else { 0 };
        pieces + list_bytes(&self.shown)
    }

    pub(super) fn new(rule: &OpacityRule, values: &Values, unit_distance: f64) -> Self {
        let linear = |factor: f64| ((factor * values.scale) as f32, (factor * values.offset) as f32);
        let compiled = match rule {
            OpacityRule::Clamp => {
                let (factor, offset) = linear(1.0);
                Rule::Clamp { factor, offset }
            }
            OpacityRule::Extinction(kappa) => {
                let (factor, offset) = linear(kappa * unit_distance);
                Rule::Extinction { factor, offset }
            }
            OpacityRule::Curve(points) => Rule::Curve(pieces(points, values)),
        };
        let shown = shown(rule).into_iter().map(|(low, high)| {
            let (a, b) = (values.number(low) as f32, values.number(high) as f32);
            // Rounded outward; a grid of one value has numbers of 0 alone.
            if values.scale == 0.0 {
                (f32::NEG_INFINITY, f32::INFINITY)
            } else {
                (a.min(b).next_down(), a.max(b).next_up())
            }
        });
        Self { rule: compiled, shown: shown.collect() }
    }

    /// Whether the opacity may be above 0 anywhere in a range of numbers.
    #[inline(always)]
    pub(super) fn shows(&self, low: f32, high: f32) -> bool {
        self.shown.iter().any(|&(from, to)| from <= high && low <= to)
    }

    /// The least optical depth, of a unit distance, of all numbers in a range.
    #[expect(clippy::manual_clamp, reason = "what is not a number becomes 0")]
    pub(super) fn least_optical_depth(&self, low: f32, high: f32) -> f32 {
        let of_ends = |factor: f32, offset: f32| (low * factor + offset).min(high * factor + offset);
        let opacity = match &self.rule {
            Rule::Extinction { factor, offset } => {
                return of_ends(*factor, *offset).max(0.0).min(MAX_OPTICAL_DEPTH);
            }
            Rule::Clamp { factor, offset } => of_ends(*factor, *offset),
            Rule::Curve(pieces) => {
                let ends = pieces.iter().skip(1).map(|piece| piece.from).chain([f32::INFINITY]);
                let begins =
                    [f32::NEG_INFINITY].into_iter().chain(pieces.iter().skip(1).map(|piece| piece.from));
                let met =
                    pieces.iter().zip(begins.zip(ends)).filter(|(_, (from, to))| *from <= high && low <= *to);
                // Straight lines are least at their ends.
                met.flat_map(|(piece, (from, to))| {
                    [low.max(from), high.min(to)].map(|n| piece.opacity + (n - piece.start) * piece.slope)
                })
                .fold(f32::INFINITY, f32::min)
            }
        };
        (-ln(1.0 - limited(opacity))).min(MAX_OPTICAL_DEPTH)
    }

    /// The opacities of numbers, in a given measure.
    #[expect(clippy::manual_clamp, reason = "what is not a number becomes 0")]
    #[inline(always)]
    pub(super) fn of<S: Simd, const N: usize>(
        &self,
        simd: S,
        numbers: &[f32; N],
        measure: Measure,
    ) -> [f32; N] {
        let mut out = [0.0; N];
        match &self.rule {
            Rule::Clamp { factor, offset } => {
                for (o, &n) in out.iter_mut().zip(numbers) {
                    *o = (n * factor + offset).max(0.0).min(MAX_OPACITY as f32);
                }
            }
            Rule::Extinction { factor, offset } => {
                for (o, &n) in out.iter_mut().zip(numbers) {
                    *o = (n * factor + offset).max(0.0).min(MAX_OPTICAL_DEPTH);
                }
                if measure == Measure::Opacity {
                    for o in &mut out {
                        *o = (1.0 - exp_minus(*o)).min(MAX_OPACITY as f32);
                    }
                }
                return out;
            }
            Rule::Curve(pieces) => curve(simd, pieces, numbers, &mut out),
        }
        if measure == Measure::OpticalDepth {
            for o in &mut out {
                *o = (-ln(1.0 - *o)).min(MAX_OPTICAL_DEPTH);
            }
        }
        out
    }
}

/// A curve is evaluated by trying all pieces if they are at most this many.
const FEW_PIECES: usize = 24;

#[inline(always)]
fn curve<S: Simd, const N: usize>(simd: S, pieces: &[Piece], numbers: &[f32; N], out: &mut [f32; N]) {
    if pieces.len() > FEW_PIECES {
        for (o, &n) in out.iter_mut().zip(numbers) {
            let piece = pieces[pieces.partition_point(|piece| piece.from <= n).max(1) - 1];
            *o = limited(piece.opacity + (n - piece.start) * piece.slope);
        }
        return;
    }
    const { assert!(N.is_multiple_of(16)) };
    for (out, numbers) in out.as_chunks_mut::<16>().0.iter_mut().zip(numbers.as_chunks::<16>().0) {
        let n = f32x16::from_slice(simd, numbers);
        let splat = |v| f32x16::splat(simd, v);
        let first = pieces[0];
        let (mut start, mut opacity, mut slope) =
            (splat(first.start), splat(first.opacity), splat(first.slope));
        for piece in &pieces[1..] {
            let in_piece = n.simd_ge(splat(piece.from));
            start = in_piece.select(splat(piece.start), start);
            opacity = in_piece.select(splat(piece.opacity), opacity);
            slope = in_piece.select(splat(piece.slope), slope);
        }
        (opacity + (n - start) * slope).store_slice(out);
    }
    for o in out {
        *o = limited(*o);
    }
}

/// An opacity held to what opacities may be.
#[inline(always)]
fn limited(opacity: f32) -> f32 {
    opacity.max(0.0).min(MAX_OPACITY as f32)
}

/// The pieces of a curve over stored numbers, ascending.
fn pieces(points: &[(f64, f64)], values: &Values) -> Vec<Piece> {
    let flat = |from: f32, opacity: f64| Piece { from, start: 0.0, opacity: opacity as f32, slope: 0.0 };
    let number = |value: f64| values.number(value) as f32;
    let (Some(&(_, first)), Some(&(end, last))) = (points.first(), points.last()) else {
        return vec![flat(f32::NEG_INFINITY, 0.0)];
    };
    if values.scale == 0.0 {
        return vec![flat(f32::NEG_INFINITY, crate::scene::curve_at(points, values.offset))];
    }
    // Ascending values are descending numbers if the scale is negative: what holds from a point on
    // then holds up to it.
    let rises = values.scale > 0.0;
    let mut pieces = vec![flat(f32::NEG_INFINITY, if rises { first } else { last })];
    let mut between: Vec<Piece> = (points.windows(2))
        .filter(|pair| pair[0].0 < pair[1].0)
        .map(|pair| {
            let ((x0, o0), (x1, o1)) = (pair[0], pair[1]);
            let ((start, opacity), from) =
                if rises { ((x0, o0), number(x0)) } else { ((x1, o1), number(x1).next_up()) };
            let slope = (o1 - o0) / (values.number(x1) - values.number(x0));
            Piece { from, start: number(start), opacity: opacity as f32, slope: slope as f32 }
        })
        .collect();
    if !rises {
        between.reverse();
    }
    pieces.append(&mut between);
    pieces.push(if rises { flat(number(end), last) } else { flat(number(points[0].0).next_up(), first) });
    pieces
}

/// The ranges of values in which a rule's opacity is above 0, ends included.
fn shown(rule: &OpacityRule) -> Vec<(f64, f64)> {
    let points = match rule {
        OpacityRule::Clamp => return vec![(0.0, f64::INFINITY)],
        OpacityRule::Extinction(kappa) if *kappa > 0.0 => return vec![(0.0, f64::INFINITY)],
        OpacityRule::Extinction(_) => return Vec::new(),
        OpacityRule::Curve(points) => points,
    };
    let (Some(first), Some(last)) = (points.first(), points.last()) else { return Vec::new() };
    let before = (f64::NEG_INFINITY, first.1);
    let behind = (f64::INFINITY, last.1);
    let ends: Vec<(f64, f64)> =
        std::iter::once(before).chain(points.iter().copied()).chain(std::iter::once(behind)).collect();
    let mut shown: Vec<(f64, f64)> = Vec::new();
    for pair in ends.windows(2) {
        if !(pair[0].1 > 0.0 || pair[1].1 > 0.0) {
            continue;
        }
        match shown.last_mut().filter(|range| range.1 >= pair[0].0) {
            Some(range) => range.1 = pair[1].0,
            None => shown.push((pair[0].0, pair[1].0)),
        }
    }
    shown
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::field::dispatch;

    fn rules() -> impl Strategy<Value = OpacityRule> {
        let point = (0_i32..60, prop_oneof![Just(0.0), 0.0_f64..=1.0]);
        prop_oneof![
            Just(OpacityRule::Clamp),
            prop::sample::select(vec![0.0, 1e-3, 2.0]).prop_map(OpacityRule::Extinction),
            prop::collection::vec(point, 1..40).prop_map(|mut points| {
                points.sort_by_key(|p| p.0);
                OpacityRule::Curve(points.into_iter().map(|(d, o)| (f64::from(d) * 4.0 - 20.0, o)).collect())
            }),
        ]
    }

    proptest! {
        #[test]
        fn rows_are_what_the_rule_says_and_shown_wherever_they_are_above_zero(
            rule in rules(),
            (scale, offset) in prop::sample::select(vec![(1.0, 0.0), (0.5, 1e6), (-1.0, 200.0), (1e-3, 0.0), (0.0, 30.0)]),
            numbers in prop::array::uniform32(0.0_f32..256.0),
            unit in prop::sample::select(vec![0.01, 1.0]),
        ) {
            let values = Values { base: 0.0, scale, offset };
            // Curves are laid where the values are.
            let rule = match rule {
                OpacityRule::Curve(points) => OpacityRule::Curve(
                    points.into_iter().map(|(d, o)| (offset + d * scale.abs(), o)).collect()),
                other => other,
            };
            let opacities = Opacities::new(&rule, &values, unit);
            // On the curve's points, and beside them.
            let numbers: [f32; 32] = std::array::from_fn(|i| if i % 2 == 0 { (numbers[i] / 4.0).round() * 4.0 } else { numbers[i] });
            let level = crate::field::SimdLevel::baseline().level();
            let found = dispatch!(level, simd => opacities.of(simd, &numbers, Measure::Opacity));
            let depths = dispatch!(level, simd => opacities.of(simd, &numbers, Measure::OpticalDepth));
            for i in 0..32 {
                let exact = rule.opacity_of_value(values.value(numbers[i]), unit);
                prop_assert!((f64::from(found[i]) - exact).abs() < 2e-5, "{} at {}: {exact}", found[i], numbers[i]);
                let depth = -(1.0 - exact.min(MAX_OPACITY)).ln();
                prop_assert!((f64::from(depths[i]) - depth).abs() < 1e-3 * depth.max(0.02), "{} {depth}", depths[i]);
                if found[i] > 0.0 {
                    prop_assert!(opacities.shows(numbers[i], numbers[i]));
                }
            }
        }

        #[test]
        fn the_least_optical_depth_of_a_range_is_no_more_than_that_of_any_number_in_it(
            rule in rules(),
            (scale, offset) in prop::sample::select(vec![(1.0, 0.0), (0.5, 3.0), (-1.0, 200.0), (0.0, 30.0)]),
            low in 0.0_f32..200.0,
            width in 0.0_f32..50.0,
        ) {
            let values = Values { base: 0.0, scale, offset };
            let opacities = Opacities::new(&rule, &values, 0.5);
            let numbers: [f32; 32] = std::array::from_fn(|i| low + width * (i as f32 / 31.0));
            let level = crate::field::SimdLevel::baseline().level();
            let depths = dispatch!(level, simd => opacities.of(simd, &numbers, Measure::OpticalDepth));
            let least = opacities.least_optical_depth(low, low + width);
            let found = depths.iter().copied().fold(f32::INFINITY, f32::min);
            prop_assert!(least <= found * 1.001 + 1e-5, "{least} of {found}");
            // And not far less, where the rule does not vary.
            prop_assert!(width > 0.0 || (least - found).abs() <= 1e-3 * found.max(0.02), "{least} of {found}");
        }

        #[test]
        fn what_is_not_shown_is_transparent(points in prop::collection::vec((0.0_f64..9.0, prop_oneof![Just(0.0), Just(0.5)]), 1..6), low in 0.0_f32..9.0, width in 0.0_f32..3.0) {
            let mut points = points;
            points.sort_by(|a, b| a.0.total_cmp(&b.0));
            let rule = OpacityRule::Curve(points);
            let opacities = Opacities::new(&rule, &Values { base: 0.0, scale: 1.0, offset: 0.0 }, 1.0);
            // The other way round, up to rounding: only ranges that touch something shown are
            // shown.
            let (a, b) = (f64::from(low) - 1e-5, f64::from(low + width) + 1e-5);
            prop_assert!(!opacities.shows(low, low + width) || rule.shows_between(a, b));
            prop_assert!(opacities.shows(low, low + width) || !rule.shows_between(f64::from(low), f64::from(low + width)));
        }
    }
}

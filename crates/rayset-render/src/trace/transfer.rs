//! Transfer functions over the outputs of nodes, prepared for rows of samples.

use std::sync::Arc;

use super::knots::{Curve, Knots, least_value};
use super::node_samples::{NodeSamples, each_lane};
use crate::field::{SLAB_SAMPLES, linear_from_srgb};
use crate::scene::{Channel, ColorMap, MAX_OPACITY, Transfer};
use rayset_base::bytes::list_bytes;

/// Knots for each unit by which a channel changes between two stops: linear interpolation between
/// knots, in linear light, is within 2e-5 of linear interpolation between the stops in
/// display-encoded values.
const KNOTS_PER_UNIT: f64 = 160.0;
/// Most knots of a map; maps with many stops have fewer knots between two stops.
const MOST_KNOTS: usize = 1 << 18;

/// A colour map, prepared for lookups: linear interpolation in linear light between knots, which
/// are its stops and some places in between. The two knots around a value are found exactly,
/// however close together they are.
pub(super) struct ColorTable {
    colors: Vec<Knot>,
    /// Where they begin.
    knots: Knots,
    /// −1 if the range descends: values are then negated; otherwise 1.
    sign: f32,
}

/// From here the colour changes linearly to that of the next knot.
#[derive(Clone, Copy)]
struct Knot {
    start: f64,
    /// 1 over the distance to the next knot; 0 if there is none, or it is at the same place.
    per_value: f64,
    color: [f32; 3],
    change: [f32; 3],
}

impl ColorTable {
    pub(super) fn new(map: &ColorMap) -> Self {
        let (low, high) = map.range;
        let sign = if high < low { -1.0 } else { 1.0 };
        let (low, high) = (low * sign, high * sign);
        let stops = subdivided(&map.palette.stops());
        let value_at = |at: f64| low + at * (high - low);
        let colors: Vec<Knot> = (stops.iter().enumerate())
            .map(|(i, &(at, color))| {
                let (next, to) = stops.get(i + 1).copied().unwrap_or((at, color));
                let change = std::array::from_fn(|c| (to[c] - color[c]) as f32);
                let distance = value_at(next) - value_at(at);
                let per_value = if distance > 0.0 { 1.0 / distance } else { 0.0 };
                Knot { start: value_at(at), per_value, color: color.map(|v| v as f32), change }
            })
            .collect();
        // The place of a value by its definition: the index must agree with it, bit for bit.
        let place = |value: f32| (f64::from(value) - low) / (high - low);
        // A value before the range counts as the beginning of the range; if there are several
        // stops, the last applies.
        let least = |at: f64| if at > 0.0 { least_value(at, place) } else { f32::NEG_INFINITY };
        let from: Vec<f32> = stops.iter().map(|&(at, _)| least(at)).collect();
        Self { colors, knots: Knots::new(from, low, high), sign: sign as f32 }
    }

    /// Bytes of its lists, and of the stops with colours that it is made from, whose list doubles
    /// as it grows.
    pub(super) fn bytes(&self) -> usize {
        let made_from = 2 * self.colors.len() * size_of::<(f64, [f64; 3])>();
        made_from + list_bytes(&self.colors) + self.knots.bytes()
    }

    /// The colour of a value, linear light.
    #[inline(always)]
    pub(super) fn color(&self, value: f32) -> [f32; 3] {
        // NaN counts as before the range.
        let value = (value * self.sign).max(f32::NEG_INFINITY);
        let Some(knot) = self.colors.get(self.knots.not_above(value).max(1) - 1) else { return [0.0; 3] };
        let along = (f64::from(value) - knot.start) * knot.per_value;
        // Before the first knot, the colour of that knot.
        let along = if along > 0.0 { along.min(1.0) as f32 } else { 0.0 };
        let (color, change) = (knot.color, knot.change);
        [color[0] + change[0] * along, color[1] + change[1] * along, color[2] + change[2] * along]
    }
}

/// Stops and places between them, each with its colour in linear light.
fn subdivided(stops: &[(f64, [f64; 3])]) -> Vec<(f64, [f64; 3])> {
    let linear = |color: [f64; 3]| color.map(linear_from_srgb);
    let mut knots = Vec::new();
    for pair in stops.windows(2) {
        let ((a, from), (b, to)) = (pair[0], pair[1]);
        let pieces = pieces(stops.len(), pair[0], pair[1]);
        for i in 0..pieces {
            let t = i as f64 / pieces as f64;
            knots.push((a + (b - a) * t, linear(std::array::from_fn(|c| from[c] + (to[c] - from[c]) * t))));
        }
    }
    knots.extend(stops.last().map(|&(at, color)| (at, linear(color))));
    knots
}

/// The number of pieces into which the line between two neighbours, of `stops` stops in all, is
/// cut.
fn pieces(stops: usize, (a, from): (f64, [f64; 3]), (b, to): (f64, [f64; 3])) -> usize {
    let most = (MOST_KNOTS / stops.max(1)) as f64;
    let change = (0..3).map(|c| (to[c] - from[c]).abs()).fold(0.0, f64::max);
    if b > a { (change * KNOTS_PER_UNIT).ceil().clamp(1.0, most) as usize } else { 1 }
}

enum Output {
    Opacity(Curve),
    Color(ColorTable),
}

/// Rows that a transfer function reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Input {
    Opacity,
    Color(usize),
    /// A named attribute, by its number in the program.
    Attribute(usize),
}

impl Input {
    fn new(channel: &Channel, names: &[Arc<str>]) -> Self {
        match channel {
            Channel::Opacity => Self::Opacity,
            Channel::Red => Self::Color(0),
            Channel::Green => Self::Color(1),
            Channel::Blue => Self::Color(2),
            Channel::Attribute(name) => Self::Attribute(names.binary_search(name).unwrap_or(0)),
        }
    }

    /// A bit for the named attribute that it reads, if any.
    pub(super) fn attributes(self) -> u32 {
        if let Self::Attribute(number) = self { 1 << number } else { 0 }
    }
}

/// A transfer function of a node.
pub(super) struct CompiledTransfer {
    pub(super) input: Input,
    output: Output,
}

impl CompiledTransfer {
    /// For a program whose attributes have these names, in alphabetical order.
    pub(super) fn new(transfer: &Transfer, names: &[Arc<str>]) -> Self {
        let (input, output) = match transfer {
            Transfer::Opacity { input, curve } => (input, Output::Opacity(Curve::new(curve))),
            Transfer::Color { input, map } => (input, Output::Color(ColorTable::new(map))),
        };
        Self { input: Input::new(input, names), output }
    }

    /// Bytes that it takes besides its place in a list.
    pub(super) fn bytes(&self) -> usize {
        match &self.output {
            Output::Opacity(curve) => curve.bytes(),
            Output::Color(table) => table.bytes(),
        }
    }

    pub(super) fn makes_color(&self) -> bool {
        matches!(self.output, Output::Color(_))
    }

    /// Applies the function to a block. Samples whose opacity is 0 stay as they are.
    // Not inlined: its rows would be part of the stack of every instruction of every slab.
    #[inline(never)]
    pub(super) fn apply(&self, block: &mut NodeSamples, wants_color: bool) {
        each_lane(block.touched, |lane| {
            for j in 0..SLAB_SAMPLES {
                let opacity = block.opacity[lane].0[j];
                if !(opacity > 0.0) {
                    continue;
                }
                let value = match self.input {
                    Input::Opacity => opacity,
                    Input::Color(channel) => block.color[channel][lane].0[j],
                    Input::Attribute(number) => block.attributes[number][lane].0[j],
                };
                match &self.output {
                    Output::Opacity(curve) => {
                        block.opacity[lane].0[j] = curve.at(value).min(MAX_OPACITY) as f32;
                    }
                    Output::Color(table) if wants_color => {
                        for (rows, v) in block.color.iter_mut().zip(table.color(value)) {
                            rows[lane].0[j] = v;
                        }
                    }
                    Output::Color(_) => {}
                }
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::scene::Palette;

    /// The largest difference between the colours of a table and those of its map, for some values.
    fn worst(map: &ColorMap, values: impl Iterator<Item = f32>) -> f64 {
        let table = ColorTable::new(map);
        let error = |v: f32| {
            let (found, exact) = (table.color(v), map.color(f64::from(v)));
            (0..3).map(|c| (f64::from(found[c]) - exact[c]).abs()).fold(0.0, f64::max)
        };
        values.map(error).fold(0.0, f64::max)
    }

    #[test]
    fn logarithmic_maps_are_as_they_are_defined_and_have_few_knots_in_a_place() {
        for (low, high) in [(1e-10, 1e-3), (2.5, 3e6), (1e-38, 1e38)] {
            let colors = (0..256).map(|i| [f64::from(i) / 255.0, f64::from(i * i % 256) / 255.0, 0.3]);
            let at = |i: usize| (f64::powf(high / low, i as f64 / 255.0) - 1.0) / (high / low - 1.0);
            let stops = colors.enumerate().map(|(i, color)| (at(i), color));
            let map = ColorMap { palette: Palette::Stops(stops.collect()), range: (low, high) };
            let values = (-100..100_100).map(|i| low as f32 * (high / low).powf(f64::from(i) / 1e5) as f32);
            assert!(worst(&map, values) < 3e-5, "{low} to {high}");
            let table = ColorTable::new(&map);
            let most = table.knots.most_in_place();
            assert!(most < 128, "{low} to {high}: {most} of {}", table.colors.len());
        }
    }

    #[test]
    fn maps_with_names_are_as_they_are_defined() {
        for name in ["viridis", "inferno_r", "grey", "turbo", "coolwarm", "cividis", "RdBu_r"] {
            let map = ColorMap::named(name.parse().expect("a map"), (-3.0, 5.0));
            let error = worst(&map, (0..100_000).map(|i| -4.0 + i as f32 * 1e-4));
            assert!(error < 3e-5, "{name}: {error}");
        }
    }

    proptest! {
        #[test]
        fn any_stops_over_any_range_are_as_they_are_defined(
            places in prop::collection::vec(0_u32..40, 1..9),
            colors in prop::collection::vec(prop::array::uniform3(0.0_f64..=1.0), 9),
            (low, width) in (-1e6_f64..1e6, prop::sample::select(vec![1e-2, 1.0, -1.0, 300.0, 1e7])),
            values in prop::collection::vec(-0.2_f64..1.2, 64),
        ) {
            let mut places = places;
            places.sort_unstable();
            let stops = places.iter().zip(colors).map(|(&at, color)| (f64::from(at.min(32)) / 32.0, color));
            let map = ColorMap { palette: Palette::Stops(stops.collect()), range: (low, low + width) };
            prop_assert!(map.check().is_ok());
            // Values anywhere, on the stops, and beside them.
            let at_stops = places.iter().map(|&at| f64::from(at.min(32)) / 32.0);
            let values: Vec<f32> = values.into_iter().chain(at_stops).map(|x| (low + x * width) as f32).collect();
            let beside = values.iter().flat_map(|&v| [v.next_down(), v, v.next_up()]);
            prop_assert!(worst(&map, beside) < 3e-5);
        }
    }
}

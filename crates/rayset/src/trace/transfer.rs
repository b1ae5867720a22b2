//! Transfer functions over what nodes make, prepared for rows of samples.

use std::sync::Arc;

use super::block::{Block, each_lane};
use crate::field::SLAB_SAMPLES;
use crate::scene::{Channel, ColorMap, MAX_OPACITY, Transfer, curve_at};

/// Entries of a colour map's table.
const TABLE: usize = 1024;

/// A colour map as a table.
pub(super) struct ColorTable {
    table: Vec<[f32; 3]>,
    low: f32,
    scale: f32,
}

impl ColorTable {
    pub(super) fn new(map: &ColorMap) -> Self {
        let (low, high) = map.range;
        Self {
            table: map.palette.linear_table(TABLE),
            low: low as f32,
            scale: ((TABLE - 1) as f64 / (high - low)) as f32,
        }
    }

    /// The colour of a value, linear light.
    pub(super) fn color(&self, value: f32) -> [f32; 3] {
        let x = ((value - self.low) * self.scale).clamp(0.0, (TABLE - 1) as f32);
        // A value that is not a number casts to 0.
        let i = (x as usize).min(TABLE - 2);
        let f = if x.is_nan() { 0.0 } else { x - i as f32 };
        std::array::from_fn(|c| self.table[i][c] + (self.table[i + 1][c] - self.table[i][c]) * f)
    }
}

enum Output {
    Opacity(Vec<(f64, f64)>),
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

    /// The named attributes that have to be there.
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
    /// Of a program whose attributes have these names, in alphabetical order.
    pub(super) fn new(transfer: &Transfer, names: &[Arc<str>]) -> Self {
        let (input, output) = match transfer {
            Transfer::Opacity { input, curve } => (input, Output::Opacity(curve.clone())),
            Transfer::Color { input, map } => (input, Output::Color(ColorTable::new(map))),
        };
        Self { input: Input::new(input, names), output }
    }

    pub(super) fn makes_color(&self) -> bool {
        matches!(self.output, Output::Color(_))
    }

    /// Rewrites a block of opacities. Where there was nothing, nothing comes to be.
    pub(super) fn apply(&self, block: &mut Block, wants_color: bool) {
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
                        block.opacity[lane].0[j] = curve_at(curve, f64::from(value)).min(MAX_OPACITY) as f32;
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

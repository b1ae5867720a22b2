//! The value ranges of the colours of different sources, and the greys of points without colours.

use std::collections::BTreeMap;

use crate::points::{ColorDepth, ColumnType, Schema};

/// What is known of colours before they are scaled: of each source that does not state a depth its
/// largest value, and the distribution of the intensities of points without colours.
///
/// The depth of a source is decided by its own values. Two kinds of values decide nothing, and take
/// the depth that most of the other sources of the same type of numbers have: whole numbers up to
/// 1, which are dark colours of any depth, and nothing but 0, which is no colour at all where other
/// sources have one.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Depths {
    /// By the number of the source.
    pub(super) guessed: BTreeMap<u32, ColorValues>,
    /// Numbers of points without colours, by the [`bucket`] of their intensity.
    pub(super) intensities: BTreeMap<u16, u64>,
    /// Number of points that have neither a colour nor an intensity.
    pub(super) plain: u64,
    /// Whether there are colours of a stated depth.
    pub(super) has_stated: bool,
}

/// The colours of a source that does not state a depth.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct ColorValues {
    /// Type of its numbers: 0 for integers, 1 for single and 2 for double precision.
    pub(super) family: u8,
    pub(super) largest: f32,
    pub(super) has_fractions: bool,
    pub(super) points: u64,
}

/// How the colour in a record becomes 0 to 1.
pub(super) type Scale = (f32, f32);

const UNIT: u32 = 0;
const BYTE: u32 = 1;
const WORD: u32 = 2;
/// Of points without colours: grey by intensity, and grey.
pub(super) const INTENSITY: u32 = 3;
pub(super) const PLAIN: u32 = 4;
/// From this number on depths are guessed, of one source each.
const FIRST_GUESSED: u32 = 5;

/// Grey of points that have neither a colour nor an intensity, from 0 to 1.
const PLAIN_GREY: f32 = 0.6;
/// Part of the points without colours that are black, and part that are white.
const TAIL: f64 = 0.01;

impl Depths {
    /// The number that denotes the depth of source `input` in records.
    pub(super) fn number(schema: &Schema, input: usize) -> u32 {
        match schema.color_depth {
            ColorDepth::Unit => UNIT,
            ColorDepth::Byte => BYTE,
            ColorDepth::Word => WORD,
            ColorDepth::Guess => u32::try_from(input).unwrap_or(u32::MAX).saturating_add(FIRST_GUESSED),
        }
    }

    /// The type of the colours of a source: 0 for integers, 1 for single and 2 for double
    /// precision.
    pub(super) fn family(schema: &Schema) -> u8 {
        match schema.find("red").map(|index| schema.columns[index].kind) {
            Some(ColumnType::F32) => 1,
            Some(ColumnType::F64) => 2,
            _ => 0,
        }
    }

    /// Includes a colour of the depth `number`.
    pub(super) fn include(&mut self, number: u32, family: u8, color: [f32; 3]) {
        if number < FIRST_GUESSED {
            self.has_stated = true;
            return;
        }
        let seen = self.guessed.entry(number).or_insert(ColorValues { family, ..ColorValues::default() });
        seen.points += 1;
        for value in color.into_iter().filter(|value| value.is_finite()) {
            seen.largest = seen.largest.max(value);
            seen.has_fractions |= value.fract() != 0.0;
        }
    }

    /// Includes a point without a colour. Returns the number that denotes how it is shown, and the
    /// value to keep of it.
    pub(super) fn include_colorless(&mut self, intensity: Option<f32>) -> (u32, f32) {
        match intensity.filter(|value| value.is_finite()) {
            Some(value) => {
                *self.intensities.entry(bucket(value)).or_default() += 1;
                (INTENSITY, value)
            }
            None => {
                self.plain += 1;
                (PLAIN, 0.0)
            }
        }
    }

    /// Includes the colours of other records.
    pub(super) fn merge(&mut self, other: &Self) {
        for (number, seen) in &other.guessed {
            let all = self
                .guessed
                .entry(*number)
                .or_insert(ColorValues { family: seen.family, ..ColorValues::default() });
            all.largest = all.largest.max(seen.largest);
            all.has_fractions |= seen.has_fractions;
            all.points += seen.points;
        }
        for (bucket, points) in &other.intensities {
            *self.intensities.entry(*bucket).or_default() += points;
        }
        self.plain += other.plain;
        self.has_stated |= other.has_stated;
    }

    /// Whether the colours of a source are all black where other sources have colours.
    fn is_blank(&self, seen: &ColorValues) -> bool {
        seen.largest <= 0.0 && (self.has_stated || self.guessed.values().any(|other| other.largest > 0.0))
    }

    /// The depth of a source.
    fn depth(&self, seen: &ColorValues) -> u32 {
        let by_others = || {
            let others = self.guessed.values().filter(|other| other.family == seen.family);
            let mut sources = [0_usize; 3];
            others.filter_map(ColorValues::depth).for_each(|depth| sources[depth as usize] += 1);
            // The smaller of two that are as frequent.
            let most = sources.iter().copied().max().unwrap_or(0);
            sources.iter().position(|&number| number == most && most > 0).map_or(UNIT, |depth| depth as u32)
        };
        seen.depth().unwrap_or_else(by_others)
    }

    /// How colours become 0 to 1, by the numbers that denote their depths.
    pub(super) fn scales(&self) -> Vec<Scale> {
        let of_depth = |depth: u32| (1.0 / [1.0, 255.0, 65535.0][depth as usize], 0.0);
        let mut scales =
            vec![of_depth(UNIT), of_depth(BYTE), of_depth(WORD), self.greys(), (0.0, PLAIN_GREY)];
        let last = self.guessed.last_key_value().map_or(FIRST_GUESSED, |(number, _)| number + 1);
        scales.resize(last as usize, of_depth(UNIT));
        for (number, seen) in &self.guessed {
            let is_blank = self.is_blank(seen);
            scales[*number as usize] = if is_blank { (0.0, PLAIN_GREY) } else { of_depth(self.depth(seen)) };
        }
        scales
    }

    /// How intensities become greys: from black to white between two percentiles.
    fn greys(&self) -> Scale {
        let points: u64 = self.intensities.values().sum();
        let tail = (points as f64 * TAIL) as u64;
        let (mut below, mut above) = (0, 0);
        let low = self.intensities.iter().find(|(_, points)| {
            below += **points;
            below > tail
        });
        let high = self.intensities.iter().rev().find(|(_, points)| {
            above += **points;
            above > tail
        });
        let (Some((&low, _)), Some((&high, _))) = (low, high) else { return (0.0, PLAIN_GREY) };
        let (black, white) = (f64::from(least(low)), f64::from(least(high.saturating_add(1))));
        if low == high || !(white - black).is_finite() {
            return (0.0, PLAIN_GREY);
        }
        ((1.0 / (white - black)) as f32, (-black / (white - black)) as f32)
    }

    /// What to say of colours: sources of different depths, and points without colours among
    /// others.
    pub(super) fn remarks(&self) -> Vec<String> {
        let mut remarks = Vec::new();
        let mut sources = [0_u64; 3];
        let mut blank = (0, 0);
        for seen in self.guessed.values() {
            if self.is_blank(seen) {
                blank = (blank.0 + 1, blank.1 + seen.points);
            } else {
                sources[self.depth(seen) as usize] += 1;
            }
        }
        let kinds = ["0 to 1", "0 to 255", "0 to 65535"].iter().zip(sources);
        let kinds: Vec<String> = kinds
            .filter(|(_, sources)| *sources > 0)
            .map(|(range, sources)| format!("{range} in {}", inputs(sources)))
            .collect();
        if kinds.len() > 1 {
            remarks.push(format!(
                "colours are from {}: each input's are read by its own range",
                kinds.join(", ")
            ));
        }
        let by_intensity: u64 = self.intensities.values().sum();
        let grey = format!("shown in grey ({:.0} %)", PLAIN_GREY * 100.0);
        if by_intensity > 0 {
            remarks.push(format!(
                "{} without colours are shown in grey by their intensity",
                points(by_intensity)
            ));
        }
        if self.plain > 0 {
            let what = points(self.plain);
            remarks.push(format!("{what} without colours and without intensities are {grey}"));
        }
        if blank.0 > 0 {
            let (files, what) = (inputs(blank.0), points(blank.1));
            remarks
                .push(format!("the colours of {files} are all black and count as none: {what} are {grey}"));
        }
        remarks
    }
}

fn points(number: u64) -> String {
    if number == 1 { "1 point".into() } else { format!("{number} points") }
}

fn inputs(number: u64) -> String {
    if number == 1 { "1 input".into() } else { format!("{number} inputs") }
}

impl ColorValues {
    /// The depth that the values themselves have; `None` if they fit any.
    fn depth(&self) -> Option<u32> {
        match self.largest {
            largest if largest > 255.0 => Some(WORD),
            largest if largest > 1.0 => Some(BYTE),
            _ if self.has_fractions => Some(UNIT),
            _ => None,
        }
    }
}

/// Bits of an `f32` that a bucket leaves out, so that it spans at most a sixteenth of its values.
const BUCKET_SHIFT: u32 = 19;
const SIGN: u32 = 1 << 31;

/// The bucket of a finite number: buckets are in the order of the numbers.
fn bucket(value: f32) -> u16 {
    let bits = value.to_bits();
    let ordered = if bits & SIGN == 0 { bits | SIGN } else { !bits };
    (ordered >> BUCKET_SHIFT) as u16
}

/// The smallest number of a bucket.
fn least(bucket: u16) -> f32 {
    let ordered = u32::from(bucket) << BUCKET_SHIFT;
    f32::from_bits(if ordered & SIGN == 0 { !ordered } else { ordered & !SIGN })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buckets_are_in_the_order_of_numbers_and_narrow() {
        let values = [-1e30_f32, -2048.0, -1.0, -1e-20, 0.0, 1e-20, 0.3, 1.0, 255.0, 65535.0, 1e30];
        for pair in values.windows(2) {
            assert!(bucket(pair[0]) <= bucket(pair[1]), "{pair:?}");
        }
        for value in values {
            let (from, to) = (least(bucket(value)), least(bucket(value) + 1));
            assert!(from <= value && value <= to, "{from} {value} {to}");
            assert!((to - from).abs() <= value.abs().max(from.abs()) / 15.0 + f32::MIN_POSITIVE, "{value}");
        }
    }
}

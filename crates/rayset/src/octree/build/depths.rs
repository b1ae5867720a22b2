//! The value ranges of the colours of different sources.

use crate::points::{ColorDepth, ColumnType, Schema};

/// Largest colour values of the sources that do not state a depth, by the type of their numbers: related tiles of the same
/// type share a depth, even if one of them is dark, whereas a table of 0 to 255 and a 16-bit scan do not.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Depths {
    pub(super) largest: [f32; GUESSED],
}

const UNIT: u8 = 0;
const BYTE: u8 = 1;
const WORD: u8 = 2;
/// From this number on, depths are guessed: those of integers, single and double precision.
const FIRST_GUESSED: u8 = 3;
const GUESSED: usize = 3;

impl Depths {
    /// The number that denotes the depth of a source in records.
    pub(super) fn number(schema: &Schema) -> u8 {
        match schema.color_depth {
            ColorDepth::Unit => UNIT,
            ColorDepth::Byte => BYTE,
            ColorDepth::Word => WORD,
            ColorDepth::Guess => {
                let kind = schema.find("red").map(|index| schema.columns[index].kind);
                FIRST_GUESSED
                    + match kind {
                        Some(ColumnType::F32) => 1,
                        Some(ColumnType::F64) => 2,
                        _ => 0,
                    }
            }
        }
    }

    /// Includes a colour value in the largest one of its depth, if that is guessed.
    pub(super) fn include(&mut self, number: u8, value: f32) {
        if let Some(largest) =
            number.checked_sub(FIRST_GUESSED).map(|guessed| &mut self.largest[usize::from(guessed)])
            && value.is_finite()
        {
            *largest = largest.max(value);
        }
    }

    /// Includes the colours of other records.
    pub(super) fn merge(&mut self, other: Self) {
        self.largest.iter_mut().zip(other.largest).for_each(|(largest, v)| *largest = largest.max(v));
    }

    /// The factors that scale colours to 0–1, by the numbers of their depths.
    pub(super) fn factors(&self) -> [f32; FIRST_GUESSED as usize + GUESSED] {
        let guess = |max: f32| {
            if max <= 1.0 {
                1.0
            } else if max <= 255.0 {
                1.0 / 255.0
            } else {
                1.0 / 65535.0
            }
        };
        let [integers, singles, doubles] = self.largest.map(guess);
        [1.0, 1.0 / 255.0, 1.0 / 65535.0, integers, singles, doubles]
    }
}

//! How bright the colours of different sources are.

use crate::points::{ColorDepth, ColumnType, Schema};

/// Largest colours of the sources that do not state a depth, by the type of their numbers: tiles of one kind that belong
/// together share a depth, even where one of them is dark; a table of 0 to 255 and a scan of 16 bits do not.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Depths {
    largest: [f32; GUESSED],
}

const UNIT: u8 = 0;
const BYTE: u8 = 1;
const WORD: u8 = 2;
/// Numbers from here on are of depths that are guessed: integers, single and double precision.
const FIRST_GUESSED: u8 = 3;
const GUESSED: usize = 3;

impl Depths {
    /// The number that stands for the depth of a source.
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

    /// Takes note of a colour.
    pub(super) fn include(&mut self, number: u8, value: f32) {
        if let Some(largest) =
            number.checked_sub(FIRST_GUESSED).map(|guessed| &mut self.largest[usize::from(guessed)])
            && value.is_finite()
        {
            *largest = largest.max(value);
        }
    }

    /// The factors that take colours to 0–1, by the numbers of their depths.
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

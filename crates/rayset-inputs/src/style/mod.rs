//! What is said of how a cloud or grid is to look, as a value.
//!
//! [`OPTIONS`] defines each option once: its name, what it means, which values it has. The options of the program, what
//! pages of the viewer send, the arguments in Python and the words of an exported command are made from it.

mod error;
mod json;
mod kinds;
mod said;
mod spelling;
mod table;
mod values;

pub use self::error::StyleError;
pub use self::spelling::Spelling;
pub use self::table::{Change, Group, OPTIONS, Style, StyleOption};
pub use self::values::{
    Background, Choice, Flag, LookName, Phase, Rgb, Shading, Side, StepLength, ValueRange,
};
pub(crate) use self::values::{End, Words};

#[cfg(test)]
mod tests;

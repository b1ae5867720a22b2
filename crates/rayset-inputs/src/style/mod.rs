//! A style: the options that override the look chosen for a cloud or a grid, and its camera.
//!
//! [`OPTIONS`] defines each option once: its name, its help and its kind of value. Five things are
//! derived from it: the options of the program, the messages of the viewer's pages, the arguments
//! in Python, the written scene and the words of an exported command.

mod error;
mod json;
pub(crate) mod kinds;
pub(crate) mod option;
mod rules;
mod spelling;
mod table;
mod values;

pub use self::error::StyleError;
pub use self::option::{Change, Group, OptionOf, Options};
pub use self::spelling::Spelling;
pub use self::table::{OPTIONS, Style, StyleOption};
pub use self::values::{
    Background, Choice, Compositing, Flag, LookName, Phase, Rgb, Shading, Side, StepLength, ValueRange,
};
pub(crate) use self::values::{End, Words};

#[cfg(test)]
mod tests;

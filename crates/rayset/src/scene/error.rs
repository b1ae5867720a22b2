//! Why a scene cannot be rendered.

use super::transfer::TransferError;

/// The most attributes that the transfer functions of one scene may read.
pub const MOST_ATTRIBUTES: usize = 32;

/// Why a scene cannot be rendered.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SceneError {
    /// A transfer function is invalid.
    #[error(transparent)]
    Transfer(#[from] TransferError),
    /// A transform has no inverse.
    #[error("a transform flattens space or is not finite (determinant {determinant:e})")]
    Singular {
        /// Its determinant.
        determinant: f64,
    },
    /// A transform that magnifies, shrinks or moves beyond all bounds.
    #[error(
        "a transform, with all those around it, takes a length of 1 to {length:e}; expected 1e-18 to 1e18, as of places"
    )]
    Stretch {
        /// What becomes of a length of 1, or of the origin.
        length: f64,
    },
    /// Too many samples.
    #[error("a step of {step:e} is too small for this scene; {least:e} or more will do, or \"auto\"")]
    Step {
        /// The distance between samples.
        step: f64,
        /// The least that there may be.
        least: f64,
    },
    /// An operator without enough children.
    #[error("{operator} of {children} children; at least {least} are needed")]
    Children {
        /// Its name.
        operator: &'static str,
        /// How many it has.
        children: usize,
        /// How many it needs.
        least: usize,
    },
    /// A term that is too large when it is written out.
    #[error("the graph stands for {places} objects and operators; at most {most} are traced")]
    TooLarge {
        /// Places of nodes.
        places: u64,
        /// How many there may be.
        most: u64,
    },
    /// A transfer function reads what nothing below it has.
    #[error("nothing below has an attribute named \"{name}\"; there are {known:?}")]
    NoAttribute {
        /// What it reads.
        name: String,
        /// What there is.
        known: Vec<String>,
    },
    /// More attributes are read than can be kept apart.
    #[error("transfer functions read {count} different attributes; at most {MOST_ATTRIBUTES} are carried")]
    TooManyAttributes {
        /// How many.
        count: usize,
    },
    /// Rays would never end.
    #[error("the scene has no end: cut its half-spaces off with an intersection")]
    Unbounded,
    /// The unit distance is not a positive number.
    #[error("the unit distance must be a number from 1e-18 to 1e18")]
    UnitDistance,
    /// A number out of its range.
    #[error("{what} {value} is out of range; expected {expected}")]
    Number {
        /// What the number is.
        what: &'static str,
        /// The number.
        value: f64,
        /// Its range.
        expected: &'static str,
    },
}

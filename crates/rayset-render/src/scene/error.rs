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
    /// A transform is not invertible.
    #[error("a transform flattens space or is not finite (determinant {determinant:e})")]
    Singular {
        /// Its determinant.
        determinant: f64,
    },
    /// A transform scales or translates beyond the range of lengths.
    #[error(
        "a transform, with all those around it, takes a length of 1 to {length:e}; expected 1e-18 to 1e18, as of places"
    )]
    Stretch {
        /// What it maps a length of 1, or the origin, to.
        length: f64,
    },
    /// The step is too small: a ray would have too many samples.
    #[error("a step of {step:e} is too small for this scene; {least:e} or more will do, or \"auto\"")]
    Step {
        /// The distance between samples.
        step: f64,
        /// The smallest step allowed.
        least: f64,
    },
    /// An operator has too few children.
    #[error("{operator} of {children} children; at least {least} are needed")]
    Children {
        /// Name of the operator.
        operator: &'static str,
        /// Number of its children.
        children: usize,
        /// Number of children it needs.
        least: usize,
    },
    /// The graph is too large when shared nodes are expanded.
    #[error("the graph stands for {places} objects and operators; at most {most} are traced")]
    TooLarge {
        /// Number of places of nodes, with shared nodes counted at every use.
        places: u64,
        /// The largest number allowed.
        most: u64,
    },
    /// A transfer function reads an attribute that no object below it has.
    #[error("nothing below has an attribute named \"{name}\"; there are {known:?}")]
    NoAttribute {
        /// Name of the attribute.
        name: String,
        /// Names of the attributes that exist.
        known: Vec<String>,
    },
    /// Transfer functions read more attributes than can be carried.
    #[error("transfer functions read {count} different attributes; at most {MOST_ATTRIBUTES} are carried")]
    TooManyAttributes {
        /// Number of attributes that are read.
        count: usize,
    },
    /// A node other than a difference has a cap.
    #[error("only a difference has a cap: it is what taking away lays bare")]
    Cap,
    /// Display values are composited where light is added or taken after the fact.
    #[error(
        "display values are composited of scenes without {what}; leave it out, or composite linear light"
    )]
    Compositing {
        /// What does not go with it.
        what: &'static str,
    },
    /// The scene has no finite bounds.
    #[error("the scene has no end: cut its half-spaces off with an intersection")]
    Unbounded,
    /// The unit distance is out of range.
    #[error("the unit distance must be a number from 1e-18 to 1e18")]
    UnitDistance,
    /// A number is out of range.
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

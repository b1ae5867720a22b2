//! Where rays are within details.

use super::StepRule;
use crate::field::{Packet, Slab};
use crate::trace::access::Access;
use crate::trace::program::Program;
use rayset_base::geometry::Ray;

/// Where a ray is within a detail.
#[derive(Clone, Copy, Debug)]
pub(super) struct Chord {
    pub(super) lane: u8,
    /// The steps that it asks for are δ₀·2^k.
    pub(super) k: i8,
    /// Distances along the ray; world space.
    pub(super) enter: f64,
    pub(super) exit: f64,
}

/// A part of all rays of a packet, and steps there that may be too coarse.
#[derive(Clone, Copy, Debug)]
pub(super) struct Part {
    pub(super) cell: Slab,
    /// The steps of the cell are δ₀·2^k.
    pub(super) k: i32,
    /// Where it begins and ends along each ray; world space.
    pub(super) reach: (f64, f64),
}

impl Part {
    /// Whether a chord asks for finer steps in it.
    pub(super) fn is_refined_by(&self, chord: &Chord) -> bool {
        i32::from(chord.k) < self.k && chord.enter <= self.reach.1 && chord.exit >= self.reach.0
    }
}

/// What chords are found of.
#[derive(Clone, Copy)]
pub(super) struct Place<'a> {
    pub(super) access: Access<'a>,
    /// World space.
    pub(super) packet: &'a Packet,
    pub(super) program: &'a Program,
    pub(super) rule: &'a StepRule,
    pub(super) rays: &'a [Ray],
}

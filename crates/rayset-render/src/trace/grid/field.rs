//! What a grid is at a place, and what is requested of it in a slab.

use super::gradients::Gradients;
use super::opacity::{Opacities, Values};
use super::placement::Placement;
use super::rays::GridRays;
use crate::field::{LANES, SimdLevel, Slab};
use crate::trace::access::Access;
use crate::trace::node_samples::{Live, MATERIAL, Measure, RequiredOutputs};
use crate::trace::transfer::ColorTable;

/// How samples are coloured.
pub(super) enum Color {
    Uniform([f32; 3]),
    Map(ColorTable),
}

/// A grid as a field in the world.
pub(super) struct GridField {
    pub(super) placement: Placement,
    pub(super) values: Values,
    pub(super) opacities: Opacities,
    pub(super) gradients: Gradients,
    /// Whether values are labels ([`GridObject::labels`](crate::scene::GridObject::labels)).
    pub(super) labels: bool,
    pub(super) color: Color,
    /// The number of the program's attribute that its values provide, if any.
    pub(super) value_number: Option<usize>,
    pub(super) material: [f32; MATERIAL],
}

impl GridField {
    /// Bytes that it takes besides itself.
    pub(super) fn bytes(&self) -> usize {
        let color = if let Color::Map(table) = &self.color { table.bytes() } else { 0 };
        self.opacities.bytes() + color
    }
}

/// What is requested of a grid in a slab.
#[derive(Clone, Copy)]
pub(in crate::trace) struct GridRequest<'a> {
    pub(in crate::trace) access: Access<'a>,
    /// The packet in the grid (`GridVolume::begin`).
    pub(in crate::trace) march: &'a GridMarch,
    pub(in crate::trace) slab: Slab,
    pub(in crate::trace) live: &'a Live,
    pub(in crate::trace) measure: Measure,
    pub(in crate::trace) required: RequiredOutputs,
    pub(in crate::trace) simd: SimdLevel,
    /// For each ray, the sum of the optical depths of samples with which it ends, if that is known.
    pub(in crate::trace) ends: Option<&'a [f32; LANES]>,
    /// A number that no other grid of the graph has.
    pub(in crate::trace) grid: usize,
}

impl GridRequest<'_> {
    /// The number of a brick among those of all grids of the graph.
    pub(super) fn key(&self, brick: u32) -> u64 {
        (self.grid as u64) << u32::BITS | u64::from(brick)
    }
}

/// The march of one packet through one grid.
pub(in crate::trace) struct GridMarch(pub(super) GridRays);

impl GridMarch {
    pub(in crate::trace) const BYTES: usize = size_of::<Self>();
}

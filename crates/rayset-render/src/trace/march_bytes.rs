//! What a march takes in memory.

use super::cloud::{CloudMarch, CloudScratch};
use super::evaluate::MOST_FIELDS;
use super::grid::{GridMarch, GridScratch};
use super::march::March;
use super::node_samples::NodeSamples;
use super::procedural::ProceduralMarch;
use super::program::{Action, Program};
use super::steps::{Details, may_differ};

/// What a march keeps of every instruction: its range of samples, the states of its cloud, grid or
/// field, its shared block.
const PLACE_BYTES: usize = size_of::<Option<(u64, u64)>>()
    + size_of::<(Option<Box<CloudMarch>>, bool)>()
    + 2 * size_of::<Option<Box<GridMarch>>>()
    + size_of::<Option<NodeSamples>>();

impl March<'_> {
    /// The most bytes that a march through a program takes.
    pub(super) fn most_bytes<P>(program: &Program<P>) -> usize {
        let count = |is: fn(&Action<P>) -> bool| {
            program.instructions.iter().filter(|instruction| is(&instruction.action)).count()
        };
        let clouds = count(|action| matches!(action, Action::Cloud(_)));
        let grids = count(|action| matches!(action, Action::Grid(_)));
        let fields = count(|action| matches!(action, Action::Procedural(_))).min(MOST_FIELDS);
        let channels = program.required.attributes.count_ones() as usize;
        let from_afar = count(|action| matches!(action, Action::Cloud(volume) if volume.lod.is_some()));
        let of_clouds = clouds * CloudMarch::BYTES
            + from_afar * CloudMarch::BYTES_FROM_AFAR
            + CloudScratch::bytes(clouds, channels, from_afar > 0);
        let of_details =
            if may_differ(program, true) { Details::BYTES + clouds * Details::BYTES_OF_CLOUD } else { 0 };
        let of_grids = if grids > 0 { grids * GridMarch::BYTES + GridScratch::BYTES } else { 0 };
        program.instructions.len() * PLACE_BYTES
            + program.most_blocks() * NodeSamples::bytes(program.required)
            + of_details
            + of_clouds
            + of_grids
            + fields * ProceduralMarch::BYTES
    }
}

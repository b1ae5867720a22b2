//! A scene graph compiled for tracing: flattened into instructions, each after those it needs;
//! immutable, and shared by all threads.
//!
//! A node that is reached twice with the same transform and material becomes one instruction, whose
//! samples are computed once.

use std::sync::Arc;

use super::bounce::ScatterKinds;
use super::cloud::CloudVolume;
use super::grid::GridVolume;
use super::node_samples::{Constants, LEAF, MATERIAL, Measure, RequiredOutputs};
use super::procedural::ProceduralVolume;
use super::transfer::CompiledTransfer;
use super::unopened::Unopened;
use super::{RenderError, SettingError};
use crate::field::{Sight, SimdLevel};
use crate::scene::{Node, Operator, RenderSettings};
use rayset_base::bytes::list_bytes;
use rayset_base::geometry::{Aabb, Ray};
use rayset_files::PagedFiles;
use rayset_files::grid::Grid;
use rayset_files::octree::Cloud;
use rayset_store::working_set::Object;

/// What an instruction does.
pub(super) enum Action<P = Arc<Object>> {
    Cloud(Box<CloudVolume<P>>),
    Grid(Box<GridVolume<P>>),
    Procedural(Box<ProceduralVolume>),
    Operator(Operator, Vec<usize>),
}

/// One node of the graph, at one place in the world.
pub(super) struct Instruction<P = Arc<Object>> {
    pub(super) action: Action<P>,
    /// Nothing outside of these is ever evaluated; world space.
    pub(super) bounds: Aabb,
    /// Those of the object itself, whatever is made of it: steps depend on these. Shading vectors
    /// are evaluated around an object that is subtracted, too, so `bounds` may be wider.
    pub(super) object_bounds: Aabb,
    pub(super) required: RequiredOutputs,
    /// What its action makes of this. The transfer functions make the rest.
    pub(super) made: RequiredOutputs,
    /// How its opacity is expressed before and after its transfer functions.
    pub(super) measures: (Measure, Measure),
    pub(super) transfers: Vec<CompiledTransfer>,
    /// Number of its uses: by other instructions, or as the root.
    pub(super) uses: u32,
    /// The colour of all samples, if it is the same; linear light.
    pub(super) color: Option<[f32; 3]>,
}

impl Instruction {
    /// How much farther splats of its own reach for those who see them; world space.
    pub(super) fn reach_world(&self, sight: Option<&Sight>) -> f64 {
        match &self.action {
            Action::Cloud(volume) => volume.placement.reach_world(sight, volume.lod.as_deref()),
            _ => 0.0,
        }
    }

    /// Nothing outside of these is evaluated where splats of the program reach so much farther.
    pub(super) fn bounds_as_seen(&self, reach: f64) -> Aabb {
        match &self.action {
            Action::Cloud(_) | Action::Operator(..) if !self.bounds.is_empty() => self.bounds.inflated(reach),
            _ => self.bounds,
        }
    }
}

/// What a program computes of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Purpose {
    /// Colours, lit.
    Picture,
    /// The same, and everything that layers record.
    Layers,
    /// Nothing but opacities, for shadows.
    Shadow,
    /// Opacities and shading vectors: where a surface is, and which side of it is which.
    Surface,
}

impl RenderSettings {
    /// What a program for pictures computes.
    pub(super) fn purpose(&self) -> Purpose {
        if self.layers { Purpose::Layers } else { Purpose::Picture }
    }
}

/// The whole graph.
pub(super) struct Program<P = Arc<Object>> {
    /// The last is the root.
    pub(super) instructions: Vec<Instruction<P>>,
    /// Every output that any instruction requires.
    pub(super) required: RequiredOutputs,
    /// The boundary of a subtracted object does not affect the shading of samples farther from it
    /// than this; world space.
    pub(super) reach: f64,
    /// Outputs that all samples share.
    pub(super) constants: Constants,
    pub(super) simd: SimdLevel,
    /// Whether some objects are splats, or are seen from afar: these absorb more than others may.
    pub(super) has_splats: bool,
    /// The number of the attribute [`LUMP_OPACITY`], if the root has it.
    pub(super) lump_opacity: Option<usize>,
}

/// A node with its transform to the world and the index of its material.
pub(super) type Key = (*const Node, [u64; 12], usize);

impl Program<Unopened> {
    /// With the pages of its files in a working set.
    ///
    /// # Errors
    /// [`RenderError::Setting`] if a cloud or grid of the scene is not open in `paged`.
    pub(super) fn open(self, paged: &PagedFiles) -> Result<Program, RenderError> {
        let Self { instructions, required, reach, constants, simd, has_splats, lump_opacity } = self;
        let instructions = instructions.into_iter().map(|instruction| instruction.open(paged));
        let instructions = instructions.collect::<Result<_, _>>()?;
        Ok(Program { instructions, required, reach, constants, simd, has_splats, lump_opacity })
    }
}

impl Instruction<Unopened> {
    fn open(self, paged: &PagedFiles) -> Result<Instruction, RenderError> {
        let Self { action, bounds, object_bounds, required, made, measures, transfers, uses, color } = self;
        let action = match action {
            Action::Cloud(volume) => {
                let path = volume.placement.cloud().path().to_owned();
                Action::Cloud(Box::new(volume.open(paged).ok_or_else(|| not_paged(&path))?))
            }
            Action::Grid(volume) => {
                let path = volume.grid().path().to_owned();
                Action::Grid(Box::new(volume.open(paged).ok_or_else(|| not_paged(&path))?))
            }
            Action::Procedural(volume) => Action::Procedural(volume),
            Action::Operator(operator, children) => Action::Operator(operator, children),
        };
        Ok(Instruction { action, bounds, object_bounds, required, made, measures, transfers, uses, color })
    }
}

impl<P> Instruction<P> {
    /// Bytes that it takes in a program.
    fn bytes(&self) -> usize {
        let action = match &self.action {
            Action::Cloud(volume) => volume.bytes(),
            Action::Grid(volume) => volume.bytes(),
            Action::Procedural(volume) => volume.bytes(),
            Action::Operator(_, children) => list_bytes(children),
        };
        let transfers: usize = self.transfers.iter().map(CompiledTransfer::bytes).sum();
        size_of::<Instruction>() + action + list_bytes(&self.transfers) + transfers
    }
}

impl<P> Program<P> {
    /// How its materials change the direction of rays.
    pub(super) fn turns(&self) -> ScatterKinds {
        ScatterKinds::of(&used_materials(&self.instructions))
    }

    /// The clouds of its instructions; one that it uses several times, several times.
    pub(super) fn clouds_of(&self) -> impl Iterator<Item = &Arc<Cloud>> {
        self.instructions.iter().filter_map(|instruction| match &instruction.action {
            Action::Cloud(volume) => Some(volume.placement.cloud()),
            _ => None,
        })
    }

    /// Likewise, its grids.
    pub(super) fn grids_of(&self) -> impl Iterator<Item = &Arc<Grid>> {
        self.instructions.iter().filter_map(|instruction| match &instruction.action {
            Action::Grid(volume) => Some(volume.grid()),
            _ => None,
        })
    }

    /// Bytes that it takes while it is compiled, and less from then on.
    pub(super) fn bytes(&self) -> usize {
        // Lists and tables double as they grow.
        let growing = size_of::<Instruction>() + 2 * size_of::<(Key, usize)>();
        self.instructions.iter().map(|instruction| growing + instruction.bytes()).sum()
    }

    /// Most blocks of samples in use at a time, by all that has to be kept for others.
    pub(super) fn most_blocks(&self) -> usize {
        let mut blocks = Vec::with_capacity(self.instructions.len());
        for instruction in &self.instructions {
            blocks.push(match &instruction.action {
                Action::Operator(operator, children) => {
                    let own = if *operator == Operator::Intersection { children.len() } else { 2 };
                    own + children.iter().map(|&child| blocks[child]).max().unwrap_or(0)
                }
                Action::Cloud(_) | Action::Grid(_) | Action::Procedural(_) => 1,
            });
        }
        let shared = self.instructions.iter().filter(|instruction| instruction.uses > 1).count();
        shared + blocks.last().copied().unwrap_or(0)
    }
}

impl Program {
    pub(super) fn root(&self) -> usize {
        self.instructions.len() - 1
    }

    /// The cloud of an instruction, if it is one.
    pub(super) fn cloud(&self, at: usize) -> Option<&CloudVolume> {
        if let Action::Cloud(volume) = &self.instructions[at].action { Some(volume) } else { None }
    }

    /// What is to be said of clouds of which every point is seen though less was asked for.
    pub(super) fn seen_whole(&self) -> impl Iterator<Item = String> {
        self.instructions.iter().filter_map(|instruction| match &instruction.action {
            Action::Cloud(volume) => {
                let path = volume.placement.cloud().path().display();
                volume.why_whole.map(|why| format!("{path}: every point is seen: {why}"))
            }
            _ => None,
        })
    }

    /// The grid of an instruction, if it is one.
    pub(super) fn grid(&self, at: usize) -> Option<&GridVolume> {
        if let Action::Grid(volume) = &self.instructions[at].action { Some(volume) } else { None }
    }

    /// The distances at which a ray enters the boxes of its procedural fields; world space.
    pub(super) fn solids_met(&self, ray: &Ray) -> impl Iterator<Item = f64> {
        let solids = self.instructions.iter().filter(|at| matches!(at.action, Action::Procedural(_)));
        solids.filter_map(|at| at.bounds.clip(ray).map(|(enter, _)| enter))
    }

    /// The pages of its clouds and grids; of files that it uses several times, several times.
    pub(super) fn files(&self) -> impl Iterator<Item = &Arc<Object>> {
        self.instructions.iter().filter_map(|instruction| match &instruction.action {
            Action::Cloud(volume) => Some(&volume.placement.pages),
            Action::Grid(volume) => Some(volume.pages()),
            Action::Procedural(_) | Action::Operator(..) => None,
        })
    }
}

/// The error for a file of the scene that was not opened.
fn not_paged(path: &std::path::Path) -> RenderError {
    SettingError::NotOpen(path.to_owned()).into()
}

/// The distinct materials of leaves, apart from leaf numbers.
pub(super) fn used_materials<P>(instructions: &[Instruction<P>]) -> Vec<[f32; MATERIAL]> {
    let mut used: Vec<[f32; MATERIAL]> = Vec::new();
    for instruction in instructions {
        let mut material = match &instruction.action {
            Action::Cloud(volume) => volume.shading.material,
            Action::Grid(volume) => *volume.material(),
            Action::Procedural(volume) => volume.material,
            Action::Operator(..) => continue,
        };
        material[LEAF] = 0.0;
        if !used.contains(&material) {
            used.push(material);
        }
    }
    used
}

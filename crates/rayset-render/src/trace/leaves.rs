//! The leaves of a scene, and what their marches take.

use std::sync::Arc;

use super::grid::{GRID_MARCH_BYTES, GRID_SCRATCH_BYTES};
use super::march::MOST_FIELDS;
use super::procedural::ProceduralMarch;
use crate::field::BATCH_BYTES;
use crate::scene::{Scene, Shape};
use rayset_files::grid::Grid;
use rayset_files::octree::Cloud;

/// What each cloud of a graph adds to a march: a packet in the cloud's space and the part of its
/// octree ahead.
const CLOUD_BYTES: u64 = 48 << 10;

/// The clouds and grids of a scene, each once, and how many places these and procedural fields have
/// in the graph.
#[derive(Default)]
pub(super) struct Leaves {
    pub(super) clouds: Vec<Arc<Cloud>>,
    cloud_places: u64,
    pub(super) grids: Vec<Arc<Grid>>,
    grid_places: u64,
    field_places: u64,
}

impl Leaves {
    pub(super) fn of(scene: &Scene) -> Self {
        let mut leaves = Self::default();
        scene.root.for_each(&mut |node| match &node.shape {
            Shape::Cloud(object) => {
                leaves.cloud_places += 1;
                if !leaves.clouds.iter().any(|known| Arc::ptr_eq(known, &object.cloud)) {
                    leaves.clouds.push(object.cloud.clone());
                }
            }
            Shape::Grid(object) => {
                leaves.grid_places += 1;
                if !leaves.grids.iter().any(|known| Arc::ptr_eq(known, &object.grid)) {
                    leaves.grids.push(object.grid.clone());
                }
            }
            Shape::Procedural(_) => leaves.field_places += 1,
            Shape::Operator(..) => {}
        });
        leaves
    }

    /// What they add to the memory of a march.
    pub(super) fn march_bytes(&self) -> u64 {
        let of_grids = if self.grids.is_empty() { 0 } else { GRID_SCRATCH_BYTES };
        let of_clouds = if self.clouds.is_empty() { 0 } else { BATCH_BYTES };
        let of_fields = self.field_places.min(MOST_FIELDS as u64) * ProceduralMarch::BYTES as u64;
        self.cloud_places * CLOUD_BYTES
            + of_clouds
            + self.grid_places * GRID_MARCH_BYTES
            + of_grids
            + of_fields
    }
}

//! The distance between samples of each ray.
//!
//! Automatic steps are δ₀·2^k, with k from the smallest radius among the nodes whose bounds the ray itself meets: a
//! function of ray and scene alone, whatever packet the ray travels in. Lattices of different k nest.

use super::RenderError;
use super::access::{Access, Halt, NODE_PRIORITY};
use crate::field::RayColumns;
use crate::geometry::{Beam, Ray};
use crate::octree::node::{Node, NodePage};
use crate::scene::{RenderSettings, Scene, Step};

/// Finest automatic step: the coarsest times 2 to the minus this.
const FINEST: i32 = 60;

/// Rays of a tile that share a step.
#[derive(Clone, Debug)]
pub(super) struct StepGroup {
    /// World space.
    pub(super) step: f64,
    /// Their places in the tile.
    pub(super) members: Vec<usize>,
}

pub(super) struct StepRule {
    coarsest: f64,
    radius_max: f32,
    /// Whether rays may differ.
    varies: bool,
}

impl StepRule {
    pub(super) fn new(scene: &Scene, settings: &RenderSettings) -> Result<Self, RenderError> {
        let radius = scene.cloud.header().radius;
        let (coarsest, varies) = match settings.step {
            Step::Fixed(step) => (step, false),
            Step::Automatic { fraction } => (f64::from(radius.max()) * fraction, radius.min() < radius.max()),
        };
        if !(coarsest > 0.0 && coarsest.is_finite()) {
            let what = format!("{coarsest} is not a positive number");
            return Err(RenderError::Setting { setting: "step", what });
        }
        Ok(Self { coarsest, radius_max: radius.max(), varies })
    }

    /// Sorts the rays of a tile into groups of the same step, finest first.
    pub(super) fn groups(&self, access: Access<'_>, rays: &[(Ray, f64)]) -> Result<Vec<StepGroup>, Halt> {
        if !self.varies {
            return Ok(vec![StepGroup { step: self.coarsest, members: (0..rays.len()).collect() }]);
        }
        let exponents = self.exponents(access, rays)?;
        let mut distinct = exponents.clone();
        distinct.sort_unstable();
        distinct.dedup();
        Ok((distinct.into_iter())
            .map(|k| StepGroup {
                step: self.coarsest * 2_f64.powi(k),
                members: (0..rays.len()).filter(|&i| exponents[i] == k).collect(),
            })
            .collect())
    }

    /// k for a radius: the largest, at most 0, for which 2^k is at most its share of the largest radius.
    fn exponent(&self, radius: f32) -> i32 {
        let share = f64::from(radius) / f64::from(self.radius_max);
        (share.log2().floor() as i32).clamp(-FINEST, 0)
    }

    fn exponents(&self, access: Access<'_>, rays: &[(Ray, f64)]) -> Result<Vec<i32>, Halt> {
        let world = access.world;
        let mut beam = Beam::EMPTY;
        rays.iter().for_each(|(ray, _)| beam.include(ray));
        // Finds the rays that may meet a box, many at a time; which of them do is for each ray to say by itself.
        let columns = RayColumns::new(world.splatter.simd, rays.iter().map(|&(ray, _)| ray));
        let mut exponents = vec![0; rays.len()];
        let mut stack: Vec<Node> = access.root()?.into_iter().collect();
        while let Some(node) = stack.pop() {
            let below = self.exponent(node.radius_min);
            let bounds = node.bounds(world.root_cell);
            let finest_known = exponents.iter().copied().max().unwrap_or(0);
            if below >= finest_known || beam.span(&bounds).is_none() {
                continue;
            }
            let own = if node.child_mask == 0 {
                Some(below)
            } else if node.own.runs > 0 {
                // Own points of an inner node are wider than the cells of its children.
                let least = world.root_cell.size * 2_f64.powi(-i32::from(node.level) - 1);
                Some(self.exponent(least as f32).max(below))
            } else {
                None
            };
            if let Some(own) = own {
                let near = columns.cross(&bounds, 0.0).near;
                for (lane, (k, (ray, _))) in exponents.iter_mut().zip(rays).enumerate() {
                    if own < *k && near >> lane & 1 == 1 && bounds.clip(ray).is_some() {
                        *k = own;
                    }
                }
            }
            if node.child_mask != 0 {
                let page = node.first_child.page;
                let guard = access.retain(world.first_node_page + page, NODE_PRIORITY)?;
                let nodes = NodePage::trusted(&guard);
                for child in 0..node.child_mask.count_ones() as usize {
                    let index = usize::from(node.first_child.index) + child;
                    stack.push(nodes.get(index).ok_or_else(|| world.broken(page))?);
                }
            }
        }
        Ok(exponents)
    }
}

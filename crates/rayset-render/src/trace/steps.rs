//! The distance between samples of each ray.
//!
//! Automatic steps are δ₀·2^k. k comes from the finest object whose bounds the ray meets, and
//! within a cloud from the smallest radius among the nodes whose bounds it meets: a function of ray
//! and scene alone, whatever packet the ray is traced in. Lattices of different k nest.
//!
//! In a solid, noise or a grid every sample is evaluated, even if it is empty. So the detail that
//! they ask for is never less than a fraction of the diagonal of the box around them all, and a ray
//! that meets one of them takes a bounded number of steps through that box, however fine a cloud in
//! it is. Both limits are functions of the scene alone.
//!
//! The radii recorded in a node stand for its points only if the points lie close together. If they
//! are scattered, or have very different radii, most rays that meet the node meet none of its
//! finest points. Then the points themselves are tested: a ray is as fine as the finest sphere of
//! influence that it passes through.

use super::access::{Access, Halt};
use super::cloud::{CloudPlacement, RetainedNodes, each_own_page, run_bounds};
use super::program::{Action, Program};
use super::{RenderError, SettingError};
use crate::field::{LANES, RayColumns};
use crate::scene::{FINEST_DETAIL, MOST_STEPS, MOST_STEPS_IN_SOLIDS, RenderSettings, Step};
use rayset_base::geometry::{Aabb, Beam, DVec3, Ray};
use rayset_files::octree::layout::RUN_POINTS;
use rayset_files::octree::node::Node;
use rayset_files::octree::walk::{Visit, Visitor, Walk};

/// Finest automatic step: the coarsest times 2^−`FINEST`.
const FINEST: i32 = 60;
/// Refinement also stops at this many steps across a scene, whatever radii its files contain,
/// unless the coarsest step is finer already.
const MOST_REFINED_STEPS: f64 = (1_u64 << 24) as f64;
/// The points of a node wider than this many of its least radii are scattered: most rays that meet
/// the node meet no point.
const SCATTERED: f64 = 256.0;
/// If a node asks for steps of 2^`ASKED_THEMSELVES` times the coarsest or finer, its scattered
/// points are tested one by one.
const ASKED_THEMSELVES: i32 = -4;

/// In a grid a step is a fraction of this many voxel spacings: half a spacing if the fraction is a
/// quarter.
const GRID_DETAIL: f64 = 2.0;

/// Rays of a tile that share a step.
#[derive(Clone, Debug)]
pub(super) struct StepGroup {
    /// World space.
    pub(super) step: f64,
    /// Their indices among the rays that were grouped.
    pub(super) members: Vec<usize>,
}

#[derive(Clone)]
pub(super) struct StepRule {
    coarsest: f64,
    /// The length of which the coarsest step is the requested fraction; `None` if steps are fixed.
    longest: Option<f64>,
    /// The least k.
    finest: i32,
    /// Whether the steps of rays may differ.
    varies: bool,
    floors: Floors,
}

/// Lower limits of steps.
#[derive(Clone, Copy, Debug)]
struct Floors {
    /// The least detail that a solid, noise or a grid asks for; world space.
    detail: f64,
    /// The least k of a ray.
    exponent: i32,
    /// The least k of a ray that meets a solid, noise or a grid.
    exponent_in_solids: i32,
}

impl StepRule {
    /// The longest step that a ray may have; world space.
    pub(super) fn coarsest_world(&self) -> f64 {
        self.coarsest
    }

    pub(super) fn new(program: &Program, settings: &RenderSettings) -> Result<Self, RenderError> {
        let within = program.instructions[program.root()].bounds;
        let diagonal = |bounds: Aabb| if bounds.is_empty() { 0.0 } else { bounds.size().length() };
        let solids = program.instructions.iter().filter(|i| is_solid(&i.action));
        let solids = solids.map(|i| i.bounds.intersection(within)).filter(|bounds| !bounds.is_empty());
        let around_solids = diagonal(solids.fold(Aabb::EMPTY, Aabb::union));
        let floor = around_solids * FINEST_DETAIL;
        let details: Vec<f64> = (program.instructions.iter())
            .filter_map(|i| {
                let least = if is_solid(&i.action) { floor } else { 0.0 };
                largest_detail(&i.action).map(|detail| detail.max(least))
            })
            .collect();
        let longest = details.iter().copied().filter(|d| d.is_finite()).fold(0.0, f64::max);
        let (coarsest, varies) = match settings.step {
            Step::Fixed(step) => (step, false),
            Step::Automatic { fraction } if longest > 0.0 => {
                let one_radius = |cloud: &CloudPlacement| {
                    let radius = cloud.header().radius;
                    radius.min() == radius.max() && cloud.local_from_world().is_none()
                };
                (
                    longest * fraction,
                    details.len() > 1 || !program.clouds().all(|(_, volume)| one_radius(&volume.placement)),
                )
            }
            // The scene has nothing to derive a step from.
            Step::Automatic { .. } => (1.0, false),
        };
        if !(coarsest > 0.0 && coarsest.is_finite()) {
            return Err(SettingError::Step(coarsest).into());
        }
        let bounds = &program.instructions[program.root()].bounds;
        let extent = if bounds.is_empty() { 0.0 } else { bounds.size().max_element() };
        if coarsest < extent / MOST_STEPS {
            return Err(SettingError::SmallStep { step: coarsest, extent, least: extent / MOST_STEPS }.into());
        }
        let fixed = matches!(settings.step, Step::Fixed(_));
        // The least k with which steps are at least `least` long.
        let exponent = |least: f64| ((least / coarsest).log2().ceil() as i32).clamp(-FINEST, FINEST);
        let floors = Floors {
            detail: floor,
            exponent: exponent(diagonal(within) / MOST_STEPS),
            exponent_in_solids: exponent(around_solids / MOST_STEPS_IN_SOLIDS),
        };
        // If even the coarsest step is too fine for solids, rays that meet them differ from the
        // others.
        let varies = varies || floors.exponent_in_solids > 0;
        let finest =
            (extent / MOST_REFINED_STEPS / coarsest).log2().ceil().clamp(f64::from(-FINEST), 0.0) as i32;
        Ok(Self { coarsest, longest: (!fixed).then_some(longest), finest, varies, floors })
    }

    /// Sorts at most 64 rays into groups of the same step, finest first.
    pub(super) fn groups(
        &self,
        access: Access<'_>,
        program: &Program,
        rays: &[(Ray, f64)],
    ) -> Result<Vec<StepGroup>, Halt> {
        let Some(longest) = self.longest.filter(|_| self.varies) else {
            return Ok(vec![StepGroup { step: self.coarsest, members: in_order(rays.len()).collect() }]);
        };
        let mut exponents = Exponents {
            longest,
            finest: self.finest,
            floors: self.floors,
            of_rays: vec![0; rays.len()],
            least: vec![self.floors.exponent; rays.len()],
        };
        exponents.lower(access, program, rays)?;
        exponents.hold_in_solids(program, rays);
        let exponents: Vec<i32> =
            exponents.of_rays.iter().zip(&exponents.least).map(|(&k, &least)| k.max(least)).collect();
        let mut distinct = exponents.clone();
        distinct.sort_unstable();
        distinct.dedup();
        Ok((distinct.into_iter())
            .map(|k| StepGroup {
                step: self.coarsest * 2_f64.powi(k),
                members: in_order(rays.len()).filter(|&i| exponents[i] == k).collect(),
            })
            .collect())
    }
}

/// The indices of rays, such that neighbours follow each other: 64 rays are those of a tile of 8 ×
/// 8 pixels, row after row, and come in the order of a Z curve.
fn in_order(rays: usize) -> impl Iterator<Item = usize> {
    let even_bits = |i: usize| i & 1 | i >> 1 & 2 | i >> 2 & 4;
    (0..rays).map(move |i| if rays == LANES { even_bits(i) + 8 * even_bits(i >> 1) } else { i })
}

/// The largest detail of an object along any ray: the length that steps are to be a fraction of.
fn largest_detail(action: &Action) -> Option<f64> {
    match action {
        Action::Cloud(volume) => Some(volume.placement.largest_radius_world()),
        Action::Procedural(volume) => Some(volume.largest_detail_world()),
        Action::Grid(volume) => Some(GRID_DETAIL * volume.largest_spacing_world()),
        Action::Operator(..) => None,
    }
}

/// Whether every sample in the bounds of an object is evaluated, empty or not.
fn is_solid(action: &Action) -> bool {
    matches!(action, Action::Procedural(_) | Action::Grid(_))
}

/// k of each ray, lowered by one object after another.
struct Exponents {
    longest: f64,
    floors: Floors,
    finest: i32,
    of_rays: Vec<i32>,
    /// Lower limit of k for each ray.
    least: Vec<i32>,
}

impl Exponents {
    /// k for a length: the largest k ≤ 0 for which 2^k is at most `length / longest`.
    fn of(&self, length: f64) -> i32 {
        // Rounding in a transform must not halve the steps of rays at random.
        let share = length / self.longest * (1.0 + 1e-6);
        (share.log2().floor() as i32).clamp(self.finest, 0)
    }

    fn lower(&mut self, access: Access<'_>, program: &Program, rays: &[(Ray, f64)]) -> Result<(), Halt> {
        let mut beam = Beam::EMPTY;
        rays.iter().for_each(|(ray, _)| beam.include(ray));
        for instruction in &program.instructions {
            if instruction.bounds.is_empty() || beam.span(&instruction.bounds).is_none() {
                continue;
            }
            match &instruction.action {
                Action::Procedural(volume) => {
                    let least = self.floors.detail;
                    self.lower_within(rays, &instruction.bounds, |ray| volume.detail_world(ray).max(least));
                }
                Action::Grid(volume) => {
                    let least = self.floors.detail;
                    self.lower_within(rays, &instruction.bounds, |ray| {
                        (GRID_DETAIL * volume.spacing_world(ray)).max(least)
                    });
                }
                Action::Cloud(volume) if self.is_one_by_bounds(&volume.placement) => {
                    let cloud = &volume.placement;
                    let radius = f64::from(cloud.header().radius.max());
                    self.lower_within(rays, &instruction.bounds, |ray| {
                        radius / cloud.stretch_along(ray.direction)
                    });
                }
                Action::Cloud(volume) => self.lower_by_octree(access, program, &volume.placement, rays)?,
                Action::Operator(..) => {}
            }
        }
        Ok(())
    }

    /// Raises the lower limit of k for rays that meet the box of a solid, noise or a grid.
    fn hold_in_solids(&mut self, program: &Program, rays: &[(Ray, f64)]) {
        let floor = self.floors.exponent_in_solids;
        if self.of_rays.iter().all(|&k| k >= floor) {
            return;
        }
        for instruction in program.instructions.iter().filter(|i| is_solid(&i.action) && !i.bounds.is_empty())
        {
            for (least, (ray, _)) in self.least.iter_mut().zip(rays) {
                if *least < floor && instruction.bounds.clip(ray).is_some() {
                    *least = floor;
                }
            }
        }
    }

    /// Whether the bounds of a cloud suffice to determine k: its points have one radius, and are
    /// not both scattered and far finer than everything else.
    fn is_one_by_bounds(&self, cloud: &CloudPlacement) -> bool {
        let header = cloud.header();
        let (least, radius) = (f64::from(header.radius.min()), f64::from(header.radius.max()));
        let scattered = header.bounds.size().max_element() > SCATTERED * radius;
        least == radius && !(scattered && self.of(cloud.largest_radius_world()) <= ASKED_THEMSELVES)
    }

    /// Lowers k for rays that meet a box: their steps are at most a fraction of a length.
    fn lower_within(&mut self, rays: &[(Ray, f64)], bounds: &Aabb, length: impl Fn(&Ray) -> f64) {
        for (i, (ray, _)) in rays.iter().enumerate() {
            let below = self.of(length(ray));
            if below < self.of_rays[i] && bounds.clip(ray).is_some() {
                self.of_rays[i] = below;
            }
        }
    }

    fn lower_by_octree(
        &mut self,
        access: Access<'_>,
        program: &Program,
        cloud: &CloudPlacement,
        rays: &[(Ray, f64)],
    ) -> Result<(), Halt> {
        // In the local space of the cloud; a ray meets a box there exactly if it does in world
        // space.
        let rays: Vec<Ray> = rays.iter().map(|(ray, _)| cloud.local_ray(ray)).collect();
        let stretch: Vec<f64> = rays.iter().map(|ray| ray.direction.length()).collect();
        let (least, most) = stretch.iter().fold((f64::INFINITY, 0.0_f64), |(a, b), &s| (a.min(s), b.max(s)));
        let mut beam = Beam::EMPTY;
        rays.iter().for_each(|ray| beam.include(ray));
        // Finds the rays that may meet a box, many at a time; the exact test is made for each ray
        // by itself.
        let columns = RayColumns::new(program.simd, rays.iter().copied());
        let local = LocalRays { rays: &rays, stretch: &stretch, columns: &columns, stretches: (least, most) };
        let mut nodes = RetainedNodes { access, cloud };
        let mut finest = FinestPoints { exponents: self, access, cloud, local, beam, waiting: Vec::new() };
        let mut walk = Walk::new();
        walk.begin(&mut nodes, &mut finest)?;
        walk.go_on(&mut nodes, &mut finest)
    }

    /// Lowers k for rays that meet the box of a node's own points, according to the least radius
    /// that these can have; if they are scattered and far finer than everything else, the points
    /// themselves are tested.
    fn lower_by_node(
        &mut self,
        access: Access<'_>,
        cloud: &CloudPlacement,
        node: &Node,
        local: LocalRays<'_>,
        walk: &mut Walk,
    ) -> Result<(), Halt> {
        let own = if node.child_mask == 0 {
            f64::from(node.radius_min)
        } else if node.own.runs > 0 {
            // Own points of an inner node are wider than the cells of its children.
            let cell = cloud.root_cell.size * 2_f64.powi(-i32::from(node.level) - 1);
            f64::from(cell as f32).max(f64::from(node.radius_min))
        } else {
            return Ok(());
        };
        let bounds = node.bounds(cloud.root_cell);
        let near = local.columns.cross(&bounds, 0.0).near;
        let same = local.same_stretch().map(|stretch| self.of(own / stretch));
        let scattered = bounds.size().max_element() > SCATTERED * own;
        let mut ask_points = 0;
        for (i, ray) in local.rays.iter().enumerate().filter(|(i, _)| near >> i & 1 == 1) {
            let k = same.unwrap_or_else(|| self.of(own / local.stretch[i]));
            if k < self.of_rays[i] && bounds.clip(ray).is_some() {
                if scattered && k <= ASKED_THEMSELVES {
                    ask_points |= 1 << i;
                } else {
                    self.of_rays[i] = k;
                }
            }
        }
        if ask_points == 0 {
            return Ok(());
        }
        if !walk.may_look_at_runs_of(node, cloud.header()) {
            return Err(cloud.broken(node.own.first_page).into());
        }
        self.lower_by_points(access, cloud, node, local, ask_points)
    }

    /// Lowers k for rays that pass through the spheres of influence of a node's own points,
    /// according to their radii.
    fn lower_by_points(
        &mut self,
        access: Access<'_>,
        cloud: &CloudPlacement,
        node: &Node,
        local: LocalRays<'_>,
        lanes: u64,
    ) -> Result<(), Halt> {
        let header = cloud.header();
        let mut radii = [header.radius.min(); RUN_POINTS];
        let mut offsets = [[0.0; RUN_POINTS]; 3];
        each_own_page(access, cloud, node, |_, points, runs| {
            for index in runs {
                let near = local.columns.cross(&run_bounds(cloud, points, index), 0.0).near & lanes;
                if near == 0 {
                    continue;
                }
                let run = points.run(index);
                if let Some(stored) = run.radii(header) {
                    radii.iter_mut().zip(stored).for_each(|(radius, stored)| *radius = stored);
                }
                run.decode_local_f64(cloud.root_cell, &mut offsets);
                let center = run.head.position_bounds(cloud.root_cell).center();
                for (lane, ray) in local.rays.iter().enumerate().filter(|(lane, _)| near >> lane & 1 == 1) {
                    // The unit direction in local space, for the squared distance of a point to the
                    // ray's line.
                    let (stretch, from) = (local.stretch[lane], center - ray.origin);
                    let direction = ray.direction / stretch;
                    for (i, &radius) in radii.iter().enumerate().take(run.head.len()) {
                        let radius = f64::from(radius);
                        let to = from + DVec3::new(offsets[0][i], offsets[1][i], offsets[2][i]);
                        let along = to.dot(direction);
                        let across = (to - direction * along).length_squared();
                        if across < radius * radius && along > -radius {
                            let k = self.of(radius / stretch);
                            self.of_rays[lane] = self.of_rays[lane].min(k);
                        }
                    }
                }
            }
        })
    }
}

/// The walk to the finest points that rays may meet.
struct FinestPoints<'t, 'a> {
    exponents: &'t mut Exponents,
    access: Access<'a>,
    cloud: &'a CloudPlacement,
    local: LocalRays<'t>,
    /// All rays, in the local space of the cloud.
    beam: Beam,
    waiting: Vec<Node>,
}

impl<'a> Visitor<RetainedNodes<'a>> for FinestPoints<'_, 'a> {
    fn meet(&mut self, node: Node) {
        self.waiting.push(node);
    }

    fn next(&mut self) -> Option<Node> {
        self.waiting.pop()
    }

    fn visit(&mut self, node: &Node, walk: &mut Walk, _: &mut RetainedNodes<'a>) -> Result<Visit, Halt> {
        let Self { access, cloud, local, .. } = *self;
        let finest_known = self.exponents.of_rays.iter().copied().max().unwrap_or(0);
        let coarse = self.exponents.of(f64::from(node.radius_min) / local.stretches.1) >= finest_known;
        if coarse || self.beam.span(&node.bounds(cloud.root_cell)).is_none() {
            return Ok(Visit::Skip);
        }
        self.exponents.lower_by_node(access, cloud, node, local, walk)?;
        Ok(Visit::Open)
    }
}

/// Rays in the local space of a cloud.
#[derive(Clone, Copy)]
struct LocalRays<'a> {
    rays: &'a [Ray],
    /// Lengths of their directions.
    stretch: &'a [f64],
    columns: &'a RayColumns,
    /// The least and the greatest of the lengths.
    stretches: (f64, f64),
}

impl LocalRays<'_> {
    /// The length of their directions, if it is the same for all.
    fn same_stretch(&self) -> Option<f64> {
        let (least, most) = self.stretches;
        (least == most).then_some(least)
    }
}

//! The distance between samples, which differs from place to place along each ray.
//!
//! Steps are δ₀·2^k. A ray is cut into *cells* of [`SLAB_SAMPLES`] steps each: those of the
//! coarsest steps first, of which one begins wherever the distance from the ray's origin is a
//! multiple of their length. A cell in which some detail asks for finer steps is cut into halves,
//! and so on. This is a function of ray and scene alone, whatever packet the ray is traced in.
//!
//! Details are objects, where the ray is within their bounds; within a cloud, nodes of its octree,
//! groups of 16 points, and single points ([`octree`]). They are looked for cell by cell
//! ([`Details`]): behind the end of a ray nothing is.
//!
//! In a solid, noise or a grid every sample is evaluated, even if it is empty. So there are two
//! limits, which are functions of the scene alone. The detail that such an object asks for is never
//! less than a fraction of the diagonal of the box around them all. A ray that meets one of them
//! takes a bounded number of steps through that box, however fine a cloud in it is.

mod chords;
mod details;
mod groups;
mod local_rays;
mod octree;

use super::cloud::{CloudLod, CloudPlacement, CloudVolume};
use super::program::{Action, Program};
use super::{RenderError, SettingError};
use crate::field::{Packet, SLAB_SAMPLES, Sight, Slab};
use crate::scene::{FINEST_DETAIL, MOST_STEPS, MOST_STEPS_IN_SOLIDS, RenderSettings, Step, largest_stretch};
use rayset_base::geometry::{Aabb, Ray};

pub(super) use self::details::Details;

/// Finest automatic step: the coarsest times 2^−`FINEST`.
const FINEST: i32 = 60;
/// Refinement also stops at this many steps across a scene, whatever radii its files contain,
/// unless the coarsest step is finer already.
const MOST_REFINED_STEPS: f64 = (1_u64 << 24) as f64;
/// The points of a cloud, a node or a group wider than this many of its least radii are scattered:
/// most rays that meet it meet no point.
const SCATTERED: f64 = 256.0;
/// If a group asks for steps of 2^`ASKED_THEMSELVES` times the coarsest or finer, its scattered
/// points are tested one by one.
const ASKED_THEMSELVES: i32 = -4;

/// In a grid a step is a fraction of this many voxel spacings: half a spacing if the fraction is a
/// quarter.
const GRID_DETAIL: f64 = 2.0;

/// Where points are seen from afar, steps are a fraction of no less than this many pixels: what is
/// seen is as wide as a pixel. Where cells are coarse, it is less wide, and steps are too long for
/// pictures at rest.
const PIXEL_DETAIL: f64 = 1.6;
/// Points with a radius of more pixels ask for steps by themselves: of smaller ones, at least
/// 45 % is seen as Gaussians.
const SHARP: f64 = 1.7;

/// A sample within so many steps behind a boundary is lit at the boundary: it would otherwise
/// shadow itself, to a degree that depends on how the lattice of samples happens to lie.
const BOUNDARY_STEPS: f64 = 2.0;
/// The same, in details of which automatic steps are a fraction, so that finer steps make the same
/// picture.
const BOUNDARY_DETAILS: f64 = 0.5;

/// Which steps the rays of a scene have.
#[derive(Clone)]
pub(super) struct StepRule {
    /// δ₀, world space.
    coarsest: f64,
    /// k of the finest and of the coarsest steps that any ray has anywhere.
    range: (i32, i32),
    boundary_steps: f64,
    scale: Scale,
    floors: Floors,
    /// For each instruction, the least k that it asks for on any ray; empty if steps are the same
    /// everywhere.
    least: Vec<i32>,
}

/// k by length.
#[derive(Clone, Copy, Debug)]
struct Scale {
    /// The length of which δ₀ is the requested fraction.
    longest: f64,
    /// The least k.
    finest: i32,
}

impl Scale {
    /// k for a length: the largest k ≤ 0 for which 2^k is at most `length / longest`.
    fn of(&self, length: f64) -> i32 {
        // Rounding in a transform must not halve the steps of rays at random.
        let share = length / self.longest * (1.0 + 1e-6);
        // The exponent of a number is the logarithm to base 2, rounded down.
        let exponent = (share.to_bits() >> 52) as i32 - 1023;
        exponent.clamp(self.finest, 0)
    }
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
    /// The steps of rays with a sight, from an eye or of a light; otherwise those of rays that see
    /// nothing from afar.
    pub(super) fn new(
        program: &Program,
        settings: &RenderSettings,
        sight: Option<&Sight>,
    ) -> Result<Self, RenderError> {
        let within = program.instructions[program.root()].bounds;
        let diagonal = |bounds: Aabb| if bounds.is_empty() { 0.0 } else { bounds.size().length() };
        let solids = program.instructions.iter().filter(|i| is_solid(&i.action));
        let solids = solids.map(|i| i.object_bounds.intersection(within)).filter(|bounds| !bounds.is_empty());
        let around_solids = diagonal(solids.fold(Aabb::EMPTY, Aabb::union));
        let floor = around_solids * FINEST_DETAIL;
        let details = program.instructions.iter().map(|i| {
            let held = if is_solid(&i.action) { floor } else { 0.0 };
            details_of(&i.action, sight).map(|(least, largest)| (least.max(held), largest.max(held)))
        });
        let details: Vec<Option<(f64, f64)>> = details.collect();
        let longest = details.iter().flatten().map(|d| d.1).filter(|d| d.is_finite()).fold(0.0, f64::max);
        let (coarsest, varies) = match settings.step {
            Step::Fixed(step) => (step, false),
            Step::Automatic { fraction } if longest > 0.0 => {
                (longest * fraction, may_differ(program, sight.is_some()))
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
        // The least k with which steps are at least `least` long.
        let exponent = |least: f64| ((least / coarsest).log2().ceil() as i32).clamp(-FINEST, FINEST);
        let floors = Floors {
            detail: floor,
            exponent: exponent(diagonal(within) / MOST_STEPS),
            exponent_in_solids: exponent(around_solids / MOST_STEPS_IN_SOLIDS),
        };
        let finest =
            (extent / MOST_REFINED_STEPS / coarsest).log2().ceil().clamp(f64::from(-FINEST), 0.0) as i32;
        let scale = Scale { longest, finest };
        let boundary_steps = match settings.step {
            Step::Fixed(_) => BOUNDARY_STEPS,
            Step::Automatic { fraction } => (BOUNDARY_DETAILS / fraction).max(BOUNDARY_STEPS),
        };
        if !varies {
            return Ok(Self { coarsest, range: (0, 0), boundary_steps, scale, floors, least: Vec::new() });
        }
        let least: Vec<i32> =
            details.iter().map(|detail| detail.map_or(0, |(least, _)| scale.of(least))).collect();
        let finest_asked = least.iter().copied().min().unwrap_or(0);
        let range =
            (finest_asked.max(floors.exponent), floors.exponent.max(floors.exponent_in_solids).max(0));
        Ok(Self { coarsest, range, boundary_steps, scale, floors, least })
    }

    /// The longest step that details are given; world space. Only limits of the number of steps
    /// make them longer.
    pub(super) fn coarsest_world(&self) -> f64 {
        self.coarsest
    }

    /// The finest step that any ray has anywhere; world space.
    pub(super) fn tick_world(&self) -> f64 {
        self.coarsest * 2_f64.powi(self.range.0)
    }

    /// How many steps behind a boundary samples are lit at it.
    pub(super) fn boundary_steps(&self) -> f64 {
        self.boundary_steps
    }

    /// Whether steps are the same everywhere.
    pub(super) fn is_uniform(&self) -> bool {
        self.range.0 == self.range.1
    }

    /// The cell of the coarsest steps that a tick is in.
    pub(super) fn cell_at(&self, tick: u64) -> Slab {
        let level = (self.range.1 - self.range.0) as u32;
        let samples = SLAB_SAMPLES as u64;
        Slab { first: (tick >> level) / samples * samples, samples: SLAB_SAMPLES, level }
    }

    /// Length of a cell of steps δ₀·2^k; world space.
    fn cell_world(&self, k: i32) -> f64 {
        self.coarsest * 2_f64.powi(k) * SLAB_SAMPLES as f64
    }

    /// k of steps at a level.
    fn exponent_at(&self, level: u32) -> i32 {
        self.range.0 + level as i32
    }
}

/// The least and the largest detail of an object along any ray: the length that steps are to be a
/// fraction of.
fn details_of(action: &Action, sight: Option<&Sight>) -> Option<(f64, f64)> {
    match action {
        Action::Cloud(volume) => {
            let cloud = &volume.placement;
            let stretch = cloud.local_from_world().map_or(1.0, largest_stretch);
            let points = (f64::from(cloud.details.0) / stretch, cloud.largest_detail_world());
            let Some(pixels) = PixelDetail::of(volume, sight) else { return Some(points) };
            let (bounds, radius) = (&cloud.header().bounds, pixels.radius_max);
            let least = pixels.least_in(bounds, radius, cloud.details.0.into());
            // Of the same scale in all directions.
            Some((least / stretch, points.1.max(pixels.largest_in(bounds) / stretch)))
        }
        Action::Procedural(volume) => Some((volume.least_detail_world(), volume.largest_detail_world())),
        Action::Grid(volume) => {
            Some((GRID_DETAIL * volume.least_spacing_world(), GRID_DETAIL * volume.largest_spacing_world()))
        }
        Action::Operator(..) => None,
    }
}

/// Whether steps may differ from place to place: not if there is but one object, which is no cloud,
/// or whose points have one radius along any ray.
pub(super) fn may_differ<P>(program: &Program<P>, is_seen: bool) -> bool {
    let mut objects = program.instructions.iter().filter_map(|instruction| match &instruction.action {
        Action::Cloud(volume) if is_seen && volume.lod.is_some() => Some(false),
        Action::Cloud(volume) => {
            let (least, most) = volume.placement.details;
            Some(least == most && volume.placement.local_from_world().is_none())
        }
        Action::Procedural(_) | Action::Grid(_) => Some(true),
        Action::Operator(..) => None,
    });
    objects.next() == Some(false) || objects.next().is_some()
}

/// The least details of a cloud that is seen from afar, by where it is; in the cloud's space.
#[derive(Clone, Copy)]
struct PixelDetail<'a> {
    lod: &'a CloudLod,
    sight: Sight,
    radius_max: f64,
    has_shapes: bool,
}

impl<'a> PixelDetail<'a> {
    /// `None` if the cloud is not seen from afar.
    fn of(volume: &'a CloudVolume, sight: Option<&Sight>) -> Option<Self> {
        let lod = volume.lod.as_deref()?;
        let sight = lod.sight(&volume.placement.local_sight(sight)?);
        let header = volume.placement.header();
        Some(Self { lod, sight, radius_max: header.radius.max().into(), has_shapes: header.shape.is_some() })
    }

    /// The least detail anywhere in a box, of points with these largest radius and least detail:
    /// some of them are seen as they are where they are larger than a pixel, however thin.
    fn least_in(&self, bounds: &Aabb, radius_max: f64, detail: f64) -> f64 {
        let pixel = self.sight.least_pixel_in(bounds);
        if self.has_shapes && radius_max > SHARP * pixel { detail } else { detail.max(PIXEL_DETAIL * pixel) }
    }

    /// The largest of pixels anywhere in a box.
    fn largest_in(&self, bounds: &Aabb) -> f64 {
        PIXEL_DETAIL * self.sight.largest_pixel_in(bounds)
    }

    /// A box of points as far as these reach.
    fn as_seen(&self, bounds: Aabb) -> Aabb {
        bounds.inflated(self.lod.reach_in(&bounds, &self.sight, self.radius_max))
    }
}

/// Whether every sample in the bounds of an object is evaluated, empty or not.
fn is_solid(action: &Action) -> bool {
    matches!(action, Action::Procedural(_) | Action::Grid(_))
}

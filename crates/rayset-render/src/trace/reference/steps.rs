//! The steps of rays, by the rule of `docs/rendering.md` (samples of a ray), stated anew: for every
//! ray, every detail of every object is looked at, in double precision.

use std::collections::BTreeMap;

use crate::field::Kernel;
use crate::scene::{CloudObject, Node, RenderSettings, Scene, Shape, Step};
use rayset_base::geometry::{Aabb, DAffine3, DVec3, Ray};
use rayset_files::octree::node::NodePage;
use rayset_files::paged_file::HasPages;
use rayset_store::container::ScanError;

/// Samples of a cell.
const CELL: u64 = 32;

/// Where the samples of rays are.
pub struct ReferenceSteps {
    rule: Rule,
    /// How many steps behind a boundary samples are lit at it.
    boundary_steps: f64,
}

enum Rule {
    Same(f64),
    ByPlace(ByPlace),
}

/// A sample of a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Place {
    /// Distance along the ray.
    pub(super) t: f64,
    /// The length that it stands for.
    pub(super) step: f64,
    /// Its number among samples with this step.
    pub(super) number: u64,
}

impl Place {
    /// The interval of the ray that it stands for.
    pub(super) fn interval(&self) -> (f64, f64) {
        let from = self.number as f64 * self.step;
        (from, from + self.step)
    }
}

/// Steps of δ₀·2^k.
struct ByPlace {
    /// δ₀ and L, world space.
    coarsest: f64,
    largest: f64,
    /// k₀.
    finest: i32,
    /// The least k of a ray, and of one that meets a solid, noise or a grid.
    least: i32,
    least_in_solids: i32,
    objects: Vec<Object>,
}

/// An object with details.
struct Object {
    /// World space.
    bounds: Aabb,
    local_from_world: DAffine3,
    is_solid: bool,
    /// In the object's space.
    details: Vec<Detail>,
    /// The least detail, world space.
    at_least: f64,
}

/// A length that asks for steps, in the space of its object.
struct Detail {
    length: f64,
    within: Within,
}

enum Within {
    Bounds,
    Box(Aabb),
    Sphere(DVec3, f64, Aabb),
}

impl ReferenceSteps {
    /// The same step, in world space, everywhere.
    #[must_use]
    pub fn same(step_world: f64) -> Self {
        Self { rule: Rule::Same(step_world), boundary_steps: 2.0 }
    }

    /// The steps that rays of a scene have by the settings; of shadow rays, too.
    ///
    /// # Errors
    /// [`ScanError`] if a cloud cannot be read or is damaged.
    pub fn of(scene: &Scene, settings: &RenderSettings) -> Result<Self, ScanError> {
        match settings.step {
            Step::Fixed(step_world) => Ok(Self::same(step_world)),
            Step::Automatic { fraction } => {
                // Half a detail, of which the step is a fraction.
                let boundary_steps = (0.5 / fraction).max(2.0);
                Ok(Self { rule: ByPlace::of(scene, fraction)?, boundary_steps })
            }
        }
    }

    /// The samples of a ray that may lie within some bounds, front to back.
    pub(super) fn samples(&self, ray: &Ray, offset: f64, bounds: &Aabb) -> Vec<Place> {
        let Some((enter, exit)) = bounds.clip(ray) else { return Vec::new() };
        match &self.rule {
            Rule::Same(step) => {
                let first = ((enter / step - offset).floor() - 1.0).max(0.0);
                (0_u64..)
                    .map(|i| (first as u64 + i, (first + i as f64 + offset) * step))
                    .take_while(|(_, t)| *t <= exit + step)
                    .map(|(number, t)| Place { t, step: *step, number })
                    .collect()
            }
            Rule::ByPlace(rule) => {
                let asked = rule.asked(ray);
                let mut samples = Vec::new();
                let k = rule.least.max(rule.least_in_solids).max(0);
                let cell = rule.step(k) * CELL as f64;
                for number in (enter / cell).floor() as u64..=(exit / cell).floor() as u64 {
                    rule.divide((number, k), &asked, (enter, exit), offset, &mut samples);
                }
                samples
            }
        }
    }

    /// How far behind a boundary samples of a step are lit at it.
    pub(super) fn boundary_reach(&self, step: f64) -> f64 {
        self.boundary_steps * step
    }

    /// The longest step that details are given; world space.
    #[must_use]
    pub fn coarsest_world(&self) -> f64 {
        match &self.rule {
            Rule::Same(step) => *step,
            Rule::ByPlace(rule) => rule.coarsest,
        }
    }
}

/// What the details that a ray is in ask for.
struct Asked {
    /// k, and from where to where along the ray.
    details: Vec<(i32, f64, f64)>,
    least: i32,
}

impl ByPlace {
    fn of(scene: &Scene, fraction: f64) -> Result<Rule, ScanError> {
        let within = scene.root.bounds();
        let diagonal = |bounds: Aabb| if bounds.is_empty() { 0.0 } else { bounds.size().length() };
        let mut leaves = Vec::new();
        collect(&scene.root, &DAffine3::IDENTITY, &mut leaves);
        let solids = leaves.iter().filter(|leaf| leaf.is_solid).map(|leaf| leaf.bounds.intersection(within));
        let solids = diagonal(solids.filter(|b| !b.is_empty()).fold(Aabb::EMPTY, Aabb::union));
        for leaf in leaves.iter_mut().filter(|leaf| leaf.is_solid) {
            leaf.at_least = solids / 2_f64.powi(14);
        }
        let largest = leaves.iter().map(Leaf::largest_world).filter(|l| l.is_finite()).fold(0.0, f64::max);
        if !(largest > 0.0) {
            return Ok(Rule::Same(1.0));
        }
        let coarsest = fraction * largest;
        if let [leaf] = &leaves[..]
            && leaf.is_alike
        {
            return Ok(Rule::Same(coarsest));
        }
        let extent = if within.is_empty() { 0.0 } else { within.size().max_element() };
        let at_least = |length: f64| ((length / coarsest).log2().ceil() as i32).clamp(-60, 60);
        let mut rule = Self {
            coarsest,
            largest,
            finest: (extent / 2_f64.powi(24) / coarsest).log2().ceil().clamp(-60.0, 0.0) as i32,
            least: at_least(diagonal(within) / 2_f64.powi(40)),
            least_in_solids: at_least(solids / 2_f64.powi(20)),
            objects: Vec::new(),
        };
        for leaf in &leaves {
            let object = rule.object(leaf)?;
            rule.objects.push(object);
        }
        Ok(Rule::ByPlace(rule))
    }

    /// k(ℓ), of a length of the world.
    fn k(&self, length: f64) -> i32 {
        (1.000_001 * length / self.largest).log2().floor().clamp(f64::from(self.finest), 0.0) as i32
    }

    fn step(&self, k: i32) -> f64 {
        self.coarsest * 2_f64.powi(k)
    }

    fn object(&self, leaf: &Leaf<'_>) -> Result<Object, ScanError> {
        let Leaf { bounds, world_from_local, is_solid, at_least, .. } = *leaf;
        let details = match leaf.cloud {
            None => vec![Detail { length: leaf.largest, within: Within::Bounds }],
            Some(cloud) => self.details_of_cloud(cloud, stretch(&world_from_local))?,
        };
        Ok(Object { bounds, local_from_world: world_from_local.inverse(), is_solid, details, at_least })
    }

    fn details_of_cloud(&self, object: &CloudObject, stretch: f64) -> Result<Vec<Detail>, ScanError> {
        let header = object.cloud.header();
        let root = header.root_cell();
        let (least, most) = object.details();
        let (least, most) = (f64::from(least), f64::from(most));
        let is_scattered =
            object.kernel != Kernel::Splat && self.is_scattered(header.bounds.size(), least, stretch);
        if least == most && !is_scattered {
            return Ok(vec![Detail { length: least, within: Within::Bounds }]);
        }
        let runs = runs_of(object)?;
        let mut details = Vec::new();
        object.cloud.stored_file().for_each_page(|page, bytes| {
            if page < header.point_pages {
                return;
            }
            let nodes = NodePage::scaled(bytes, header);
            for node in (0..nodes.len()).filter_map(|i| nodes.get(i)).filter(|node| node.own.runs > 0) {
                let (bounds, finest) = (node.bounds(root), f64::from(node.detail_min));
                let half_cell = root.size * 2_f64.powi(-i32::from(node.level) - 1);
                let is_of_balls = header.shape.is_none();
                let finest = if node.child_mask > 0 && is_of_balls { finest.max(half_cell) } else { finest };
                let k = self.k(finest * stretch);
                let is_one = k - self.k(f64::from(node.detail_max) * stretch) >= -1;
                let is_short = bounds.size().max_element() * stretch <= 64.0 * self.step(k);
                if (is_one || is_short) && !self.is_scattered(bounds.size(), finest, stretch) {
                    details.push(Detail { length: finest, within: Within::Box(bounds) });
                    continue;
                }
                let own = runs.range(node.own.first_page..).flat_map(|(_, runs)| runs);
                for run in own.skip(usize::from(node.own.first_run)).take(node.own.runs as usize) {
                    run.chunks(16).for_each(|group| self.add_group(group, &bounds, stretch, &mut details));
                }
            }
        })?;
        Ok(details)
    }

    /// Adds a group of points of a node, or each of them.
    fn add_group(&self, group: &[StepPoint], of_node: &Aabb, stretch: f64, details: &mut Vec<Detail>) {
        let mut around = Aabb::EMPTY;
        for point in group {
            around.include(point.position - point.radius);
            around.include(point.position + point.radius);
        }
        let around = around.intersection(*of_node);
        let least = group.iter().map(|point| point.detail).fold(f64::INFINITY, f64::min);
        if !self.is_scattered(around.size(), least, stretch) {
            details.push(Detail { length: least, within: Within::Box(around) });
            return;
        }
        let sphere = |point: &StepPoint| {
            let StepPoint { position, radius, detail } = *point;
            Detail { length: detail, within: Within::Sphere(position, radius, around) }
        };
        details.extend(group.iter().map(sphere));
    }

    /// Whether points in a box of some size, of which the least has a detail, are scattered.
    fn is_scattered(&self, size: DVec3, detail: f64, stretch: f64) -> bool {
        size.max_element() > 256.0 * detail && self.k(detail * stretch) <= -4
    }

    fn asked(&self, ray: &Ray) -> Asked {
        let mut asked = Asked { details: Vec::new(), least: self.least };
        for object in &self.objects {
            let Some((enter, exit)) = object.bounds.clip(ray) else { continue };
            if object.is_solid {
                asked.least = asked.least.max(self.least_in_solids);
            }
            let local = Ray {
                origin: object.local_from_world.transform_point3(ray.origin),
                direction: object.local_from_world.transform_vector3(ray.direction),
            };
            let stretch = local.direction.length();
            for detail in &object.details {
                let within = match &detail.within {
                    Within::Bounds => Some((enter, exit)),
                    Within::Box(bounds) => bounds.clip(&local),
                    Within::Sphere(at, radius, around) => {
                        let sphere = passes(&local, *at, *radius);
                        let both = |(a, b): (f64, f64), (c, d): (f64, f64)| (a.max(c), b.min(d));
                        sphere.zip(around.clip(&local)).map(|(a, b)| both(a, b))
                    }
                };
                let k = self.k((detail.length / stretch).max(object.at_least));
                if let Some((from, to)) = within.filter(|_| k < 0) {
                    let (from, to) = (from.max(enter), to.min(exit));
                    if from <= to {
                        asked.details.push((k, from, to));
                    }
                }
            }
        }
        asked
    }

    /// Adds the samples of a cell, or of its halves.
    fn divide(
        &self,
        (cell, k): (u64, i32),
        asked: &Asked,
        span: (f64, f64),
        offset: f64,
        samples: &mut Vec<Place>,
    ) {
        let step = self.step(k);
        let (begin, end) = ((cell * CELL) as f64 * step, ((cell + 1) * CELL) as f64 * step);
        if begin > span.1 || end < span.0 {
            return;
        }
        let asks = |&(finer, from, to): &(i32, f64, f64)| finer < k && from <= end && to >= begin;
        if k > asked.least && (k > 0 || asked.details.iter().any(asks)) {
            self.divide((2 * cell, k - 1), asked, span, offset, samples);
            self.divide((2 * cell + 1, k - 1), asked, span, offset, samples);
            return;
        }
        let numbers = cell * CELL..(cell + 1) * CELL;
        samples.extend(numbers.map(|number| Place { t: (number as f64 + offset) * step, step, number }));
    }
}

/// An object of a scene, where it is.
struct Leaf<'a> {
    cloud: Option<&'a CloudObject>,
    bounds: Aabb,
    world_from_local: DAffine3,
    is_solid: bool,
    /// The largest detail, in a space of its own for grids: that of voxels.
    largest: f64,
    /// Whether it asks for the same steps wherever rays are in it, if it is alone.
    is_alike: bool,
    at_least: f64,
}

impl Leaf<'_> {
    fn largest_world(&self) -> f64 {
        (self.largest * stretch(&self.world_from_local)).max(self.at_least)
    }
}

fn collect<'a>(node: &'a Node, world_from_parent: &DAffine3, leaves: &mut Vec<Leaf<'a>>) {
    let world_from_local = *world_from_parent * node.parent_from_local;
    let (cloud, world_from_local, largest, is_alike) = match &node.shape {
        Shape::Operator(_, children) => {
            return children.iter().for_each(|child| collect(child, &world_from_local, leaves));
        }
        Shape::Cloud(object) => {
            let (least, most) = object.details();
            let is_alike = least == most && world_from_local == DAffine3::IDENTITY;
            (Some(object), world_from_local, f64::from(most), is_alike)
        }
        // Of voxels one to the right, one up and one away from each other.
        Shape::Grid(object) => (None, world_from_local * object.grid.header().space_from_voxel, 2.0, true),
        Shape::Procedural(field) => (None, world_from_local, field.detail(), true),
    };
    let (bounds, is_solid) = (node.bounds().transformed(world_from_parent), cloud.is_none());
    leaves.push(Leaf { cloud, bounds, world_from_local, is_solid, largest, is_alike, at_least: 0.0 });
}

/// For each page of points its runs.
type Runs = BTreeMap<u32, Vec<Vec<StepPoint>>>;

/// A point of a cloud: its detail is its radius, of an ellipsoid twice the shortest semi-axis if
/// that is less.
#[derive(Clone, Copy)]
struct StepPoint {
    position: DVec3,
    radius: f64,
    detail: f64,
}

fn runs_of(object: &CloudObject) -> Result<Runs, ScanError> {
    let header = object.cloud.header();
    let mut runs = Runs::new();
    object.cloud.for_each_run(|page, run| {
        let positions = run.positions(header.root_cell());
        let radii: Vec<f64> = match run.radii(header) {
            Some(radii) => radii.map(f64::from).collect(),
            None => vec![f64::from(header.radius.min()); positions.len()],
        };
        let details: Vec<f64> = match run.details(header) {
            Some(details) => details.map(f64::from).collect(),
            None => radii.clone(),
        };
        let points = positions.into_iter().zip(radii).zip(details);
        let points = points.map(|((position, radius), detail)| StepPoint { position, radius, detail });
        runs.entry(page).or_default().push(points.collect());
    })?;
    Ok(runs)
}

/// The most that a transform stretches any direction: the square root of the largest eigenvalue of
/// MᵀM, a root of its characteristic polynomial.
fn stretch(map: &DAffine3) -> f64 {
    let m = map.matrix3;
    let s = m.transpose() * m;
    let mean = (s.x_axis.x + s.y_axis.y + s.z_axis.z) / 3.0;
    let centred = s - rayset_base::geometry::DMat3::from_diagonal(DVec3::splat(mean));
    let spread = centred.to_cols_array().iter().map(|v| v * v).sum::<f64>() / 6.0;
    let radius = spread.sqrt();
    if radius <= 1e-15 * mean {
        return mean.sqrt();
    }
    let angle = (centred.determinant() / (2.0 * radius.powi(3))).clamp(-1.0, 1.0).acos() / 3.0;
    (mean + 2.0 * radius * angle.cos()).sqrt()
}

/// From where to where a ray is in a sphere.
fn passes(ray: &Ray, center: DVec3, radius: f64) -> Option<(f64, f64)> {
    let (to, per_length) = (center - ray.origin, 1.0 / ray.direction.length());
    let direction = ray.direction * per_length;
    let (along, across) = (to.dot(direction), to.cross(direction).length());
    let half = (radius * radius - across * across).max(0.0).sqrt();
    let (from, until) = ((along - half) * per_length, (along + half) * per_length);
    (across < radius && until > 0.0).then(|| (from.max(0.0), until))
}

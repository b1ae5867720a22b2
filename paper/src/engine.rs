//! The discrete ray tracer's side: from a sample to its leaf, from the leaf to its points, from
//! these to the field.

use std::cell::RefCell;
use std::rc::Rc;

use rayset::field::Kernel;
use rayset::field::reference::ReferenceSample;
use rayset::geometry::{DVec3, Ray};
use rayset::scene::{Camera, CloudObject, RenderSettings};
use rayset::scene::{CameraError, Scene};
use rayset::trace::reference::{PointField, Purpose, ReferenceError, ReferenceRenderer, ReferenceSteps};

use crate::cache::CacheError;
use crate::predict::{Foresight, Predictor};
use crate::record::{Below, Node, Point};
use crate::records::{Ahead, Hold, Records, Work};

/// Priorities by source (section 4.2).
const OPACITY_PRIORITY: u8 = 200;
const SHADOW_PRIORITY: u8 = 150;
const PREDICTION_PRIORITY: u8 = 100;

/// Why there is no picture.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EngineError {
    /// A record.
    #[error(transparent)]
    Cache(#[from] CacheError),
    /// The scene.
    #[error(transparent)]
    Scene(#[from] ReferenceError),
    /// The camera.
    #[error(transparent)]
    Camera(#[from] CameraError),
}

/// The path from the root to the leaf of the last sample, all of it retained, and the points of
/// that leaf.
#[derive(Default)]
struct Place {
    path: Vec<(u64, Node, Hold)>,
    list: Vec<u32>,
    listed: Option<u64>,
}

impl Place {
    /// Goes to the leaf that holds a sample: up as far as need be, then down. Nothing outside the
    /// root.
    fn find(
        &mut self,
        records: &mut impl Records,
        s: DVec3,
        priority: u8,
    ) -> Result<Option<u64>, CacheError> {
        if self.path.is_empty() {
            let (root, hold) = records.retain(0, priority)?;
            self.path.push((0, root, hold));
        }
        while let Some((_, node, hold)) = self.path.last().copied() {
            records.work(Work::Step);
            if node.contains(s) {
                break;
            }
            if self.path.len() == 1 {
                return Ok(None);
            }
            records.release(hold);
            self.path.pop();
        }
        loop {
            let Some(&(number, node, hold)) = self.path.last() else { return Ok(None) };
            let Below::Children(children) = node.below else {
                if self.listed != Some(number) {
                    self.list.clear();
                    records.list((&node, hold), priority, &mut self.list)?;
                    self.listed = Some(number);
                    records.hint_points(&self.list, priority)?;
                }
                return Ok(Some(number));
            };
            records.work(Work::Step);
            let child = children[node.octant(s)];
            let (inner, hold) = records.retain(child, priority)?;
            if inner.parent != number || !inner.contains(s) {
                records.release(hold);
                return Err(CacheError::Tangled { child, parent: number });
            }
            self.path.push((child, inner, hold));
        }
    }

    /// Gives the path back.
    fn leave(&mut self, records: &mut impl Records) {
        for (_, _, hold) in self.path.drain(..).rev() {
            records.release(hold);
        }
        self.listed = None;
    }

    /// The leaf of the last sample.
    fn leaf(&self) -> Option<Node> {
        self.path.last().map(|(_, leaf, _)| *leaf)
    }

    /// The deepest node of the path that holds a place.
    fn above(&self, q: DVec3) -> Option<&Node> {
        self.path.iter().rev().map(|(_, node, _)| node).find(|node| node.contains(q))
    }
}

/// Algorithm 2 for the leaves that come next on a way, `depth` of them: the paper's is 1. True
/// where all of them are in core.
fn look_ahead(
    records: &mut impl Records,
    place: &Place,
    (mut s, way): (DVec3, DVec3),
    depth: u32,
) -> Result<bool, CacheError> {
    let Some(mut leaf) = place.leaf() else { return Ok(true) };
    for _ in 0..depth {
        let Some(beyond) = next_beyond(&leaf, s, way) else { return Ok(true) };
        // Outside the root there is nothing to bring in.
        let Some(from) = place.above(beyond) else { return Ok(true) };
        match records.precache(from, beyond, PREDICTION_PRIORITY)? {
            Ahead::Reached(next) => (s, leaf) = (beyond, next),
            Ahead::Asked => return Ok(false),
            Ahead::Nowhere => return Ok(true),
        }
    }
    Ok(true)
}

/// The next place on the way of a sample that is not in its leaf.
fn next_beyond(leaf: &Node, s: DVec3, way: DVec3) -> Option<DVec3> {
    let mut exit = f64::INFINITY;
    for axis in 0..3 {
        if way[axis] != 0.0 {
            let side = if way[axis] > 0.0 { leaf.max[axis] } else { leaf.min[axis] };
            exit = exit.min((side - s[axis]) / way[axis]);
        }
    }
    let steps = exit.floor().max(0.0) + 1.0;
    let beyond = s + way * steps;
    // On the side itself a rounded place may still be inside.
    Some(if leaf.contains(beyond) { beyond + way } else { beyond }).filter(|q| q.is_finite())
}

/// The field of one object over an index, which other objects may share. The nodes that it retains
/// are given back with it.
pub struct IndexField<R: Records> {
    records: Rc<RefCell<R>>,
    failure: Rc<RefCell<Option<CacheError>>>,
    state: RefCell<(Place, Predictor)>,
    kernel: Kernel,
    normalised: bool,
    gradient: bool,
    depth: u32,
}

impl<R: Records> IndexField<R> {
    /// The field of an object. `failure` is where the first error goes, since a field has no way to
    /// return it.
    #[must_use]
    pub fn new(
        object: &CloudObject,
        gradient: bool,
        foresight: impl Into<Foresight>,
        records: Rc<RefCell<R>>,
        failure: Rc<RefCell<Option<CacheError>>>,
    ) -> Self {
        let Foresight { variant, depth } = foresight.into();
        let state = RefCell::new((Place::default(), Predictor::new(variant)));
        Self {
            records,
            failure,
            state,
            kernel: object.kernel,
            normalised: object.normalised,
            gradient,
            depth,
        }
    }

    fn sample_or_fail(&self, s: DVec3, priority: u8) -> Result<ReferenceSample, CacheError> {
        let mut records = self.records.borrow_mut();
        let (place, predictor) = &mut *self.state.borrow_mut();
        let mut sum = ReferenceSample::default();
        records.work(Work::Sample);
        let Some(leaf) = place.find(&mut *records, s, priority)? else { return Ok(sum) };
        if let Some(way) = predictor.access(s, leaf) {
            let cached = look_ahead(&mut *records, place, (s, way), self.depth)?;
            predictor.attempted(cached);
        }
        for &number in &place.list {
            let point = records.point(number, priority)?;
            records.work(Work::Point);
            add(&mut sum, &point, s, self.kernel, self.normalised, self.gradient);
        }
        Ok(sum)
    }
}

impl<R: Records> Drop for IndexField<R> {
    fn drop(&mut self) {
        self.state.get_mut().0.leave(&mut *self.records.borrow_mut());
    }
}

impl<R: Records> PointField for IndexField<R> {
    fn ray(&self, ray: &Ray, _purpose: Purpose) {
        self.state.borrow_mut().1.ray(ray.origin);
    }

    fn sample(&self, q: DVec3, purpose: Purpose) -> ReferenceSample {
        if self.failure.borrow().is_some() {
            return ReferenceSample::default();
        }
        let priority = if purpose == Purpose::Shadow { SHADOW_PRIORITY } else { OPACITY_PRIORITY };
        self.sample_or_fail(q, priority).unwrap_or_else(|error| {
            *self.failure.borrow_mut() = Some(error);
            ReferenceSample::default()
        })
    }
}

/// Adds a point to the field at a place; false if it does not reach that far.
pub(crate) fn add(
    sum: &mut ReferenceSample,
    point: &Point,
    q: DVec3,
    kernel: Kernel,
    normalised: bool,
    gradient: bool,
) -> bool {
    let offset = q - point.position;
    let radius = f64::from(point.radius);
    let inverse = 1.0 / (radius * radius);
    let s = offset.length_squared() * inverse;
    if s >= 1.0 {
        return false;
    }
    let norm = if normalised { 1.0 / (radius.powi(3) * kernel.integral()) } else { 1.0 };
    let weight = f64::from(point.weight) * norm;
    sum.density += weight * kernel.value(s);
    if gradient {
        sum.gradient += offset * (weight * kernel.slope_over_x(s) * inverse);
    }
    true
}

/// All points, at every sample: the first baseline.
pub struct BruteForce {
    points: Vec<Point>,
    kernel: Kernel,
    normalised: bool,
    gradient: bool,
}

impl BruteForce {
    /// Over the points of an index.
    ///
    /// # Errors
    /// What the system says.
    pub fn load(index: &crate::index::Index, object: &CloudObject, gradient: bool) -> std::io::Result<Self> {
        let [_, _, path] = index.files();
        let bytes = std::fs::read(path)?;
        let count = index.summary.points as usize;
        let points = bytes.chunks_exact(crate::record::POINT_BYTES).take(count).map(Point::decode).collect();
        Ok(Self { points, kernel: object.kernel, normalised: object.normalised, gradient })
    }
}

impl PointField for BruteForce {
    fn sample(&self, q: DVec3, _purpose: Purpose) -> ReferenceSample {
        let mut sum = ReferenceSample::default();
        for point in &self.points {
            add(&mut sum, point, q, self.kernel, self.normalised, self.gradient);
        }
        sum
    }
}

/// A picture in linear light, row after row.
pub type Picture = Vec<[f32; 4]>;

/// Renders pixels of a scene one after another: all of them, row after row, or those given.
///
/// # Errors
/// [`EngineError`] where a record, the scene or the camera fails.
pub fn render<'a>(
    scene: &'a Scene,
    (camera, settings, step): (&Camera, &RenderSettings, f64),
    failure: &RefCell<Option<CacheError>>,
    field: impl FnMut(&CloudObject) -> &'a dyn PointField,
    pixels: impl IntoIterator<Item = (u32, u32)>,
) -> Result<Picture, EngineError> {
    let reference_renderer = ReferenceRenderer::with_fields(scene, field)?;
    let steps = ReferenceSteps::same(step);
    let mut picture = Picture::new();
    for (x, y) in pixels {
        let pixel = reference_renderer.pixel(camera, settings, &steps, x, y)?;
        if let Some(error) = failure.borrow_mut().take() {
            return Err(error.into());
        }
        picture.push(pixel.map(|v| v as f32));
    }
    Ok(picture)
}

/// Every pixel of a picture, row after row.
pub fn all_pixels(settings: &RenderSettings) -> impl Iterator<Item = (u32, u32)> + use<> {
    let (width, height) = (settings.width, settings.height);
    (0..height).flat_map(move |y| (0..width).map(move |x| (x, y)))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use rayset::points::Workload;

    use super::*;
    use crate::disk::RealDisk;
    use crate::experiments::{Subject, budget_of, differing};
    use crate::index::{Index, Limits};
    use crate::mapped::{self, Access};
    use crate::memory::{Flat, Paged};
    use crate::predict::Variant;
    use crate::records::{Budget, OutOfCore};
    use crate::simulated::{Clock, SimulatedDisk};
    use crate::structures::{InCore, Structures, grow, write_files};
    use crate::swap::Swap;

    const SIDE: u32 = 20;

    fn subject(folder: &Path) -> (Subject, Index) {
        let workload: Workload = "sphere-3k".parse().expect("a workload");
        let subject =
            Subject::build(workload.source(), Some(0.12), SIDE, &folder.join("c.rset")).expect("a cloud");
        let index = subject.index(folder, Limits { height: 5, leaf_points: 8 }).expect("an index");
        (subject, index)
    }

    fn bits(picture: &Picture) -> Vec<[u32; 4]> {
        picture.iter().map(|p| p.map(f32::to_bits)).collect()
    }

    #[test]
    fn the_reference_makes_the_picture_of_the_engine_that_ships() {
        let folder = tempfile::tempdir().expect("a folder");
        let (subject, index) = subject(folder.path());
        let records = InCore::load(&index).expect("the index loads");
        let (found, _) =
            subject.reference(records, Variant::None, all_pixels(&subject.settings)).expect("a picture");
        let (shipped, _) = subject.shipping().expect("a picture");
        assert!(found.iter().filter(|p| p[3] > 0.1).count() > 60, "there is something to see");
        assert!(differing(&found, &shipped) <= 0.005, "{} of the pixels differ", differing(&found, &shipped));
    }

    #[test]
    fn the_picture_is_the_same_wherever_the_records_are_and_whatever_is_predicted() {
        let folder = tempfile::tempdir().expect("a folder");
        let (subject, index) = subject(folder.path());
        let pixels = || all_pixels(&subject.settings);
        let records = InCore::load(&index).expect("the index loads");
        let (first, _) = subject.reference(records, Variant::None, pixels()).expect("a picture");
        for variant in Variant::ALL {
            for budget in [budget_of(20_000, 3000), Budget { nodes: 40, points: 3 }, budget_of(1 << 30, 3000)]
            {
                for (batch, prefetches) in [(16, true), (1, true), (16, false)] {
                    let clock = Clock::default();
                    let disk = SimulatedDisk::open(&index.files(), clock.clone()).expect("a disk");
                    let records = OutOfCore::new(Box::new(disk), budget, batch, prefetches, Some(clock));
                    let (again, _) = subject.reference(records, variant, pixels()).expect("a picture");
                    assert!(bits(&again) == bits(&first), "{variant}, {budget:?}, batches of {batch}");
                }
            }
        }
        let disk = RealDisk::open(&index.files(), true, Default::default()).expect("a disk");
        let records = OutOfCore::new(Box::new(disk), budget_of(50_000, 3000), 16, true, None);
        let (again, records) = subject.reference(records, Variant::Line, pixels()).expect("a picture");
        assert!(bits(&again) == bits(&first), "on the real disk");
        let around = RealDisk::open(&index.files(), false, Default::default());
        let around = around.and_then(|disk| disk.reading_around(&index.files(), 16 << 10)).expect("a disk");
        let cached = OutOfCore::new(Box::new(around), budget_of(50_000, 3000), 16, true, None);
        let (again, _) = subject.reference(cached, Variant::Line, pixels()).expect("a picture");
        assert!(bits(&again) == bits(&first), "through the file cache");
        let [nodes, _, points] = records.counts();
        assert!(nodes.prefetched_used > 0 && points.prefetched_used > 0, "{nodes:?} {points:?}");
        let image = folder.path().join("image.bin");
        let of_files = write_files(&index, &image).expect("an image");
        for access in [Access::Plain, Access::Random] {
            let records = Structures::new(mapped::open(&image, access).expect("a map"), of_files);
            let (again, _) = subject.reference(records, Variant::None, pixels()).expect("a picture");
            assert!(bits(&again) == bits(&first), "mapped, {access:?}");
        }
        let (heap, of_heap) = grow(&index, &mut |_, _, _| {}).expect("points");
        let (again, _) = subject
            .reference(Structures::new(Flat(heap.clone()), of_heap), Variant::None, pixels())
            .expect("a picture");
        assert!(bits(&again) == bits(&first), "in a heap");
        let files = std::fs::read(&image).expect("an image");
        for (memory, layout) in [(files, of_files), (heap, of_heap)] {
            let clock = Clock::default();
            let swap = Swap::new(100_000, clock.clone()).swapped_out(layout.bytes());
            let records = Structures::new(Paged::new(memory, swap, clock), layout);
            let (again, records) = subject.reference(records, Variant::None, pixels()).expect("a picture");
            assert!(bits(&again) == bits(&first), "paged");
            assert!(records.memory().swap().evictions() > 0, "nothing was paged out");
        }
    }

    #[test]
    fn a_field_gives_back_what_it_retains() {
        let folder = tempfile::tempdir().expect("a folder");
        let (subject, index) = subject(folder.path());
        let clock = Clock::default();
        let disk = SimulatedDisk::open(&index.files(), clock.clone()).expect("a disk");
        // A path has six nodes: two of them would not fit.
        let mut records = OutOfCore::new(Box::new(disk), budget_of(1 << 20, 3000), 16, true, Some(clock));
        records.set_capacities(8, 1, 1);
        for _ in 0..3 {
            let (_, again) =
                subject.reference(records, Variant::Line, [(10, 10), (4, 15)]).expect("some pixels");
            records = again;
        }
    }

    #[test]
    fn a_tree_that_leads_in_a_circle_is_an_error() {
        let folder = tempfile::tempdir().expect("a folder");
        let (subject, index) = subject(folder.path());
        let [nodes, ..] = index.files();
        let mut bytes = std::fs::read(&nodes).expect("nodes");
        let root = Node::decode(&bytes);
        let circle = Node { below: Below::Children([0; 8]), ..root };
        bytes[..crate::record::NODE_BYTES].copy_from_slice(&circle.encode(&[]));
        std::fs::write(&nodes, bytes).expect("a write");
        let records = InCore::load(&index).expect("the index loads");
        let outcome = subject.reference(records, Variant::Line, all_pixels(&subject.settings));
        let error = outcome.err().expect("an error").to_string();
        assert!(error.contains("damaged"), "{error}");
    }

    #[test]
    fn caches_may_shrink_and_grow_while_they_are_used() {
        let folder = tempfile::tempdir().expect("a folder");
        let (subject, index) = subject(folder.path());
        let records = InCore::load(&index).expect("the index loads");
        let (first, _) =
            subject.reference(records, Variant::None, all_pixels(&subject.settings)).expect("a picture");
        let clock = Clock::default();
        let disk = SimulatedDisk::open(&index.files(), clock.clone()).expect("a disk");
        let mut records = OutOfCore::new(Box::new(disk), budget_of(1 << 20, 3000), 16, true, Some(clock));
        let mut picture = Picture::new();
        for (row, nodes) in (0..SIDE).zip([4000, 30, 300, 60, 5000].into_iter().cycle()) {
            records.set_capacities(nodes, nodes / 4, nodes);
            let pixels = (0..SIDE).map(|x| (x, row));
            let (part, again) = subject.reference(records, Variant::Line, pixels).expect("a row");
            picture.extend(part);
            records = again;
            let held = records.resident();
            assert!(held[0] <= nodes && held[1] <= nodes / 4 && held[2] <= nodes, "{held:?} of {nodes}");
        }
        assert!(bits(&picture) == bits(&first));
    }

    #[test]
    fn a_cache_without_room_for_a_path_is_an_error_that_says_so() {
        let folder = tempfile::tempdir().expect("a folder");
        let (subject, index) = subject(folder.path());
        let clock = Clock::default();
        let disk = SimulatedDisk::open(&index.files(), clock.clone()).expect("a disk");
        let mut records = OutOfCore::new(Box::new(disk), budget_of(1 << 20, 3000), 16, true, Some(clock));
        records.set_capacities(2, 1, 1);
        let outcome = subject.reference(records, Variant::Line, all_pixels(&subject.settings));
        let error = outcome.err().expect("an error").to_string();
        assert!(error.contains("too small"), "{error}");
    }
}

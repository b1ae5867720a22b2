//! The discrete ray tracer's side: from a sample to its leaf, from the leaf to its points, from these to the field.

use std::cell::RefCell;
use std::rc::Rc;

use rayset::field::Kernel;
use rayset::field::judge::JudgeSample;
use rayset::geometry::{DVec3, Ray};
use rayset::scene::{Camera, CloudObject, RenderSettings};
use rayset::scene::{CameraError, Scene};
use rayset::trace::judge::{Judge, JudgeError, PointField, Purpose};

use crate::cache::CacheError;
use crate::predict::{Predictor, Variant};
use crate::record::{Below, Node, Point};
use crate::records::{Hold, Records, Work};

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
    Scene(#[from] JudgeError),
    /// The camera.
    #[error(transparent)]
    Camera(#[from] CameraError),
}

/// The path from the root to the leaf of the last sample, all of it retained, and the points of that leaf.
#[derive(Default)]
struct Place {
    path: Vec<(u64, Node, Hold)>,
    list: Vec<u32>,
    listed: Option<u64>,
}

impl Place {
    /// Goes to the leaf that holds a sample: up as far as need be, then down. Nothing outside the root.
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
            let (node, hold) = records.retain(child, priority)?;
            self.path.push((child, node, hold));
        }
    }

    /// The next place on the way of a sample that is not in its leaf.
    fn next_beyond(&self, s: DVec3, way: DVec3) -> Option<DVec3> {
        let (_, leaf, _) = self.path.last()?;
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

    /// The deepest node of the path that holds a place.
    fn above(&self, q: DVec3) -> Option<&Node> {
        self.path.iter().rev().map(|(_, node, _)| node).find(|node| node.contains(q))
    }
}

/// The field of one object over an index, which other objects may share.
pub struct IndexField<R> {
    records: Rc<RefCell<R>>,
    failure: Rc<RefCell<Option<CacheError>>>,
    state: RefCell<(Place, Predictor)>,
    kernel: Kernel,
    normalised: bool,
    gradient: bool,
}

impl<R: Records> IndexField<R> {
    /// The field of an object. `failure` is where the first error goes, since a field has no way to return it.
    #[must_use]
    pub fn new(
        object: &CloudObject,
        gradient: bool,
        variant: Variant,
        records: Rc<RefCell<R>>,
        failure: Rc<RefCell<Option<CacheError>>>,
    ) -> Self {
        let state = RefCell::new((Place::default(), Predictor::new(variant)));
        Self { records, failure, state, kernel: object.kernel, normalised: object.normalised, gradient }
    }

    fn sample_or_fail(&self, s: DVec3, priority: u8) -> Result<JudgeSample, CacheError> {
        let mut records = self.records.borrow_mut();
        let (place, predictor) = &mut *self.state.borrow_mut();
        let mut sum = JudgeSample::default();
        records.work(Work::Sample);
        let Some(leaf) = place.find(&mut *records, s, priority)? else { return Ok(sum) };
        if let Some(way) = predictor.access(s, leaf)
            && let Some(beyond) = place.next_beyond(s, way)
        {
            let from = place.above(beyond);
            let cached = from.map_or(Ok(true), |from| records.precache(from, beyond, PREDICTION_PRIORITY))?;
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

impl<R: Records> PointField for IndexField<R> {
    fn ray(&self, ray: &Ray, _purpose: Purpose) {
        self.state.borrow_mut().1.ray(ray.origin);
    }

    fn sample(&self, q: DVec3, purpose: Purpose) -> JudgeSample {
        if self.failure.borrow().is_some() {
            return JudgeSample::default();
        }
        let priority = if purpose == Purpose::Shadow { SHADOW_PRIORITY } else { OPACITY_PRIORITY };
        self.sample_or_fail(q, priority).unwrap_or_else(|error| {
            *self.failure.borrow_mut() = Some(error);
            JudgeSample::default()
        })
    }
}

/// Adds a point to the field at a place.
fn add(sum: &mut JudgeSample, point: &Point, q: DVec3, kernel: Kernel, normalised: bool, gradient: bool) {
    let offset = q - point.position;
    let radius = f64::from(point.radius);
    let inverse = 1.0 / (radius * radius);
    let s = offset.length_squared() * inverse;
    if s >= 1.0 {
        return;
    }
    let norm = if normalised { 1.0 / (radius.powi(3) * kernel.integral()) } else { 1.0 };
    let weight = f64::from(point.weight) * norm;
    sum.density += weight * kernel.value(s);
    if gradient {
        sum.gradient += offset * (weight * kernel.slope_over_x(s) * inverse);
    }
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
    fn sample(&self, q: DVec3, _purpose: Purpose) -> JudgeSample {
        let mut sum = JudgeSample::default();
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
    let judge = Judge::with_fields(scene, field)?;
    let mut picture = Picture::new();
    for (x, y) in pixels {
        let pixel = judge.pixel(camera, settings, step, x, y)?;
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

//! Classes of points and labels of voxels, by name.

use std::collections::HashMap;

use rayset::geometry::DVec3;
use rayset::scene::{Camera, Projection};
use rayset::{Cloud, Grid};
use rayset_inputs::look::class_name;

/// Points of a sample: enough to meet every class of a few thousandths.
const SAMPLE_POINTS: usize = 1 << 14;

/// A class of points, or a label of voxels.
pub(super) struct Class {
    pub(super) value: f64,
    pub(super) name: String,
    /// Where points of a sample have it.
    places: Vec<DVec3>,
}

impl Class {
    pub(super) fn bytes(&self) -> u64 {
        (self.places.capacity() * size_of::<DVec3>()) as u64
    }
}

/// The classes of a column that a sample of the points has, ascending, with their names; none if
/// the sample cannot be read.
pub(super) fn in_use(cloud: &Cloud, column: &str) -> Vec<Class> {
    let schema = cloud.sample_schema();
    let index = schema.columns.iter().position(|known| known.name == column);
    let (Some(index), Ok(sample)) = (index, cloud.sample(SAMPLE_POINTS)) else { return Vec::new() };
    let mut points: Vec<(f64, DVec3)> = (0..sample.len())
        .map(|i| (sample.columns[index].get(i), DVec3::from_array(sample.position[i])))
        .filter(|(value, _)| value.is_finite())
        .collect();
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    let same = points.chunk_by(|a, b| a.0 == b.0);
    same.map(|same| Class {
        value: same[0].0,
        name: class_name(same[0].0, column),
        places: same.iter().map(|(_, place)| *place).collect(),
    })
    .collect()
}

/// The labels of a grid's voxels that `shows`, ascending, with their names, and where voxels of a
/// sample have them; of a label that the sample lacks nobody knows where it is.
pub(super) fn labels(grid: &Grid, shows: impl Fn(f64) -> bool) -> Vec<Class> {
    let sample = grid.sample(SAMPLE_POINTS).ok();
    let places_of = |value: f64| {
        let sample = sample.as_ref()?;
        let has = |i: &usize| sample.columns[0].get(*i) == value;
        let found = (0..sample.len()).filter(has).map(|i| DVec3::from_array(sample.position[i]));
        Some(found.collect())
    };
    let labels = grid.header().labels.values.iter().filter(|label| shows(label.value));
    labels
        .map(|label| Class {
            value: label.value,
            name: if label.name.is_empty() { label.value.to_string() } else { label.name.clone() },
            places: places_of(label.value).unwrap_or_default(),
        })
        .collect()
}

/// What a camera sees in a picture of a size.
pub(super) struct View<'a> {
    pub(super) camera: &'a Camera,
    pub(super) size: (u32, u32),
}

impl View<'_> {
    /// The cell of the picture, of so many each way, that a place is seen in, how far away it is,
    /// and how wide the cell is there; `None` outside of the picture.
    fn cell(&self, place: DVec3, cells: f64) -> Option<([u32; 2], f64, f64)> {
        let forward = self.camera.direction.normalize_or_zero();
        let right = forward.cross(self.camera.up).normalize_or_zero();
        let offset = place - self.camera.position;
        let depth = offset.dot(forward);
        let half_height = match self.camera.projection {
            Projection::Perspective { fovy } => depth * (0.5 * fovy).tan(),
            Projection::Orthographic { height } => 0.5 * height,
            _ => return None,
        };
        let half_width = half_height * f64::from(self.size.0) / f64::from(self.size.1);
        let at = [offset.dot(right) / half_width, offset.dot(right.cross(forward)) / half_height];
        let is_seen = depth > 0.0 && at.iter().all(|v| v.abs() <= 1.0);
        let width = 2.0 * half_width.max(half_height) / cells;
        is_seen.then(|| (at.map(|v| (0.5 * (v + 1.0) * cells).min(cells - 1.0) as u32), depth, width))
    }
}

/// The classes of which a camera sees points: within the picture, and not behind so many others of
/// the sample that these hide them; and those of which nobody knows where they are.
pub(super) fn seen<'c>(classes: &'c [Class], view: &View<'_>) -> Vec<&'c Class> {
    /// Cells along each side of the picture.
    const CELLS: f64 = 48.0;
    /// Points in a cell of which those in front hide what is behind.
    const CLOSED: u32 = 6;
    /// How far behind the first point of a cell what is still seen lies, in widths of the cell:
    /// surfaces are slanted.
    const SLANT: f64 = 4.0;
    let mut nearest: HashMap<[u32; 2], (f64, u32)> = HashMap::new();
    for (cell, depth, _) in classes.iter().flat_map(|class| cells_of(class, view, CELLS)) {
        let found = nearest.entry(cell).or_insert((f64::INFINITY, 0));
        *found = (found.0.min(depth), found.1 + 1);
    }
    let is_seen = |class: &&Class| {
        cells_of(class, view, CELLS).any(|(cell, depth, width)| {
            let (first, count) = nearest.get(&cell).copied().unwrap_or_default();
            count < CLOSED || depth <= first + SLANT * width
        })
    };
    classes.iter().filter(|class| class.places.is_empty() || is_seen(class)).collect()
}

/// The cells in which the points of a class are seen.
fn cells_of<'a>(
    class: &'a Class,
    view: &'a View<'_>,
    cells: f64,
) -> impl Iterator<Item = ([u32; 2], f64, f64)> + 'a {
    class.places.iter().filter_map(move |place| view.cell(*place, cells))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classes_outside_of_the_picture_and_behind_others_are_not_seen() {
        let plane = |z: f64, value: f64, from: f64| {
            let place = |i: u32| {
                DVec3::new(from + f64::from(i % 200) * 0.01 - 1.0, f64::from(i / 200) * 0.01 - 1.0, z)
            };
            Class { value, name: String::new(), places: (0..40_000).map(place).collect() }
        };
        let classes = [plane(0.0, 1.0, 0.0), plane(-1.0, 2.0, 0.0), plane(0.0, 3.0, 9.0)];
        let projection = Projection::Orthographic { height: 1.5 };
        let camera = Camera { position: DVec3::Z * 5.0, direction: DVec3::NEG_Z, up: DVec3::Y, projection };
        let seen = |classes: &[Class]| -> Vec<f64> {
            let view = View { camera: &camera, size: (100, 100) };
            super::seen(classes, &view).iter().map(|class| class.value).collect()
        };
        assert_eq!(seen(&classes), [1.0]);
        assert_eq!(seen(&classes[1..]), [2.0]);
    }
}

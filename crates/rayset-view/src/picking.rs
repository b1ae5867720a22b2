//! What lies behind a place of a page's picture.

use rayset::geometry::{DAffine3, DVec3};
use rayset::image::LayerPixel;
use rayset::points::PointBatch;
use rayset::scene::{CloudObject, Node, Shape};
use rayset::{CancelToken, Cloud, FinishedTile, PreparedScene, SinkError, Work};
use serde::Serialize;

use crate::compose;
use crate::protocol::{Pose, Show};

/// Points up to this many of the cloud's largest radii from what is seen may be what is seen.
const RADII: f64 = 2.0;

/// The answer to a question for what lies behind a place.
#[derive(Clone, Debug, Default, Serialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct Picked {
    pub(crate) question: u32,
    /// World space; `None` if nothing is seen there.
    pub(crate) position: Option<[f64; 3]>,
    /// The point next to it, if there is one.
    pub(crate) point: Option<Point>,
    /// The value of the voxel there, if a grid is seen.
    pub(crate) value: Option<f64>,
    /// How exactly places are known, in world space: of a point as its file stores it, of other
    /// things as they are seen.
    pub(crate) error: f64,
    /// The step of the coordinates that the point's file was made from, in world space; `None` if
    /// it is not known.
    pub(crate) step: Option<f64>,
}

/// A point of a cloud.
#[derive(Clone, Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct Point {
    /// World space.
    pub(crate) position: [f64; 3],
    /// In the cloud's own coordinates.
    pub(crate) stored: [f64; 3],
    /// How exactly these are known.
    pub(crate) error: f64,
    /// Their step along each axis in the inputs of the file; `None` if it is not known.
    pub(crate) step: Option<[f64; 3]>,
    /// Radius, weight, colour and attributes: name, value, unit.
    pub(crate) values: Vec<(String, f64, String)>,
}

/// Looks through one pixel of a page's picture.
///
/// # Errors
/// Why it cannot be told.
pub(crate) fn pick(
    question: u32,
    [across, down]: [f64; 2],
    show: &Show,
    scene: &PreparedScene,
    root: &Node,
) -> Result<Picked, String> {
    let mut picked = Picked { question, ..Picked::default() };
    let camera = compose::camera(&through(&show.camera, [across, down], show.size));
    let seen = look(scene, &camera).map_err(|error| error.to_string())?;
    if !(seen.depth.is_finite() && seen.opacity > 0.0) {
        return Ok(picked);
    }
    let place = camera.position + camera.direction.normalize() * f64::from(seen.depth);
    picked.position = Some(place.to_array());
    let distance = f64::from(seen.depth);
    // A pixel is as wide as this there. What is no point is seen at most a step behind where it
    // begins.
    let wide = show.camera.height.unwrap_or(2.0 * (0.5 * show.camera.fovy.to_radians()).tan() * distance);
    let pixel = wide / f64::from(show.size[1].max(1));
    picked.error = pixel.max(scene.longest_step()).max(distance * f64::from(f32::EPSILON));
    let objects = objects(root);
    let mut nearest = f64::INFINITY;
    for (shape, world_from_local) in &objects {
        let Shape::Cloud(object) = shape else { continue };
        let (cloud, local) = (&object.cloud, world_from_local.inverse().transform_point3(place));
        let within = RADII * f64::from(cloud.header().radius.max());
        let found = cloud.nearest(local, within).map_err(|error| error.to_string())?;
        let Some(&stored) = found.position.first() else { continue };
        let position = world_from_local.transform_point3(stored.into());
        if position.distance(place) < nearest {
            nearest = position.distance(place);
            // Nor more than double precision has.
            let within = |at: DVec3, error: f64| error.max(at.abs().max_element() * f64::EPSILON);
            let (position_error, step) = (cloud.header().position_error, cloud.header().step);
            let matrix = world_from_local.matrix3;
            let longest = [matrix.x_axis, matrix.y_axis, matrix.z_axis].map(DVec3::length);
            let scale = longest.into_iter().fold(0.0, f64::max);
            picked.error = within(position, position_error * scale);
            picked.step = step.map(|step| DVec3::from_array(step).max_element() * scale);
            picked.point = Some(Point {
                position: position.to_array(),
                stored,
                error: within(stored.into(), position_error),
                step,
                values: values(cloud, &found),
            });
        }
    }
    if picked.point.is_none() {
        let values = objects.iter().filter_map(|(shape, world_from_local)| match shape {
            Shape::Grid(object) => Some((&object.grid, world_from_local.inverse().transform_point3(place))),
            _ => None,
        });
        for (grid, local) in values {
            if let Some(value) = grid.value_at(local).map_err(|error| error.to_string())? {
                picked.value = Some(value);
                break;
            }
        }
    }
    Ok(picked)
}

/// The camera of a picture of one pixel, which is one of a larger picture.
fn through(pose: &Pose, [across, down]: [f64; 2], [width, height]: [u32; 2]) -> Pose {
    let ahead = DVec3::from_array(pose.direction).normalize_or(DVec3::NEG_Z);
    let right = ahead.cross(pose.up.into()).normalize_or(ahead.any_orthonormal_vector());
    let above = right.cross(ahead);
    let aspect = f64::from(width) / f64::from(height.max(1));
    let place =
        |half: f64| right * ((2.0 * across - 1.0) * half * aspect) + above * ((1.0 - 2.0 * down) * half);
    if let Some(whole) = pose.height {
        let position = DVec3::from_array(pose.position) + place(0.5 * whole);
        let height_of_pixel = whole / f64::from(height.max(1));
        return Pose { position: position.to_array(), height: Some(height_of_pixel), ..*pose };
    }
    let half = (0.5 * pose.fovy.to_radians()).tan();
    let direction = ahead + place(half);
    // As high as a pixel is where the picture is not slanted.
    let fovy = (2.0 * (half / f64::from(height.max(1))).atan()).to_degrees().max(1e-3);
    Pose { direction: direction.normalize().to_array(), up: above.to_array(), fovy, ..*pose }
}

/// The layers of a picture of one pixel.
fn look(scene: &PreparedScene, camera: &rayset::scene::Camera) -> Result<LayerPixel, rayset::RenderError> {
    let view = scene.view_of_size(camera, 1, 1)?;
    let mut seen = LayerPixel::default();
    let mut sink = |finished: &FinishedTile<'_>| -> Result<(), SinkError> {
        seen = finished.layers.first().copied().unwrap_or_default();
        Ok(())
    };
    view.render(&Work::tiles(view.tiles(&view.region())), &CancelToken::new(), &mut sink)?;
    Ok(seen)
}

/// The clouds of a graph, each with where it is.
pub(crate) fn clouds(root: &Node) -> Vec<(&CloudObject, DAffine3)> {
    let mut found = Vec::new();
    for (shape, world_from_local) in objects(root) {
        if let Shape::Cloud(object) = shape {
            found.push((object, world_from_local));
        }
    }
    found
}

/// The clouds and grids of a graph, each with where it is.
fn objects(root: &Node) -> Vec<(&Shape, DAffine3)> {
    let mut found = Vec::new();
    find_objects(root, DAffine3::IDENTITY, &mut found);
    found
}

fn find_objects<'a>(node: &'a Node, world_from_parent: DAffine3, found: &mut Vec<(&'a Shape, DAffine3)>) {
    /// More are not asked.
    const MOST: usize = 64;
    let world_from_local = world_from_parent * node.parent_from_local;
    match &node.shape {
        shape @ (Shape::Cloud(_) | Shape::Grid(_)) if found.len() < MOST => {
            found.push((shape, world_from_local));
        }
        Shape::Operator(_, children) if found.len() < MOST => {
            children.iter().for_each(|child| find_objects(child, world_from_local, found));
        }
        _ => {}
    }
}

/// The columns of the first point of a batch.
fn values(cloud: &Cloud, batch: &PointBatch) -> Vec<(String, f64, String)> {
    let schema = cloud.sample_schema();
    let columns = schema.columns.iter().zip(&batch.columns);
    columns.map(|(info, values)| (info.name.clone(), values.get(0), info.unit.clone())).collect()
}

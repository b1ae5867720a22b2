//! Cameras of turntables.

use rayset::geometry::{DAffine3, DQuat, DVec3};
use rayset::scene::{Camera, Scene};

/// A camera, turned about the centre of a scene by so many full turns, around what is up.
#[must_use]
pub fn turned(camera: &Camera, scene: &Scene, turns: f64) -> Camera {
    let bounds = scene.root.bounds();
    let center = if bounds.is_empty() { DVec3::ZERO } else { bounds.center() };
    let axis = camera.up.normalize_or(DVec3::Y);
    let turn = DAffine3::from_quat(DQuat::from_axis_angle(axis, turns * std::f64::consts::TAU));
    Camera {
        position: center + turn.transform_vector3(camera.position - center),
        direction: turn.transform_vector3(camera.direction),
        up: camera.up,
        ..*camera
    }
}

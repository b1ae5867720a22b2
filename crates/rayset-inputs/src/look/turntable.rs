//! Cameras of turntables.

use rayset::geometry::{DAffine3, DQuat, DVec3};
use rayset::scene::{Camera, Projection, Scene};

use super::framing::{Axis, turning_frame};

/// What the camera of a turntable turns about.
#[derive(Clone, Copy, Debug)]
pub struct Turntable {
    /// A place on the axis.
    pub center: DVec3,
    /// The direction of the axis.
    pub axis: DVec3,
}

impl Turntable {
    /// Of a scene that has its own camera: the axis is what that camera has up, through the middle
    /// of the scene.
    #[must_use]
    pub fn of_scene(scene: &Scene, camera: &Camera) -> Self {
        let bounds = scene.root.bounds();
        let center = if bounds.is_empty() { DVec3::ZERO } else { bounds.center() };
        Self { center, axis: camera.up }
    }

    /// A camera after so many full turns.
    #[must_use]
    pub fn turned(&self, camera: &Camera, turns: f64) -> Camera {
        let axis = self.axis.normalize_or(DVec3::Y);
        let turn = DAffine3::from_quat(DQuat::from_axis_angle(axis, turns * std::f64::consts::TAU));
        // What is up stays so where it is the axis itself.
        let up = if camera.up == self.axis { camera.up } else { turn.transform_vector3(camera.up) };
        Camera {
            position: self.center + turn.transform_vector3(camera.position - self.center),
            direction: turn.transform_vector3(camera.direction),
            up,
            ..*camera
        }
    }
}

/// The first camera of a turntable of a scene. One that frames the scene because nothing else is
/// said goes as far back as all of the others need; others stay where they are.
#[must_use]
pub fn standing_back(camera: &Camera, scene: &Scene, aspect: f64) -> Camera {
    /// Positions that differ by less than this part of the distance are the same.
    const SAME: f64 = 1e-9;
    let (bounds, direction) = (scene.root.bounds(), camera.direction.normalize_or(DVec3::NEG_Z));
    let (tangent, fovy) = match camera.projection {
        Projection::Perspective { fovy } => (Some((0.5 * fovy).tan()), fovy),
        Projection::Orthographic { .. } => (None, 0.0),
        _ => return *camera,
    };
    let framing = Camera::framing(&bounds, camera.direction, camera.up, fovy, aspect, tangent.is_none());
    let apart = framing.position.distance(camera.position);
    if bounds.is_empty() || apart > SAME * framing.position.distance(bounds.center()) {
        return *camera;
    }
    let corner = |i: i32| {
        let end = |bit: i32| if i >> bit & 1 == 0 { bounds.min } else { bounds.max };
        DVec3::new(end(0).x, end(1).y, end(2).z)
    };
    let corners: Vec<(DVec3, f64)> = (0..8).map(|i| (corner(i), 0.0)).collect();
    let axis = Axis { center: bounds.center(), up: camera.up.normalize_or(DVec3::Y) };
    let right = direction.cross(axis.up).normalize_or(direction.any_orthonormal_vector());
    let frame = turning_frame(&corners, axis, direction, right.cross(direction), tangent, aspect);
    let projection = match camera.projection {
        Projection::Orthographic { height } => {
            Projection::Orthographic { height: height.max(2.0 * frame.half_height) }
        }
        same => same,
    };
    Camera { position: frame.position, projection, ..*camera }
}

/// A camera, turned about the centre of a scene by so many full turns, around what is up.
#[must_use]
pub fn turned(camera: &Camera, scene: &Scene, turns: f64) -> Camera {
    Turntable::of_scene(scene, camera).turned(camera, turns)
}

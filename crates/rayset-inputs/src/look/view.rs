//! From where a cloud or grid is seen: what is up, from which side, and how far away.

use anyhow::{Result, ensure};
use rayset::geometry::DVec3;
use serde_json::json;

use super::framing::{self, Axis};
use crate::style::{Side, Style};

const DEFAULT_FOVY: f64 = 35.0;

/// What a style says of the camera.
#[derive(Clone, Copy)]
pub(super) struct CameraChoice<'a> {
    pub(super) style: &'a Style,
    /// Whether the camera is the first of a turntable, whose others are to see everything, too.
    pub(super) turns: bool,
}

/// What is up, and from where the front is seen; both of length one and at right angles.
#[derive(Clone, Copy)]
pub(super) struct Orientation {
    pub(super) up: DVec3,
    /// The direction in which one looks at the front.
    pub(super) facing: DVec3,
    /// What is up in a picture from above: the direction in which such data customarily are looked
    /// at, or a file says that they are.
    pub(super) ahead: DVec3,
    /// Why.
    pub(super) reason: &'static str,
    /// Whether the thing is flat, and lies: it is seen more from above.
    pub(super) lies: bool,
}

impl Orientation {
    /// With the front where that of data with this axis up customarily is.
    pub(super) fn with_up(up: DVec3, reason: &'static str) -> Self {
        let up = up.normalize_or(DVec3::Z);
        // Maps have their south in front; things with y up face the reader.
        let toward = if up.dot(DVec3::Y).abs() < 0.9 { DVec3::Y } else { DVec3::NEG_Z };
        let facing = (toward - up * toward.dot(up)).normalize_or(up.any_orthonormal_vector());
        Self { up, facing, ahead: facing, reason, lies: false }
    }

    /// The same, seen from the other side.
    pub(super) fn turned_around(self) -> Self {
        Self { facing: -self.facing, ..self }
    }

    /// With the front where a file says.
    pub(super) fn toward_front(self, facing: Option<DVec3>) -> Self {
        let across = facing.map(|facing| facing - self.up * facing.dot(self.up));
        let facing = across.and_then(DVec3::try_normalize).unwrap_or(self.facing);
        Self { facing, ahead: facing, ..self }
    }

    /// `z up (the thinnest extent)`
    pub(super) fn reason_and_up(&self) -> String {
        let axes = [("x", DVec3::X), ("y", DVec3::Y), ("z", DVec3::Z)];
        let named = axes.iter().find_map(|(name, axis)| match self.up.dot(*axis) {
            v if v > 0.999_999 => Some((*name).to_owned()),
            v if v < -0.999_999 => Some(format!("-{name}")),
            _ => None,
        });
        let up = named.unwrap_or_else(|| format!("{:.3},{:.3},{:.3}", self.up.x, self.up.y, self.up.z));
        format!("{up} up ({})", self.reason)
    }

    /// The viewing direction of a side.
    fn toward(&self, side: Side) -> DVec3 {
        let right = self.facing.cross(self.up);
        match side {
            Side::Front => self.facing,
            Side::Back => -self.facing,
            Side::Left => right,
            Side::Right => -right,
            Side::Top => -self.up,
            Side::Bottom => self.up,
            Side::Iso => {
                let down = if self.lies { 0.75 } else { 0.35 };
                (self.facing - right * 0.55 - self.up * down).normalize()
            }
        }
    }

    /// A direction that is up in a picture that looks in another.
    fn up_in_picture(&self, direction: DVec3) -> DVec3 {
        let across = |up: DVec3| up - direction * up.dot(direction);
        let up = across(self.up);
        // From above, what lies ahead is up, whichever side is the front: plans have north up.
        let up = if up.length() > 1e-6 { up } else { across(self.ahead * -self.up.dot(direction).signum()) };
        up.normalize_or(direction.any_orthonormal_vector())
    }
}

impl CameraChoice<'_> {
    /// The up direction that was given.
    fn given_up(&self) -> Option<DVec3> {
        self.style.up.map(DVec3::from_array)
    }

    /// What a turntable turns about; `None` of one picture, and of an eye whose place was given.
    pub(super) fn axis(&self, orientation: &Orientation, points: &[(DVec3, f64)]) -> Option<Axis> {
        (self.turns && self.style.position.is_none()).then(|| Axis::of(points, orientation.up))
    }

    /// The camera of a scene file that sees `points`, each with its radius, in a picture of this
    /// aspect ratio.
    pub(super) fn scene(
        &self,
        orientation: &Orientation,
        points: &[(DVec3, f64)],
        aspect: f64,
    ) -> Result<serde_json::Value> {
        let style = self.style;
        let fovy = style.fovy.unwrap_or(DEFAULT_FOVY);
        let is_orthographic = style.orthographic.is_some();
        let tangent = (!is_orthographic).then(|| (0.5 * fovy.to_radians()).tan());
        let direction = match (style.direction, style.view) {
            (Some(direction), _) => DVec3::from_array(direction).normalize_or(orientation.facing),
            (None, side) => orientation.toward(side.unwrap_or(Side::Iso)),
        };
        let framed_up = orientation.up_in_picture(direction);
        let frame = match self.axis(orientation, points) {
            Some(axis) => framing::turning_frame(points, axis, direction, framed_up, tangent, aspect),
            None => framing::frame(points, direction, framed_up, tangent, aspect),
        };
        let (mut position, mut direction) = (frame.position, direction);
        if let Some(eye) = style.position {
            position = DVec3::from_array(eye);
            direction = match (style.look_at, style.direction) {
                (Some(target), _) => DVec3::from_array(target) - position,
                (None, Some(direction)) => DVec3::from_array(direction),
                (None, None) => middle(points) - position,
            };
        }
        let up = match self.given_up() {
            Some(up) => {
                let sine = direction.normalize_or(DVec3::X).cross(up.normalize_or(DVec3::Y)).length();
                ensure!(
                    sine > 1e-9 || style.direction.is_none() && style.position.is_none(),
                    "the camera's up direction is parallel to its viewing direction, zero or not finite"
                );
                if sine > 1e-9 { up } else { framed_up }
            }
            None => orientation.up_in_picture(direction.normalize_or(framed_up)),
        };
        let (position, direction, up) = (position.to_array(), direction.to_array(), up.to_array());
        Ok(if is_orthographic {
            let height = style.height.unwrap_or(2.0 * frame.half_height);
            json!({"type": "orthographic", "position": position, "direction": direction, "up": up, "height": height})
        } else {
            json!({"position": position, "direction": direction, "up": up, "fovy": fovy})
        })
    }
}

/// The middle of the box around points.
fn middle(points: &[(DVec3, f64)]) -> DVec3 {
    let low = points.iter().fold(DVec3::INFINITY, |low, (p, _)| low.min(*p));
    let high = points.iter().fold(DVec3::NEG_INFINITY, |high, (p, _)| high.max(*p));
    if points.is_empty() { DVec3::ZERO } else { 0.5 * (low + high) }
}

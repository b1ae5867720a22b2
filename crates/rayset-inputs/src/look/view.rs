//! From where a cloud or grid is seen: what is up, from which side, and how far away.

use anyhow::{Result, ensure};
use clap::{Args, ValueEnum};
use rayset::geometry::DVec3;
use serde_json::json;

use super::framing::{self, Axis};
use crate::values;

/// From where a cloud or grid is seen; a scene says this itself.
#[derive(Args, Clone, Default)]
#[command(next_help_heading = "Camera (by default it frames the whole input; a scene file has its own)")]
pub struct CameraArgs {
    /// Side to look from; iso, a three-quarter view, by default
    #[arg(long, value_enum, conflicts_with_all = ["position", "direction"])]
    pub view: Option<Side>,
    /// Eye
    #[arg(long, value_parser = values::vector, allow_hyphen_values = true)]
    pub position: Option<[f64; 3]>,
    /// What the eye looks at; the middle of the input by default
    #[arg(long, value_parser = values::vector, allow_hyphen_values = true, requires = "position")]
    pub look_at: Option<[f64; 3]>,
    /// Viewing direction: with an eye instead of --look-at, without one to frame the input from another side
    #[arg(long, value_parser = values::direction, allow_hyphen_values = true, conflicts_with = "look_at")]
    pub direction: Option<[f64; 3]>,
    /// Up: x, y, z, -x, -y, -z or a vector; chosen from the data by default
    #[arg(long, value_parser = axis, allow_hyphen_values = true)]
    pub up: Option<[f64; 3]>,
    /// Vertical field of view in degrees, 0.001 to 179; 35 by default
    #[arg(long, value_parser = degrees)]
    pub fovy: Option<f64>,
    /// Parallel rays
    #[arg(long)]
    pub orthographic: bool,
    /// Height of an orthographic picture, in units of the input
    #[arg(long, value_parser = values::length, requires = "orthographic")]
    pub height: Option<f64>,
    /// Whether the camera is the first of a turntable, whose others are to see everything, too.
    #[arg(skip)]
    pub turns: bool,
}

/// A side to look from.
#[derive(Clone, Copy, ValueEnum, PartialEq, Eq)]
pub enum Side {
    Front,
    Back,
    Left,
    Right,
    Top,
    Bottom,
    /// From the front, the right and above
    Iso,
}

const DEFAULT_FOVY: f64 = 35.0;

fn degrees(text: &str) -> Result<f64, String> {
    values::number_within(text, 1e-3, 179.0)
}

/// An axis with its sign, or any direction.
fn axis(text: &str) -> Result<[f64; 3], String> {
    let (sign, name) =
        text.strip_prefix('-').map_or((1.0, text.trim_start_matches('+')), |name| (-1.0, name));
    match name {
        "x" => Ok([sign, 0.0, 0.0]),
        "y" => Ok([0.0, sign, 0.0]),
        "z" => Ok([0.0, 0.0, sign]),
        _ => values::direction(text),
    }
}

/// What is up, and from where the front is seen; both of length one and at right angles.
#[derive(Clone, Copy)]
pub(super) struct Orientation {
    pub(super) up: DVec3,
    /// The direction in which one looks at the front.
    pub(super) facing: DVec3,
    /// What is up in a picture from above: the direction in which such data customarily are looked at, or a file says that they are.
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

impl CameraArgs {
    /// Whether any of these was given.
    pub fn is_given(&self) -> bool {
        self.view.is_some()
            || self.position.is_some()
            || self.direction.is_some()
            || self.up.is_some()
            || self.fovy.is_some()
            || self.orthographic
    }

    /// The up direction that was given.
    pub(super) fn given_up(&self) -> Option<DVec3> {
        self.up.map(DVec3::from_array)
    }

    /// What a turntable turns about; `None` of one picture, and of an eye whose place was given.
    pub(super) fn axis(&self, orientation: &Orientation, points: &[(DVec3, f64)]) -> Option<Axis> {
        (self.turns && self.position.is_none()).then(|| Axis::of(points, orientation.up))
    }

    /// The camera of a scene file that sees `points`, each with its radius, in a picture of this aspect ratio.
    pub(super) fn scene(
        &self,
        orientation: &Orientation,
        points: &[(DVec3, f64)],
        aspect: f64,
    ) -> Result<serde_json::Value> {
        let fovy = self.fovy.unwrap_or(DEFAULT_FOVY);
        let tangent = (!self.orthographic).then(|| (0.5 * fovy.to_radians()).tan());
        let direction = match (self.direction, self.view) {
            (Some(direction), _) => DVec3::from_array(direction).normalize_or(orientation.facing),
            (None, side) => orientation.toward(side.unwrap_or(Side::Iso)),
        };
        let framed_up = orientation.up_in_picture(direction);
        let frame = match self.axis(orientation, points) {
            Some(axis) => framing::turning_frame(points, axis, direction, framed_up, tangent, aspect),
            None => framing::frame(points, direction, framed_up, tangent, aspect),
        };
        let (mut position, mut direction) = (frame.position, direction);
        if let Some(eye) = self.position {
            position = DVec3::from_array(eye);
            direction = match (self.look_at, self.direction) {
                (Some(target), _) => DVec3::from_array(target) - position,
                (None, Some(direction)) => DVec3::from_array(direction),
                (None, None) => middle(points) - position,
            };
        }
        let up = match self.given_up() {
            Some(up) => {
                let sine = direction.normalize_or(DVec3::X).cross(up.normalize_or(DVec3::Y)).length();
                ensure!(
                    sine > 1e-9 || self.direction.is_none() && self.position.is_none(),
                    "the camera's up direction is parallel to its viewing direction, zero or not finite"
                );
                if sine > 1e-9 { up } else { framed_up }
            }
            None => orientation.up_in_picture(direction.normalize_or(framed_up)),
        };
        let (position, direction, up) = (position.to_array(), direction.to_array(), up.to_array());
        Ok(if self.orthographic {
            let height = self.height.unwrap_or(2.0 * frame.half_height);
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

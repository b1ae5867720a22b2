//! Lights.

use super::{BRIGHTEST, FARTHEST, SHORTEST, SceneError};
use crate::geometry::DVec3;

/// What lights a scene. Names follow ANARI.
#[derive(Clone, Debug, PartialEq)]
pub enum Lighting {
    /// Nothing: samples have the colours of their transfer functions.
    Unlit,
    /// Lights, any number.
    Lit(Vec<Light>),
}

impl Default for Lighting {
    /// A light at the eye.
    fn default() -> Self {
        Self::headlight()
    }
}

impl Lighting {
    /// A white light at the eye that throws no shadows anyone could see, and as much from everywhere.
    #[must_use]
    pub fn headlight() -> Self {
        let light = |kind| Light { kind, color: [1.0; 3], shadow: false };
        Self::Lit(vec![light(LightKind::Ambient), light(LightKind::Headlight)])
    }

    /// Whether any light throws shadows.
    #[must_use]
    pub fn throws_shadows(&self) -> bool {
        matches!(self, Self::Lit(lights) if lights.iter().any(Light::throws_shadows))
    }

    pub(super) fn check(&self) -> Result<(), SceneError> {
        match self {
            Self::Unlit => Ok(()),
            Self::Lit(lights) => lights.iter().try_for_each(Light::check),
        }
    }
}

/// A light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// Where its light comes from.
    pub kind: LightKind,
    /// Its light times its strength, linear: radiance of ambient light, irradiance of a headlight or directional light,
    /// radiant intensity of a point light.
    pub color: [f32; 3],
    /// Whether objects throw shadows in it. Without meaning for ambient light and headlights.
    pub shadow: bool,
}

/// Kinds of light.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum LightKind {
    /// The same from everywhere.
    Ambient,
    /// From where the ray comes.
    Headlight,
    /// Parallel rays.
    Directional {
        /// Where the light goes, world space; of any length from 1e-18 to 1e18.
        direction: DVec3,
    },
    /// From a point.
    Point {
        /// The point, world space.
        position: DVec3,
        /// Whether it weakens with the square of the distance.
        decays: bool,
    },
}

impl Light {
    /// Whether shadow rays go to it.
    #[must_use]
    pub fn throws_shadows(&self) -> bool {
        self.shadow && matches!(self.kind, LightKind::Directional { .. } | LightKind::Point { .. })
    }

    fn check(&self) -> Result<(), SceneError> {
        let in_range = |what, v: DVec3, least: f64, expected| {
            let fits = v.abs().max_element() <= FARTHEST && v.length() >= least;
            if fits { Ok(()) } else { Err(SceneError::Number { what, value: v.length(), expected }) }
        };
        if let Some(&value) = self.color.iter().find(|v| !(0.0..=BRIGHTEST as f32).contains(*v)) {
            let (what, value) = ("light color", f64::from(value));
            return Err(SceneError::Number { what, value, expected: "0 to 1e12" });
        }
        match self.kind {
            LightKind::Ambient | LightKind::Headlight => Ok(()),
            LightKind::Directional { direction } => {
                in_range("the length of a light's direction", direction, SHORTEST, "1e-18 to 1e18")
            }
            LightKind::Point { position, .. } => {
                in_range("the distance of a light from the origin", position, 0.0, "at most 1e18")
            }
        }
    }
}

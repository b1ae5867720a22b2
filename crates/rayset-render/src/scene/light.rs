//! Lights.

use super::{BRIGHTEST, FARTHEST, SHORTEST, SceneError};
use rayset_base::geometry::DVec3;

/// The lighting of a scene. Names follow ANARI.
#[derive(Clone, Debug, PartialEq)]
pub enum Lighting {
    /// No lighting: samples have the colours given by their transfer functions.
    Unlit,
    /// Any number of lights.
    Lit(Vec<Light>),
}

impl Default for Lighting {
    /// See [`Lighting::headlight`].
    fn default() -> Self {
        Self::headlight()
    }
}

impl Lighting {
    /// A white light at the eye, which casts no visible shadows, and white ambient light of the
    /// same strength.
    #[must_use]
    pub fn headlight() -> Self {
        let light = |kind| Light { kind, color: [1.0; 3], shadow: false };
        Self::Lit(vec![light(LightKind::Ambient), light(LightKind::Headlight)])
    }

    /// Whether any light casts shadows.
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
    /// The kind of light, with its position or direction.
    pub kind: LightKind,
    /// Colour times intensity, in linear light: radiance of ambient light, irradiance of a
    /// headlight or directional light, radiant intensity of a point light.
    pub color: [f32; 3],
    /// Whether objects cast shadows in this light. Ignored for ambient light and headlights.
    pub shadow: bool,
}

/// Kinds of light.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum LightKind {
    /// Light of equal radiance from all directions.
    Ambient,
    /// Light along the ray, from where the ray starts.
    Headlight,
    /// Parallel rays.
    Directional {
        /// Direction in which the light travels, world space; its length may be anything from 1e-18
        /// to 1e18.
        direction: DVec3,
    },
    /// Light from a point.
    Point {
        /// Position of the light, world space.
        position: DVec3,
        /// Whether its intensity decreases with the square of the distance.
        decays: bool,
    },
}

impl Light {
    /// Whether the light needs shadow rays.
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

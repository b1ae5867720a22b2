//! Fields given in closed form.

use std::any::Any;
use std::fmt;

use super::transfer::ColorMap;
use rayset_base::geometry::{Aabb, DVec3, Ray};

/// A field at one position, local space.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ProceduralSample {
    /// Opacity, 0 to 1.
    pub opacity: f64,
    /// Value of the implicit function: negative inside, 0 at the boundary.
    pub implicit: f64,
    /// Its gradient, which points outward.
    pub gradient: DVec3,
    /// Colour, linear light.
    pub color: [f64; 3],
}

/// A volume object given in closed form. Programs can implement their own.
pub trait Procedural: Any + fmt::Debug + Send + Sync {
    /// A box outside which the opacity is 0, local space; infinite if the object is unbounded.
    fn bounds(&self) -> Aabb;

    /// The length scale on which the field varies, local space: automatic steps are at most a
    /// fraction of it.
    fn detail(&self) -> f64;

    /// An interval of distances along a ray, from 0 on, local space, outside which the opacity is
    /// 0: in units of the length of the ray's direction. `None` if the ray meets nothing. The
    /// tighter it is, the fewer samples are taken; a step's worth of rounding errors does no harm.
    /// By default, where the ray is within the bounds.
    fn span(&self, ray: &Ray) -> Option<(f64, f64)> {
        self.bounds().clip(ray)
    }

    /// The colour, if it is the same everywhere.
    fn uniform_color(&self) -> Option<[f64; 3]> {
        None
    }

    /// The field at a position. Must be a function of the position alone.
    fn sample(&self, p: DVec3) -> ProceduralSample;

    /// Names of attributes besides colour that the field has.
    fn attributes(&self) -> &[&str] {
        &[]
    }

    /// The attribute with an index in [`attributes`](Self::attributes) at a position, in single
    /// precision like those of points. Must be a function of the position alone.
    fn attribute(&self, _index: usize, _p: DVec3) -> f32 {
        0.0
    }

    /// The field at many positions, for fields that can be evaluated faster this way.
    fn sample_all(&self, places: &[DVec3], out: &mut [ProceduralSample]) {
        for (sample, &p) in out.iter_mut().zip(places) {
            *sample = self.sample(p);
        }
    }
}

/// Colour as a function of position.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Pattern {
    /// The same everywhere, linear light.
    Uniform([f64; 3]),
    /// Cubes of two alternating colours.
    Checker {
        /// The two colours, linear light.
        colors: [[f64; 3]; 2],
        /// Edge length of a cube.
        size: f64,
    },
    /// A colour map along a direction.
    Gradient {
        /// Position of the map's value 0.
        from: DVec3,
        /// Position of the map's value 1.
        to: DVec3,
        /// The colours.
        map: ColorMap,
    },
}

impl Pattern {
    /// The colour at a position, linear light.
    #[must_use]
    pub fn color(&self, p: DVec3) -> [f64; 3] {
        match self {
            Self::Uniform(color) => *color,
            Self::Checker { colors, .. } => colors[usize::from(self.value(p) > 0.0)],
            Self::Gradient { map, .. } => map.color(self.value(p)),
        }
    }

    /// The name of the pattern's value as an attribute; empty for a uniform colour.
    #[must_use]
    pub fn attributes(&self) -> &'static [&'static str] {
        match self {
            Self::Uniform(_) => &[],
            Self::Checker { .. } => &["checker"],
            Self::Gradient { .. } => &["gradient"],
        }
    }

    /// The pattern's value: 0 or 1 in the cubes of a checker, the position along a gradient (0 at
    /// `from`, 1 at `to`).
    #[must_use]
    pub fn value(&self, p: DVec3) -> f64 {
        match self {
            Self::Uniform(_) => 0.0,
            Self::Checker { size, .. } => {
                let cell = (p / *size).floor();
                if (cell.x + cell.y + cell.z).rem_euclid(2.0) >= 1.0 { 1.0 } else { 0.0 }
            }
            Self::Gradient { from, to, .. } => {
                let along = *to - *from;
                (p - *from).dot(along) / along.length_squared()
            }
        }
    }

    /// The colour, if it is uniform.
    #[must_use]
    pub fn uniform(&self) -> Option<[f64; 3]> {
        if let Self::Uniform(color) = self { Some(*color) } else { None }
    }
}

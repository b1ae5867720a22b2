//! Transfer functions: map density to opacity, and density or an attribute to colour.
//!
//! Opacity refers to `unit_distance`, one length for the whole scene: a step δ through opacity O
//! absorbs 1 − exp(−σδ) with σ = −ln(1 − min(O, 1 − 1/4096)) / unit_distance. A density that is not
//! positive is transparent.

use std::borrow::Cow;
use std::sync::Arc;

use super::colormap::NamedPalette;
use super::{FARTHEST, SHORTEST};
use crate::field::linear_from_srgb;
use rayset_base::bytes::list_bytes;

/// Opacity is limited to this, so that extinction stays finite.
pub const MAX_OPACITY: f64 = 1.0 - 1.0 / 4096.0;
/// Samples of this opacity or more are inside of something solid.
pub(crate) const SOLID_OPACITY: f64 = 0.999;

/// Maps density to opacity.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum OpacityRule {
    /// O = min(1, D), as in the paper.
    Clamp,
    /// Physical absorption with σ = κ·D: O = 1 − exp(−σ·unit_distance).
    Extinction(f64),
    /// Piecewise linear through (density, opacity) pairs in ascending order; constant beyond the
    /// ends. If several pairs share one density, the last applies at and above it, the first just
    /// below.
    Curve(Vec<(f64, f64)>),
}

/// The input of a leaf's colour map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum MapInput {
    /// The density.
    Density,
    /// A stored attribute, by its index in the header; the numbers behind those of all attributes
    /// stand for the coordinates x, y and z
    /// ([`Header::attribute_number`](rayset_files::octree::format::Header::attribute_number)).
    /// Class labels are not averaged: a sample has that of the point that contributes most.
    Attribute(usize),
}

/// Colours for the numbers from 0 to 1.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Palette {
    /// A named colour map.
    Named(NamedPalette),
    /// (place, display-encoded colour) pairs in ascending order of places from 0 to 1, interpolated
    /// linearly. If several stops share one place, an edge, the last applies at and above it, the
    /// first just below.
    Stops(Arc<[(f64, [f64; 3])]>),
}

impl Palette {
    /// The colour at `x` (clamped to 0–1), display-encoded (sRGB), 0 to 1.
    #[must_use]
    pub fn display_color(&self, x: f64) -> [f64; 3] {
        match self {
            Self::Named(map) => map.display_color(x),
            Self::Stops(stops) => {
                let x = if x.is_nan() { 0.0 } else { x.clamp(0.0, 1.0) };
                let above = stops.partition_point(|&(at, _)| at <= x);
                match (above.checked_sub(1).map(|i| stops[i]), stops.get(above)) {
                    (Some((a, low)), Some(&(b, high))) => {
                        std::array::from_fn(|c| low[c] + (high[c] - low[c]) * (x - a) / (b - a))
                    }
                    (Some((_, color)), None) | (None, Some(&(_, color))) => color,
                    (None, None) => [0.0; 3],
                }
            }
        }
    }

    /// The stops: (place, display-encoded colour), in ascending order.
    #[must_use]
    pub fn stops(&self) -> Cow<'_, [(f64, [f64; 3])]> {
        match self {
            Self::Named(map) => Cow::Owned(map.stops()),
            Self::Stops(stops) => Cow::Borrowed(stops),
        }
    }
}

/// A palette over a range of values.
#[derive(Clone, Debug, PartialEq)]
pub struct ColorMap {
    /// The colours.
    pub palette: Palette,
    /// The values at the two ends of the palette.
    pub range: (f64, f64),
}

impl ColorMap {
    /// A named palette over a range of values.
    #[must_use]
    pub fn named(palette: NamedPalette, range: (f64, f64)) -> Self {
        Self { palette: Palette::Named(palette), range }
    }

    /// The colour of a value, linear light.
    #[must_use]
    pub fn color(&self, value: f64) -> [f64; 3] {
        let (low, high) = self.range;
        self.palette.display_color((value - low) / (high - low)).map(linear_from_srgb)
    }

    /// Bytes of the stops that it has.
    pub(super) fn bytes(&self) -> usize {
        if let Palette::Stops(stops) = &self.palette { size_of_val(&**stops) } else { 0 }
    }

    pub(crate) fn check(&self) -> Result<(), TransferError> {
        let (low, high) = self.range;
        let apart = (high - low).abs();
        let in_range = low.abs() <= FARTHEST && high.abs() <= FARTHEST;
        // Closer than that, values in between would not be distinct numbers.
        if !(in_range && apart >= SHORTEST && apart >= 1e-15 * low.abs().max(high.abs())) {
            return Err(TransferError::Range);
        }
        match &self.palette {
            Palette::Named(_) => Ok(()),
            Palette::Stops(stops) => {
                let ascending = stops.windows(2).all(|w| w[0].0 <= w[1].0);
                let in_range = stops.iter().all(|(at, color)| {
                    (0.0..=1.0).contains(at) && color.iter().all(|v| (0.0..=1.0).contains(v))
                });
                let few = (1..=super::MOST_STOPS).contains(&stops.len());
                if !few || !ascending || !in_range { Err(TransferError::Stops) } else { Ok(()) }
            }
        }
    }
}

/// How the colour of a sample is determined.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum ColorRule {
    /// The same colour everywhere, linear light.
    Uniform([f32; 3]),
    /// The colours of the points.
    Points,
    /// A colour map.
    Map {
        /// The map.
        map: ColorMap,
        /// The input value.
        input: MapInput,
    },
}

/// Opacity and colour of a leaf that has a density.
#[derive(Clone, Debug, PartialEq)]
pub struct TransferFunction {
    /// Opacity.
    pub opacity: OpacityRule,
    /// Colour.
    pub color: ColorRule,
}

/// Why a transfer function is invalid.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum TransferError {
    /// κ is out of range.
    #[error("the extinction coefficient must be a number from 0 to 1e18")]
    Extinction,
    /// A curve is empty, not ascending, or has values out of range.
    #[error("an opacity curve needs ascending densities and opacities from 0 to 1, as in 0:0,1:0.5,4:1")]
    Curve,
    /// The two ends of the value range are equal or out of range.
    #[error("the value range must be two different numbers from -1e18 to 1e18, as in 0:10")]
    Range,
    /// A palette is empty, too long, not ascending, or has values outside 0–1.
    #[error("a palette needs ascending places from 0 to 1 and colours from 0 to 1")]
    Stops,
    /// Splats have another opacity rule, or are normalised.
    #[error("the kernel `splat` needs the opacity rule `extinction`, and weights that are not normalised")]
    Splats,
    /// What does not have the kernel `splat` has a filter of splats.
    #[error("a splat filter needs the kernel `splat`")]
    Filter,
    /// The cloud has no such column.
    #[error("the cloud stores no {0}")]
    Missing(&'static str),
}

impl OpacityRule {
    /// Bytes that it takes besides itself.
    pub(crate) fn bytes(&self) -> usize {
        if let Self::Curve(curve) = self { list_bytes(curve) } else { 0 }
    }

    /// Whether the opacity reaches 1: it is that of solid things, with surfaces.
    pub(crate) fn is_solid(&self) -> bool {
        match self {
            Self::Clamp => true,
            Self::Extinction(_) => false,
            Self::Curve(points) => points.iter().any(|&(_, opacity)| opacity >= 1.0),
        }
    }

    /// Checks the extinction coefficient or the curve.
    ///
    /// # Errors
    /// [`TransferError`] if it is out of range, or if a curve is empty or not ascending.
    pub fn check(&self) -> Result<(), TransferError> {
        match self {
            Self::Clamp => Ok(()),
            Self::Extinction(kappa) if (0.0..=FARTHEST).contains(kappa) => Ok(()),
            Self::Extinction(_) => Err(TransferError::Extinction),
            Self::Curve(points) => {
                let ascending = points.windows(2).all(|w| w[0].0 <= w[1].0);
                let in_range = points.iter().all(|&(d, o)| d.abs() <= FARTHEST && (0.0..=1.0).contains(&o));
                if points.is_empty() || !ascending || !in_range { Err(TransferError::Curve) } else { Ok(()) }
            }
        }
    }

    /// Opacity at a density, at most [`MAX_OPACITY`].
    #[must_use]
    pub fn opacity(&self, density: f64, unit_distance: f64) -> f64 {
        if !(density > 0.0) {
            return 0.0;
        }
        let opacity = match self {
            Self::Clamp => density,
            Self::Extinction(kappa) => -(-kappa * density * unit_distance).exp_m1(),
            Self::Curve(points) => curve_at(points, density),
        };
        opacity.min(MAX_OPACITY)
    }

    /// Opacity at a value of a grid: as at a density, except that curves also apply to values that
    /// are not positive.
    #[must_use]
    pub fn opacity_of_value(&self, value: f64, unit_distance: f64) -> f64 {
        match self {
            Self::Curve(points) => curve_at(points, value).min(MAX_OPACITY),
            Self::Clamp | Self::Extinction(_) => self.opacity(value, unit_distance),
        }
    }

    /// Whether the opacity is above 0 anywhere in a range of values.
    #[must_use]
    pub fn shows_between(&self, low: f64, high: f64) -> bool {
        match self {
            Self::Clamp => high > 0.0,
            Self::Extinction(kappa) => high > 0.0 && *kappa > 0.0,
            Self::Curve(points) => {
                let within = points.iter().any(|&(d, o)| o > 0.0 && d >= low && d <= high);
                within || curve_at(points, low) > 0.0 || curve_at(points, high) > 0.0
            }
        }
    }

    /// Extinction σ at a density, per unit of length in world space.
    #[must_use]
    pub fn extinction(&self, density: f64, unit_distance: f64) -> f64 {
        if let Self::Extinction(kappa) = self {
            // Equal to the extinction computed from the opacity, but without its loss of precision.
            return (kappa * density.max(0.0)).min(max_extinction(unit_distance));
        }
        -(1.0 - self.opacity(density, unit_distance)).ln() / unit_distance
    }

    /// The density that defines the boundary of an object: where the opacity first reaches half its
    /// maximum.
    #[must_use]
    pub fn boundary_density(&self, unit_distance: f64) -> f64 {
        match self {
            Self::Clamp => 0.5,
            Self::Extinction(kappa) => std::f64::consts::LN_2 / (kappa * unit_distance).max(1e-30),
            Self::Curve(points) => {
                let half = 0.5 * points.iter().map(|p| p.1).fold(0.0, f64::max);
                let above = points.iter().position(|&(_, o)| o >= half).unwrap_or(0);
                let (d1, o1) = points[above];
                match above.checked_sub(1).map(|i| points[i]) {
                    Some((d0, o0)) if o1 > o0 => d0 + (d1 - d0) * (half - o0) / (o1 - o0),
                    _ => d1.max(0.0),
                }
            }
        }
    }
}

/// The value of a curve: piecewise linear, constant beyond the ends. If several points share one
/// place, the last applies at it.
#[must_use]
pub fn curve_at(points: &[(f64, f64)], x: f64) -> f64 {
    let above = points.partition_point(|&(d, _)| d <= x);
    match (above.checked_sub(1).map(|i| points[i]), points.get(above)) {
        (None, Some(&(_, o))) | (Some((_, o)), None) => o,
        (Some((d0, o0)), Some(&(d1, o1))) => o0 + (o1 - o0) * (x - d0) / (d1 - d0),
        (None, None) => 0.0,
    }
}

/// The extinction of [`MAX_OPACITY`], the largest possible.
#[must_use]
pub fn max_extinction(unit_distance: f64) -> f64 {
    -(1.0 - MAX_OPACITY).ln() / unit_distance
}

impl TransferFunction {
    /// Bytes that it takes besides itself.
    pub(super) fn bytes(&self) -> usize {
        let color = if let ColorRule::Map { map, .. } = &self.color { map.bytes() } else { 0 };
        self.opacity.bytes() + color
    }

    /// Checks the opacity rule and the colour map.
    ///
    /// # Errors
    /// [`TransferError`] if one of them is invalid.
    pub fn check(&self) -> Result<(), TransferError> {
        self.opacity.check()?;
        if let ColorRule::Map { map, .. } = &self.color {
            map.check()?;
        }
        Ok(())
    }
}

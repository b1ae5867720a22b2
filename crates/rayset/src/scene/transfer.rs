//! Transfer functions: from density to opacity, from density or an attribute to colour.
//!
//! Opacity is per `unit_distance`: a step δ through opacity O absorbs 1 − exp(−σδ) with
//! σ = −ln(1 − min(O, 1 − 1/4096)) / unit_distance. A density that is not positive is transparent.

use super::colormap::Colormap;

/// Opacity is held below this, so that extinction stays finite.
pub const MAX_OPACITY: f64 = 1.0 - 1.0 / 4096.0;

/// From density to opacity.
#[derive(Clone, Debug, PartialEq)]
pub enum OpacityRule {
    /// O = min(1, D): the paper's.
    Clamp,
    /// σ = κ·D: physics. O = 1 − exp(−σ·unit_distance).
    Extinction(f64),
    /// Straight lines between (density, opacity) pairs in ascending order; constant beyond the ends.
    Curve(Vec<(f64, f64)>),
}

/// What a colour map is read with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MapInput {
    /// The density.
    Density,
    /// A stored attribute, by its index in the header.
    Attribute(usize),
}

/// Where a sample's colour comes from.
#[derive(Clone, Debug, PartialEq)]
pub enum ColorRule {
    /// The same everywhere, linear light.
    Uniform([f32; 3]),
    /// The points' own.
    Points,
    /// A colour map over a range of values.
    Map {
        /// The map.
        map: Colormap,
        /// What is looked up.
        input: MapInput,
        /// Values of the map's two ends.
        range: (f64, f64),
    },
}

/// Opacity and colour of a volume object.
#[derive(Clone, Debug, PartialEq)]
pub struct TransferFunction {
    /// Opacity.
    pub opacity: OpacityRule,
    /// The length that opacity refers to, world space.
    pub unit_distance: f64,
    /// Colour.
    pub color: ColorRule,
}

/// Why a transfer function is none.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum TransferError {
    /// The unit distance is not a positive number.
    #[error("the unit distance must be a positive number")]
    UnitDistance,
    /// κ is negative or not finite.
    #[error("the extinction coefficient must be a number of at least 0")]
    Extinction,
    /// A curve is empty, not ascending, or leaves 0–1.
    #[error("an opacity curve needs ascending densities and opacities from 0 to 1, as in 0:0,1:0.5,4:1")]
    Curve,
    /// The value range is empty or not finite.
    #[error("the value range must be two different finite numbers, as in 0:10")]
    Range,
    /// The cloud has no such column.
    #[error("the cloud stores no {0}")]
    Missing(&'static str),
}

impl TransferFunction {
    /// Checks the numbers.
    ///
    /// # Errors
    /// [`TransferError`] that says which is out of range.
    pub fn check(&self) -> Result<(), TransferError> {
        if !(self.unit_distance > 0.0 && self.unit_distance.is_finite()) {
            return Err(TransferError::UnitDistance);
        }
        match &self.opacity {
            OpacityRule::Clamp => {}
            OpacityRule::Extinction(kappa) if *kappa >= 0.0 && kappa.is_finite() => {}
            OpacityRule::Extinction(_) => return Err(TransferError::Extinction),
            OpacityRule::Curve(points) => {
                let ascending = points.windows(2).all(|w| w[0].0 < w[1].0);
                let in_range = points.iter().all(|&(d, o)| d.is_finite() && (0.0..=1.0).contains(&o));
                if points.is_empty() || !ascending || !in_range {
                    return Err(TransferError::Curve);
                }
            }
        }
        if let ColorRule::Map { range: (low, high), .. } = &self.color
            && !(low.is_finite() && high.is_finite() && low != high)
        {
            return Err(TransferError::Range);
        }
        Ok(())
    }

    /// Opacity at a density.
    #[must_use]
    pub fn opacity(&self, density: f64) -> f64 {
        if !(density > 0.0) {
            return 0.0;
        }
        match &self.opacity {
            OpacityRule::Clamp => density.min(1.0),
            OpacityRule::Extinction(kappa) => 1.0 - (-kappa * density * self.unit_distance).exp(),
            OpacityRule::Curve(points) => {
                let above = points.partition_point(|&(d, _)| d <= density);
                match (above.checked_sub(1).map(|i| points[i]), points.get(above)) {
                    (None, Some(&(_, o))) | (Some((_, o)), None) => o,
                    (Some((d0, o0)), Some(&(d1, o1))) => o0 + (o1 - o0) * (density - d0) / (d1 - d0),
                    (None, None) => 0.0,
                }
            }
        }
    }

    /// Extinction σ at a density, per world unit of length.
    #[must_use]
    pub fn extinction(&self, density: f64) -> f64 {
        if let OpacityRule::Extinction(kappa) = self.opacity {
            // The same as by way of the opacity, without its loss of digits.
            return (kappa * density.max(0.0)).min(self.max_extinction());
        }
        -(1.0 - self.opacity(density).min(MAX_OPACITY)).ln() / self.unit_distance
    }

    /// The largest extinction there is.
    #[must_use]
    pub fn max_extinction(&self) -> f64 {
        -(1.0 - MAX_OPACITY).ln() / self.unit_distance
    }
}

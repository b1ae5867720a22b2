//! How the rays of lights see clouds from afar: their pixels are the cells of a light's map, or as
//! wide as the pixels of the samples that are lit.

use crate::field::{Eye, Sight};
use crate::scene::{Light, LightKind, RenderSettings};
use crate::trace::RenderError;
use crate::trace::program::{Action, Program};
use crate::trace::steps::StepRule;
use rayset_base::geometry::{Aabb, DVec3};

/// How rays see what is far, and their steps.
pub(super) struct LightSight {
    pub(super) sight: Sight,
    pub(super) steps: StepRule,
}

/// Whether anything is seen from afar.
pub(super) fn sees_from_afar<P>(program: &Program<P>) -> bool {
    program.instructions.iter().any(|i| matches!(&i.action, Action::Cloud(volume) if volume.lod.is_some()))
}

impl LightSight {
    /// Bytes of one, in a program of so many instructions.
    pub(super) fn bytes(instructions: usize) -> usize {
        size_of::<Self>() + instructions * size_of::<i32>()
    }

    pub(super) fn new(
        program: &Program,
        settings: &RenderSettings,
        sight: Sight,
    ) -> Result<Self, RenderError> {
        Ok(Self { sight, steps: StepRule::new(program, settings, Some(&sight))? })
    }
}

/// How rays from samples see: by pixels whose widths are powers of two, so that rays of few kinds
/// have to be told apart. None if nothing is seen from afar.
pub(super) struct Octaves {
    /// The exponent of the narrowest.
    least: i32,
    steps: Vec<StepRule>,
}

/// The number of an octave; `None` for rays that see every point.
pub(super) type Octave = Option<usize>;

impl Octaves {
    /// The widest is at most the diagonal of a scene; of what is narrower than this part of it,
    /// every point is seen.
    const COUNT: i32 = 24;

    /// Bytes that they take at most in a program of so many instructions.
    pub(super) fn bytes(instructions: usize) -> usize {
        Self::COUNT as usize * (size_of::<StepRule>() + instructions * size_of::<i32>())
    }

    pub(super) fn new(
        program: &Program,
        settings: &RenderSettings,
        bounds: &Aabb,
    ) -> Result<Self, RenderError> {
        let diagonal = if bounds.is_empty() { 0.0 } else { bounds.size().length() };
        if !(sees_from_afar(program) && diagonal > 0.0) {
            return Ok(Self { least: 0, steps: Vec::new() });
        }
        let least = exponent(diagonal) + 1 - Self::COUNT;
        let steps = (0..Self::COUNT).map(|number| {
            // Of steps, the direction is of no importance.
            let sight = sight_toward(Eye::Along(DVec3::Z), 2_f64.powi(least + number));
            StepRule::new(program, settings, Some(&sight))
        });
        Ok(Self { least, steps: steps.collect::<Result<_, _>>()? })
    }

    /// That of a sample whose pixel is so wide; world space.
    pub(super) fn of(&self, pixel_width: f64) -> Octave {
        let number = exponent(pixel_width) - self.least;
        (number >= 0 && !self.steps.is_empty()).then(|| (number as usize).min(self.steps.len() - 1))
    }

    /// How rays to a light see, and their steps.
    pub(super) fn sight(&self, octave: Octave, light: &Light) -> Option<(Sight, &StepRule)> {
        let number = octave?;
        let eye = match light.kind {
            LightKind::Point { position, .. } => Eye::Toward(position),
            LightKind::Directional { direction } => Eye::Along(direction.normalize()),
            LightKind::Ambient | LightKind::Headlight => return None,
        };
        Some((sight_toward(eye, 2_f64.powi(self.least + number as i32)), &self.steps[number]))
    }
}

fn sight_toward(eye: Eye, pixel: f64) -> Sight {
    let forward = if let Eye::Along(direction) = eye { direction } else { DVec3::Z };
    Sight { eye, forward, pixel, corner_cosine: 1.0, is_shown: false }
}

/// The logarithm to base 2, rounded down; of what is not a positive number, some very low or high
/// one.
fn exponent(length: f64) -> i32 {
    (length.max(0.0).to_bits() >> 52) as i32 - 1023
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponents_are_logarithms_rounded_down() {
        for (length, least) in [(1.0, 0), (1.9, 0), (2.0, 1), (0.75, -1), (1e-9, -30), (3e9, 31)] {
            assert_eq!(exponent(length), least, "{length}");
        }
        assert!(exponent(0.0) < -1000 && exponent(-1.0) < -1000 && exponent(f64::NAN) < -1000);
    }
}

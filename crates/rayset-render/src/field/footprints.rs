//! From where each point of a run is seen, and how wide a pixel is there.

use super::run::DecodedRun;
use super::sight::{Eye, Sight};
use rayset_files::octree::layout::RUN_POINTS;

/// The footprints of pixels at the points of a run.
pub(super) struct Footprints {
    /// The direction to each point from the eye, of length one.
    pub(super) toward: [[f32; RUN_POINTS]; 3],
    /// The square of what was asked for at the distance 1, where each point is.
    pub(super) squared: [f32; RUN_POINTS],
}

impl Footprints {
    /// Of what is so long in the middle of the picture at the distance 1 as it is seen, such as the
    /// edge of a pixel. By places relative to the centre of a run.
    // Loops over plain columns, without branches: the compiler makes vectors of them.
    #[inline(always)]
    pub(super) fn new(sight: &Sight, edge: f64, run: &DecodedRun) -> Self {
        let mut seen = Self { squared: [(edge * edge) as f32; RUN_POINTS], toward: [[0.0; RUN_POINTS]; 3] };
        match sight.eye {
            Eye::Along(direction) => {
                let direction = direction.normalize_or_zero().to_array();
                seen.toward = direction.map(|v| [v as f32; RUN_POINTS]);
            }
            Eye::Toward(place) => {
                let from = (run.center - place).to_array().map(|v| v as f32);
                for i in 0..RUN_POINTS {
                    let offset = [0, 1, 2].map(|axis| from[axis] + run.points.position[axis][i]);
                    let square = dot(offset, offset);
                    // At the place itself, any direction.
                    let inverse = if square > 0.0 { 1.0 / square.sqrt() } else { 0.0 };
                    for axis in 0..3 {
                        seen.toward[axis][i] = offset[axis] * inverse;
                    }
                    seen.toward[2][i] += if square > 0.0 { 0.0 } else { 1.0 };
                }
            }
            Eye::At(eye) => {
                let from = (run.center - eye).to_array().map(|v| v as f32);
                let forward = sight.forward.to_array().map(|v| v as f32);
                let (least, position) = (sight.corner_cosine as f32, &run.points.position);
                for i in 0..RUN_POINTS {
                    let offset = [0, 1, 2].map(|axis| from[axis] + position[axis][i]);
                    // Not a number at the eye itself, which `max` leaves out.
                    let inverse = 1.0 / dot(offset, offset).sqrt();
                    let cosine = (dot(offset, forward) * inverse).max(least);
                    let across = seen.squared[i] * cosine * cosine * cosine;
                    seen.squared[i] = across * dot(offset, offset);
                    for axis in 0..3 {
                        seen.toward[axis][i] = offset[axis] * inverse;
                    }
                }
            }
        }
        seen
    }
}

#[inline(always)]
pub(super) fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

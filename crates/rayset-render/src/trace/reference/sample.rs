//! Samples of nodes, and the operators on them, by the table of operators.

use crate::scene::{MAX_OPACITY, MOST_ATTRIBUTES, Operator};
use rayset_base::geometry::DVec3;

/// The output of a node at one position.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    pub(super) opacity: f64,
    pub(super) color: [f64; 3],
    /// Of length one or zero, world space.
    pub(super) normal: DVec3,
    /// Signed distance to the boundary that the normal belongs to, world space; negative inside.
    pub(super) boundary: f64,
    pub(super) material: [f64; 6],
    /// In the order of [`super::ReferenceRenderer::names`].
    pub(super) attributes: [f64; MOST_ATTRIBUTES],
}

pub(super) const NOTHING: Sample = Sample {
    opacity: 0.0,
    color: [0.0; 3],
    normal: DVec3::ZERO,
    boundary: f64::INFINITY,
    material: [0.0; 6],
    attributes: [0.0; MOST_ATTRIBUTES],
};

/// Applies an operator to samples of its children, by the table of operators.
pub(super) fn combine(operator: Operator, samples: &[Sample], reach: f64) -> Sample {
    match operator {
        Operator::Union => samples.iter().skip(1).fold(samples[0], |a, b| {
            let outside_both = a.opacity == 0.0 && b.opacity == 0.0;
            if b.opacity > a.opacity || (outside_both && b.boundary < a.boundary) { *b } else { a }
        }),
        Operator::Intersection => {
            let (mut shape, mut attributes) = (samples[0], samples[0]);
            for s in &samples[1..] {
                let ends_first = s.opacity == shape.opacity && s.boundary > shape.boundary;
                if s.opacity < shape.opacity || ends_first {
                    shape = *s;
                }
                if s.opacity > attributes.opacity {
                    attributes = *s;
                }
            }
            let Sample { color, material, attributes, .. } = attributes;
            Sample { color, material, attributes, ..shape }
        }
        Operator::Difference => samples.iter().skip(1).fold(samples[0], |a, b| {
            let cut = b.boundary.abs() < a.boundary.abs() && b.boundary.abs() <= reach;
            let (normal, boundary) = if cut { (-b.normal, -b.boundary) } else { (a.normal, a.boundary) };
            Sample { opacity: (a.opacity - b.opacity).max(0.0), normal, boundary, ..a }
        }),
        Operator::Blend => {
            let sum: f64 = samples.iter().map(|s| s.opacity).sum();
            if !(sum > 0.0) {
                return NOTHING;
            }
            let mut mixed = NOTHING;
            let mut largest = 0.0;
            for s in samples.iter().filter(|s| s.opacity > 0.0) {
                for channel in 0..3 {
                    mixed.color[channel] += s.opacity * s.color[channel] / sum;
                }
                for (mixed, value) in mixed.attributes.iter_mut().zip(&s.attributes) {
                    *mixed += s.opacity * value / sum;
                }
                for number in 0..5 {
                    mixed.material[number] += s.opacity * s.material[number] / sum;
                }
                if s.opacity > largest {
                    (largest, mixed.material[5]) = (s.opacity, s.material[5]);
                }
                if s.boundary.abs() < mixed.boundary.abs() {
                    mixed.boundary = s.boundary;
                }
                mixed.normal += s.normal * s.opacity;
            }
            Sample { opacity: sum.min(MAX_OPACITY), normal: mixed.normal.normalize_or_zero(), ..mixed }
        }
    }
}

//! How operators combine what nodes yield at the samples of a slab.

use super::node_samples::{
    FAR, MATERIAL, Measure, NodeSamples, REFRACTIVE_INDEX, RequiredOutputs, ZERO, each_lane, normalize,
    numbers,
};
use crate::field::{SLAB_SAMPLES, SampleRow};
use crate::math::{absorbed, ln};
use crate::scene::MAX_OPACITY;

/// No difference of which the depth is computed is more opaque: the largest number below 1.
const MOST: f32 = 1.0 - f32::EPSILON / 2.0;

impl NodeSamples {
    /// Union with the next child.
    pub(super) fn unite(&mut self, other: &Self, required: RequiredOutputs) {
        each_lane(other.touched, |lane| {
            if self.touched >> lane & 1 == 0 {
                return self.copy_lane(other, lane, required);
            }
            let (a, b) = (self.opacity[lane], other.opacity[lane]);
            let mut takes = bits_where(|j| b.0[j] > a.0[j]);
            if required.outside {
                // Outside both, the nearer boundary is the union's.
                let (s, t) = (self.boundary[lane], other.boundary[lane]);
                takes |= bits_where(|j| a.0[j] == 0.0 && b.0[j] == 0.0 && t.0[j] < s.0[j]);
            }
            for (to, from) in self.selected(other, required) {
                take(&mut to[lane], &from[lane], takes);
            }
            take(&mut self.opacity[lane], &b, takes);
        });
    }

    /// Intersection of children, in their order. The result replaces the rows of the first.
    pub(super) fn intersect(children: &mut [Self], required: RequiredOutputs) {
        let Some((first, others)) = children.split_first_mut() else { return };
        let common = others.iter().fold(first.touched, |touched, other| touched & other.touched);
        let attributes = RequiredOutputs { normal: false, boundary: false, ..required };
        let boundary = required.normal || required.boundary;
        let shape = RequiredOutputs { color: false, material: false, attributes: 0, boundary, ..required };
        each_lane(common, |lane| {
            let (mut least, mut largest) = (first.opacity[lane], first.opacity[lane]);
            for other in others.iter() {
                let o = other.opacity[lane];
                let takes = bits_where(|j| o.0[j] > largest.0[j]);
                for (to, from) in first.selected(other, attributes) {
                    take(&mut to[lane], &from[lane], takes);
                }
                take(&mut largest, &o, takes);
                let mut takes = bits_where(|j| o.0[j] < least.0[j]);
                if boundary {
                    // Of two that are equally opaque, or both transparent, the one with the larger
                    // boundary ends first.
                    let (s, t) = (first.boundary[lane], other.boundary[lane]);
                    takes |= bits_where(|j| o.0[j] == least.0[j] && t.0[j] > s.0[j]);
                }
                for (to, from) in first.selected(other, shape) {
                    take(&mut to[lane], &from[lane], takes);
                }
                take(&mut least, &o, takes);
            }
            first.opacity[lane] = least;
        });
        first.touched = common;
    }

    /// Subtracts another, of the same measure. Its boundaries farther than `reach_world` do not
    /// affect shading.
    pub(super) fn subtract(
        &mut self,
        other: &Self,
        (measure, required): (Measure, RequiredOutputs),
        reach_world: f32,
    ) {
        each_lane(self.touched & other.touched, |lane| {
            let b = other.opacity[lane];
            for (a, &b) in self.opacity[lane].0.iter_mut().zip(&b.0) {
                *a = match measure {
                    Measure::Opacity => (*a - b).max(0.0),
                    // Beside what is subtracted nothing changes, however much a sample absorbs.
                    Measure::OpticalDepth if b == 0.0 => *a,
                    Measure::OpticalDepth => -ln(1.0 - (absorbed(*a) - absorbed(b)).clamp(0.0, MOST)),
                };
            }
            if !required.normal {
                return;
            }
            let (s, t) = (self.boundary[lane], other.boundary[lane]);
            let takes = bits_where(|j| t.0[j].abs() < s.0[j].abs() && t.0[j].abs() <= reach_world);
            for axis in 0..3 {
                let turned = SampleRow(other.normal[axis][lane].0.map(|n| -n));
                take(&mut self.normal[axis][lane], &turned, takes);
            }
            take(&mut self.boundary[lane], &SampleRow(t.0.map(|t| -t)), takes);
        });
    }

    /// Adds an operand of a blend; call [`finish_blend`](Self::finish_blend) after the last. Until
    /// then attributes and shading vectors are weighted sums.
    pub(super) fn add(&mut self, other: &Self, required: RequiredOutputs, first: bool) {
        if first {
            self.touched = 0;
        }
        each_lane(other.touched, |lane| {
            let fresh = self.touched >> lane & 1 == 0;
            let o = other.opacity[lane];
            let sum = if fresh { ZERO } else { self.opacity[lane] };
            let takes = if required.boundary {
                if fresh {
                    self.boundary[lane] = FAR;
                }
                // An operand that is transparent here has no part in the blend, nor has its
                // boundary.
                let (s, t) = (self.boundary[lane], other.boundary[lane]);
                bits_where(|j| o.0[j] > 0.0 && (!(sum.0[j] > 0.0) || t.0[j].abs() < s.0[j].abs()))
            } else {
                0
            };
            self.touched |= 1 << lane;
            let weighted = |to: &mut SampleRow, from: &SampleRow| {
                for j in 0..SLAB_SAMPLES {
                    let before = if fresh { 0.0 } else { to.0[j] };
                    to.0[j] = if o.0[j] > 0.0 { before + o.0[j] * from.0[j] } else { before };
                }
            };
            for channel in 0..3 {
                if required.color {
                    weighted(&mut self.color[channel][lane], &other.color[channel][lane]);
                }
                if required.normal {
                    weighted(&mut self.normal[channel][lane], &other.normal[channel][lane]);
                }
            }
            for number in numbers(required.attributes) {
                weighted(&mut self.attributes[number][lane], &other.attributes[number][lane]);
            }
            if required.boundary {
                take(&mut self.boundary[lane], &other.boundary[lane], takes);
            }
            if required.material {
                for number in 0..REFRACTIVE_INDEX {
                    weighted(&mut self.material[number][lane], &other.material[number][lane]);
                }
                let largest = &mut self.largest[lane];
                let larger = if fresh { u32::MAX } else { bits_where(|j| o.0[j] > largest.0[j]) };
                take(largest, &o, larger);
                for number in REFRACTIVE_INDEX..MATERIAL {
                    take(&mut self.material[number][lane], &other.material[number][lane], larger);
                }
            }
            for j in 0..SLAB_SAMPLES {
                self.opacity[lane].0[j] = sum.0[j] + o.0[j];
            }
        });
    }

    pub(super) fn finish_blend(&mut self, required: RequiredOutputs) {
        each_lane(self.touched, |lane| {
            let sum = self.opacity[lane];
            let divide = |row: &mut SampleRow| {
                for (v, &o) in row.0.iter_mut().zip(&sum.0) {
                    *v = if o > 0.0 { *v / o } else { 0.0 };
                }
            };
            for channel in 0..3 {
                if required.color {
                    divide(&mut self.color[channel][lane]);
                }
            }
            for number in numbers(required.attributes) {
                divide(&mut self.attributes[number][lane]);
            }
            if required.normal {
                let [x, y, z] = &mut self.normal;
                normalize(&mut x[lane], &mut y[lane], &mut z[lane]);
            }
            if required.material {
                self.material[..REFRACTIVE_INDEX].iter_mut().for_each(|rows| divide(&mut rows[lane]));
            }
            for o in &mut self.opacity[lane].0 {
                *o = o.min(MAX_OPACITY as f32);
            }
        });
    }
}

#[inline(always)]
fn take(to: &mut SampleRow, from: &SampleRow, bits: u32) {
    for j in 0..SLAB_SAMPLES {
        to.0[j] = if bits >> j & 1 == 1 { from.0[j] } else { to.0[j] };
    }
}

#[inline(always)]
fn bits_where(holds: impl Fn(usize) -> bool) -> u32 {
    (0..SLAB_SAMPLES).fold(0, |bits, j| bits | u32::from(holds(j)) << j)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SHAPE: RequiredOutputs = RequiredOutputs {
        color: false,
        normal: true,
        boundary: true,
        outside: false,
        material: false,
        attributes: 0,
    };

    const REQUIRED: RequiredOutputs = RequiredOutputs {
        color: true,
        normal: false,
        boundary: false,
        outside: false,
        material: false,
        attributes: 0b101,
    };

    /// One lane of opacities from a few values, so that ties are common, with a colour that tells
    /// the operands apart.
    fn samples() -> impl Strategy<Value = NodeSamples> {
        let opacity = prop::sample::select(vec![0.0, 0.25, 0.5, 0.75, MAX_OPACITY as f32]);
        (prop::collection::vec(opacity, SLAB_SAMPLES), 0.0_f32..1.0).prop_map(|(opacities, color)| {
            let mut samples = NodeSamples::new(REQUIRED);
            samples.touched = 1;
            samples.opacity[0].0.copy_from_slice(&opacities);
            samples.color.iter_mut().for_each(|rows| rows[0].0.fill(color));
            numbers(REQUIRED.attributes).for_each(|number| samples.attributes[number][0].0.fill(-color));
            samples
        })
    }

    fn copy(of: &NodeSamples) -> NodeSamples {
        let mut copy = NodeSamples::new(REQUIRED);
        copy.copy_from(of, REQUIRED);
        copy
    }

    /// Opacities and boundaries of a few values, with a shading vector that tells the operands
    /// apart.
    fn solids() -> impl Strategy<Value = Vec<(f32, f32)>> {
        let values = (prop::sample::select(vec![0.0_f32, 0.5, 0.75]), -9_i8..0);
        prop::collection::vec(values.prop_map(|(o, b)| (o, f32::from(b))), SLAB_SAMPLES)
    }

    /// What an intersection has of some solids: opacity, boundary and shading vector where the
    /// opacity is not 0.
    fn shape_of(solids: &[Vec<(f32, f32)>], order: &[usize]) -> Vec<Option<[f32; 3]>> {
        let mut children: Vec<NodeSamples> = (order.iter())
            .map(|&number| {
                let mut samples = NodeSamples::new(SHAPE);
                samples.touched = 1;
                for (j, &(opacity, boundary)) in solids[number].iter().enumerate() {
                    (samples.opacity[0].0[j], samples.boundary[0].0[j]) = (opacity, boundary);
                    // Of one boundary there is one shading vector, whichever child has it.
                    samples.normal.iter_mut().for_each(|rows| rows[0].0[j] = boundary + 100.0 * opacity);
                }
                samples
            })
            .collect();
        NodeSamples::intersect(&mut children, SHAPE);
        let first = &children[0];
        let shape = |j| [first.opacity[0].0[j], first.boundary[0].0[j], first.normal[0][0].0[j]];
        (0..SLAB_SAMPLES).map(|j| (first.opacity[0].0[j] > 0.0).then(|| shape(j))).collect()
    }

    fn union(a: &NodeSamples, b: &NodeSamples) -> NodeSamples {
        let mut out = copy(a);
        out.unite(b, REQUIRED);
        out
    }

    fn intersection(a: &NodeSamples, b: &NodeSamples) -> NodeSamples {
        let mut children = [copy(a), copy(b)];
        NodeSamples::intersect(&mut children, REQUIRED);
        let [first, _] = children;
        first
    }

    fn difference(a: &NodeSamples, b: &NodeSamples) -> NodeSamples {
        let mut out = copy(a);
        out.subtract(b, (Measure::Opacity, REQUIRED), 1.0);
        out
    }

    fn blend(operands: &[&NodeSamples]) -> NodeSamples {
        let mut out = NodeSamples::new(REQUIRED);
        for (place, operand) in operands.iter().enumerate() {
            out.add(operand, REQUIRED, place == 0);
        }
        out.finish_blend(REQUIRED);
        out
    }

    fn opacities(samples: &NodeSamples) -> [f32; SLAB_SAMPLES] {
        if samples.touched == 1 { samples.opacity[0].0 } else { [0.0; SLAB_SAMPLES] }
    }

    /// Colours and an attribute where the opacity is not 0.
    fn attributes(samples: &NodeSamples) -> Vec<Option<(f32, f32)>> {
        let both = |j: usize| (samples.color[0][0].0[j], samples.attributes[2][0].0[j]);
        (0..SLAB_SAMPLES).map(|j| (opacities(samples)[j] > 0.0).then(|| both(j))).collect()
    }

    proptest! {
        #[test]
        fn opacity_under_union_and_intersection_is_a_distributive_lattice(a in samples(), b in samples(), c in samples()) {
            let equal = |x: NodeSamples, y: NodeSamples| opacities(&x) == opacities(&y);
            prop_assert!(equal(union(&a, &b), union(&b, &a)));
            prop_assert!(equal(intersection(&a, &b), intersection(&b, &a)));
            prop_assert!(equal(union(&a, &union(&b, &c)), union(&union(&a, &b), &c)));
            prop_assert!(equal(intersection(&a, &intersection(&b, &c)), intersection(&intersection(&a, &b), &c)));
            prop_assert!(equal(union(&a, &intersection(&a, &b)), copy(&a)));
            prop_assert!(equal(intersection(&a, &union(&a, &b)), copy(&a)));
            prop_assert!(equal(
                intersection(&a, &union(&b, &c)),
                union(&intersection(&a, &b), &intersection(&a, &c))
            ));
        }

        #[test]
        fn attributes_of_union_are_associative(a in samples(), b in samples(), c in samples()) {
            prop_assert_eq!(attributes(&union(&a, &union(&b, &c))), attributes(&union(&union(&a, &b), &c)));
        }

        #[test]
        fn the_surface_of_an_intersection_is_that_of_the_nearest_boundary_in_any_order(a in solids(), b in solids(), c in solids()) {
            let solids = [a, b, c];
            let shape = shape_of(&solids, &[0, 1, 2]);
            for order in [[0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]] {
                prop_assert_eq!(&shape_of(&solids, &order), &shape);
            }
            for (j, shape) in shape.iter().enumerate() {
                let Some([opacity, boundary, _]) = *shape else { continue };
                let tied = solids.iter().map(|solid| solid[j]).filter(|&(o, _)| o == opacity);
                prop_assert_eq!(tied.map(|(_, b)| b).fold(f32::NEG_INFINITY, f32::max), boundary);
            }
        }

        #[test]
        fn nothing_taken_away_leaves_all_and_all_taken_away_leaves_nothing(a in samples()) {
            let nothing = NodeSamples::new(REQUIRED);
            prop_assert_eq!(opacities(&difference(&a, &nothing)), opacities(&a));
            prop_assert_eq!(attributes(&difference(&a, &nothing)), attributes(&a));
            prop_assert_eq!(opacities(&difference(&a, &a)), [0.0; SLAB_SAMPLES]);
        }

        #[test]
        fn blend_is_associative_up_to_rounding_and_clamped_once(a in samples(), b in samples(), c in samples()) {
            let at_once = opacities(&blend(&[&a, &b, &c]));
            let nested = opacities(&blend(&[&blend(&[&a, &b]), &c]));
            for j in 0..SLAB_SAMPLES {
                prop_assert!((at_once[j] - nested[j]).abs() < 1e-6);
                let sum = opacities(&a)[j] + opacities(&b)[j] + opacities(&c)[j];
                prop_assert!((at_once[j] - sum.min(MAX_OPACITY as f32)).abs() < 1e-6);
            }
        }
    }
}

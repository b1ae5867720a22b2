//! What a node of the scene graph makes at the samples of one slab of a packet, and how operators combine it.
//!
//! Invariant: where a result is 0, nothing else of it is ever looked at, save the shading vector and the boundary of what
//! is taken away. So samples and lanes that cannot matter may hold anything there, and skipping them changes no bit.

use fearless_simd::dispatch;

use super::math::{exp_minus, ln};
use crate::field::{LANES, SLAB_SAMPLES, SampleRow, SimdLevel};
use crate::geometry::DVec3;
use crate::scene::MAX_OPACITY;

/// The largest optical depth of a unit distance: −ln(1 − MAX_OPACITY).
pub(super) const MAX_OPTICAL_DEPTH: f32 = 8.317_766;
/// Where a sample is lit: a sample within so many steps behind a boundary stands for the part of its ray that begins there,
/// and would else shadow itself more or less as the lattice happens to lie.
pub(super) const STEPS_TO_BOUNDARY: f64 = 2.0;
const ZERO: SampleRow = SampleRow([0.0; SLAB_SAMPLES]);
const FAR: SampleRow = SampleRow([f32::INFINITY; SLAB_SAMPLES]);
/// Numbers of a material.
pub(super) const MATERIAL: usize = 7;
/// Place of the reflectance among them.
pub(super) const REFLECTANCE: usize = 4;
/// Place of the refractive index. What stands here and behind is not mixed by blends: the larger operand's counts.
pub(super) const REFRACTIVE_INDEX: usize = 5;
/// Place of the number of the leaf.
pub(super) const LEAF: usize = 6;

/// What of a node is looked at, besides its opacity.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct RequiredOutputs {
    pub(super) color: bool,
    pub(super) normal: bool,
    /// The signed distance to the boundary that the shading vector belongs to.
    pub(super) boundary: bool,
    /// Shading vector and boundary around the object, where its opacity is 0: it is taken away from something.
    pub(super) outside: bool,
    pub(super) material: bool,
    /// A bit for each named attribute.
    pub(super) attributes: u32,
}

impl RequiredOutputs {
    pub(super) fn and(self, other: Self) -> Self {
        Self {
            color: self.color || other.color,
            normal: self.normal || other.normal,
            boundary: self.boundary || other.boundary,
            outside: self.outside || other.outside,
            material: self.material || other.material,
            attributes: self.attributes | other.attributes,
        }
    }
}

/// How opacity is written: maxima and minima are the same in both, and rays need the second in the end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Measure {
    /// O, 0 to [`MAX_OPACITY`].
    Opacity,
    /// −ln(1 − O), 0 to [`MAX_OPTICAL_DEPTH`].
    OpticalDepth,
}

/// Samples that can still matter: a bit for each, lane by lane.
#[derive(Clone, Copy, Debug)]
pub(super) struct Live(pub(super) [u32; LANES]);

impl Live {
    /// All samples of the lanes given.
    pub(super) fn of(lanes: u64) -> Self {
        Self(std::array::from_fn(|lane| if lanes >> lane & 1 == 1 { u32::MAX } else { 0 }))
    }

    pub(super) fn lanes(&self) -> u64 {
        self.0.iter().enumerate().fold(0, |lanes, (lane, &bits)| lanes | u64::from(bits != 0) << lane)
    }
}

/// Rows of samples, one for each lane.
pub(super) type Rows = Vec<SampleRow>;

/// One node at the samples of a slab.
#[derive(Debug)]
pub(super) struct NodeSamples {
    /// Lanes whose rows hold anything; everywhere else the opacity is 0 and the boundary far.
    pub(super) touched: u64,
    /// As the node's [`Measure`] says.
    pub(super) opacity: Rows,
    /// Linear light.
    pub(super) color: [Rows; 3],
    /// Of length one or zero, world space.
    pub(super) normal: [Rows; 3],
    /// World space, negative inside.
    pub(super) boundary: Rows,
    pub(super) material: [Rows; MATERIAL],
    /// Named attributes, by their numbers in the program.
    pub(super) attributes: Vec<Rows>,
    /// While a blend is summed: its largest operand so far, whose refractive index is the blend's.
    largest: Rows,
}

impl NodeSamples {
    pub(super) fn new(required: RequiredOutputs) -> Self {
        let rows = |wanted: bool| vec![ZERO; if wanted { LANES } else { 0 }];
        Self {
            touched: 0,
            opacity: rows(true),
            color: std::array::from_fn(|_| rows(required.color)),
            normal: std::array::from_fn(|_| rows(required.normal)),
            boundary: rows(required.boundary),
            material: std::array::from_fn(|_| rows(required.material)),
            attributes: (0..u32::BITS - required.attributes.leading_zeros())
                .map(|number| rows(required.attributes >> number & 1 == 1))
                .collect(),
            largest: rows(required.material),
        }
    }

    /// Bytes of a block.
    pub(super) fn bytes(required: RequiredOutputs) -> usize {
        let kinds = [required.color, required.normal, required.boundary, required.material].map(usize::from);
        let attributes = required.attributes.count_ones() as usize;
        (1 + 3 * kinds[0] + 3 * kinds[1] + kinds[2] + (MATERIAL + 1) * kinds[3] + attributes)
            * LANES
            * size_of::<SampleRow>()
    }

    /// Says that nothing is there, in a lane that others look at nevertheless.
    pub(super) fn clear_lane(&mut self, lane: usize, required: RequiredOutputs) {
        self.touched |= 1 << lane;
        self.opacity[lane] = ZERO;
        if required.normal {
            self.normal.iter_mut().for_each(|rows| rows[lane] = ZERO);
        }
        if required.boundary {
            self.boundary[lane] = FAR;
        }
    }

    /// The shading vector of a sample.
    pub(super) fn normal_at(&self, lane: usize, j: usize) -> DVec3 {
        DVec3::from_array(self.normal.each_ref().map(|rows| f64::from(rows[lane].0[j])))
    }

    fn copy_lane(&mut self, from: &Self, lane: usize, required: RequiredOutputs) {
        self.touched |= 1 << lane;
        self.opacity[lane] = from.opacity[lane];
        for (to, from) in self.selected(from, required) {
            to[lane] = from[lane];
        }
    }

    pub(super) fn copy_from(&mut self, from: &Self, required: RequiredOutputs) {
        self.touched = 0;
        each_lane(from.touched, |lane| self.copy_lane(from, lane, required));
    }

    /// The rows besides the opacity that are looked at, of this block and of another.
    fn selected<'b>(
        &'b mut self,
        other: &'b Self,
        required: RequiredOutputs,
    ) -> impl Iterator<Item = (&'b mut Rows, &'b Rows)> {
        let color = self.color.iter_mut().zip(&other.color).filter(move |_| required.color);
        let normal = self.normal.iter_mut().zip(&other.normal).filter(move |_| required.normal);
        let boundary = [(&mut self.boundary, &other.boundary)].into_iter().filter(move |_| required.boundary);
        let material = self.material.iter_mut().zip(&other.material).filter(move |_| required.material);
        let attributes = self.attributes.iter_mut().zip(&other.attributes).enumerate();
        let attributes = attributes.filter(move |(number, _)| required.attributes >> number & 1 == 1);
        color.chain(normal).chain(boundary).chain(material).chain(attributes.map(|(_, rows)| rows))
    }

    /// Samples of `live` that another operand of a union could still change: those that are not opaque.
    pub(super) fn not_opaque(&self, live: &Live, measure: Measure) -> Live {
        let most = most(measure);
        self.narrowed(live, true, |o| o < most)
    }

    /// Samples of `live` where there is anything.
    pub(super) fn not_empty(&self, live: &Live) -> Live {
        self.narrowed(live, false, |o| o > 0.0)
    }

    fn narrowed(&self, live: &Live, untouched: bool, keep: impl Fn(f32) -> bool) -> Live {
        let mut narrowed = *live;
        for lane in 0..LANES {
            if narrowed.0[lane] == 0 {
                continue;
            }
            if self.touched >> lane & 1 == 0 {
                if !untouched {
                    narrowed.0[lane] = 0;
                }
                continue;
            }
            let bits =
                self.opacity[lane].0.iter().enumerate().fold(0, |b, (j, &o)| b | u32::from(keep(o)) << j);
            narrowed.0[lane] &= bits;
        }
        narrowed
    }

    /// Union with the child that comes next.
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

    /// Intersection of children, in their order. Rows of the first become those of the result.
    pub(super) fn intersect(children: &mut [Self], required: RequiredOutputs) {
        let Some((first, others)) = children.split_first_mut() else { return };
        let common = others.iter().fold(first.touched, |touched, other| touched & other.touched);
        let attributes = RequiredOutputs { normal: false, boundary: false, ..required };
        let shape = RequiredOutputs { color: false, material: false, attributes: 0, ..required };
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
                if required.outside {
                    // Where both are outside, the boundary that lies farther is the intersection's.
                    let (s, t) = (first.boundary[lane], other.boundary[lane]);
                    takes |= bits_where(|j| o.0[j] == 0.0 && least.0[j] == 0.0 && t.0[j] > s.0[j]);
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

    /// Takes another away. Boundaries of it that are farther than `reach_world` light nothing.
    pub(super) fn subtract(&mut self, other: &Self, required: RequiredOutputs, reach_world: f32) {
        each_lane(self.touched & other.touched, |lane| {
            let b = other.opacity[lane];
            for (a, &b) in self.opacity[lane].0.iter_mut().zip(&b.0) {
                *a = (*a - b).max(0.0);
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

    /// Adds another, of a blend; [`finish_blend`](Self::finish_blend) follows the last. Until then attributes and shading
    /// vectors are sums.
    pub(super) fn add(&mut self, other: &Self, required: RequiredOutputs, first: bool) {
        if first {
            self.touched = 0;
        }
        each_lane(other.touched, |lane| {
            let fresh = self.touched >> lane & 1 == 0;
            let o = other.opacity[lane];
            let sum = if fresh { ZERO } else { self.opacity[lane] };
            let nearer = required.boundary && !fresh;
            let takes = if nearer {
                let (s, t) = (self.boundary[lane], other.boundary[lane]);
                bits_where(|j| t.0[j].abs() < s.0[j].abs())
            } else {
                u32::MAX
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

    /// Rewrites opacities.
    pub(super) fn measure(&mut self, from: Measure, to: Measure, simd: SimdLevel) {
        if from == to {
            return;
        }
        each_lane(self.touched, |lane| {
            let row = &mut self.opacity[lane];
            match to {
                Measure::OpticalDepth => dispatch!(simd.level(), _simd => optical_depth(row)),
                Measure::Opacity => dispatch!(simd.level(), _simd => opacity(row)),
            }
        });
    }
}

/// Most that a measure reaches.
fn most(measure: Measure) -> f32 {
    match measure {
        Measure::Opacity => MAX_OPACITY as f32,
        Measure::OpticalDepth => MAX_OPTICAL_DEPTH,
    }
}

/// Vectors become of length one, or stay zero.
#[inline(always)]
pub(super) fn normalize(x: &mut SampleRow, y: &mut SampleRow, z: &mut SampleRow) {
    for j in 0..SLAB_SAMPLES {
        // In units of its largest component, so that its length can be squared however small or large it is.
        let largest = x.0[j].abs().max(y.0[j].abs()).max(z.0[j].abs());
        let fits = (f32::MIN_POSITIVE..f32::INFINITY).contains(&largest);
        let unit = if fits { 1.0 / largest } else { 0.0 };
        let [a, b, c] = [x.0[j] * unit, y.0[j] * unit, z.0[j] * unit];
        let factor = 1.0 / (a * a + b * b + c * c).sqrt();
        (x.0[j], y.0[j], z.0[j]) = if fits { (a * factor, b * factor, c * factor) } else { (0.0, 0.0, 0.0) };
    }
}

#[inline(always)]
fn optical_depth(row: &mut SampleRow) {
    for o in &mut row.0 {
        *o = (-ln(1.0 - o.min(MAX_OPACITY as f32))).min(MAX_OPTICAL_DEPTH);
    }
}

#[inline(always)]
fn opacity(row: &mut SampleRow) {
    for o in &mut row.0 {
        *o = (1.0 - exp_minus(*o)).min(MAX_OPACITY as f32);
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

/// The numbers of the bits that are set.
#[inline(always)]
pub(super) fn numbers(mut bits: u32) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let number = bits.trailing_zeros() as usize;
        (bits != 0).then(|| {
            bits &= bits - 1;
            number
        })
    })
}

/// Calls `f` with every lane of a mask.
#[inline(always)]
pub(super) fn each_lane(mut lanes: u64, mut f: impl FnMut(usize)) {
    while lanes != 0 {
        let lane = lanes.trailing_zeros() as usize;
        lanes &= lanes - 1;
        f(lane);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const WANTS: RequiredOutputs = RequiredOutputs {
        color: true,
        normal: false,
        boundary: false,
        outside: false,
        material: false,
        attributes: 0b101,
    };

    /// One lane of opacities of few values, so that ties are common, each with a colour that tells where it is from.
    fn block() -> impl Strategy<Value = NodeSamples> {
        let opacity = prop::sample::select(vec![0.0, 0.25, 0.5, 0.75, MAX_OPACITY as f32]);
        (prop::collection::vec(opacity, SLAB_SAMPLES), 0.0_f32..1.0).prop_map(|(opacities, color)| {
            let mut block = NodeSamples::new(WANTS);
            block.touched = 1;
            block.opacity[0].0.copy_from_slice(&opacities);
            block.color.iter_mut().for_each(|rows| rows[0].0.fill(color));
            numbers(WANTS.attributes).for_each(|number| block.attributes[number][0].0.fill(-color));
            block
        })
    }

    fn copy(of: &NodeSamples) -> NodeSamples {
        let mut copy = NodeSamples::new(WANTS);
        copy.copy_from(of, WANTS);
        copy
    }

    fn union(a: &NodeSamples, b: &NodeSamples) -> NodeSamples {
        let mut out = copy(a);
        out.unite(b, WANTS);
        out
    }

    fn intersection(a: &NodeSamples, b: &NodeSamples) -> NodeSamples {
        let mut children = [copy(a), copy(b)];
        NodeSamples::intersect(&mut children, WANTS);
        let [first, _] = children;
        first
    }

    fn difference(a: &NodeSamples, b: &NodeSamples) -> NodeSamples {
        let mut out = copy(a);
        out.subtract(b, WANTS, 1.0);
        out
    }

    fn blend(blocks: &[&NodeSamples]) -> NodeSamples {
        let mut out = NodeSamples::new(WANTS);
        for (place, block) in blocks.iter().enumerate() {
            out.add(block, WANTS, place == 0);
        }
        out.finish_blend(WANTS);
        out
    }

    fn opacities(block: &NodeSamples) -> [f32; SLAB_SAMPLES] {
        if block.touched == 1 { block.opacity[0].0 } else { [0.0; SLAB_SAMPLES] }
    }

    /// Colours and an attribute where there is anything.
    fn attributes(block: &NodeSamples) -> Vec<Option<(f32, f32)>> {
        let both = |j: usize| (block.color[0][0].0[j], block.attributes[2][0].0[j]);
        (0..SLAB_SAMPLES).map(|j| (opacities(block)[j] > 0.0).then(|| both(j))).collect()
    }

    proptest! {
        #[test]
        fn opacity_under_union_and_intersection_is_a_distributive_lattice(a in block(), b in block(), c in block()) {
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
        fn attributes_of_union_are_associative(a in block(), b in block(), c in block()) {
            prop_assert_eq!(attributes(&union(&a, &union(&b, &c))), attributes(&union(&union(&a, &b), &c)));
        }

        #[test]
        fn nothing_taken_away_leaves_all_and_all_taken_away_leaves_nothing(a in block()) {
            let nothing = NodeSamples::new(WANTS);
            prop_assert_eq!(opacities(&difference(&a, &nothing)), opacities(&a));
            prop_assert_eq!(attributes(&difference(&a, &nothing)), attributes(&a));
            prop_assert_eq!(opacities(&difference(&a, &a)), [0.0; SLAB_SAMPLES]);
        }

        #[test]
        fn blend_is_associative_up_to_rounding_and_clamped_once(a in block(), b in block(), c in block()) {
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

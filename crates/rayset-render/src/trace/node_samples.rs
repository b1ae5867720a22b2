//! What a node of the scene graph yields at the samples of one slab of a packet.
//!
//! Invariant: where the opacity of a node is 0, its other outputs are never read, except for the
//! shading vector and the boundary of an object that is subtracted. So samples and lanes that
//! cannot matter may hold any values, and skipping them changes no bit of the picture.

use crate::field::{LANES, SLAB_SAMPLES, SampleRow, SimdLevel, dispatch};
use crate::math::{exp_minus, ln};
use crate::scene::MAX_OPACITY;
use rayset_base::geometry::DVec3;

/// The largest optical depth per unit distance: −ln(1 − MAX_OPACITY).
pub(super) const MAX_OPTICAL_DEPTH: f32 = 8.317_766;
pub(super) const ZERO: SampleRow = SampleRow([0.0; SLAB_SAMPLES]);
pub(super) const FAR: SampleRow = SampleRow([f32::INFINITY; SLAB_SAMPLES]);
/// Number of values of a material.
pub(super) const MATERIAL: usize = 7;
/// Index of the reflectance among them.
pub(super) const REFLECTANCE: usize = 4;
/// Index of the refractive index. Blends do not mix the values from here on: they take those of the
/// largest operand.
pub(super) const REFRACTIVE_INDEX: usize = 5;
/// Index of the leaf number.
pub(super) const LEAF: usize = 6;

/// The attribute that says how opaque is what covers a part of a pixel at a sample, 0 to 1; 0 of
/// what is not seen from afar. No file has one of this name.
pub(super) const LUMP_OPACITY: &str = "\u{0}lump opacity";

/// Which outputs of a node are required besides its opacity.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct RequiredOutputs {
    pub(super) color: bool,
    pub(super) normal: bool,
    /// The signed distance to the boundary that the shading vector belongs to.
    pub(super) boundary: bool,
    /// Shading vector and boundary also around the object, where its opacity is 0: it is subtracted
    /// from another.
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

/// How opacity is expressed. Maxima and minima are the same in both measures; rays need optical
/// depths in the end.
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
    /// All samples of `lanes`.
    pub(super) fn of(lanes: u64) -> Self {
        Self(std::array::from_fn(|lane| if lanes >> lane & 1 == 1 { u32::MAX } else { 0 }))
    }

    pub(super) fn lanes(&self) -> u64 {
        self.0.iter().enumerate().fold(0, |lanes, (lane, &bits)| lanes | u64::from(bits != 0) << lane)
    }
}

/// Outputs that are the same for all samples of a scene; samples then need no rows for them. `None`
/// if samples may differ.
#[derive(Clone, Copy, Debug)]
pub(super) struct Constants {
    /// Linear light.
    pub(super) color: Option<[f32; 3]>,
    pub(super) material: Option<[f32; MATERIAL]>,
}

impl Constants {
    /// The colour of a sample of the root.
    pub(super) fn color_at(&self, root: &NodeSamples, lane: usize, j: usize) -> [f32; 3] {
        match self.color {
            Some(color) => color,
            None => [root.color[0][lane].0[j], root.color[1][lane].0[j], root.color[2][lane].0[j]],
        }
    }

    /// One of the values of the material of a sample of the root.
    #[inline(always)]
    pub(super) fn material_at(&self, root: &NodeSamples, value: usize, lane: usize, j: usize) -> f32 {
        match &self.material {
            Some(material) => material[value],
            None => root.material[value][lane].0[j],
        }
    }
}

/// Rows of samples, one for each lane.
pub(super) type Rows = Vec<SampleRow>;

/// One node at the samples of a slab.
#[derive(Debug)]
pub(super) struct NodeSamples {
    /// Lanes whose rows are valid; in all others the opacity is 0 and the boundary infinitely far.
    pub(super) touched: u64,
    /// In the node's [`Measure`].
    pub(super) opacity: Rows,
    /// Linear light.
    pub(super) color: [Rows; 3],
    /// Of length one or zero; world space.
    pub(super) normal: [Rows; 3],
    /// Signed distance, negative inside; world space.
    pub(super) boundary: Rows,
    pub(super) material: [Rows; MATERIAL],
    /// Named attributes, by their numbers in the program.
    pub(super) attributes: Vec<Rows>,
    /// While a blend is summed: the opacity of its largest operand so far, whose refractive index
    /// the blend takes.
    pub(super) largest: Rows,
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

    /// Bytes of one block.
    pub(super) fn bytes(required: RequiredOutputs) -> usize {
        let kinds = [required.color, required.normal, required.boundary, required.material].map(usize::from);
        let attributes = required.attributes.count_ones() as usize;
        (1 + 3 * kinds[0] + 3 * kinds[1] + kinds[2] + (MATERIAL + 1) * kinds[3] + attributes)
            * LANES
            * size_of::<SampleRow>()
    }

    /// Makes a lane valid but empty: opacity and shading vector 0, boundary infinitely far.
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
        let [x, y, z] = &self.normal;
        DVec3::new(x[lane].0[j].into(), y[lane].0[j].into(), z[lane].0[j].into())
    }

    pub(super) fn copy_lane(&mut self, from: &Self, lane: usize, required: RequiredOutputs) {
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

    /// The required rows besides the opacity, of this block and of another.
    pub(super) fn selected<'b>(
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

    /// Samples of `live` that another operand of a union could still change: those that are not
    /// opaque.
    pub(super) fn not_opaque(&self, live: &Live, measure: Measure) -> Live {
        let most = most(measure);
        self.narrowed(live, true, |o| o < most)
    }

    /// Samples of `live` that are not empty.
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

    /// Converts opacities from one measure to another.
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

/// The largest value of a measure.
fn most(measure: Measure) -> f32 {
    match measure {
        Measure::Opacity => MAX_OPACITY as f32,
        Measure::OpticalDepth => MAX_OPTICAL_DEPTH,
    }
}

/// Scales vectors to length one; zero vectors stay zero.
#[inline(always)]
pub(super) fn normalize(x: &mut SampleRow, y: &mut SampleRow, z: &mut SampleRow) {
    for j in 0..SLAB_SAMPLES {
        // Relative to the largest component, so that squaring can neither overflow nor underflow to
        // zero.
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

/// The indices of the bits that are set.
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

/// Calls `f` for every lane of a mask.
#[inline(always)]
pub(super) fn each_lane(mut lanes: u64, mut f: impl FnMut(usize)) {
    while lanes != 0 {
        let lane = lanes.trailing_zeros() as usize;
        lanes &= lanes - 1;
        f(lane);
    }
}

/// The samples of a row that are above a value, a bit for each.
#[inline(always)]
pub(super) fn above(row: &SampleRow, value: f32) -> u32 {
    row.0.iter().enumerate().fold(0, |bits, (j, &v)| bits | u32::from(v > value) << j)
}

/// So many samples, from the first, a bit for each.
#[inline(always)]
pub(super) fn first_samples(count: usize) -> u32 {
    const { assert!(SLAB_SAMPLES == u32::BITS as usize) };
    if count == 0 { 0 } else { u32::MAX >> (SLAB_SAMPLES - count) }
}

/// The number of samples, from the first, up to the one with which their optical depths exceed
/// `left`.
#[inline(always)]
pub(super) fn samples_within(depths: &[f32; SLAB_SAMPLES], left: f32) -> usize {
    // The order in which they are added changes the sum by far less than a thousandth.
    let mut lanes = [0.0; 8];
    for eight in depths.as_chunks::<8>().0 {
        for (lane, depth) in lanes.iter_mut().zip(eight) {
            *lane += depth;
        }
    }
    if lanes.iter().sum::<f32>() * 1.001 < left {
        return SLAB_SAMPLES;
    }
    let mut sum = 0.0;
    let over = depths.iter().position(|depth| {
        sum += depth;
        sum > left
    });
    over.map_or(SLAB_SAMPLES, |j| j + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_end_with_the_one_that_exceeds_what_is_left() {
        let depths: [f32; SLAB_SAMPLES] = std::array::from_fn(|j| if j % 2 == 1 { 1.0 } else { 0.0 });
        assert_eq!(samples_within(&depths, 0.5), 2);
        assert_eq!(samples_within(&depths, 1.0), 4);
        assert_eq!(samples_within(&depths, 16.0), SLAB_SAMPLES);
        assert_eq!(samples_within(&depths, f32::INFINITY), SLAB_SAMPLES);
    }
}

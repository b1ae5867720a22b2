//! From the field of what is seen from afar to a volume: the closure, sample by sample, and what
//! stands beside it of points that are densities.

use super::lod::CloudLod;
use super::measures::opacity_of_optical_depth;
use super::shading::{Carried, CloudShading, Color};
use crate::field::{FarChannel, FieldSamples, LANES, SLAB_SAMPLES, SampleRow, SimdLevel, dispatch};
use crate::lod::{MOST_OPACITY, STACKING};
use crate::math::{absorbed, ln};
use crate::scene::MAX_OPACITY;
use crate::trace::display_values::all_to_linear;
use crate::trace::node_samples::{Measure, NodeSamples, RequiredOutputs, ZERO, each_lane, numbers};

/// What is taken of the light by less than this, for a unit of volume, has no colour.
const LEAST_AREA: f32 = 1e-30;

/// What points that are densities make of a lane.
struct DensityLane {
    /// By themselves, in the measure that is asked for.
    opacity: SampleRow,
    /// Beside what is seen from afar: optical depths.
    depth: SampleRow,
    color: [SampleRow; 3],
    normal: [SampleRow; 3],
    boundary: SampleRow,
    attributes: Vec<SampleRow>,
}

impl CloudShading {
    /// Converts the fields of densities and of what is seen from afar to opacity, colour and
    /// shading vector. A sample at which there is nothing of one of them is as if that was not
    /// there: whether its ray meets it elsewhere must not matter.
    pub(super) fn transfer_spread(
        &self,
        lod: &CloudLod,
        (near, spread): (&mut FieldSamples, &FieldSamples),
        (measure, required, simd): (Measure, RequiredOutputs, SimdLevel),
        out: &mut NodeSamples,
    ) {
        self.transfer(near, (measure, required, simd), None, out);
        let both = near.touched & spread.touched;
        let mut beside: Vec<(usize, DensityLane)> = (0..LANES)
            .filter(|lane| both >> lane & 1 == 1)
            .map(|lane| (lane, DensityLane::of(out, (lane, required))))
            .collect();
        self.beside_spread(lod, (near, spread), (required, simd), (&mut beside, out));
        each_lane(spread.touched, |lane| self.fill_spread(lod, spread, (lane, required, simd), out));
        for (lane, beside) in beside {
            beside.join(out, (lane, measure, required));
        }
        let alone = spread.touched & !both;
        if measure == Measure::Opacity {
            dispatch!(simd.level(), _simd => opacity_of_optical_depth(alone, &mut out.opacity));
        }
        out.touched = near.touched | spread.touched;
    }

    /// What densities absorb, as optical depths, beside what is seen from afar, which adds to the
    /// density that they are in: of g at both together, by their part of it. Colours that follow
    /// from densities are those of both, too.
    fn beside_spread(
        &self,
        lod: &CloudLod,
        (near, spread): (&mut FieldSamples, &FieldSamples),
        (required, simd): (RequiredOutputs, SimdLevel),
        (beside, out): (&mut [(usize, DensityLane)], &mut NodeSamples),
    ) {
        let channel = lod.decoder.channel(FarChannel::Density);
        let own: Vec<SampleRow> = beside.iter().map(|(lane, _)| near.density[*lane]).collect();
        let mut lanes = 0;
        for (lane, _) in &*beside {
            lanes |= 1 << lane;
            let more = &spread.attribute[channel][*lane].0;
            near.density[*lane].0.iter_mut().zip(more).for_each(|(d, more)| *d += more);
        }
        let touched = std::mem::replace(&mut near.touched, lanes);
        self.fill_opacity(near, Measure::OpticalDepth, simd, out);
        near.touched = touched;
        let is_recolored = required.color && matches!(self.color, Color::Map { carried: None, .. });
        for ((lane, of), own) in beside.iter_mut().zip(own) {
            let (depth, all) = (&out.opacity[*lane].0, &near.density[*lane].0);
            let part = |j: usize| if own.0[j] > 0.0 { depth[j] * (own.0[j] / all[j]) } else { 0.0 };
            of.depth = SampleRow(std::array::from_fn(part));
            if is_recolored {
                self.fill_color(near, *lane, None, simd, out);
                of.color = out.color.each_ref().map(|rows| rows[*lane]);
            }
        }
    }

    /// Fills a lane with what is seen from afar; opacities are optical depths.
    fn fill_spread(
        &self,
        lod: &CloudLod,
        spread: &FieldSamples,
        (lane, required, simd): (usize, RequiredOutputs, SimdLevel),
        out: &mut NodeSamples,
    ) {
        let area = &spread.density[lane].0;
        let of = |channel: FarChannel| &spread.attribute[lod.decoder.channel(channel)][lane].0;
        let sums = [area, of(FarChannel::Cover), of(FarChannel::Length), of(FarChannel::Depth)];
        let per_local = (self.unit_distance * lod.stretch) as f32;
        dispatch!(simd.level(), _simd =>
            closed(sums, per_local, &mut out.opacity[lane].0));
        let mean = |channel: usize| {
            let sum = &spread.attribute[channel][lane].0;
            let of = |j: usize| if area[j] > LEAST_AREA { sum[j] / area[j] } else { 0.0 };
            SampleRow(std::array::from_fn(of))
        };
        let value = |carried: Carried| match carried {
            Carried::LumpOpacity => mean_opacity(area, sums[1]),
            Carried::Mean(channel) => mean(channel),
            Carried::Label(number) => spread.label[number][0][lane],
        };
        if required.color {
            self.color_spread(lod, (mean, value), (lane, simd), out);
        }
        for number in numbers(required.attributes) {
            out.attributes[number][lane] = self.carried(number).map_or(ZERO, value);
        }
        if required.normal || required.boundary {
            // The boundary is where half of a pixel is covered.
            let covered =
                SampleRow(std::array::from_fn(|j| area[j] * (0.5 / sums[2][j].max(f32::MIN_POSITIVE))));
            self.fill_vectors(
                (&spread.gradient, &spread.density[lane]),
                &covered,
                (lane, required, simd),
                out,
            );
        }
        if required.normal && lod.decoder.has_normals() {
            let first = lod.decoder.channel(FarChannel::Normal);
            self.turn_to_flat([mean(first), mean(first + 1), mean(first + 2)], lane, out);
        }
        if required.material {
            for (rows, &v) in out.material.iter_mut().zip(&self.material) {
                rows[lane].0.fill(v);
            }
        }
    }

    /// Turns shading vectors, by the gradient of the field, to the direction across what is flat,
    /// which says more of a surface than how what stands for it overlaps.
    fn turn_to_flat(&self, flat: [SampleRow; 3], lane: usize, out: &mut NodeSamples) {
        let m = &self.normal_map;
        let scale = 1.0 / m.iter().map(|column| column[0] * column[0]).sum::<f32>().sqrt();
        for j in 0..SLAB_SAMPLES {
            let local = flat.each_ref().map(|row| -row.0[j] * scale);
            let length = (local[0] * local[0] + local[1] * local[1] + local[2] * local[2]).sqrt() / scale;
            let rest = (1.0 - length).max(0.0);
            let mut sum = [0.0; 3];
            for axis in 0..3 {
                let world = m[0][axis] * local[0] + m[1][axis] * local[1] + m[2][axis] * local[2];
                sum[axis] = world + rest * out.normal[axis][lane].0[j];
            }
            let length = (sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]).sqrt();
            for axis in 0..3 {
                out.normal[axis][lane].0[j] = if length > 1e-6 { sum[axis] / length } else { 0.0 };
            }
        }
    }

    fn color_spread(
        &self,
        lod: &CloudLod,
        (mean, value): (impl Fn(usize) -> SampleRow, impl Fn(Carried) -> SampleRow),
        (lane, simd): (usize, SimdLevel),
        out: &mut NodeSamples,
    ) {
        let first_of_densities = lod.decoder.channel(FarChannel::Color);
        match &self.color {
            Color::Uniform(color) => {
                for (rows, &v) in out.color.iter_mut().zip(color) {
                    rows[lane].0.fill(v);
                }
            }
            Color::Points => {
                for (channel, rows) in out.color.iter_mut().enumerate() {
                    rows[lane] = mean(channel);
                    if self.are_colors_displayed() {
                        dispatch!(simd.level(), _simd => all_to_linear(&mut rows[lane].0));
                    }
                }
            }
            Color::Map { carried: None, .. } => {
                for (channel, rows) in out.color.iter_mut().enumerate() {
                    rows[lane] = mean(first_of_densities + channel);
                }
            }
            Color::Map { table, carried: Some(carried), .. } => {
                let values = value(*carried);
                let [red, green, blue] = out.color.each_mut().map(|rows| &mut rows[lane].0);
                for j in 0..SLAB_SAMPLES {
                    if out.opacity[lane].0[j] > 0.0 {
                        [red[j], green[j], blue[j]] = table.color(values.0[j]);
                    }
                }
            }
        }
    }
}

/// The closure, as `lod::closure` has it in double precision: optical depths per unit distance. The
/// sums are those of the area that takes light, of the area that is covered, and of the latter
/// times its length and times its depth. A unit distance is `unit` long in the cloud's space.
#[inline(always)]
fn closed([area, cover, length, depth]: [&[f32; SLAB_SAMPLES]; 4], unit: f32, out: &mut [f32; SLAB_SAMPLES]) {
    let stacking = STACKING as f32;
    for j in 0..SLAB_SAMPLES {
        let (covered, per_cover) = (length[j], 1.0 / cover[j].max(f32::MIN_POSITIVE));
        let opacity = (area[j] * per_cover).min(MOST_OPACITY as f32);
        // The length of what covers the pixel.
        let long = (covered * per_cover).max(f32::MIN_POSITIVE);
        let mean_depth = depth[j] * per_cover;
        let overlap = stacking * covered;
        let opacity = opacity + overlap * (absorbed(mean_depth) - opacity).max(0.0);
        let beside = minus_ln_1m((overlap * opacity).min(0.999_999)) / (stacking * long);
        let behind = covered * mean_depth / long;
        let sigma = if overlap < 1.0 { beside } else { behind };
        out[j] = if cover[j] > 0.0 { sigma * unit } else { 0.0 };
    }
}

/// The mean opacity of what covers a part of a pixel.
fn mean_opacity(area: &[f32; SLAB_SAMPLES], cover: &[f32; SLAB_SAMPLES]) -> SampleRow {
    let of = |j: usize| if cover[j] > 0.0 { (area[j] / cover[j]).min(1.0) } else { 0.0 };
    SampleRow(std::array::from_fn(of))
}

/// −ln(1 − x), for x from 0 to less than 1.
#[inline(always)]
fn minus_ln_1m(x: f32) -> f32 {
    let series = x * (1.0 + x * (0.5 + x * (1.0 / 3.0 + x * (0.25 + x * 0.2))));
    if x < 0.03 { series } else { -ln(1.0 - x) }
}

impl DensityLane {
    fn of(out: &NodeSamples, (lane, required): (usize, RequiredOutputs)) -> Self {
        let row = |wanted: bool, rows: &[SampleRow]| if wanted { rows[lane] } else { ZERO };
        Self {
            opacity: out.opacity[lane],
            depth: ZERO,
            color: out.color.each_ref().map(|rows| row(required.color, rows)),
            normal: out.normal.each_ref().map(|rows| row(required.normal, rows)),
            boundary: row(required.boundary, &out.boundary),
            attributes: out.attributes.iter().map(|rows| rows[lane]).collect(),
        }
    }

    /// Joins it with what is seen from afar, of which there are optical depths: each has its part
    /// of what absorbs.
    fn join(self, out: &mut NodeSamples, (lane, measure, required): (usize, Measure, RequiredOutputs)) {
        for j in 0..SLAB_SAMPLES {
            let spread = out.opacity[lane].0[j];
            let all = self.depth.0[j] + spread;
            out.opacity[lane].0[j] = match measure {
                _ if !(spread > 0.0) => self.opacity.0[j],
                Measure::OpticalDepth => all,
                Measure::Opacity => absorbed(all).min(MAX_OPACITY as f32),
            };
            let part = if spread > 0.0 { self.depth.0[j] / all } else { 1.0 };
            if part > 0.0 {
                self.mix(out, (lane, j, part), required);
            }
        }
    }

    /// Mixes what a sample has besides opacity.
    fn mix(&self, out: &mut NodeSamples, (lane, j, part): (usize, usize, f32), required: RequiredOutputs) {
        let mixed = |own: f32, other: f32| if part < 1.0 { own * part + other * (1.0 - part) } else { own };
        if required.color {
            for (rows, own) in out.color.iter_mut().zip(&self.color) {
                rows[lane].0[j] = mixed(own.0[j], rows[lane].0[j]);
            }
        }
        if required.normal {
            let own = self.normal.each_ref().map(|row| row.0[j]);
            let sum = [0, 1, 2].map(|axis| mixed(own[axis], out.normal[axis][lane].0[j]));
            let length = (sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]).sqrt();
            for axis in 0..3 {
                let of_both = if length > 1e-6 { sum[axis] / length } else { 0.0 };
                out.normal[axis][lane].0[j] = if part < 1.0 { of_both } else { own[axis] };
            }
        }
        if required.boundary && part > 0.5 {
            out.boundary[lane].0[j] = self.boundary.0[j];
        }
        for number in numbers(required.attributes) {
            let rows = &mut out.attributes[number];
            rows[lane].0[j] = mixed(self.attributes[number].0[j], rows[lane].0[j]);
        }
    }
}

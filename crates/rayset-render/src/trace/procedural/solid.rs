//! Samples of solids, eight at a time.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f64x8};

use super::solid_rows::{SolidRows, length};
use super::volume::{Eight, ProceduralRequest, ProceduralVolume, replace};
use crate::field::BLOCK_SAMPLES;
use crate::math::ln;
use crate::scene::{MAX_OPACITY, Pattern, Solid};
use crate::trace::node_samples::{MAX_OPTICAL_DEPTH, Measure, NodeSamples, RequiredOutputs, numbers};
use rayset_base::geometry::DVec3;

impl ProceduralVolume {
    /// Fills some samples of one ray through a solid. Returns the sum of their optical depths, or 0
    /// if opacities are requested.
    #[inline(always)]
    pub(super) fn fill_solid<S: Simd>(
        &self,
        simd: S,
        asked: &ProceduralRequest<'_>,
        solid: &Solid,
        eight: &Eight<'_>,
        out: &mut NodeSamples,
    ) -> f32 {
        let ProceduralRequest { packet, slab, measure, required, .. } = *asked;
        let Eight { lane, block, samples, ray } = *eight;
        let splat = |v| f64x8::splat(simd, v);
        let first = (slab.first + (block * BLOCK_SAMPLES) as u64) as f64;
        let numbers_in_block = f64x8::from_slice(simd, &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
        let t = (splat(first) + numbers_in_block + splat(packet.sample_offset(lane)))
            * splat(packet.step_world());
        let place = |axis: usize| splat(ray.origin[axis]) + splat(ray.direction[axis]) * t;
        let places = [place(0), place(1), place(2)];
        let rows = SolidRows::new(simd, solid, places);
        let of_solid: [f64; BLOCK_SAMPLES] =
            rows.opacity.max_precise(splat(0.0)).min(splat(MAX_OPACITY)).into();
        let mut opacity = [0.0; BLOCK_SAMPLES];
        let mut most = 0.0_f32;
        for i in 0..BLOCK_SAMPLES {
            opacity[i] = if samples >> i & 1 == 1 { of_solid[i] as f32 } else { 0.0 };
            most = most.max(opacity[i]);
        }
        if !required.outside && !(most > 0.0) {
            return 0.0;
        }
        self.begin_lane(lane, required, out);
        let mut sum = 0.0;
        if measure == Measure::OpticalDepth {
            for depth in &mut opacity {
                *depth = (-ln(1.0 - *depth)).min(MAX_OPTICAL_DEPTH);
            }
            for depth in opacity {
                sum += depth;
            }
        }
        replace(&mut out.opacity[lane], block, &opacity, samples);
        let places: [[f64; BLOCK_SAMPLES]; 3] = [places[0].into(), places[1].into(), places[2].into()];
        if required.color {
            color_rows(&solid.pattern, &places, &opacity, lane, block, out);
        }
        for number in numbers(required.attributes) {
            let index = self.named.get(number).copied().flatten();
            for i in (0..BLOCK_SAMPLES).filter(|i| opacity[*i] > 0.0) {
                let place = DVec3::new(places[0][i], places[1][i], places[2][i]);
                let value = index.map_or(0.0, |index| self.field.attribute(index, place));
                out.attributes[number][lane].0[block * BLOCK_SAMPLES + i] = value;
            }
        }
        if required.normal || required.boundary {
            self.normal_rows(simd, required, &rows, eight, out);
        }
        sum
    }

    /// Fills shading vectors and boundaries of some samples of a solid.
    #[inline(always)]
    fn normal_rows<S: Simd>(
        &self,
        simd: S,
        required: RequiredOutputs,
        rows: &SolidRows<S>,
        eight: &Eight<'_>,
        out: &mut NodeSamples,
    ) {
        let Eight { lane, block, samples, .. } = *eight;
        let splat = |v| f64x8::splat(simd, v);
        let columns = self.world_gradient.to_cols_array_2d();
        let [x, y, z] = rows.gradient;
        let along = |axis: usize| {
            splat(columns[0][axis]) * x + splat(columns[1][axis]) * y + splat(columns[2][axis]) * z
        };
        let gradient = [along(0), along(1), along(2)];
        let per_length = splat(1.0) / length(gradient);
        if required.boundary {
            // A first-order estimate, exact if the implicit function is a distance.
            replace(&mut out.boundary[lane], block, &single(rows.implicit * per_length), samples);
        }
        if required.normal {
            let exists = per_length.simd_gt(splat(0.0)) & per_length.simd_lt(splat(f64::INFINITY));
            for (rows, gradient) in out.normal.iter_mut().zip(gradient) {
                let normal = exists.select(gradient * per_length, splat(0.0));
                replace(&mut rows[lane], block, &single(normal), samples);
            }
        }
    }
}

/// Numbers in single precision.
#[inline(always)]
fn single<S: Simd>(numbers: f64x8<S>) -> [f32; BLOCK_SAMPLES] {
    let numbers: [f64; BLOCK_SAMPLES] = numbers.into();
    let mut rounded = [0.0; BLOCK_SAMPLES];
    for i in 0..BLOCK_SAMPLES {
        rounded[i] = numbers[i] as f32;
    }
    rounded
}

/// Fills the colours of a block of samples, which are of no importance where there is no opacity.
#[inline(always)]
fn color_rows(
    pattern: &Pattern,
    places: &[[f64; BLOCK_SAMPLES]; 3],
    opacity: &[f32; BLOCK_SAMPLES],
    lane: usize,
    block: usize,
    out: &mut NodeSamples,
) {
    let mut colors = [[0.0; BLOCK_SAMPLES]; 3];
    match pattern {
        Pattern::Uniform(color) => {
            for (row, &v) in colors.iter_mut().zip(color) {
                *row = [v as f32; BLOCK_SAMPLES];
            }
        }
        Pattern::Checker { colors: two, size } => {
            for i in 0..BLOCK_SAMPLES {
                let sum = (places[0][i] / size).floor()
                    + (places[1][i] / size).floor()
                    + (places[2][i] / size).floor();
                // The remainder of a whole number.
                let second = sum - 2.0 * (sum * 0.5).floor() >= 1.0;
                for channel in 0..3 {
                    colors[channel][i] = (if second { two[1][channel] } else { two[0][channel] }) as f32;
                }
            }
        }
        Pattern::Gradient { .. } => {
            for i in (0..BLOCK_SAMPLES).filter(|i| opacity[*i] > 0.0) {
                let color = pattern.color(DVec3::new(places[0][i], places[1][i], places[2][i]));
                for (row, v) in colors.iter_mut().zip(color) {
                    row[i] = v as f32;
                }
            }
        }
    }
    for (rows, colors) in out.color.iter_mut().zip(&colors) {
        rows[lane].0.as_chunks_mut().0[block] = *colors;
    }
}

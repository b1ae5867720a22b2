//! Sums over points at the samples of one block of one ray.

use std::ops::Range;

use fearless_simd::f32x8;
use fearless_simd::prelude::*;

use super::columns::PointColumns;
use super::gaussian_splat::Chord;
use super::lane_kernels::LaneKernel;
use super::lane_ray::LaneRay;
use super::packet::BLOCK_SAMPLES;
use super::pairs::Pairs;
use super::run::DecodedRun;
use super::samples::FieldSamples;
use rayset_files::octree::layout::RUN_POINTS;

/// Channels of a colour, whose sums are kept in registers.
pub(super) const COLOR: usize = 3;
/// Any other number of channels; their sums are kept in memory.
pub(super) const ANY: usize = usize::MAX;

/// The samples of one block of one ray.
#[derive(Clone, Copy)]
pub(super) struct SampleBlock {
    pub(super) lane: usize,
    pub(super) block: usize,
}

impl SampleBlock {
    /// Their range in the rows of the ray.
    #[inline(always)]
    pub(super) fn range(self) -> Range<usize> {
        BLOCK_SAMPLES * self.block..BLOCK_SAMPLES * (self.block + 1)
    }
}

/// Sums at the samples of one block, kept in registers.
pub(super) struct Sums<S: Simd, const GRADIENT: bool, const ATTRIBUTES: usize> {
    pub(super) density: f32x8<S>,
    color: [f32x8<S>; COLOR],
    gradient: [f32x8<S>; 3],
}

impl<S: Simd, const GRADIENT: bool, const ATTRIBUTES: usize> Sums<S, GRADIENT, ATTRIBUTES> {
    #[inline(always)]
    pub(super) fn zero(simd: S) -> Self {
        let zero = f32x8::splat(simd, 0.0);
        Self { density: zero, color: [zero; COLOR], gradient: [zero; 3] }
    }

    /// What has been added to the samples before.
    #[inline(always)]
    pub(super) fn load(simd: S, samples: &FieldSamples, place: SampleBlock) -> Self {
        let (lane, at) = (place.lane, place.range());
        let mut sums = Self::zero(simd);
        sums.density = f32x8::from_slice(simd, &samples.density[lane].0[at.clone()]);
        for channel in 0..3 {
            if ATTRIBUTES == COLOR {
                let row = &samples.attribute[channel][lane].0;
                sums.color[channel] = f32x8::from_slice(simd, &row[at.clone()]);
            }
            if GRADIENT {
                let row = &samples.gradient[channel][lane].0;
                sums.gradient[channel] = f32x8::from_slice(simd, &row[at.clone()]);
            }
        }
        sums
    }

    #[inline(always)]
    pub(super) fn store(&self, samples: &mut FieldSamples, place: SampleBlock) {
        let (lane, at) = (place.lane, place.range());
        self.density.store_slice(&mut samples.density[lane].0[at.clone()]);
        for channel in 0..3 {
            if ATTRIBUTES == COLOR {
                self.color[channel].store_slice(&mut samples.attribute[channel][lane].0[at.clone()]);
            }
            if GRADIENT {
                self.gradient[channel].store_slice(&mut samples.gradient[channel][lane].0[at.clone()]);
            }
        }
    }

    /// Adds those of some points of a run that reach the block, in their order.
    #[inline(always)]
    pub(super) fn add<K: LaneKernel, const SHAPES: bool>(
        &mut self,
        ray: &LaneRay,
        pairs: &Pairs,
        hits: [u64; 2],
        (points, run): (&PointColumns, &DecodedRun),
        samples: &mut FieldSamples,
        place: SampleBlock,
    ) {
        let simd = self.density.simd;
        let t = ray.samples_of_block(simd, place.block);
        let zero = f32x8::splat(simd, 0.0);
        // Component of the gradient along the ray and, with reversed sign, across it, of this run
        // only.
        let (mut along_ray, mut across) = (zero, [zero; 3]);
        for (half, mut hits) in hits.into_iter().enumerate() {
            while hits != 0 {
                // Below RUN_POINTS by construction; the mask makes this visible to the compiler.
                let i = (64 * half + hits.trailing_zeros() as usize) & (RUN_POINTS - 1);
                hits &= hits - 1;
                let inverse = if SHAPES { pairs.scale[i] } else { points.inverse_radius[i] };
                let along = t * inverse - pairs.nearest[i];
                if K::IS_SPLAT {
                    let of = (pairs, points, run, i);
                    let slopes = (&mut along_ray, &mut across);
                    let weighted = self.add_splat::<SHAPES>(ray, (along, inverse), of, slopes);
                    if ATTRIBUTES == ANY {
                        add_attributes(weighted, run, usize::from(points.number[i]), samples, place);
                    }
                    continue;
                }
                let q = (-along).mul_add(along, f32x8::splat(simd, pairs.inside[i]));
                let weighted = self.add_value(K::value(q), points.weight[i], (points, run), i);
                if ATTRIBUTES == ANY {
                    add_attributes(weighted, run, usize::from(points.number[i]), samples, place);
                }
                if GRADIENT && SHAPES {
                    let slope = K::slope_over_x(q) * points.weight[i];
                    let slope_along = -(slope * along);
                    for channel in 0..3 {
                        let sum = slope.mul_add(pairs.across[channel][i], across[channel]);
                        across[channel] = slope_along.mul_add(pairs.toward[channel][i], sum);
                    }
                } else if GRADIENT {
                    let slope = K::slope_over_x(q) * (points.weight[i] * inverse);
                    along_ray = slope.mul_add(along, along_ray);
                    let slope = slope * inverse;
                    for channel in 0..3 {
                        across[channel] = slope.mul_add(pairs.across[channel][i], across[channel]);
                    }
                }
            }
        }
        if GRADIENT {
            for channel in 0..3 {
                self.gradient[channel] += along_ray * ray.direction[channel] - across[channel];
            }
        }
    }

    /// Adds the value of one point to density and colour; returns it, weighted if attributes
    /// follow.
    #[inline(always)]
    fn add_value(
        &mut self,
        value: f32x8<S>,
        weight: f32,
        (points, run): (&PointColumns, &DecodedRun),
        i: usize,
    ) -> f32x8<S> {
        if ATTRIBUTES == 0 {
            self.density = value.mul_add(weight, self.density);
            return value;
        }
        let weighted = value * weight;
        self.density += weighted;
        if ATTRIBUTES == COLOR {
            let point = usize::from(points.number[i]) & (RUN_POINTS - 1);
            let columns = &run.attribute[..COLOR];
            for channel in 0..COLOR {
                self.color[channel] = weighted.mul_add(columns[channel][point], self.color[channel]);
            }
        }
        weighted
    }
}

impl<S: Simd, const GRADIENT: bool, const ATTRIBUTES: usize> Sums<S, GRADIENT, ATTRIBUTES> {
    /// Adds the mean extinctions of one splat in the intervals of the samples, which are `along`
    /// the ray in radii, of which a unit of length has `scale`, and returns them. For gradients,
    /// they are multiplied by the slope where the intervals begin in the splat: the side that is
    /// seen.
    #[inline(always)]
    fn add_splat<const SHAPES: bool>(
        &mut self,
        ray: &LaneRay,
        (along, scale): (f32x8<S>, f32),
        (pairs, points, run, i): (&Pairs, &PointColumns, &DecodedRun, usize),
        (along_ray, across): (&mut f32x8<S>, &mut [f32x8<S>; 3]),
    ) -> f32x8<S> {
        let chord = Chord::new(points.weight[i], pairs.inside[i]);
        let (from, to) = (along - ray.interval.0 * scale, along + ray.interval.1 * scale);
        let extinction = chord.depth(from, to) * ray.per_step_world;
        let weighted = self.add_value(extinction, 1.0, (points, run), i);
        let front = chord.entered(from);
        if GRADIENT && SHAPES {
            for channel in 0..3 {
                let sum = (-weighted).mul_add(pairs.across[channel][i], across[channel]);
                across[channel] = (weighted * front).mul_add(pairs.toward[channel][i], sum);
            }
        } else if GRADIENT {
            *along_ray = (weighted * -scale).mul_add(front, *along_ray);
            for channel in 0..3 {
                let slope = weighted * -(scale * scale);
                across[channel] = slope.mul_add(pairs.across[channel][i], across[channel]);
            }
        }
        weighted
    }
}

/// Adds one point to the attributes, whose sums are in memory, and to the labels.
#[inline(always)]
fn add_attributes<S: Simd>(
    weighted: f32x8<S>,
    run: &DecodedRun,
    point: usize,
    samples: &mut FieldSamples,
    place: SampleBlock,
) {
    let (simd, lane) = (weighted.simd, place.lane);
    for (rows, column) in samples.attribute.iter_mut().zip(&run.attribute) {
        let row = &mut rows[lane].0[place.range()];
        weighted.mul_add(column[point], f32x8::from_slice(simd, row)).store_slice(row);
    }
    for ([rows, most], column) in samples.label.iter_mut().zip(&run.label) {
        let row = &mut rows[lane].0[place.range()];
        let most = &mut most[lane].0[place.range()];
        let before = f32x8::from_slice(simd, most);
        let wins = weighted.simd_gt(before);
        let label = f32x8::splat(simd, column[point]);
        wins.select(label, f32x8::from_slice(simd, row)).store_slice(row);
        wins.select(weighted, before).store_slice(most);
    }
}

//! The samples of a slab in one brick: listed ray by ray, evaluated batch by batch.

use fearless_simd::prelude::*;

use super::batch::{BATCH, Batch, gradients, lane_and_sample, values};
use super::field::{Color, GridField, GridRequest};
use super::places::{OfSamples, Places};
use super::spans::Segment;
use super::visible::Blocks;
use super::voxels::Voxel;
use crate::field::{LANES, SLAB_SAMPLES};
use crate::trace::node_samples::{NodeSamples, numbers};

/// The samples of a slab in one brick.
pub(super) struct BrickSamples<'a> {
    pub(super) field: &'a GridField,
    pub(super) request: &'a GridRequest<'a>,
    pub(super) voxels: &'a [u8],
    pub(super) places: &'a Places,
    /// The blocks that show anything.
    pub(super) blocks: Blocks,
}

/// Samples of a brick: first those that are to be evaluated, then those of them that are not transparent.
pub(super) struct List {
    len: usize,
    /// Lane · 32 + sample.
    at: OfSamples<u16>,
    /// Stored numbers less the base.
    number: OfSamples<f32>,
    opacity: OfSamples<f32>,
}

impl List {
    pub(super) fn new() -> Self {
        const ALL: usize = LANES * SLAB_SAMPLES;
        Self { len: 0, at: [0; ALL], number: [0.0; ALL], opacity: [0.0; ALL] }
    }

    /// Batches of samples and of their numbers, and how many there are in each. The last is filled up with one of them.
    #[inline(always)]
    fn batch(&self, first: usize) -> (Batch, [f32; BATCH], usize) {
        let len = (self.len - first).min(BATCH);
        let (mut at, mut number) = ([self.at[first]; BATCH], [self.number[first]; BATCH]);
        at[..len].copy_from_slice(&self.at[first..first + len]);
        number[..len].copy_from_slice(&self.number[first..first + len]);
        (at, number, len)
    }
}

impl BrickSamples<'_> {
    /// Fills the samples of some segments, all in this brick. `seen` is, for each lane, the number of samples after
    /// which its ray is known to have ended.
    #[inline(always)]
    pub(super) fn fill<S: Simd, V: Voxel>(
        &self,
        simd: S,
        segments: impl Iterator<Item = Segment> + Clone,
        seen: &mut [usize; LANES],
        list: &mut List,
        out: &mut NodeSamples,
    ) {
        let required = self.request.required;
        self.list_visible(segments.clone(), seen, list);
        self.opacities::<S, V>(simd, list);
        self.store_opacities(list, out);
        self.drop_hidden(segments, seen, list, out);
        if required.color || required.attributes != 0 {
            self.colors(list, out);
        }
        if required.normal || required.boundary {
            self.normals::<V>(list, out);
        }
    }

    /// Lists the samples whose blocks show anything.
    #[inline(always)]
    fn list_visible(
        &self,
        segments: impl Iterator<Item = Segment>,
        seen: &[usize; LANES],
        list: &mut List,
    ) {
        list.len = 0;
        for segment in segments {
            let lane = usize::from(segment.lane) % LANES;
            let mut samples = segment.samples & below(seen[lane]);
            while samples != 0 {
                let at = lane * SLAB_SAMPLES + samples.trailing_zeros() as usize % SLAB_SAMPLES;
                samples &= samples - 1;
                list.at[list.len % list.at.len()] = at as u16;
                list.len += usize::from(self.blocks.has(self.places.block[at]));
            }
        }
    }

    /// Evaluates the listed samples; those that are not transparent stay in the list.
    #[inline(always)]
    fn opacities<S: Simd, V: Voxel>(&self, simd: S, list: &mut List) {
        let GridRequest { measure, required, .. } = *self.request;
        let mut shown = 0;
        for first in (0..list.len).step_by(BATCH) {
            let (batch, _, len) = list.batch(first);
            let numbers = values::<V>(self.voxels, (&batch, self.places), self.field.values.base);
            let opacities = self.field.opacities.of(simd, &numbers, measure);
            for i in 0..len {
                let to = shown % list.at.len();
                (list.at[to], list.number[to], list.opacity[to]) = (batch[i], numbers[i], opacities[i]);
                shown += usize::from(opacities[i] > 0.0 || required.outside);
            }
        }
        list.len = shown;
    }

    #[inline(always)]
    fn store_opacities(&self, list: &List, out: &mut NodeSamples) {
        for (&at, &opacity) in list.at.iter().zip(&list.opacity).take(list.len) {
            let (lane, j) = lane_and_sample(at);
            if out.touched >> lane & 1 == 0 {
                self.begin(lane, out);
            }
            out.opacity[lane].0[j] = opacity;
        }
    }

    /// Makes a lane valid, and fills what is the same for all of its samples.
    fn begin(&self, lane: usize, out: &mut NodeSamples) {
        let required = self.request.required;
        out.clear_lane(lane, required);
        if required.material {
            for (rows, &v) in out.material.iter_mut().zip(&self.field.material) {
                rows[lane].0.fill(v);
            }
        }
        if let (true, Color::Uniform(color)) = (required.color, &self.field.color) {
            for (rows, &v) in out.color.iter_mut().zip(color) {
                rows[lane].0.fill(v);
            }
        }
    }

    /// Finds where rays end, and drops the samples behind that from the list.
    #[inline(always)]
    fn drop_hidden(
        &self,
        segments: impl Iterator<Item = Segment>,
        seen: &mut [usize; LANES],
        list: &mut List,
        out: &NodeSamples,
    ) {
        let Some(ends) = self.request.ends else { return };
        let mut any = false;
        for segment in segments {
            let lane = usize::from(segment.lane) % LANES;
            if out.touched >> lane & 1 == 1 {
                seen[lane] = seen[lane].min(samples_within(&out.opacity[lane].0, ends[lane]));
                any |= seen[lane] < SLAB_SAMPLES;
            }
        }
        if !any {
            return;
        }
        let mut kept = 0;
        for i in 0..list.len {
            let (lane, j) = lane_and_sample(list.at[i]);
            (list.at[kept], list.number[kept]) = (list.at[i], list.number[i]);
            kept += usize::from(j < seen[lane]);
        }
        list.len = kept;
    }

    #[inline(always)]
    fn colors(&self, list: &List, out: &mut NodeSamples) {
        let required = self.request.required;
        for first in (0..list.len).step_by(BATCH) {
            let (batch, numbers_of_batch, len) = list.batch(first);
            let mut value = [0.0; BATCH];
            for i in 0..BATCH {
                value[i] = self.field.values.value(numbers_of_batch[i]) as f32;
            }
            if let (true, Color::Map(table)) = (required.color, &self.field.color) {
                let colors = table.colors(&value);
                for (rows, colors) in out.color.iter_mut().zip(&colors) {
                    for (&at, &v) in batch.iter().zip(colors).take(len) {
                        let (lane, j) = lane_and_sample(at);
                        rows[lane].0[j] = v;
                    }
                }
            }
            for number in numbers(required.attributes) {
                let own = self.field.value_number == Some(number);
                for (&at, &value) in batch.iter().zip(&value).take(len) {
                    let (lane, j) = lane_and_sample(at);
                    out.attributes[number][lane].0[j] = if own { value } else { 0.0 };
                }
            }
        }
    }

    #[inline(always)]
    fn normals<V: Voxel>(&self, list: &List, out: &mut NodeSamples) {
        let required = self.request.required;
        for first in (0..list.len).step_by(BATCH) {
            let (batch, numbers, len) = list.batch(first);
            let gradients = gradients::<V>(self.voxels, (&batch, self.places));
            let (normal, boundary) = self.field.gradients.of(&numbers, &gradients);
            for (i, &at) in batch.iter().enumerate().take(len) {
                let (lane, j) = lane_and_sample(at);
                if required.normal {
                    for (rows, row) in out.normal.iter_mut().zip(&normal) {
                        rows[lane].0[j] = row[i];
                    }
                }
                if required.boundary {
                    out.boundary[lane].0[j] = boundary[i];
                }
            }
        }
    }
}

/// The bits below a number.
#[inline(always)]
fn below(number: usize) -> u32 {
    if number >= SLAB_SAMPLES { u32::MAX } else { (1 << number) - 1 }
}

/// The number of samples, from the first, up to the one with which their optical depths exceed `left`.
#[inline(always)]
fn samples_within(depths: &[f32; SLAB_SAMPLES], left: f32) -> usize {
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

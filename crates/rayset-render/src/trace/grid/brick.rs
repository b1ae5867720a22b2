//! The samples of a slab in one brick: found ray by ray in groups of eight, evaluated batch by
//! batch.

use fearless_simd::prelude::*;

use super::batch::{
    Around, BATCH, BATCH_GROUPS, Brick, Cells, Row, at_sample, corners_of, gradients, trilinear,
};
use super::field::{Color, GridField, GridRequest};
use super::labels::{labels, show};
use super::places::{GROUPS, GROUPS_OF_LANE, OfSamples, Places};
use super::spans::Segment;
use super::visible::Blocks;
use crate::field::{BLOCK_SAMPLES, LANES, SLAB_SAMPLES, SampleRow};
use crate::trace::node_samples::{NodeSamples, numbers, samples_within};

/// The samples of a slab in one brick.
pub(super) struct BrickSamples<'a> {
    pub(super) brick: Brick<'a>,
    pub(super) field: &'a GridField,
    pub(super) request: &'a GridRequest<'a>,
    pub(super) places: &'a Places,
    /// The blocks that show anything.
    pub(super) blocks: Blocks,
}

/// Samples of a brick: first those that are to be evaluated, then those of them that are kept,
/// which are not transparent unless the surroundings of the grid are required. Whole groups are
/// evaluated: the other samples of a group, in other bricks or outside, read voxels of this brick
/// and are dropped.
pub(super) struct Groups {
    len: usize,
    /// Eight samples of one ray each: lane · 4 + block.
    at: [u8; GROUPS],
    /// A bit for each sample.
    samples: [u8; GROUPS],
    /// Stored numbers less the base; valid for evaluated samples.
    number: OfSamples<f32>,
    /// Samples one by one: lane · 32 + sample.
    listed: [u16; GROUPS * BLOCK_SAMPLES],
}

impl Groups {
    pub(super) fn new() -> Self {
        Self {
            len: 0,
            at: [0; GROUPS],
            samples: [0; GROUPS],
            number: [[0.0; BLOCK_SAMPLES]; GROUPS],
            listed: [0; GROUPS * BLOCK_SAMPLES],
        }
    }

    /// Adds a group, if it has any samples.
    #[inline(always)]
    fn push(&mut self, at: u8, samples: u8) {
        (self.at[self.len % GROUPS], self.samples[self.len % GROUPS]) = (at, samples);
        self.len += usize::from(samples != 0);
    }

    /// Lists the samples one by one. Returns how many there are.
    #[inline(always)]
    fn list(&mut self) -> usize {
        let mut count = 0;
        for (at, mut samples) in self.at.into_iter().zip(self.samples).take(self.len) {
            while samples != 0 {
                self.listed[count % (GROUPS * BLOCK_SAMPLES)] =
                    u16::from(at) * BLOCK_SAMPLES as u16 + samples.trailing_zeros() as u16;
                samples &= samples - 1;
                count += 1;
            }
        }
        count
    }

    /// The groups, with a bit for each sample.
    fn iter(&self) -> impl Iterator<Item = (u8, u8)> {
        self.at.into_iter().zip(self.samples).take(self.len)
    }
}

/// The lane of a group, and the group's number among those of the lane.
#[inline(always)]
fn lane_and_block(group: u8) -> (usize, usize) {
    let group = usize::from(group);
    (group / GROUPS_OF_LANE, group % GROUPS_OF_LANE)
}

/// The eight samples of a group among those of a row.
#[inline(always)]
fn eight(row: &mut SampleRow, block: usize) -> &mut [f32; BLOCK_SAMPLES] {
    &mut row.0.as_chunks_mut().0[block]
}

impl BrickSamples<'_> {
    /// Fills the samples of some segments, all in this brick. `seen` is, for each lane, the number
    /// of samples after which its ray is known to have ended.
    #[inline(always)]
    pub(super) fn fill<S: Simd>(
        &self,
        simd: S,
        segments: impl Iterator<Item = Segment>,
        seen: &mut [usize; LANES],
        groups: &mut Groups,
        around: &mut Around,
        out: &mut NodeSamples,
    ) {
        let required = self.request.required;
        self.find_visible(segments, seen, groups);
        self.opacities(simd, groups, around, out);
        self.drop_hidden(seen, groups, out);
        if required.color || required.attributes != 0 {
            self.colors(groups, out);
        }
        if required.normal || required.boundary {
            self.normals(simd, groups, around, out);
        }
    }

    /// What a batch of samples is, in stored numbers less the base.
    #[inline(always)]
    fn numbers<S: Simd>(&self, simd: S, cells: &Cells, around: &mut Around) -> Row {
        around.read_corners(simd, self.brick, cells, self.field.values.base);
        let corners = &around.corners;
        if self.field.labels {
            labels(corners, &cells.within)
        } else {
            trilinear(simd, corners, &cells.within)
        }
    }

    /// Collects the samples whose blocks show anything.
    #[inline(always)]
    fn find_visible(
        &self,
        segments: impl Iterator<Item = Segment>,
        seen: &[usize; LANES],
        groups: &mut Groups,
    ) {
        let (mut visible, mut lanes) = ([0_u32; LANES], 0_u64);
        for segment in segments {
            let lane = usize::from(segment.lane) % LANES;
            let mut samples = segment.samples & below(seen[lane]);
            let blocks = &self.places.block.as_flattened().as_chunks::<SLAB_SAMPLES>().0[lane];
            while samples != 0 {
                let j = samples.trailing_zeros() as usize % SLAB_SAMPLES;
                samples &= samples - 1;
                visible[lane] |= u32::from(self.blocks.has(blocks[j])) << j;
            }
            lanes |= 1 << lane;
        }
        groups.len = 0;
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize;
            lanes &= lanes - 1;
            for (block, samples) in visible[lane].to_le_bytes().into_iter().enumerate() {
                groups.push((lane * GROUPS_OF_LANE + block) as u8, samples);
            }
        }
    }

    /// Evaluates groups of samples; those that are not transparent are kept, and their opacities
    /// stored.
    #[inline(always)]
    fn opacities<S: Simd>(&self, simd: S, groups: &mut Groups, around: &mut Around, out: &mut NodeSamples) {
        let GridRequest { measure, required, .. } = *self.request;
        let evaluated = std::mem::take(&mut groups.len);
        for first in (0..evaluated).step_by(BATCH_GROUPS) {
            let (mut batch, mut samples) = ([groups.at[first]; BATCH_GROUPS], [0; BATCH_GROUPS]);
            let count = (evaluated - first).min(BATCH_GROUPS);
            batch[..count].copy_from_slice(&groups.at[first..first + count]);
            samples[..count].copy_from_slice(&groups.samples[first..first + count]);
            let cells = Cells::of_groups(self.places, &batch);
            let numbers = self.numbers(simd, &cells, around);
            let opacities = self.field.opacities.of(simd, &numbers, measure);
            for i in 0..BATCH_GROUPS {
                let (numbers, opacities) = (&numbers.as_chunks().0[i], &opacities.as_chunks().0[i]);
                let shown = if required.outside { u8::MAX } else { positive(opacities) } & samples[i];
                if shown != 0 {
                    let (lane, block) = lane_and_block(batch[i]);
                    if out.touched >> lane & 1 == 0 {
                        self.begin(lane, out);
                    }
                    groups.number[usize::from(batch[i])] = *numbers;
                    replace(eight(&mut out.opacity[lane], block), opacities, shown);
                }
                groups.push(batch[i], shown);
            }
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

    /// Finds where rays end, and drops the samples behind that.
    #[inline(always)]
    fn drop_hidden(&self, seen: &mut [usize; LANES], groups: &mut Groups, out: &NodeSamples) {
        let Some(ends) = self.request.ends else { return };
        let shown = std::mem::take(&mut groups.len);
        let mut latest = LANES;
        for i in 0..shown {
            let (at, samples) = (groups.at[i % GROUPS], groups.samples[i % GROUPS]);
            let (lane, block) = lane_and_block(at);
            if lane != latest {
                seen[lane] = seen[lane].min(samples_within(&out.opacity[lane].0, ends[lane]));
                latest = lane;
            }
            groups.push(at, samples & below(seen[lane]).to_le_bytes()[block]);
        }
    }

    #[inline(always)]
    fn colors(&self, groups: &Groups, out: &mut NodeSamples) {
        let required = self.request.required;
        for (at, samples) in groups.iter() {
            let (lane, block) = lane_and_block(at);
            let mut values = [0.0; BLOCK_SAMPLES];
            for (value, &number) in values.iter_mut().zip(&groups.number[usize::from(at)]) {
                *value = self.field.values.value(number) as f32;
            }
            if let (true, Color::Map(table)) = (required.color, &self.field.color) {
                let [red, green, blue] = &mut out.color;
                let red = eight(&mut red[lane], block);
                let green = eight(&mut green[lane], block);
                let blue = eight(&mut blue[lane], block);
                let mut samples = samples;
                while samples != 0 {
                    let j = samples.trailing_zeros() as usize % BLOCK_SAMPLES;
                    samples &= samples - 1;
                    [red[j], green[j], blue[j]] = table.color(values[j]);
                }
            }
            for number in numbers(required.attributes) {
                let own = self.field.value_number == Some(number);
                let values = if own { values } else { [0.0; BLOCK_SAMPLES] };
                replace(eight(&mut out.attributes[number][lane], block), &values, samples);
            }
        }
    }

    #[inline(always)]
    fn normals<S: Simd>(&self, simd: S, groups: &mut Groups, around: &mut Around, out: &mut NodeSamples) {
        let listed = groups.list();
        for first in (0..listed).step_by(BATCH) {
            let count = (listed - first).min(BATCH);
            let mut batch = [groups.listed[first]; BATCH];
            batch[..count].copy_from_slice(&groups.listed[first..first + count]);
            self.normals_of_batch(simd, &batch, count, groups, around, out);
        }
    }

    /// Stores shading vectors and boundaries of the first `len` samples of a batch.
    #[inline(always)]
    fn normals_of_batch<S: Simd>(
        &self,
        simd: S,
        batch: &[u16; BATCH],
        len: usize,
        groups: &Groups,
        around: &mut Around,
        out: &mut NodeSamples,
    ) {
        let required = self.request.required;
        let mut numbers = [0.0; BATCH];
        for (number, &at) in numbers.iter_mut().zip(batch) {
            *number = at_sample(&groups.number, at);
        }
        let cells = Cells::of_samples(self.places, batch);
        // Gradients need no base, and subtracting it would round; labels are looked up with it.
        let base = if self.field.labels { self.field.values.base } else { 0.0 };
        around.read_surroundings(simd, self.brick, &cells, base);
        let surroundings = &mut around.surroundings;
        if self.field.labels {
            show(simd, &self.field.opacities, &numbers, surroundings);
            numbers = trilinear(simd, &corners_of(surroundings), &cells.within);
        }
        let gradients = gradients(simd, surroundings, &cells.within);
        let (normal, boundary) = self.field.gradients.of(&numbers, &gradients);
        for (i, &at) in batch.iter().enumerate().take(len) {
            let (lane, j) = (usize::from(at) / SLAB_SAMPLES % LANES, usize::from(at) % SLAB_SAMPLES);
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

/// A bit for each number that is above 0.
#[inline(always)]
fn positive(numbers: &[f32; BLOCK_SAMPLES]) -> u8 {
    let mut bits = 0;
    for (i, &number) in numbers.iter().enumerate() {
        bits |= u8::from(number > 0.0) << i;
    }
    bits
}

/// Replaces the numbers whose bits are set.
#[inline(always)]
fn replace(numbers: &mut [f32; BLOCK_SAMPLES], with: &[f32; BLOCK_SAMPLES], bits: u8) {
    for i in 0..BLOCK_SAMPLES {
        numbers[i] = if bits >> i & 1 == 1 { with[i] } else { numbers[i] };
    }
}

/// The bits below a number.
#[inline(always)]
fn below(number: usize) -> u32 {
    if number >= SLAB_SAMPLES { u32::MAX } else { (1 << number) - 1 }
}

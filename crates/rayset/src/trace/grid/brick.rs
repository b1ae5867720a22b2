//! The samples of a slab in one brick: gathered ray by ray, evaluated batch by batch.

use super::batch::{BATCH, Spot, gradients, values};
use super::field::{Color, GridField, GridMarch, GridRequest};
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
    /// The first voxel of the brick.
    pub(super) corner: [i32; 3],
}

impl BrickSamples<'_> {
    /// Fills the samples of some segments, all in this brick. `seen` is, for each lane, the number of samples after
    /// which its ray is known to have ended.
    #[inline(always)]
    pub(super) fn fill<V: Voxel>(
        &self,
        segments: &[Segment],
        blocks: &Blocks,
        seen: &mut [usize; LANES],
        shown: &mut Vec<(Spot, f32)>,
        out: &mut NodeSamples,
    ) {
        shown.clear();
        let GridRequest { march: GridMarch(rays), slab, required, .. } = *self.request;
        let last_cell = self.field.placement.bounds_voxel.max - 1.0;
        let mut batch = [Spot::default(); BATCH];
        let mut len = 0;
        for segment in segments {
            let lane = usize::from(segment.lane);
            let (cells, within) = rays.ray(lane, slab).cells(last_cell);
            let (voxels, in_blocks) = self.voxels_and_blocks::<V>(&cells);
            let mut samples = segment.samples & below(seen[lane]);
            while samples != 0 {
                let j = samples.trailing_zeros() as usize & (SLAB_SAMPLES - 1);
                samples &= samples - 1;
                if !blocks.has(in_blocks[j]) {
                    continue;
                }
                batch[len] = Spot {
                    voxel: voxels[j],
                    at: (lane * SLAB_SAMPLES + j) as u16,
                    within: [within[0][j], within[1][j], within[2][j]],
                };
                len += 1;
                if len == BATCH {
                    self.opacities::<V>(&batch, len, shown, out);
                    len = 0;
                }
            }
        }
        if len > 0 {
            let spare = batch[0];
            batch[len..].fill(spare);
            self.opacities::<V>(&batch, len, shown, out);
        }
        if let Some(ends) = self.request.ends {
            for segment in segments {
                let lane = usize::from(segment.lane);
                if out.touched >> lane & 1 == 1 {
                    seen[lane] = seen[lane].min(samples_within(&out.opacity[lane].0, ends[lane]));
                }
            }
            shown.retain(|(spot, _)| {
                let (lane, j) = spot.lane_and_sample();
                j < seen[lane]
            });
        }
        if required.color || required.attributes != 0 {
            self.colors(shown, out);
        }
        if required.normal || required.boundary {
            self.normals::<V>(shown, out);
        }
    }

    /// The first voxels of cells, by their indices in the brick, and the blocks of cells; of cells in this brick.
    #[inline(always)]
    fn voxels_and_blocks<V: Voxel>(
        &self,
        cells: &[[i32; SLAB_SAMPLES]; 3],
    ) -> ([u32; SLAB_SAMPLES], [u32; SLAB_SAMPLES]) {
        let (mut voxels, mut blocks) = ([0; SLAB_SAMPLES], [0; SLAB_SAMPLES]);
        let side = V::SIDE as u32;
        for j in 0..SLAB_SAMPLES {
            let x = cells[0][j].wrapping_sub(self.corner[0]) as u32;
            let y = cells[1][j].wrapping_sub(self.corner[1]) as u32;
            let z = cells[2][j].wrapping_sub(self.corner[2]) as u32;
            voxels[j] = z.wrapping_mul(side).wrapping_add(y).wrapping_mul(side).wrapping_add(x);
            blocks[j] = Blocks::number::<V>([x.wrapping_sub(1), y.wrapping_sub(1), z.wrapping_sub(1)]);
        }
        (voxels, blocks)
    }

    /// The opacities of the first `len` samples of a batch; those that are not transparent are added to `shown`.
    #[inline(always)]
    fn opacities<V: Voxel>(
        &self,
        batch: &[Spot; BATCH],
        len: usize,
        shown: &mut Vec<(Spot, f32)>,
        out: &mut NodeSamples,
    ) {
        let required = self.request.required;
        let numbers = values::<V>(self.voxels, batch, self.field.values.base);
        let opacities = self.field.opacities.of(&numbers, self.request.measure);
        for i in 0..len {
            if !(opacities[i] > 0.0) && !required.outside {
                continue;
            }
            let (lane, j) = batch[i].lane_and_sample();
            if out.touched >> lane & 1 == 0 {
                self.begin(lane, out);
            }
            out.opacity[lane].0[j] = opacities[i];
            shown.push((batch[i], numbers[i]));
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

    fn colors(&self, shown: &[(Spot, f32)], out: &mut NodeSamples) {
        let required = self.request.required;
        for (spot, number) in shown {
            let (lane, j) = spot.lane_and_sample();
            let value = self.field.values.value(*number) as f32;
            if let (true, Color::Map(table)) = (required.color, &self.field.color) {
                for (rows, v) in out.color.iter_mut().zip(table.color(value)) {
                    rows[lane].0[j] = v;
                }
            }
            for number in numbers(required.attributes) {
                let own = self.field.value_number == Some(number);
                out.attributes[number][lane].0[j] = if own { value } else { 0.0 };
            }
        }
    }

    #[inline(always)]
    fn normals<V: Voxel>(&self, shown: &[(Spot, f32)], out: &mut NodeSamples) {
        let required = self.request.required;
        for some in shown.chunks(BATCH) {
            let (mut spots, mut numbers) = ([some[0].0; BATCH], [some[0].1; BATCH]);
            for (i, &(spot, number)) in some.iter().enumerate() {
                (spots[i], numbers[i]) = (spot, number);
            }
            let (normal, boundary) = self.field.gradients.of(&numbers, &gradients::<V>(self.voxels, &spots));
            for (i, (spot, _)) in some.iter().enumerate() {
                let (lane, j) = spot.lane_and_sample();
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

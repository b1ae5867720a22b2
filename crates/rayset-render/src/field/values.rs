//! The values of a run's points: their weights, and the attributes that a field carries.

use super::gaussian_splat;
use super::run::{DecodedRun, RunDecoder, normalised_weight};
use rayset_files::octree::format::Header;
use rayset_files::octree::layout::RUN_POINTS;
use rayset_files::octree::page::Run;

impl RunDecoder {
    #[inline(always)]
    pub(super) fn decode_weights(&self, run: &Run<'_>, header: &Header, out: &mut DecodedRun) {
        let n = run.head.len();
        if let Some(w) = self.weight {
            out.points.weight[..n].fill(w);
        } else if let Some(weights) = run.weights(header) {
            out.points.weight.iter_mut().zip(weights).for_each(|(o, w)| *o = w);
            if self.are_splats {
                out.points.weight[..n].iter_mut().for_each(|w| *w = gaussian_splat::extent(*w));
            }
        }
        if let Some(factor) = self.normalisation.filter(|_| header.shape.is_none()) {
            for (w, inverse) in out.points.weight[..n].iter_mut().zip(&out.points.inverse_radius) {
                *w = normalised_weight(*w, factor, *inverse, 1.0);
            }
        }
    }

    #[inline(always)]
    pub(super) fn decode_attributes(&self, run: &Run<'_>, header: &Header, out: &mut DecodedRun) {
        out.attribute.resize(self.columns.channels(), [0.0; RUN_POINTS]);
        let (color, scalars) = out.attribute.split_at_mut(self.columns.first_scalar());
        if let ([red, green, blue], Some(colors)) = (color, run.colors(header)) {
            for (i, c) in colors.enumerate() {
                red[i] = self.color_from_byte[usize::from(c[0])];
                green[i] = self.color_from_byte[usize::from(c[1])];
                blue[i] = self.color_from_byte[usize::from(c[2])];
            }
        }
        for (column, &number) in scalars.iter_mut().zip(&self.columns.scalars) {
            match number.checked_sub(header.attributes.len()) {
                None => decode_attribute(run, header, number, column),
                Some(axis) => {
                    let center = out.center[axis];
                    for (o, &offset) in column.iter_mut().zip(&out.points.position[axis]).take(run.head.len())
                    {
                        *o = (center + f64::from(offset)) as f32;
                    }
                }
            }
        }
        out.label.resize(self.columns.labels.len(), [0.0; RUN_POINTS]);
        for (column, &number) in out.label.iter_mut().zip(&self.columns.labels) {
            decode_attribute(run, header, number, column);
        }
    }
}

/// Decodes a stored attribute. A value that is not finite counts as 0, so that it does not spoil
/// its neighbours.
#[inline(always)]
fn decode_attribute(run: &Run<'_>, header: &Header, index: usize, column: &mut [f32; RUN_POINTS]) {
    for (o, v) in column.iter_mut().zip(run.attribute(header, index)) {
        *o = if v.is_finite() { v } else { 0.0 };
    }
}

//! What is seen of points from afar, decoded for the inner loop: Gaussians, of aggregates and of
//! points by themselves, each of which covers an area of which it takes a part of the light
//! ([`crate::lod`]).
//!
//! The field of them is the area that takes light, for a unit of volume: Σ P·c·N. What else the
//! closure needs are means over it, carried as attributes behind those of the cloud.

use super::columns::{AttributeColumns, MAP_COLUMNS};
use super::run::DecodedRun;
use super::sight::Sight;
use super::simd::{SimdLevel, dispatch};
use crate::lod::{Absorber, CrossSections, LEAST_PART, SPREAD, Seen};
use crate::math::linear_from_srgb;
use rayset_base::geometry::{Aabb, DVec3};
use rayset_files::octree::aggregates::{Aggregate, AggregatePage};
use rayset_files::octree::format::Header;
use rayset_files::octree::layout::RUN_POINTS;

/// What takes less of the light that meets it is not there.
pub(super) const LEAST_OPACITY: f64 = 1e-6;

/// The channels of the closure, behind those of the cloud's attributes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FarChannel {
    /// 1/c: sums to the area that is covered.
    Cover,
    /// L/c: sums to that area times the length of what covers it.
    Length,
    /// M/(P·c): sums to the density.
    Density,
    /// −ln(1 − c)/c: sums to the area that is covered times the optical depth of what covers it.
    Depth,
    /// The first of three of the direction to the eye across flat ones, by how flat they are.
    Normal,
    /// The first of three of a colour that follows from densities.
    Color,
}

/// Channels of the closure besides directions and colours.
pub(super) const OF_CLOSURE: usize = 4;

/// Decodes what stands for the points of one cloud from afar.
#[derive(Clone, Debug)]
pub(crate) struct FarDecoder {
    sections: CrossSections,
    columns: AttributeColumns,
    /// Over which part of a pixel, as wide as it is taken to be, what is seen is spread.
    spread: f64,
    /// Whether colours are those of densities.
    colors_densities: bool,
    /// Whether the field carries directions across what is flat.
    has_normals: bool,
    /// The value of each byte of a colour.
    color_from_byte: Box<[f32; 256]>,
}

impl FarDecoder {
    /// For the cross-sections of a cloud's aggregates, of which each is spread over a part of a
    /// pixel.
    pub(crate) fn new(sections: CrossSections, spread: f64, colors_densities: bool) -> Self {
        let (columns, color_from_byte) = (AttributeColumns::default(), Box::new([0.0; 256]));
        Self { sections, columns, spread, colors_densities, has_normals: false, color_from_byte }
    }

    /// Sets which attributes of the cloud fields carry, and whether directions, and colours that
    /// follow from densities.
    pub(crate) fn carry(&mut self, columns: &AttributeColumns, normals: bool, colors: bool) {
        self.has_normals = normals;
        if !colors {
            self.colors_densities = false;
            self.sections.forget_colors();
        }
        let color = |display: f64| {
            if columns.color_as_displayed { display } else { linear_from_srgb(display) }
        };
        *self.color_from_byte = std::array::from_fn(|i| color(i as f64 / 255.0) as f32);
        self.columns = columns.clone();
    }

    /// Bytes that it takes besides itself.
    pub(crate) fn bytes(&self) -> usize {
        CrossSections::bytes(self.colors_densities)
            + size_of_val(&*self.color_from_byte)
            + self.columns.bytes()
    }

    /// Number of channels of a field.
    pub(crate) fn channels(&self) -> usize {
        let colors = if self.colors_densities { 3 } else { 0 };
        let normals = if self.has_normals { 3 } else { 0 };
        self.columns.channels() + OF_CLOSURE + normals + colors
    }

    /// The number of a channel.
    pub(crate) fn channel(&self, channel: FarChannel) -> usize {
        self.columns.channels()
            + match channel {
                FarChannel::Cover => 0,
                FarChannel::Length => 1,
                FarChannel::Density => 2,
                FarChannel::Depth => 3,
                FarChannel::Normal => OF_CLOSURE,
                FarChannel::Color => OF_CLOSURE + if self.has_normals { 3 } else { 0 },
            }
    }

    /// Whether fields carry directions across what is flat.
    pub(crate) fn has_normals(&self) -> bool {
        self.has_normals
    }

    /// Whether a channel is one of colours that follow from densities.
    pub(super) fn is_color(&self, channel: usize) -> bool {
        self.colors_densities && channel >= self.channel(FarChannel::Color)
    }

    /// With pixels as wide as those over which what is seen is spread.
    pub(crate) fn sharp(&self, sight: &Sight) -> Sight {
        Sight { pixel: sight.pixel * self.spread, ..*sight }
    }

    /// The first channel of the closure.
    pub(super) fn first_of_closure(&self) -> usize {
        self.columns.channels()
    }

    /// What the kernel integrates to, and its variance.
    pub(super) fn kernel(&self) -> (f64, f64) {
        self.sections.kernel
    }

    /// The variance of what is seen because it is spread over a part of a pixel, for a pixel of
    /// one.
    pub(super) fn variance_of_pixel(&self) -> f32 {
        (self.spread * self.spread / 12.0) as f32
    }

    /// Gives points, as they are decoded for a field of densities, the channels of the closure, and
    /// colours if these follow from densities.
    pub(super) fn color_points(&self, run: &mut DecodedRun, colors: &[[f32; 3]; RUN_POINTS]) {
        run.attribute.resize(self.channels(), [0.0; RUN_POINTS]);
        if self.colors_densities {
            let first = self.channel(FarChannel::Color);
            for i in 0..run.len {
                (0..3).for_each(|channel| run.attribute[first + channel][i] = colors[i][channel]);
            }
        }
    }

    /// The area that a unit of an aggregate's mass takes of the light, and its colour, if colours
    /// follow from densities.
    pub(crate) fn of_mass(&self, aggregate: &Aggregate) -> (f64, [f32; 3]) {
        let variances = aggregate.deviations.map(|length| length * length);
        let color = if self.colors_densities { self.sections.color(aggregate) } else { [0.0; 3] };
        (self.sections.of(aggregate, variances) / (self.sections.kernel.0 * aggregate.mass), color)
    }

    /// Decodes some records of a page, all of one level, each by a part.
    pub(crate) fn decode_records(
        &self,
        (page, header): (&AggregatePage<'_>, &Header),
        (first, level): (usize, u8),
        parts: &[f32],
        (sight, simd): (&Sight, SimdLevel),
        out: &mut DecodedRun,
    ) {
        let mut bounds = Aabb::EMPTY;
        let records = first..page.len().min(first + parts.len());
        records
            .clone()
            .filter_map(|index| page.place(index, level))
            .for_each(|cell| bounds.include(cell.centroid));
        out.center = bounds.center();
        let mut writer = FarWriter::begin(self, out);
        for (index, &part) in records.zip(parts) {
            let Some(aggregate) = page.get(index, level).filter(|_| f64::from(part) > LEAST_PART) else {
                continue;
            };
            let absorber = Absorber::of(&aggregate, &self.sections);
            let pixel = self.spread * sight.pixel_at(absorber.center);
            let seen = absorber.seen(sight.eye.toward(absorber.center), pixel);
            let Some(at) = writer.add(&seen, part) else { continue };
            if self.has_normals {
                writer.add_normal(at, absorber.normal(sight.eye.toward(absorber.center)));
            }
            self.attributes(header, &aggregate, (page, index), at, writer.out);
        }
        writer.finish(simd);
    }

    fn attributes(
        &self,
        header: &Header,
        aggregate: &Aggregate,
        (page, index): (&AggregatePage<'_>, usize),
        at: usize,
        out: &mut DecodedRun,
    ) {
        let value = |number: usize| match number.checked_sub(header.attributes.len()) {
            None => page.attribute(index, number).filter(|v| v.is_finite()).unwrap_or(0.0),
            Some(axis) => aggregate.centroid[axis.min(2)] as f32,
        };
        let first = self.columns.first_scalar();
        if let Some(color) = page.color(index).filter(|_| self.columns.color) {
            for (channel, byte) in color.into_iter().enumerate() {
                out.attribute[channel][at] = self.color_from_byte[usize::from(byte)];
            }
        }
        for (column, &number) in out.attribute[first..].iter_mut().zip(&self.columns.scalars) {
            column[at] = value(number);
        }
        for (column, &number) in out.label.iter_mut().zip(&self.columns.labels) {
            column[at] = value(number);
        }
        self.density_color(at, out, || self.sections.color(aggregate));
    }

    fn density_color(&self, at: usize, out: &mut DecodedRun, color: impl FnOnce() -> [f32; 3]) {
        let first = self.channel(FarChannel::Color);
        if self.colors_densities {
            for (column, v) in out.attribute[first..].iter_mut().zip(color()) {
                column[at] = v;
            }
        }
    }
}

/// Writes Gaussians into a run, one after another, never before what is read of it.
struct FarWriter<'t> {
    out: &'t mut DecodedRun,
    len: usize,
    first: usize,
    reach: DVec3,
    least_radius: f64,
}

impl<'t> FarWriter<'t> {
    fn begin(decoder: &FarDecoder, out: &'t mut DecodedRun) -> Self {
        let columns = &decoder.columns;
        out.attribute.resize(decoder.channels(), [0.0; RUN_POINTS]);
        out.label.resize(columns.labels.len(), [0.0; RUN_POINTS]);
        out.become_spread();
        let first = columns.channels();
        Self { out, len: 0, first, reach: DVec3::ZERO, least_radius: f64::INFINITY }
    }

    /// Returns its place, if it takes any light.
    fn add(&mut self, seen: &Seen, part: f32) -> Option<usize> {
        if !(seen.opacity > LEAST_OPACITY) {
            return None;
        }
        let (at, out) = (self.len, &mut *self.out);
        let radii = DVec3::from_array(seen.variances.to_array().map(|v| (v / SPREAD.variance()).sqrt()));
        let weight =
            f64::from(part) * seen.area * seen.opacity / (SPREAD.integral() * radii.element_product());
        if !(weight > 0.0 && weight < 1e30) {
            return None;
        }
        let offset = seen.center - out.center;
        out.points.map.resize(MAP_COLUMNS, [f32::INFINITY; RUN_POINTS]);
        for axis in 0..3 {
            out.points.position[axis][at] = offset[axis] as f32;
            let row = seen.axes.col(axis) / radii[axis];
            for j in 0..3 {
                out.points.map[3 * axis + j][at] = row[j] as f32;
            }
        }
        let largest = radii.max_element();
        out.points.radius[at] = largest as f32;
        out.points.inverse_radius[at] = (1.0 / largest) as f32;
        out.points.weight[at] = weight as f32;
        let per_opacity = 1.0 / seen.opacity;
        out.attribute[self.first][at] = per_opacity as f32;
        out.attribute[self.first + 1][at] = (seen.length * per_opacity) as f32;
        out.attribute[self.first + 2][at] = (seen.mass * per_opacity / seen.area) as f32;
        out.attribute[self.first + 3][at] = (seen.depth * per_opacity) as f32;
        let (axes, squares) = (seen.axes, radii * radii);
        let across = (0..3).map(|axis| {
            let row = axes.row(axis);
            (row * row).dot(squares).sqrt()
        });
        for (axis, across) in across.enumerate() {
            self.reach[axis] = self.reach[axis].max(offset[axis].abs() + across);
        }
        self.least_radius = self.least_radius.min(radii.min_element());
        self.len += 1;
        Some(at)
    }

    fn add_normal(&mut self, at: usize, normal: DVec3) {
        let columns = &mut self.out.attribute[self.first + OF_CLOSURE..];
        columns.iter_mut().zip(normal.to_array()).for_each(|(column, v)| column[at] = v as f32);
    }

    /// Finishes the run. Single precision suffices: what is rounded is a small part of a pixel.
    fn finish(self, simd: SimdLevel) {
        let Self { out, len, reach, least_radius, .. } = self;
        out.len = len;
        out.reach = reach.to_array().map(|v| (v * 1.00001) as f32);
        out.set_far((least_radius * 0.9999) as f32, simd);
    }
}

impl DecodedRun {
    /// Forgets its points; what it becomes is within a box.
    pub(super) fn lies_within(&mut self, bounds: &Aabb) {
        self.center = bounds.center();
        self.reach = (bounds.size() * 0.5).to_array().map(|v| (v * 1.00001) as f32);
        self.reach_length = self.reach[0] + self.reach[1] + self.reach[2];
        (self.len, self.may_be_wide, self.has_plates, self.are_splats) = (0, false, false, false);
    }

    /// Becomes one of Gaussians in single precision, whatever it was: what is rounded is a small
    /// part of a pixel.
    pub(super) fn become_spread(&mut self) {
        self.are_splats = false;
        self.is_widened = false;
        self.size = (0.0, 0.0);
    }

    /// Makes a run of Gaussians, whose columns, size and reach are known, ready.
    pub(super) fn set_far(&mut self, least_radius: f32, simd: SimdLevel) {
        self.reach_length = self.reach[0] + self.reach[1] + self.reach[2];
        self.least_length = f64::from(least_radius);
        self.has_plates = true;
        let spare = self.wide.take().or_else(|| self.spare_wide.take());
        self.spare_wide = spare;
        self.may_be_wide = false;
        dispatch!(simd.level(), token => self.bound_again(token, least_radius));
    }
}

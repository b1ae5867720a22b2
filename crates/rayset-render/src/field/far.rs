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
use crate::lod::{Absorber, CrossSections, LEAST_PART, SPREAD, Seen, density_part};
use crate::math::linear_from_srgb;
use rayset_base::geometry::{Aabb, DMat3, DVec3};
use rayset_files::octree::aggregates::{Aggregate, AggregatePage};
use rayset_files::octree::format::Header;
use rayset_files::octree::layout::RUN_POINTS;

/// What takes less of the light that meets it is not there.
const LEAST_OPACITY: f64 = 1e-6;

/// The channels of the closure, behind those of the cloud's attributes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FarChannel {
    /// 1/c: sums to the area that is covered.
    Cover,
    /// L/c: sums to that area times the length of what covers it.
    Length,
    /// M/(P·c): sums to the density.
    Density,
    /// The first of three of a colour that follows from densities.
    Color,
}

/// Channels of the closure besides colours.
const OF_CLOSURE: usize = 3;

/// Decodes what stands for the points of one cloud from afar.
#[derive(Clone, Debug)]
pub struct FarDecoder {
    sections: CrossSections,
    columns: AttributeColumns,
    /// Whether colours are those of densities.
    colors_densities: bool,
    /// The value of each byte of a colour.
    color_from_byte: Box<[f32; 256]>,
}

/// By which part each point of a run is seen by itself, and the area that a unit of the mass around
/// it takes of the light.
#[derive(Clone, Debug)]
pub struct PointParts {
    /// For each point.
    pub part: [f32; RUN_POINTS],
    /// For each point.
    pub of_mass: [f64; RUN_POINTS],
}

impl FarDecoder {
    /// For the cross-sections of a cloud's aggregates.
    pub(crate) fn new(sections: CrossSections, colors_densities: bool) -> Self {
        let (columns, color_from_byte) = (AttributeColumns::default(), Box::new([0.0; 256]));
        Self { sections, columns, colors_densities, color_from_byte }
    }

    /// The same, for a field that carries some attributes of the cloud.
    pub(crate) fn carrying(&mut self, columns: &AttributeColumns) {
        let color = |display: f64| {
            if columns.color_as_displayed { display } else { linear_from_srgb(display) }
        };
        self.color_from_byte = Box::new(std::array::from_fn(|i| color(i as f64 / 255.0) as f32));
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
        self.columns.channels() + OF_CLOSURE + colors
    }

    /// The number of a channel.
    pub(crate) fn channel(&self, channel: FarChannel) -> usize {
        self.columns.channels() + channel as usize
    }

    /// Whether colours follow from densities.
    pub(crate) fn colors_densities(&self) -> bool {
        self.colors_densities
    }

    /// The area that a unit of an aggregate's mass takes of the light.
    pub(crate) fn of_mass(&self, aggregate: &Aggregate) -> f64 {
        let absorber = Absorber::of(aggregate, &self.sections);
        absorber.cross_section / absorber.mass
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
        records.clone().filter_map(|index| page.place(index)).for_each(|cell| bounds.include(cell.centroid));
        out.center = bounds.center();
        let mut writer = FarWriter::begin(self, out);
        for (index, &part) in records.zip(parts) {
            let Some(aggregate) = page.get(index, level).filter(|_| f64::from(part) > LEAST_PART) else {
                continue;
            };
            let absorber = Absorber::of(&aggregate, &self.sections);
            let seen = absorber.seen(sight.eye.toward(absorber.center), sight.pixel_at(absorber.center));
            let Some(at) = writer.add(&seen, part) else { continue };
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

    /// Makes of a run's points, as they are decoded for a field of densities, what is seen of them
    /// as Gaussians.
    pub(crate) fn spread_points(
        &self,
        parts: &PointParts,
        (sight, simd): (&Sight, SimdLevel),
        run: &mut DecodedRun,
    ) {
        let (integral, variance) = self.sections.kernel;
        let (len, are_balls) = (run.len, run.points.map.is_empty());
        let mut writer = FarWriter::begin(self, run);
        for i in 0..len {
            let point = writer.out.point(i, are_balls);
            let pixel = sight.pixel_at(point.center);
            let part = f64::from(parts.part[i]) * (1.0 - density_part(point.lengths.x, pixel));
            if part <= LEAST_PART {
                continue;
            }
            let mass = integral * point.weight * point.lengths.element_product();
            let absorber = Absorber {
                center: point.center,
                axes: point.axes,
                variances: point.lengths * point.lengths * variance,
                mass,
                cross_section: parts.of_mass[i] * mass,
            };
            let seen = absorber.seen(sight.eye.toward(point.center), pixel);
            let Some(at) = writer.add(&seen, part as f32) else { continue };
            for column in
                writer.out.attribute[..self.columns.channels()].iter_mut().chain(&mut writer.out.label)
            {
                column[at] = column[i];
            }
            self.density_color(at, writer.out, || self.sections.color_at(point.weight));
        }
        writer.finish(simd);
    }
}

/// A point, in the cloud's space.
struct Point {
    center: DVec3,
    axes: DMat3,
    /// Of the semi-axes.
    lengths: DVec3,
    weight: f64,
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
        out.are_splats = false;
        out.is_widened = false;
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

    /// Finishes the run. Single precision suffices: what is rounded is a small part of a pixel.
    fn finish(self, simd: SimdLevel) {
        let Self { out, len, reach, least_radius, .. } = self;
        out.len = len;
        out.reach = reach.to_array().map(|v| (v * 1.00001) as f32);
        out.size = (0.0, 0.0);
        out.set_far((least_radius * 0.9999) as f32, simd);
    }
}

impl DecodedRun {
    /// The radii of its points.
    pub(crate) fn radii(&self) -> &[f32; RUN_POINTS] {
        &self.points.radius
    }

    /// A point of a run that has been decoded for a field of densities.
    fn point(&self, i: usize, is_ball: bool) -> Point {
        let points = &self.points;
        let offset = match &self.wide {
            Some(wide) => DVec3::from_array(wide.position.each_ref().map(|column| column[i])),
            None => DVec3::from_array(points.position.each_ref().map(|column| f64::from(column[i]))),
        };
        let (center, weight) = (self.center + offset, f64::from(points.weight[i]));
        if is_ball {
            let lengths = DVec3::splat(f64::from(points.radius[i]));
            return Point { center, axes: DMat3::IDENTITY, lengths, weight };
        }
        let row = |row: usize| DVec3::from_array([0, 1, 2].map(|j| f64::from(points.map[3 * row + j][i])));
        let rows = [row(0), row(1), row(2)];
        let lengths = DVec3::from_array(rows.map(|row| 1.0 / row.length()));
        let axes = DMat3::from_cols(rows[0] * lengths.x, rows[1] * lengths.y, rows[2] * lengths.z);
        Point { center, axes, lengths, weight }
    }

    /// Leaves of a run's points, as they are decoded for a field of densities, what is a density of
    /// them.
    pub(crate) fn fade_points(&mut self, parts: &PointParts, sight: &Sight, simd: SimdLevel) {
        let mut len = 0;
        let mut least_radius = f32::INFINITY;
        for i in 0..self.len {
            let point = self.point(i, self.points.map.is_empty());
            let radius = self.points.radius[i];
            let as_density = density_part(f64::from(radius), sight.pixel_at(point.center));
            let part = f64::from(parts.part[i]) * as_density;
            if part <= LEAST_PART {
                continue;
            }
            let points = &mut self.points;
            points.position.iter_mut().for_each(|column| column[len] = column[i]);
            points.map.iter_mut().for_each(|column| column[len] = column[i]);
            points.radius[len] = radius;
            points.inverse_radius[len] = points.inverse_radius[i];
            points.weight[len] = (f64::from(points.weight[i]) * part) as f32;
            self.attribute.iter_mut().chain(&mut self.label).for_each(|column| column[len] = column[i]);
            if let Some(wide) = &mut self.wide {
                wide.position.iter_mut().for_each(|column| column[len] = column[i]);
                wide.inverse_radius[len] = wide.inverse_radius[i];
                if !wide.map.is_empty() {
                    wide.map[len] = wide.map[i];
                }
            }
            least_radius = least_radius.min(radius);
            len += 1;
        }
        self.len = len;
        dispatch!(simd.level(), token => self.bound_again(token, least_radius * 0.9999));
    }
}

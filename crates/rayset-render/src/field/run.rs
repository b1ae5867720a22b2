//! A run of points, decoded for the inner loop.

use fearless_simd::f32x8;
use fearless_simd::prelude::*;

use super::columns::{
    AttributeColumns, CHUNK_POINTS, CHUNKS, MAP_BYTES, MAP_COLUMNS, PointColumns, chunks_of, fold,
};
use super::gaussian_splat;
use super::harmonics;
use super::plates::Plates;
use super::sight::Sight;
use super::simd::{SimdLevel, dispatch};
use super::splat_filter::SplatFilter;
use crate::math::linear_from_srgb;
use rayset_base::geometry::DVec3;
use rayset_base::kernel::Kernel;
use rayset_files::octree::format::Header;
use rayset_files::octree::layout::{RUN_POINTS, RootCell};
use rayset_files::octree::page::Run;

/// Largest ratio of a run's extent to its smallest radius for single precision. Beyond it,
/// coordinates relative to the run's centre would have errors of more than a few 1e-5 of a radius,
/// and the run is evaluated in double precision.
const WIDEST_IN_F32: f64 = 128.0;
/// Most samples across a run that can be counted exactly in single precision.
const MOST_STEPS_IN_F32: f64 = (1 << 22) as f64;

/// Details may be so much finer than the radius that is too small for single precision: errors are
/// then a few 1e-4 of the shortest semi-axis.
const FINEST_IN_F32: f64 = 4.0;

/// Most columns of attributes of a run that is kept.
const MOST_COLUMNS: usize = 8;
/// Bytes of a run with so many columns and with shapes, in single precision.
pub(super) const DECODED_BYTES: usize =
    size_of::<DecodedRun>() + MOST_COLUMNS * RUN_POINTS * size_of::<f32>() + MAP_BYTES;

/// Up to 128 points stored by columns, relative to the centre of their bounds.
#[derive(Clone, Debug)]
pub struct DecodedRun {
    pub(super) len: usize,
    /// Centre of the bounds of the positions, in the cloud's space.
    pub(super) center: DVec3,
    /// Half the edge lengths of the bounds of influence about the centre, rounded up.
    pub(super) reach: [f32; 3],
    /// No less than the length of the vector of these.
    pub(super) reach_length: f32,
    /// Whether it may need double precision, as far as its place tells, or its points once they
    /// are decoded: what is said of it in single precision need not hold then.
    pub(super) may_be_wide: bool,
    /// Whether the points are splats, whose weights are their [extents](gaussian_splat::extent).
    pub(super) are_splats: bool,
    /// Whether a filter has widened these.
    pub(super) is_widened: bool,
    /// The longest edge of the bounds of the positions, and the largest radius.
    pub(super) size: (f64, f64),
    /// By which it is found out whether it needs double precision: see
    /// [`RunDecoder::least_length`].
    pub(super) least_length: f64,
    /// No more than the radius of any point.
    pub(super) radius_min: f32,
    pub(super) points: PointColumns,
    /// Spheres of influence of chunks of points, by which a chunk is culled as a whole.
    pub(super) chunk_center: [[f32; CHUNKS]; 3],
    /// Negative for chunks that the run does not have.
    pub(super) chunk_reach_squared: [f32; CHUNKS],
    /// Of ellipsoids, where rays are near them.
    pub(super) plates: Plates,
    /// Whether that is known: of decoded points in single precision.
    pub(super) has_plates: bool,
    /// One column for each channel of [`AttributeColumns`].
    pub(super) attribute: Vec<[f32; RUN_POINTS]>,
    /// One column for each attribute of class labels.
    pub(super) label: Vec<[f32; RUN_POINTS]>,
    /// Positions and inverse radii in double precision, for runs that are too wide for single
    /// precision.
    pub(super) wide: Option<Box<WideRun>>,
    pub(super) spare_wide: Option<Box<WideRun>>,
}

#[derive(Clone, Debug)]
pub(super) struct WideRun {
    pub(super) position: [[f64; RUN_POINTS]; 3],
    pub(super) inverse_radius: [f64; RUN_POINTS],
    /// Of ellipsoids the rows of the map of each to the unit ball; none for balls.
    pub(super) map: Vec<[f64; MAP_COLUMNS]>,
}

/// Decodes the runs of one cloud.
#[derive(Clone, Debug)]
pub struct RunDecoder {
    pub(super) root: RootCell,
    radius: Option<f32>,
    pub(super) are_splats: bool,
    filter: SplatFilter,
    /// Normalised, if kernels are and all radii are the same.
    pub(super) weight: Option<f32>,
    /// 1/∫ω dV over the unit ball, if each weight has to be normalised for itself.
    pub(super) normalisation: Option<f64>,
    pub(super) columns: AttributeColumns,
    /// The value of each byte of a colour.
    pub(super) color_from_byte: Box<[f32; 256]>,
}

impl RunDecoder {
    /// A decoder for the runs of a cloud.
    #[must_use]
    pub fn new(header: &Header, kernel: Kernel, normalised: bool, columns: AttributeColumns) -> Self {
        let radius = (!header.radius.is_stored()).then(|| header.radius.min());
        let mut weight = (!header.weight.is_stored()).then(|| header.weight.min());
        let mut normalisation = normalised.then(|| 1.0 / kernel.integral());
        if let (Some(radius), Some(weight)) = (radius, &mut weight)
            && header.shape.is_none()
            && let Some(factor) = normalisation.take()
        {
            *weight = normalised_weight(*weight, factor, 1.0 / radius, 1.0);
        }
        let are_splats = kernel == Kernel::Splat;
        if are_splats {
            (weight, normalisation) = (weight.map(gaussian_splat::extent), None);
        }
        let color =
            |display: f64| if columns.color_as_displayed { display } else { linear_from_srgb(display) };
        Self {
            root: header.root_cell(),
            radius,
            are_splats,
            filter: SplatFilter::None,
            weight,
            normalisation,
            color_from_byte: Box::new(std::array::from_fn(|i| color(i as f64 / 255.0) as f32)),
            columns,
        }
    }

    /// The same, where splats are filtered for those who see them.
    #[must_use]
    pub fn filtered(self, filter: SplatFilter) -> Self {
        Self { filter, ..self }
    }

    /// The length of which a run's coordinates must be known to a small part: its least radius, or
    /// less where points are very thin. Of splats, errors of a thousandth of a deviation are not
    /// seen.
    fn least_length(&self, radius: f64, detail: f64) -> f64 {
        let (radius, finest) =
            if self.are_splats { (8.0 * radius, 4.0 * FINEST_IN_F32) } else { (radius, FINEST_IN_F32) };
        radius.min(finest * detail)
    }

    /// Bytes that it takes besides itself.
    pub(crate) fn bytes(&self) -> usize {
        size_of_val(&*self.color_from_byte) + self.columns.bytes()
    }

    /// Decodes where a run is, for samples that are at least `step` apart, in the cloud's space, as
    /// is the sight of who sees it.
    pub fn place(
        &self,
        run: &Run<'_>,
        header: &Header,
        (step, sight): (f64, Option<&Sight>),
        out: &mut DecodedRun,
    ) {
        let bounds = run.head.position_bounds(self.root);
        out.center = bounds.center();
        let wider = sight.map_or(0.0, |sight| self.filter.reach_in(&bounds, sight));
        let radius_max = f64::from(run.head.radius_max()) + wider;
        let half = bounds.size() * 0.5 + radius_max;
        out.reach = half.to_array().map(|v| (v * 1.00001) as f32);
        out.reach_length = out.reach[0] + out.reach[1] + out.reach[2];
        out.size = (bounds.size().max_element(), radius_max);
        let least = self.least_length(f64::from(header.radius.min()), f64::from(header.details().0));
        out.may_be_wide = is_wide(out.size, least, step);
        out.has_plates = false;
        out.are_splats = self.are_splats;
    }

    /// Decodes the points of a run whose place is known, for samples that are at least `step`
    /// apart, in the cloud's space, as is the sight of who sees them. Those in one place may become
    /// one.
    pub fn decode(
        &self,
        run: &Run<'_>,
        header: &Header,
        asked: (f64, Option<&Sight>),
        simd: SimdLevel,
        out: &mut DecodedRun,
    ) {
        self.decode_run(run, header, (asked, true), simd, out);
    }

    /// The same, and every point stays what it is.
    pub(crate) fn decode_each(
        &self,
        run: &Run<'_>,
        header: &Header,
        asked: (f64, Option<&Sight>),
        simd: SimdLevel,
        out: &mut DecodedRun,
    ) {
        self.place(run, header, asked, out);
        self.decode_run(run, header, (asked, false), simd, out);
    }

    fn decode_run(
        &self,
        run: &Run<'_>,
        header: &Header,
        asked: ((f64, Option<&Sight>), bool),
        simd: SimdLevel,
        out: &mut DecodedRun,
    ) {
        dispatch!(simd.level(), token => self.decode_with(token, simd, run, header, asked, out));
        let (_, sight) = asked.0;
        if self.columns.color && header.harmonics > 0 {
            let places = (out.center, &out.points.position);
            let as_displayed = self.columns.color_as_displayed;
            let eye = sight.map(|sight| sight.eye);
            harmonics::fill_colors((run, header), eye, places, as_displayed, &mut out.attribute);
        }
    }

    #[inline(always)]
    fn decode_with<S: Simd>(
        &self,
        simd: S,
        level: SimdLevel,
        run: &Run<'_>,
        header: &Header,
        ((step, sight), may_merge): ((f64, Option<&Sight>), bool),
        out: &mut DecodedRun,
    ) {
        let n = run.head.len();
        out.len = n;
        run.decode_local(self.root, &mut out.points.position);
        let mut radius_min = f64::INFINITY;
        if let Some(r) = self.radius {
            radius_min = f64::from(r);
            out.points.radius[..n].fill(r);
            out.points.inverse_radius[..n].fill(1.0 / r);
        } else if let Some(radii) = run.radii(header) {
            let (stored, inverse) = (&mut out.points.radius[..n], &mut out.points.inverse_radius[..n]);
            stored.iter_mut().zip(radii).for_each(|(o, r)| *o = r);
            inverse.iter_mut().zip(&*stored).for_each(|(o, r)| *o = 1.0 / r);
            // Numbers above zero are in the order of their bits, whose least is found several at a
            // time.
            let least = stored.iter().fold(u32::MAX, |least, r| least.min(r.to_bits()));
            radius_min = f64::from(f32::from_bits(least));
        }
        self.decode_weights(run, header, out);
        out.points.map.clear();
        let mut detail = f64::INFINITY;
        if header.shape.is_some() {
            detail = self.decode_shapes(run, header, level, out);
        }
        let sight = sight.filter(|_| self.are_splats && self.filter != SplatFilter::None);
        out.is_widened = sight.is_some();
        if let Some(sight) = sight {
            detail = out.widen(self.filter, sight, level);
            radius_min = f64::from(out.points.radius[..n].iter().copied().fold(f32::INFINITY, f32::min));
        }
        out.least_length = self.least_length(radius_min, detail);
        out.pad_last_chunk();
        let one_place = out.bound_chunks(simd);
        self.decode_attributes(run, header, out);
        out.radius_min = radius_min as f32 * 0.9999;
        let is_wide = is_wide(out.size, out.least_length, step);
        out.set_wide(is_wide.then_some((run, header)));
        out.may_be_wide = is_wide;
        // Points in one place follow each other: fifteen of them fill a chunk. Fewer cost little.
        let whole = (1 << (n / CHUNK_POINTS)) - 1;
        if may_merge && one_place & whole != 0 && !is_wide && !self.are_splats && out.label.is_empty() {
            out.merge_places();
            out.pad_last_chunk();
            out.bound_chunks(simd);
        }
        out.has_plates = header.shape.is_some() && !is_wide;
        if out.has_plates {
            out.set_plates(simd);
        }
    }
}

/// A weight divided by the integral of its kernel, over an ellipsoid whose volume is a part of that
/// of its ball, clamped so that it fits an `f32`: larger weights make no difference to a picture.
#[inline(always)]
pub(super) fn normalised_weight(weight: f32, factor: f64, inverse_radius: f32, volume: f32) -> f32 {
    let of_ball = f64::from(weight) * factor * f64::from(inverse_radius).powi(3);
    (of_ball / f64::from(volume)).clamp(-1e30, 1e30) as f32
}

/// Whether points within bounds of a longest edge need double precision, with their largest and
/// least radius, and the least distance between samples.
pub(super) fn is_wide((extent, radius_max): (f64, f64), radius_min: f64, step: f64) -> bool {
    extent > WIDEST_IN_F32 * radius_min || extent + 2.0 * radius_max > MOST_STEPS_IN_F32 * step
}

impl Default for DecodedRun {
    fn default() -> Self {
        Self {
            len: 0,
            center: DVec3::ZERO,
            reach: [0.0; 3],
            reach_length: 0.0,
            may_be_wide: false,
            are_splats: false,
            is_widened: false,
            size: (0.0, 0.0),
            least_length: 0.0,
            radius_min: 0.0,
            points: PointColumns::default(),
            chunk_center: [[0.0; CHUNKS]; 3],
            chunk_reach_squared: [-1.0; CHUNKS],
            plates: Plates::default(),
            has_plates: false,
            attribute: Vec::new(),
            label: Vec::new(),
            wide: None,
            spare_wide: None,
        }
    }
}

impl DecodedRun {
    /// How many times [`DECODED_BYTES`] it takes at most; `None` if it has more than twice the
    /// columns.
    pub(super) fn memory(&self) -> Option<usize> {
        const WIDE_BYTES: usize = size_of::<WideRun>() + RUN_POINTS * size_of::<[f64; MAP_COLUMNS]>();
        let has_wide = self.wide.is_some();
        let columns = self.attribute.capacity() + self.label.capacity();
        let wide = if has_wide { WIDE_BYTES.div_ceil(DECODED_BYTES) } else { 0 };
        (columns <= 2 * MOST_COLUMNS).then_some(1 + wide + usize::from(columns > MOST_COLUMNS))
    }

    /// Whether its points are no balls, whose decoding takes long.
    pub(super) fn has_shapes(&self) -> bool {
        !self.points.map.is_empty()
    }

    /// Whether it is decoded as for samples that are at least `step` apart.
    pub(super) fn is_for(&self, step: f64) -> bool {
        self.wide.is_some() == is_wide(self.size, self.least_length, step)
    }

    /// Gives back the memory that waits for runs in double precision.
    pub(super) fn forget_spare(&mut self) {
        self.spare_wide = None;
    }

    /// Fills up the last chunk with copies of its first point, which do not enlarge its bounds and
    /// reach no sample.
    #[inline(always)]
    fn pad_last_chunk(&mut self) {
        let (n, padded) = (self.len, self.len.next_multiple_of(CHUNK_POINTS));
        for column in
            self.points.position.iter_mut().chain([&mut self.points.radius, &mut self.points.inverse_radius])
        {
            let first = column[padded - CHUNK_POINTS];
            column[n..padded].fill(first);
        }
        for (squared, inverse) in
            self.points.inverse_radius_squared[..n].iter_mut().zip(&self.points.inverse_radius)
        {
            *squared = inverse * inverse;
        }
        self.points.inverse_radius_squared[n..padded].fill(f32::INFINITY);
        self.points.map.iter_mut().for_each(|column| column[n..padded].fill(f32::INFINITY));
    }

    /// Finds the bounds of points that were left of a run.
    #[inline(always)]
    pub(super) fn bound_again<S: Simd>(&mut self, simd: S, least_radius: f32) {
        self.radius_min = least_radius;
        if self.len == 0 {
            return;
        }
        self.pad_last_chunk();
        self.bound_chunks(simd);
        if self.has_plates {
            self.set_plates(simd);
        }
    }

    fn set_plates<S: Simd>(&mut self, simd: S) {
        simd.vectorize(
            #[inline(always)]
            || self.plates.set(simd, &self.points, self.len, self.reach_length),
        );
    }

    /// Returns a bit for each chunk whose points are in one place.
    #[inline(always)]
    fn bound_chunks<S: Simd>(&mut self, simd: S) -> u64 {
        let mut one_place = 0;
        let chunks = self.len.div_ceil(CHUNK_POINTS);
        for group in 0..chunks.div_ceil(8) {
            let of_group = 8 * group..8 * group + 8;
            for axis in 0..3 {
                let points = chunks_of(simd, &self.points.position[axis], group);
                let center = (fold::<S, false>(points) + fold::<S, true>(points)) * 0.5;
                center.store_slice(&mut self.chunk_center[axis][of_group.clone()]);
            }
            let mut distance_squared = [f32x8::splat(simd, 0.0); 8];
            for axis in 0..3 {
                let points = chunks_of(simd, &self.points.position[axis], group);
                for (chunk, sum) in distance_squared.iter_mut().enumerate() {
                    let offset = points[chunk] - self.chunk_center[axis][8 * group + chunk];
                    *sum = offset.mul_add(offset, *sum);
                }
            }
            let radius = fold::<S, true>(chunks_of(simd, &self.points.radius, group));
            let farthest = fold::<S, true>(distance_squared);
            one_place |= farthest.simd_eq(0.0).to_bitmask() << (8 * group);
            let reach = farthest.sqrt() + radius;
            (reach * reach * 1.0001).store_slice(&mut self.chunk_reach_squared[of_group]);
        }
        self.chunk_reach_squared[chunks..].fill(-1.0);
        one_place
    }

    pub(super) fn set_wide(&mut self, source: Option<(&Run<'_>, &Header)>) {
        let spare = self.wide.take().or_else(|| self.spare_wide.take());
        let Some((run, header)) = source else {
            self.spare_wide = spare;
            return;
        };
        let mut wide = spare.unwrap_or_else(|| {
            let (position, inverse_radius) = ([[0.0; RUN_POINTS]; 3], [0.0; RUN_POINTS]);
            Box::new(WideRun { position, inverse_radius, map: Vec::new() })
        });
        run.decode_local_f64(header.root_cell(), &mut wide.position);
        for (o, i) in wide.inverse_radius.iter_mut().zip(&self.points.inverse_radius) {
            *o = f64::from(*i);
        }
        if self.is_widened {
            wide.take_maps(&self.points.map, self.len);
        } else {
            wide.decode_maps(run, header, &self.points.radius);
        }
        self.wide = Some(wide);
    }
}

//! From a cloud's field to a volume: which attributes of its points the field carries, and how
//! density, attributes and gradient are shaded.

use std::sync::Arc;

use super::least_absorption::least_absorption;
use super::measures::{opacity_of_optical_depth, optical_depth_of_extinction, optical_depth_of_opacity};
use crate::field::{
    AttributeColumns, Channels, FieldSamples, Kernel, LANES, LeastAbsorption, RunDecoder, SLAB_SAMPLES,
    SampleRow, SimdLevel, SplatFilter, dispatch,
};
use crate::scene::{CloudObject, ColorRule, Compositing, MAX_OPACITY, MapInput, OpacityRule, Scene};
use crate::trace::display_values::all_to_linear;
use crate::trace::knots::Curve;
use crate::trace::node_samples::{
    LUMP_OPACITY, MATERIAL, MAX_OPTICAL_DEPTH, Measure, NodeSamples, RequiredOutputs, ZERO, above, each_lane,
    first_samples, normalize, numbers, samples_within,
};
use crate::trace::transfer::ColorTable;
use rayset_base::bytes::list_bytes;
use rayset_base::geometry::{DAffine3, DMat3};
use rayset_files::octree::format::Header;

/// Attributes are 0 where the density is not above this fraction of the largest density of a single
/// point.
const LEAST_WEIGHT: f32 = 1e-12;

pub(super) enum Color {
    Uniform([f32; 3]),
    Points,
    /// By density, or by the attribute with this number.
    Map {
        table: ColorTable,
        attribute: Option<usize>,
        /// Where the field carries it, once [`CloudShading::carry`] has been called.
        carried: Option<Carried>,
    },
}

/// Where a field carries an attribute.
#[derive(Clone, Copy)]
pub(super) enum Carried {
    /// Averaged, in this channel.
    Mean(usize),
    /// As class labels, the one of this number.
    Label(usize),
    /// Nowhere: it is of what is seen from afar.
    LumpOpacity,
}

/// How a cloud is shaded.
pub(in crate::trace) struct CloudShading {
    pub(in crate::trace) kernel: Kernel,
    pub(in crate::trace) normalised: bool,
    pub(in crate::trace) opacity: OpacityRule,
    /// The curve of the opacity, if it is one.
    curve: Option<Curve>,
    /// How much samples absorb at least, per unit distance, if that is anything.
    pub(super) least_absorption: Option<LeastAbsorption>,
    pub(in crate::trace) unit_distance: f64,
    pub(in crate::trace) material: [f32; MATERIAL],
    filter: SplatFilter,
    pub(in crate::trace) decoder: RunDecoder,
    /// What the cloud's field carries. The colour, or the attribute it is mapped from, comes first.
    columns: AttributeColumns,
    compositing: Compositing,
    /// For each attribute of the program, its channel; `None` if the cloud does not have it.
    named: Vec<Option<Carried>>,
    pub(super) color: Color,
    /// The density that defines the boundary.
    boundary_density: f32,
    least_weight: f32,
    /// Maps gradients in the cloud's space to vectors in world space that point to lower density;
    /// by columns.
    pub(super) normal_map: [[f32; 3]; 3],
}

impl CloudShading {
    /// A number that no other shading has at the same time.
    pub(super) fn number(&self) -> usize {
        std::ptr::from_ref(self) as usize
    }

    /// Bytes that it takes besides itself.
    pub(super) fn bytes(&self) -> usize {
        let color = if let Color::Map { table, .. } = &self.color { table.bytes() } else { 0 };
        let columns = self.columns.bytes() + list_bytes(&self.named);
        let curve = self.curve.as_ref().map_or(0, Curve::bytes);
        self.opacity.bytes() + curve + color + self.decoder.bytes() + columns
    }

    /// Shading for an object at a position in the world. Until [`carry`](Self::carry) is called,
    /// the field carries densities only.
    pub(in crate::trace) fn new(
        object: &CloudObject,
        local_from_world: Option<&DAffine3>,
        scene: &Scene,
        material: [f32; MATERIAL],
    ) -> Self {
        let unit_distance = scene.unit_distance;
        let header = object.cloud.header();
        let color = match &object.transfer.color {
            ColorRule::Uniform(color) => Color::Uniform(*color),
            ColorRule::Points => Color::Points,
            ColorRule::Map { map, input } => {
                let attribute = if let MapInput::Attribute(index) = input { Some(*index) } else { None };
                Color::Map { table: ColorTable::new(map), attribute, carried: None }
            }
        };
        // Gradients are transformed by the transpose of the inverse.
        let map = local_from_world.map_or(DMat3::IDENTITY, |map| map.matrix3.transpose());
        Self {
            kernel: object.kernel,
            normalised: object.normalised,
            opacity: object.transfer.opacity.clone(),
            curve: match &object.transfer.opacity {
                OpacityRule::Curve(points) => Some(Curve::new(points)),
                OpacityRule::Clamp | OpacityRule::Extinction(_) => None,
            },
            least_absorption: least_absorption(&object.transfer.opacity, unit_distance),
            unit_distance,
            material,
            filter: object.splat_filter,
            decoder: RunDecoder::new(header, object.kernel, object.normalised, AttributeColumns::default())
                .filtered(object.splat_filter),
            columns: AttributeColumns::default(),
            compositing: scene.compositing,
            named: Vec::new(),
            color,
            boundary_density: object.transfer.opacity.boundary_density(unit_distance) as f32,
            least_weight: object.largest_point_density() as f32 * LEAST_WEIGHT,
            normal_map: (-map).to_cols_array_2d().map(|column| column.map(|v| v as f32)),
        }
    }

    /// The colour of the whole cloud, if it is uniform.
    pub(in crate::trace) fn uniform_color(&self) -> Option<[f32; 3]> {
        if let Color::Uniform(color) = self.color { Some(color) } else { None }
    }

    /// Sets the required outputs and the names of the program's attributes. Before this, only
    /// densities are carried.
    pub(super) fn carry(
        &mut self,
        header: &Header,
        required: RequiredOutputs,
        names: &[Arc<str>],
    ) -> &AttributeColumns {
        let mut columns = AttributeColumns::default();
        if required.color {
            columns.color = matches!(self.color, Color::Points);
            columns.color_as_displayed = columns.color && self.compositing == Compositing::Display;
            if let Color::Map { attribute: Some(attribute), carried, .. } = &mut self.color {
                *carried = Some(Carried::new(header, *attribute, &mut columns));
            }
        }
        self.named = vec![None; names.len()];
        for number in numbers(required.attributes) {
            let attribute = header.attribute_number(&names[number]);
            let carried = attribute.map(|attribute| Carried::new(header, attribute, &mut columns));
            self.named[number] =
                if &*names[number] == LUMP_OPACITY { Some(Carried::LumpOpacity) } else { carried };
        }
        self.decoder =
            RunDecoder::new(header, self.kernel, self.normalised, columns.clone()).filtered(self.filter);
        self.columns = columns;
        &self.columns
    }

    /// The channels that the field must carry for the required outputs.
    pub(in crate::trace) fn channels(&self, required: RequiredOutputs) -> Channels {
        Channels {
            gradient: required.normal || required.boundary,
            attributes: self.columns.channels(),
            labels: self.columns.labels.len(),
        }
    }

    /// Converts the field to opacity, colour and shading vector. Of samples behind the optical
    /// depth in `ends` at which their ray ends, what follows from the opacity may be left out.
    pub(in crate::trace) fn transfer(
        &self,
        field: &FieldSamples,
        (measure, required, simd): (Measure, RequiredOutputs, SimdLevel),
        ends: Option<&[f32; LANES]>,
        out: &mut NodeSamples,
    ) {
        out.touched = field.touched;
        self.fill_opacity(field, measure, simd, out);
        if required == RequiredOutputs::default() {
            return;
        }
        each_lane(field.touched, |lane| {
            self.fill_lane(field, (lane, ends.map(|ends| ends[lane])), (required, simd), out);
        });
    }

    /// Fills what a lane has besides opacity, as [`transfer`](Self::transfer) does.
    pub(super) fn fill_lane(
        &self,
        field: &FieldSamples,
        (lane, end): (usize, Option<f32>),
        (required, simd): (RequiredOutputs, SimdLevel),
        out: &mut NodeSamples,
    ) {
        if required.color {
            self.fill_color(field, lane, end, simd, out);
        }
        for number in numbers(required.attributes) {
            self.fill_attribute(field, lane, number, out);
        }
        if required.normal || required.boundary {
            let level = SampleRow([self.boundary_density; SLAB_SAMPLES]);
            let of = (&field.gradient, &field.density[lane]);
            self.fill_vectors(of, &level, (lane, required, simd), out);
        }
        if required.material {
            for (rows, &v) in out.material.iter_mut().zip(&self.material) {
                rows[lane].0.fill(v);
            }
        }
    }

    /// Where the field carries an attribute of the program, if the cloud has it.
    pub(super) fn carried(&self, number: usize) -> Option<Carried> {
        self.named.get(number).copied().flatten()
    }

    /// Whether the field carries colours as displays have them.
    pub(super) fn are_colors_displayed(&self) -> bool {
        self.columns.color_as_displayed
    }

    pub(super) fn fill_opacity(
        &self,
        field: &FieldSamples,
        measure: Measure,
        simd: SimdLevel,
        out: &mut NodeSamples,
    ) {
        let (lanes, density, rows) = (field.touched, &field.density, &mut out.opacity);
        match (&self.opacity, measure) {
            (OpacityRule::Extinction(kappa), _) => {
                let per_density = (kappa * self.unit_distance) as f32;
                // Splats absorb in an interval what they absorb, however short it is.
                let most = if self.kernel == Kernel::Splat { f32::MAX } else { MAX_OPTICAL_DEPTH };
                dispatch!(simd.level(), _simd => {
                    optical_depth_of_extinction(lanes, density, (per_density, most), rows);
                    if measure == Measure::Opacity {
                        opacity_of_optical_depth(lanes, rows);
                    }
                });
            }
            (OpacityRule::Clamp, Measure::Opacity) => each_lane(lanes, |lane| {
                let held = |d: f32| if d > 0.0 { d.min(MAX_OPACITY as f32) } else { 0.0 };
                rows[lane] = SampleRow(density[lane].0.map(held));
            }),
            (OpacityRule::Clamp, Measure::OpticalDepth) => {
                each_lane(lanes, |lane| rows[lane] = density[lane]);
                dispatch!(simd.level(), _simd => optical_depth_of_opacity(lanes, rows));
            }
            (OpacityRule::Curve(_), _) => {
                let Some(curve) = &self.curve else { return };
                let zero_until = curve.zero_until().max(0.0);
                each_lane(lanes, |lane| {
                    let (density, row) = (&density[lane], &mut rows[lane]);
                    *row = ZERO;
                    for j in numbers(above(density, zero_until)) {
                        row.0[j] = curve.at(density.0[j]).min(MAX_OPACITY) as f32;
                    }
                });
                if measure == Measure::OpticalDepth {
                    dispatch!(simd.level(), _simd => optical_depth_of_opacity(lanes, rows));
                }
            }
        }
    }

    /// Fills the colours of a lane. Those that are mapped are left out behind the optical depth
    /// `end`.
    pub(super) fn fill_color(
        &self,
        field: &FieldSamples,
        lane: usize,
        end: Option<f32>,
        simd: SimdLevel,
        out: &mut NodeSamples,
    ) {
        let density = &field.density[lane].0;
        match &self.color {
            Color::Uniform(color) => {
                for (rows, &v) in out.color.iter_mut().zip(color) {
                    rows[lane].0.fill(v);
                }
            }
            Color::Points => {
                for (channel, rows) in out.color.iter_mut().enumerate() {
                    rows[lane] = self.mean(field, lane, channel);
                    if self.columns.color_as_displayed {
                        dispatch!(simd.level(), _simd => all_to_linear(&mut rows[lane].0));
                    }
                }
            }
            Color::Map { table, carried, .. } => {
                let values = carried.map_or(*density, |carried| self.value(field, lane, carried).0);
                let opacity = &out.opacity[lane];
                let seen = end.map_or(SLAB_SAMPLES, |end| samples_within(&opacity.0, end));
                let shown = above(opacity, 0.0) & first_samples(seen);
                let [red, green, blue] = out.color.each_mut().map(|rows| &mut rows[lane].0);
                for j in numbers(shown) {
                    [red[j], green[j], blue[j]] = table.color(values[j]);
                }
            }
        }
    }

    fn fill_attribute(&self, field: &FieldSamples, lane: usize, number: usize, out: &mut NodeSamples) {
        let carried = self.carried(number);
        out.attributes[number][lane] = carried.map_or(ZERO, |carried| self.value(field, lane, carried));
    }

    /// The value of an attribute: its mean, or the label of the point that contributes most.
    fn value(&self, field: &FieldSamples, lane: usize, carried: Carried) -> SampleRow {
        match carried {
            Carried::LumpOpacity => ZERO,
            Carried::Mean(channel) => self.mean(field, lane, channel),
            Carried::Label(number) => {
                let (density, label) = (&field.density[lane].0, &field.label[number][0][lane].0);
                let defined = |j: usize| density[j] > self.least_weight;
                SampleRow(std::array::from_fn(|j| if defined(j) { label[j] } else { 0.0 }))
            }
        }
    }

    /// The mean of an attribute: Σ v·ω·a / Σ v·ω.
    fn mean(&self, field: &FieldSamples, lane: usize, channel: usize) -> SampleRow {
        let (density, sum) = (&field.density[lane].0, &field.attribute[channel][lane].0);
        let defined = |j: usize| density[j] > self.least_weight;
        SampleRow(std::array::from_fn(|j| if defined(j) { sum[j] / density[j] } else { 0.0 }))
    }

    /// Fills shading vectors and distances to the boundary of a lane, of a field with this
    /// gradient: the boundary is where it has a level.
    pub(super) fn fill_vectors(
        &self,
        (gradient, field): (&[Vec<SampleRow>; 3], &SampleRow),
        level: &SampleRow,
        (lane, required, simd): (usize, RequiredOutputs, SimdLevel),
        out: &mut NodeSamples,
    ) {
        // Gradients are transformed by the transpose of the inverse; the shading vector points to
        // lower density.
        let [mut x, mut y, mut z] = gradient.each_ref().map(|rows| rows[lane]);
        let boundary = required.boundary.then_some((field, level));
        let distance =
            dispatch!(simd.level(), _simd => to_world(&self.normal_map, &mut x, &mut y, &mut z, boundary));
        if required.boundary {
            out.boundary[lane] = distance;
        }
        if required.normal {
            for (rows, row) in out.normal.iter_mut().zip([x, y, z]) {
                rows[lane] = row;
            }
        }
    }
}

impl Carried {
    /// Adds the attribute with this number to what the field carries, if it is not there yet.
    fn new(header: &Header, number: usize, columns: &mut AttributeColumns) -> Self {
        let place_in = |list: &mut Vec<usize>| {
            list.iter().position(|&known| known == number).unwrap_or_else(|| {
                list.push(number);
                list.len() - 1
            })
        };
        if header.attributes.get(number).is_some_and(|a| a.is_class) {
            return Self::Label(place_in(&mut columns.labels));
        }
        let first = columns.first_scalar();
        Self::Mean(first + place_in(&mut columns.scalars))
    }
}

/// Transforms gradients to world space and normalises them. Returns the first-order distance to the
/// boundary if densities and the boundary's density are given.
#[inline(always)]
fn to_world(
    m: &[[f32; 3]; 3],
    x: &mut SampleRow,
    y: &mut SampleRow,
    z: &mut SampleRow,
    boundary: Option<(&SampleRow, &SampleRow)>,
) -> SampleRow {
    for j in 0..SLAB_SAMPLES {
        let g = [x.0[j], y.0[j], z.0[j]];
        let row = |axis: usize| m[0][axis] * g[0] + m[1][axis] * g[1] + m[2][axis] * g[2];
        (x.0[j], y.0[j], z.0[j]) = (row(0), row(1), row(2));
    }
    let mut distance = SampleRow([f32::INFINITY; SLAB_SAMPLES]);
    if let Some((density, level)) = boundary {
        for j in 0..SLAB_SAMPLES {
            let slope = (x.0[j] * x.0[j] + y.0[j] * y.0[j] + z.0[j] * z.0[j]).sqrt();
            distance.0[j] = (level.0[j] - density.0[j]) / slope;
        }
    }
    normalize(x, y, z);
    distance
}

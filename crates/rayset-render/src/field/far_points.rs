//! Points of a run that are small in a picture: what is a density of them, and what is seen of them
//! as Gaussians.

use super::clusters::{Clusters, Points};
use super::columns::{MAP_COLUMNS, PointColumns};
use super::far::{FarDecoder, LEAST_OPACITY, OF_CLOSURE};
use super::footprints::{Footprints, dot};
use super::principal_axes::principal_axes;
use super::run::{DecodedRun, is_wide};
use super::sight::Sight;
use super::simd::{SimdLevel, dispatch};
use crate::lod::{ClusterCells, LEAST_PART, MOST_DEPTH, SPREAD, STRETCH, half_density};
use crate::math::{absorbed, ln};
use rayset_base::geometry::DVec3;
use rayset_files::octree::layout::RUN_POINTS;

type Column = [f32; RUN_POINTS];

/// By which part each point of a run is seen by itself, and the area that a unit of the mass around
/// it takes of the light.
#[derive(Clone, Debug)]
pub(crate) struct PointParts {
    pub(crate) part: Column,
    pub(crate) of_mass: [f64; RUN_POINTS],
    /// The colour around it, if colours follow from densities; linear light.
    pub(crate) color: [[f32; 3]; RUN_POINTS],
}

/// Scratch memory in which points become Gaussians.
#[derive(Debug, Default)]
pub(crate) struct FarScratch {
    pub(crate) parts: PointParts,
    points: Points,
    clusters: Clusters,
    spread: Spread,
}

impl Default for PointParts {
    fn default() -> Self {
        Self { part: [0.0; RUN_POINTS], of_mass: [0.0; RUN_POINTS], color: [[0.0; 3]; RUN_POINTS] }
    }
}

/// The parts by which points are densities, by their pixels' squares.
#[inline(always)]
fn density_parts(points: &PointColumns, pixel_squared: &Column) -> Column {
    let half = half_density(!points.map.is_empty());
    let (radius, per_half) = (&points.radius, (1.0 / (half * half)) as f32);
    let mut density = [0.0; RUN_POINTS];
    for i in 0..RUN_POINTS {
        let ratio = radius[i] * radius[i] * per_half / pixel_squared[i].max(f32::MIN_POSITIVE);
        let octaves = ln(ratio.clamp(0.5, 8.0)) * (0.5 * std::f32::consts::LOG2_E);
        let x = (2.0 * octaves + 0.5).clamp(0.0, 1.0);
        density[i] = x * x * (3.0 - 2.0 * x);
    }
    density
}

/// What the closure needs of Gaussians, besides their places.
#[derive(Debug)]
struct Spread {
    /// Σ of these is what it is of the area that takes light, for a unit of volume.
    weight: Column,
    radius: Column,
    map: [Column; MAP_COLUMNS],
    per_opacity: Column,
    length: Column,
    density: Column,
    depth: Column,
    normal: [Column; 3],
    reach: [f32; 3],
    least_radius: f32,
}

impl DecodedRun {
    /// The radii of its points.
    pub(crate) fn radii(&self) -> &Column {
        &self.points.radius
    }

    /// Leaves of a run's points, as they are decoded for a field of densities and samples that are
    /// at least `step` apart, what is a density of them.
    pub(crate) fn fade_points(&mut self, parts: &PointParts, sight: &Sight, (step, simd): (f64, SimdLevel)) {
        let mut stay = [0; 2];
        dispatch!(simd.level(), _simd => {
            let pixels = Footprints::new(sight, sight.pixel, self).squared;
            let density = density_parts(&self.points, &pixels);
            stay = fade(&mut self.points.weight, &parts.part, &density, self.len);
        });
        self.leave(stay);
        let radius = &self.points.radius[..self.len];
        let least = radius.iter().copied().fold(f32::INFINITY, f32::min);
        if !self.has_shapes() {
            self.narrow(f64::from(least), step);
        }
        dispatch!(simd.level(), token => self.bound_again(token, least * 0.9999));
    }

    /// Goes back to single precision if that is enough for the points that were left, balls of a
    /// least radius.
    fn narrow(&mut self, least_radius: f64, step: f64) {
        self.least_length = least_radius;
        if self.wide.is_some() && !is_wide(self.size, least_radius, step) {
            self.set_wide(None);
            self.may_be_wide = false;
        }
    }

    /// Leaves the points whose bits are set.
    fn leave(&mut self, stay: [u64; 2]) {
        let mut len = 0;
        for i in 0..self.len {
            if stay[i / 64] >> (i % 64) & 1 == 0 {
                continue;
            }
            if len < i {
                self.points.move_point(i, len);
                self.attribute.iter_mut().chain(&mut self.label).for_each(|column| column[len] = column[i]);
                if let Some(wide) = &mut self.wide {
                    wide.position.iter_mut().for_each(|column| column[len] = column[i]);
                    wide.inverse_radius[len] = wide.inverse_radius[i];
                    if !wide.map.is_empty() {
                        wide.map[len] = wide.map[i];
                    }
                }
            }
            len += 1;
        }
        self.len = len;
    }

    /// Makes of a run's points, as they are decoded for a field of densities, what is seen of them
    /// as Gaussians, whose parts have been set: of clusters of them. They are in cells from a
    /// corner on, with edges that are parts of `root`.
    pub(crate) fn spread_points(
        &mut self,
        decoder: &FarDecoder,
        scratch: &mut FarScratch,
        (corner, root): (DVec3, f64),
        (sight, simd): (&Sight, SimdLevel),
    ) {
        decoder.color_points(self, &scratch.parts.color);
        let radius = self.points.radius[..self.len].iter().copied().fold(f32::INFINITY, f32::min);
        let of_points = (f64::from(radius), decoder.kernel().1);
        let cells = ClusterCells::new(sight.pixel_at(self.center), of_points, root);
        let mut stay = [0; 2];
        let mut least_radius = f32::INFINITY;
        let first = decoder.first_of_closure();
        dispatch!(simd.level(), _simd => {
            let FarScratch { parts, points, clusters, spread } = scratch;
            set_points(points, decoder, self, (parts, &decoder.sharp(sight)));
            let carried = |channel| channel < first || decoder.is_color(channel);
            clusters.set(self, (points, &parts.of_mass), (cells, corner), carried);
            self.len = clusters.len;
            let seen = Footprints::new(sight, sight.pixel, self);
            spread.set(self, clusters, &seen, decoder.variance_of_pixel());
            stay = more_than(&spread.weight, 0.0, self.len);
            self.points.weight = spread.weight;
            self.points.radius = spread.radius;
            self.points.map.resize(MAP_COLUMNS, [0.0; RUN_POINTS]);
            self.points.map.copy_from_slice(&spread.map);
            for i in 0..RUN_POINTS {
                self.points.inverse_radius[i] = 1.0 / spread.radius[i];
            }
            self.attribute[first] = spread.per_opacity;
            self.attribute[first + 1] = spread.length;
            self.attribute[first + 2] = spread.density;
            self.attribute[first + 3] = spread.depth;
            if decoder.has_normals() {
                self.attribute[first + OF_CLOSURE..first + OF_CLOSURE + 3].copy_from_slice(&spread.normal);
            }
            self.reach = spread.reach;
            least_radius = spread.least_radius;
        });
        self.become_spread();
        self.leave(stay);
        self.set_far(least_radius * 0.9999, simd);
    }
}

impl PointColumns {
    fn move_point(&mut self, from: usize, to: usize) {
        let columns = [&mut self.radius, &mut self.inverse_radius, &mut self.weight];
        let columns = columns.into_iter().chain(&mut self.position).chain(&mut self.map);
        columns.for_each(|column| column[to] = column[from]);
    }
}

#[inline(always)]
fn fade(weight: &mut Column, part: &Column, density: &Column, len: usize) -> [u64; 2] {
    let mut whole = [0.0; RUN_POINTS];
    for i in 0..RUN_POINTS {
        whole[i] = part[i] * density[i];
        weight[i] *= whole[i];
    }
    more_than(&whole, LEAST_PART as f32, len)
}

/// A bit for each of the first numbers that is more than another.
#[inline(always)]
fn more_than(column: &Column, least: f32, len: usize) -> [u64; 2] {
    let mut bits = [0; 2];
    for i in 0..len {
        bits[i / 64] |= u64::from(column[i] > least) << (i % 64);
    }
    bits
}

/// Sets what is seen of a run's points as Gaussians.
#[inline(always)]
fn set_points(
    out: &mut Points,
    decoder: &FarDecoder,
    run: &DecodedRun,
    (parts, sight): (&PointParts, &Sight),
) {
    let (integral, variance) = decoder.kernel();
    let points = &run.points;
    let density = density_parts(points, &Footprints::new(sight, sight.pixel, run).squared);
    for i in 0..RUN_POINTS {
        let rest = parts.part[i] * (1.0 - density[i]);
        out.part[i] = if rest > LEAST_PART as f32 { rest } else { 0.0 };
    }
    let volume = set_shapes(&mut out.covariance, points, variance as f32);
    for i in 0..RUN_POINTS {
        let radius = f64::from(points.radius[i]);
        let of_volume = radius * radius * radius * f64::from(volume[i]);
        out.seen[i] = f64::from(out.part[i]) * (integral * f64::from(points.weight[i]) * of_volume).max(0.0);
    }
}

/// Sets the covariances of points whose kernel has this variance; returns their volumes as parts of
/// that of the ball.
#[inline(always)]
fn set_shapes(covariance: &mut [Column; 6], points: &PointColumns, variance: f32) -> Column {
    let mut volume = [1.0; RUN_POINTS];
    let Some(map) = points.map.first_chunk::<MAP_COLUMNS>() else {
        for i in 0..RUN_POINTS {
            let of_ball = variance * points.radius[i] * points.radius[i];
            (0..3).for_each(|axis| covariance[axis][i] = of_ball);
            (3..6).for_each(|k| covariance[k][i] = 0.0);
        }
        return volume;
    };
    for i in 0..RUN_POINTS {
        let mut sum = [0.0; 6];
        for row in 0..3 {
            let [x, y, z] = [map[3 * row][i], map[3 * row + 1][i], map[3 * row + 2][i]];
            let inverse = 1.0 / dot([x, y, z], [x, y, z]);
            let scale = variance * inverse * inverse;
            let products = [x * x, y * y, z * z, x * y, x * z, y * z];
            (0..6).for_each(|k| sum[k] += scale * products[k]);
            volume[i] *= inverse.sqrt() * points.inverse_radius[i];
        }
        (0..6).for_each(|k| covariance[k][i] = sum[k]);
    }
    volume
}

impl Spread {
    /// Sets the closure of clusters, as `lod::closure` has it in double precision. A pixel of one
    /// spreads them by the variance `of_pixel`.
    #[inline(always)]
    fn set(&mut self, run: &DecodedRun, clusters: &Clusters, seen: &Footprints, of_pixel: f32) {
        let out = self;
        (out.reach, out.least_radius) = ([0.0; 3], f32::INFINITY);
        let (mut reach, mut shortest) = ([[0.0_f32; RUN_POINTS]; 3], [0.0_f32; RUN_POINTS]);
        for i in 0..clusters.len {
            let toward = [0, 1, 2].map(|axis| seen.toward[axis][i]);
            let covariance = [0, 1, 2, 3, 4, 5].map(|k| clusters.covariance[k][i]);
            // In units of the size: squares of lengths squared are beyond single precision.
            let size = (covariance[0] + covariance[1] + covariance[2]).max(f32::MIN_POSITIVE);
            let per_size = 1.0 / size;
            let (axes, v) = principal_axes(covariance.map(|of| of * per_size));
            let across = axes.map(|axis| dot(axis, toward) * dot(axis, toward));
            let area = across[0] * v[1] * v[2] + across[1] * v[2] * v[0] + across[2] * v[0] * v[1];
            let area = 12.0 * area.max(0.0).sqrt() * size;
            let v = v.map(|of| of * size);
            let cross = clusters.cross_section[i] as f32;
            let depth = (cross / area.max(f32::MIN_POSITIVE)).min(MOST_DEPTH as f32);
            let opacity = absorbed(depth);
            let s = v.map(|v| v + seen.squared[i] * of_pixel);
            let stretched = s.map(|of_axis| of_axis + STRETCH as f32 * (of_axis - s[2]));
            let along = across[0] / stretched[0] + across[1] / stretched[1] + across[2] / stretched[2];
            let r = s.map(|s| (s * (1.0 / SPREAD.variance()) as f32).sqrt());
            let per_opacity = 1.0 / opacity.max(f32::MIN_POSITIVE);
            let of_volume = (1.0 / SPREAD.integral()) as f32 * area / r[0] / r[1] / r[2];
            let weight = clusters.part[i] * opacity * of_volume;
            let is_seen = opacity > LEAST_OPACITY as f32 && weight < 1e30;
            out.weight[i] = if is_seen { weight } else { 0.0 };
            out.radius[i] = r[0].max(r[1]);
            out.per_opacity[i] = per_opacity;
            out.length[i] = (std::f32::consts::TAU / along).sqrt() * per_opacity;
            out.depth[i] = depth * per_opacity;
            out.density[i] = clusters.mass[i] as f32 * per_opacity / area.max(f32::MIN_POSITIVE);
            // How flat it is.
            let flat = 1.0 - v[2] / v[1].max(f32::MIN_POSITIVE);
            let against = if dot(axes[2], toward) > 0.0 { -flat * flat } else { flat * flat };
            for j in 0..3 {
                let mut squared = 0.0;
                for row in 0..3 {
                    out.map[3 * row + j][i] = axes[row][j] / r[row];
                    squared += axes[row][j] * axes[row][j] * (r[row] * r[row]);
                }
                out.normal[j][i] = against * axes[2][j];
                reach[j][i] = run.points.position[j][i].abs() + squared.sqrt();
            }
            shortest[i] = r[2];
        }
        for i in 0..clusters.len {
            if out.weight[i] > 0.0 {
                out.least_radius = out.least_radius.min(shortest[i]);
                (0..3).for_each(|j| out.reach[j] = out.reach[j].max(reach[j][i] * 1.00001));
            }
        }
    }
}

impl Default for Spread {
    fn default() -> Self {
        const NONE: Column = [0.0; RUN_POINTS];
        Self {
            weight: NONE,
            radius: NONE,
            map: [NONE; MAP_COLUMNS],
            per_opacity: NONE,
            length: NONE,
            density: NONE,
            depth: NONE,
            normal: [NONE; 3],
            reach: [0.0; 3],
            least_radius: f32::INFINITY,
        }
    }
}

//! Points of a run that are small in a picture: what is a density of them, and what is seen of them
//! as Gaussians.

use super::columns::{MAP_COLUMNS, PointColumns};
use super::far::{FarDecoder, LEAST_OPACITY, OF_CLOSURE};
use super::run::DecodedRun;
use super::sight::{Eye, Sight};
use super::simd::{SimdLevel, dispatch};
use crate::lod::{LEAST_PART, MOST_DEPTH, SPREAD, STRETCH};
use crate::math::{absorbed, ln};
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

/// From where the points of a run are seen.
struct Seen {
    /// The direction to each from the eye, of length one.
    toward: [Column; 3],
    /// The square of a pixel's edge at each.
    pixel_squared: Column,
    /// The part by which each is a density.
    density: Column,
}

impl Seen {
    // Loops over plain columns, without branches: the compiler makes vectors of them.
    #[inline(always)]
    fn new(sight: &Sight, run: &DecodedRun) -> Self {
        let pixel = sight.pixel as f32;
        let mut seen = Self {
            toward: [[0.0; RUN_POINTS]; 3],
            pixel_squared: [pixel * pixel; RUN_POINTS],
            density: [0.0; RUN_POINTS],
        };
        match sight.eye {
            Eye::Along(direction) => {
                let direction = direction.normalize_or_zero().to_array();
                seen.toward = direction.map(|v| [v as f32; RUN_POINTS]);
            }
            Eye::At(eye) => {
                let from = (run.center - eye).to_array().map(|v| v as f32);
                let forward = sight.forward.to_array().map(|v| v as f32);
                let (least, position) = (sight.corner_cosine as f32, &run.points.position);
                for i in 0..RUN_POINTS {
                    let offset = [0, 1, 2].map(|axis| from[axis] + position[axis][i]);
                    let squared = dot(offset, offset);
                    // Not a number at the eye itself, which `max` leaves out.
                    let inverse = 1.0 / squared.sqrt();
                    let cosine = (dot(offset, forward) * inverse).max(least);
                    seen.pixel_squared[i] *= squared * (cosine * cosine * cosine);
                    for axis in 0..3 {
                        seen.toward[axis][i] = offset[axis] * inverse;
                    }
                }
            }
        }
        let radius = &run.points.radius;
        for i in 0..RUN_POINTS {
            let ratio = radius[i] * radius[i] / seen.pixel_squared[i].max(f32::MIN_POSITIVE);
            let octaves = ln(ratio.clamp(0.5, 8.0)) * (0.5 * std::f32::consts::LOG2_E);
            let x = octaves.clamp(0.0, 1.0);
            seen.density[i] = x * x * (3.0 - 2.0 * x);
        }
        seen
    }
}

#[inline(always)]
fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// What the closure needs of Gaussians, besides their places.
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

    /// Leaves of a run's points, as they are decoded for a field of densities, what is a density of
    /// them.
    pub(crate) fn fade_points(&mut self, parts: &PointParts, sight: &Sight, simd: SimdLevel) {
        let mut stay = [0; 2];
        dispatch!(simd.level(), _simd => {
            let density = Seen::new(sight, self).density;
            stay = fade(&mut self.points.weight, &parts.part, &density, self.len);
        });
        self.leave(stay);
        let radius = &self.points.radius[..self.len];
        let least = radius.iter().copied().fold(f32::INFINITY, f32::min) * 0.9999;
        dispatch!(simd.level(), token => self.bound_again(token, least));
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
    /// as Gaussians.
    pub(crate) fn spread_points(
        &mut self,
        decoder: &FarDecoder,
        parts: &PointParts,
        (sight, simd): (&Sight, SimdLevel),
    ) {
        decoder.color_points(self, &parts.color);
        let mut stay = [0; 2];
        let mut least_radius = f32::INFINITY;
        let first = decoder.first_of_closure();
        dispatch!(simd.level(), _simd => {
            let spread = spread(decoder, self, parts, &Seen::new(sight, self));
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

/// The shapes of points: their axes, of length one, and the second and third semi-axis as parts of
/// the first.
struct Axes {
    axes: [Column; MAP_COLUMNS],
    ratios: [Column; 2],
}

impl Axes {
    #[inline(always)]
    fn of(points: &PointColumns) -> Self {
        let mut out = Self { axes: [[0.0; RUN_POINTS]; MAP_COLUMNS], ratios: [[1.0; RUN_POINTS]; 2] };
        let Some(map) = points.map.first_chunk::<MAP_COLUMNS>() else {
            (0..3).for_each(|row| out.axes[4 * row] = [1.0; RUN_POINTS]);
            return out;
        };
        for i in 0..RUN_POINTS {
            for row in 0..3 {
                let of = [map[3 * row][i], map[3 * row + 1][i], map[3 * row + 2][i]];
                let length = 1.0 / dot(of, of).sqrt();
                for j in 0..3 {
                    out.axes[3 * row + j][i] = of[j] * length;
                }
                if row > 0 {
                    out.ratios[row - 1][i] = length * points.inverse_radius[i];
                }
            }
        }
        out
    }

    #[inline(always)]
    fn rows(&self, i: usize) -> [[f32; 3]; 3] {
        [0, 3, 6].map(|row| [self.axes[row][i], self.axes[row + 1][i], self.axes[row + 2][i]])
    }
}

/// The areas that points take of the light by themselves, and their masses.
#[inline(always)]
fn cross_sections(
    points: &PointColumns,
    ratios: &[Column; 2],
    of_mass: &[f64; RUN_POINTS],
    integral: f64,
) -> [Column; 2] {
    let [mut cross, mut mass] = [[0.0; RUN_POINTS]; 2];
    for i in 0..RUN_POINTS {
        let radius = f64::from(points.radius[i]);
        let volume = radius * radius * radius * f64::from(ratios[0][i] * ratios[1][i]);
        let of_point = integral * f64::from(points.weight[i]) * volume;
        cross[i] = (of_mass[i] * of_point) as f32;
        mass[i] = of_point as f32;
    }
    [cross, mass]
}

/// The closure of points, as `lod::closure` has it in double precision.
#[inline(always)]
fn spread(decoder: &FarDecoder, run: &DecodedRun, parts: &PointParts, seen: &Seen) -> Spread {
    let (integral, variance) = decoder.kernel();
    let points = &run.points;
    let mu = variance as f32;
    let shapes = Axes::of(points);
    let ratios = &shapes.ratios;
    let [cross, mass] = cross_sections(points, ratios, &parts.of_mass, integral);
    let mut out = Spread::default();
    let mut radii = [[0.0; RUN_POINTS]; 3];
    for i in 0..RUN_POINTS {
        let (radius, toward) = (points.radius[i], [0, 1, 2].map(|axis| seen.toward[axis][i]));
        let across = shapes.rows(i).map(|axis| dot(axis, toward) * dot(axis, toward));
        // Of the radius squared.
        let v = [mu, mu * ratios[0][i] * ratios[0][i], mu * ratios[1][i] * ratios[1][i]];
        let area = across[0] * v[1] * v[2] + across[1] * v[2] * v[0] + across[2] * v[0] * v[1];
        let area = 12.0 * radius * radius * area.max(0.0).sqrt();
        let depth = (cross[i] / area.max(f32::MIN_POSITIVE)).min(MOST_DEPTH as f32);
        let opacity = absorbed(depth);
        let s = v.map(|v| v * radius * radius + seen.pixel_squared[i] * (1.0 / 12.0));
        let least = s[0].min(s[1]).min(s[2]);
        let stretched = s.map(|s| s + STRETCH as f32 * (s - least));
        let along = across[0] / stretched[0] + across[1] / stretched[1] + across[2] / stretched[2];
        let r = s.map(|s| (s * (1.0 / SPREAD.variance()) as f32).sqrt());
        let per_opacity = 1.0 / opacity.max(f32::MIN_POSITIVE);
        let part = parts.part[i] * (1.0 - seen.density[i]);
        let of_volume = (1.0 / SPREAD.integral()) as f32 * area / r[0] / r[1] / r[2];
        let weight = part * opacity * of_volume;
        let is_seen = part > LEAST_PART as f32 && opacity > LEAST_OPACITY as f32 && weight < 1e30;
        out.weight[i] = if is_seen { weight } else { 0.0 };
        out.radius[i] = r[0].max(r[1]).max(r[2]);
        (0..3).for_each(|row| radii[row][i] = r[row]);
        out.per_opacity[i] = per_opacity;
        out.length[i] = (std::f32::consts::TAU / along).sqrt() * per_opacity;
        out.depth[i] = depth * per_opacity;
        out.density[i] = mass[i] * per_opacity / area.max(f32::MIN_POSITIVE);
    }
    out.set_shapes(run, &shapes, &radii, seen);
    out
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

impl Spread {
    /// Sets the maps to the unit ball, of Gaussians with these radii along their axes, how far they
    /// reach, and directions across those that are flat.
    #[inline(always)]
    fn set_shapes(&mut self, run: &DecodedRun, shapes: &Axes, radii: &[Column; 3], seen: &Seen) {
        let mut reach = [[0.0_f32; RUN_POINTS]; 3];
        for i in 0..RUN_POINTS {
            let axis = shapes.rows(i);
            let toward = [0, 1, 2].map(|j| seen.toward[j][i]);
            let thin = shapes.ratios[1][i] / shapes.ratios[0][i];
            // Ellipsoids have their shortest axis last.
            let flat = 1.0 - thin * thin;
            let against = if dot(axis[2], toward) > 0.0 { -flat * flat } else { flat * flat };
            for j in 0..3 {
                let mut squared = 0.0;
                for row in 0..3 {
                    self.map[3 * row + j][i] = axis[row][j] / radii[row][i];
                    squared += axis[row][j] * axis[row][j] * radii[row][i] * radii[row][i];
                }
                self.normal[j][i] = against * axis[2][j];
                reach[j][i] = run.points.position[j][i].abs() + squared.sqrt();
            }
        }
        for i in 0..run.len {
            if self.weight[i] > 0.0 {
                let shortest = radii[0][i].min(radii[1][i]).min(radii[2][i]);
                self.least_radius = self.least_radius.min(shortest);
                (0..3).for_each(|j| self.reach[j] = self.reach[j].max(reach[j][i] * 1.00001));
            }
        }
    }
}

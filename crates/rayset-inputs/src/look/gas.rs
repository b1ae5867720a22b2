//! What glows: how the densities of a gas are spread, and how opaque each is.

use std::collections::HashSet;

use rayset::Cloud;
use rayset::geometry::DVec3;
use serde_json::{Value, json};

use super::statistics::{Statistics, percentile, range};

/// If the radii of most points are beyond these, densities of numbers, their inverse cubes, are out
/// of the range of transfer functions: molecules in metres, galaxies in kilometres.
const NORMALISED_RADII: [f64; 2] = [1e-5, 1e5];
/// Inverse cubes of radii beyond these are out of the range of densities.
const EXTREME_RADII: [f64; 2] = [1e-10, 1e10];

/// Fewer points that are seen than these say nothing of where a gas is.
const LEAST_SEEN: usize = 200;
/// What is thin about a gas is left out of the frame if the rest is smaller than this part of all:
/// the picture gains by it. Elsewhere columns of it are seen, and would be cut off at the border.
const MUCH_SMALLER: f64 = 0.7;

/// Points of the curves, evenly spaced in the logarithm.
const KNOTS: usize = 64;
/// Cells along each axis in which places of a gas are counted.
const CELLS: f64 = 32.0;
/// What lies beyond the middle of all but such a part at either end may be astray.
const ASTRAY: f64 = 0.005;
/// The optical depth, at least, of what is densest.
const DENSEST_DEPTH: f64 = 0.6;
/// Opacities refer to no less than such a part of what they do where nothing is small: those of
/// thin gas would be nothing in single precision.
const LEAST_OF_WHOLE: f64 = 1e-3;
/// The least unit distance of scenes is shorter.
const SHORTEST: f64 = 1e-17;

const BALL: f64 = 4.0 / 3.0 * std::f64::consts::PI;

/// Whether the density of a cloud is that of numbers. Weights of simulations are densities already;
/// without them, the number of points in a volume counts.
pub(super) fn is_normalised(cloud: &Cloud, statistics: &Statistics) -> bool {
    let header = cloud.header();
    // A few far smaller than the rest, in the middles of haloes, are still the densest.
    let (smallest, largest) = range(&statistics.sorted("radius"), 0.02);
    !header.weight.is_stored()
        && smallest > NORMALISED_RADII[0]
        && largest < NORMALISED_RADII[1]
        && f64::from(header.radius.min()) > EXTREME_RADII[0]
        && f64::from(header.radius.max()) < EXTREME_RADII[1]
}

/// A sample of a gas.
pub(super) struct Gas<'a> {
    pub(super) statistics: &'a Statistics,
    /// Whether its kernels are normalised: the density is that of numbers.
    pub(super) is_normalised: bool,
}

/// A point of the sample.
#[derive(Clone, Copy)]
struct Place {
    position: DVec3,
    radius: f64,
    /// Of mass, or of numbers where points have no weights: an estimate.
    density: f64,
    /// Of the gas that the point stands for.
    volume: f64,
}

impl Gas<'_> {
    /// Points that are dense enough to be seen, each with its radius, if a picture of these alone
    /// gains by what it leaves out.
    pub(super) fn dense_points(&self) -> Option<Vec<(DVec3, f64)>> {
        let places = self.places();
        let (low, high) = range_of(&places);
        // The place on the map whose opacity is a sixteenth of the largest.
        let faint = low * (high / low.max(1e-300)).powf(0.3);
        let dense: Vec<Place> = places.iter().filter(|place| place.density >= faint).copied().collect();
        let is_much_smaller = Extent::of(&dense).longest() < MUCH_SMALLER * Extent::of(&places).longest();
        (dense.len() >= LEAST_SEEN && is_much_smaller)
            .then(|| dense.iter().map(|place| (place.position, place.radius)).collect())
    }

    /// The densities, ascending: estimates.
    pub(super) fn densities(&self) -> Vec<f64> {
        let mut densities: Vec<f64> = self.places().iter().map(|place| place.density).collect();
        densities.sort_by(f64::total_cmp);
        densities
    }

    fn places(&self) -> Vec<Place> {
        let (weights, radii) = (self.statistics.values("weight"), self.statistics.values("radius"));
        let positions: Vec<DVec3> = self.statistics.positions().collect();
        let around = self.statistics.number_densities();
        // Points within a radius: few where radii were measured, dozens in simulations, none where
        // points are alone.
        let mut reached: Vec<f64> =
            around.iter().map(|&(i, numbers)| numbers * BALL * radii[i].powi(3)).collect();
        reached.sort_by(f64::total_cmp);
        let reached = percentile(&reached, 0.5);
        let sorted = self.statistics.sorted("radius");
        let are_alike = percentile(&sorted, 0.99) < 1.2 * percentile(&sorted, 0.01);
        // Where radii say nothing, some points are asked for their neighbours.
        let numbers: Vec<(usize, f64)> = if self.is_normalised && are_alike && !around.is_empty() {
            around.to_vec()
        } else {
            radii.iter().map(|r| reached.max(5.0) / (BALL * r.powi(3))).enumerate().collect()
        };
        let each_stands_for = self.statistics.points() / numbers.len().max(1) as f64;
        let place = |(i, numbers): (usize, f64)| Place {
            position: positions[i],
            radius: radii[i],
            density: if self.is_normalised {
                numbers * weights[i]
            } else {
                // Each counts by its kernel, whose mean over its ball is about a fifth; at its
                // middle it is 1.
                (0.2 * reached).max(1.0) * weights[i]
            },
            volume: each_stands_for / numbers,
        };
        let mut places: Vec<Place> = numbers.into_iter().map(place).collect();
        places.retain(|place| place.density.is_finite() && place.density > 0.0);
        places
    }

    /// Colours and opacity by the logarithm of the density of mass, or of numbers where points have
    /// no weights. Colours are those of the points if `has_colors`.
    pub(super) fn transfer_function(&self, has_colors: bool) -> Value {
        let Opacities { low, high, curve: opacity, .. } = self.opacities();
        if has_colors {
            return json!({"opacity": opacity, "color": "points"});
        }
        let colors = inferno_stops();
        let color: Vec<Value> = opacity
            .iter()
            .zip(&colors)
            .map(|([density, _], color)| json!([((density - low) / (high - low)).clamp(0.0, 1.0), color]))
            .collect();
        json!({"opacity": opacity, "color": color, "input": "density", "valueRange": [low, high]})
    }

    /// The length that opacities refer to.
    pub(super) fn unit_distance(&self) -> f64 {
        self.opacities().unit_distance
    }

    /// How opaque each density is. Thin gas is faint, and dense gas is opaque over a part of the
    /// whole. What is dense and far smaller than that, as haloes are, is as opaque as it has to be
    /// to be seen.
    fn opacities(&self) -> Opacities {
        let mut places = self.places();
        let (low, high) = range_of(&places);
        let (low, high) = (low.max(1e-17), high.min(1e17));
        let (low, high) = if high > 1.2 * low { (low, high) } else { (0.3 * low, 3.0 * low) };
        let density = |t: f64| low * (high / low).powf(t);
        let faint_to_opaque = |t: f64| 0.006 + 0.45 * t.powf(2.5);
        let whole = self.part_of_whole();
        places.sort_by(|a, b| b.density.total_cmp(&a.density));
        let mut paths = Paths::among(&places);
        let mut denser = places.iter().peekable();
        // From the densest down; extinctions never grow on the way.
        let mut extinctions: Vec<f64> = (0..=KNOTS)
            .rev()
            .map(|knot| {
                let t = at(knot);
                while let Some(place) = denser.next_if(|place| place.density >= density(t)) {
                    paths.add(place);
                }
                let by_size = match paths.length() {
                    length if length > 0.0 => DENSEST_DEPTH * t.powf(1.5) / length,
                    _ => 0.0,
                };
                by_size.max(-(1.0 - faint_to_opaque(t)).ln() / whole)
            })
            .collect();
        extinctions.reverse();
        let mut largest = 0.0;
        for extinction in &mut extinctions {
            largest = f64::max(largest, *extinction);
            *extinction = largest;
        }
        let shortened = -(1.0 - faint_to_opaque(1.0)).ln() / largest;
        let unit_distance = shortened.clamp(LEAST_OF_WHOLE * whole, whole).max(SHORTEST);
        let opacity = |knot: usize| match extinctions[knot] {
            // What has no density is not seen.
            _ if knot == 0 => 0.0,
            extinction => -(-extinction * unit_distance).exp_m1(),
        };
        let curve = (0..=KNOTS).map(|knot| [density(at(knot)), opacity(knot)]).collect();
        Opacities { low, high, curve, unit_distance }
    }

    /// A part of the diagonal of what most points fill.
    fn part_of_whole(&self) -> f64 {
        let sides = ["x", "y", "z"].map(|axis| {
            let (low, high) = range(&self.statistics.sorted(axis), ASTRAY);
            high - low
        });
        sides.iter().map(|side| side * side).sum::<f64>().sqrt().max(1e-15) / 60.0
    }
}

/// The densities that a map goes from and to.
fn range_of(places: &[Place]) -> (f64, f64) {
    let mut sorted: Vec<f64> = places.iter().map(|place| place.density).collect();
    sorted.sort_by(f64::total_cmp);
    (percentile(&sorted, 0.02), percentile(&sorted, 0.98))
}

/// The box around all but a few places.
struct Extent {
    low: DVec3,
    high: DVec3,
}

impl Extent {
    fn of(places: &[Place]) -> Self {
        let ends = [0, 1, 2].map(|axis| {
            let mut sorted: Vec<f64> = places.iter().map(|place| place.position[axis]).collect();
            sorted.sort_by(f64::total_cmp);
            [ASTRAY, 1.0 - ASTRAY].map(|part| percentile(&sorted, part))
        });
        Self { low: ends.map(|[low, _]| low).into(), high: ends.map(|[_, high]| high).into() }
    }

    fn longest(&self) -> f64 {
        (self.high - self.low).max_element()
    }
}

/// How opaque a gas is.
struct Opacities {
    /// The densities that the map goes from and to.
    low: f64,
    high: f64,
    /// Densities, ascending, each with its opacity.
    curve: Vec<[f64; 2]>,
    unit_distance: f64,
}

/// The place of a knot on the map, from 0 to 1.
fn at(knot: usize) -> f64 {
    knot as f64 / KNOTS as f64
}

/// About how long rays are in a part of a gas, where they meet it: its volume over the area that it
/// covers, in the mean of three directions. The gas lies in cells; those of one column are behind
/// each other, and in each is a clump with its share of the volume.
struct Paths {
    corner: DVec3,
    cell: f64,
    cells: HashSet<[i32; 3]>,
    /// Along each axis.
    columns: [HashSet<[i32; 2]>; 3],
    volume: f64,
}

impl Paths {
    /// Those in nothing yet, of all that there is.
    fn among(all: &[Place]) -> Self {
        let extent = Extent::of(all);
        let cell = (extent.longest() / CELLS).max(1e-300);
        let (cells, columns) = (HashSet::new(), std::array::from_fn(|_| HashSet::new()));
        Self { corner: extent.low, cell, cells, columns, volume: 0.0 }
    }

    fn add(&mut self, place: &Place) {
        // What is astray is in the cells at the border.
        let in_cells = ((place.position - self.corner) / self.cell).to_array();
        let [x, y, z] = in_cells.map(|place| place.clamp(-1.0, CELLS) as i32);
        self.cells.insert([x, y, z]);
        let [along_x, along_y, along_z] = &mut self.columns;
        along_x.insert([y, z]);
        along_y.insert([z, x]);
        along_z.insert([x, y]);
        self.volume += place.volume;
    }

    /// 0 in nothing.
    fn length(&self) -> f64 {
        let cells = self.cells.len().max(1) as f64;
        let of_clumps = cells * (self.volume / cells).powf(2.0 / 3.0);
        let covered = |columns: &HashSet<_>| of_clumps.min(columns.len() as f64 * self.cell * self.cell);
        let covered = self.columns.iter().map(covered).sum::<f64>() / 3.0;
        if covered > 0.0 { self.volume / covered } else { 0.0 }
    }
}

/// Stops of the map `inferno`, as displayed, one for each knot.
fn inferno_stops() -> Vec<String> {
    let map: Result<rayset::scene::NamedPalette, _> = "inferno".parse();
    (0..=KNOTS)
        .map(|i| {
            let color = map.as_ref().map_or([at(i); 3], |map| map.display_color(at(i)));
            let [red, green, blue] = color.map(|v| (v * 255.0).round() as u8);
            format!("#{red:02x}{green:02x}{blue:02x}")
        })
        .collect()
}

//! Radii and shapes that are measured: they are what the documents say, and clouds with them look
//! like what was scanned.

#![allow(clippy::print_stdout, reason = "a measurement prints its table")]

use std::collections::HashMap;

use rayset::field::Kernel;
use rayset::geometry::{DMat3, DVec3, Shape};
use rayset::octree::build::{self, BuildControl, BuildOptions, Precision, Rule, ShapeRule};
use rayset::octree::page::Run;
use rayset::octree::shape::StoredShape;
use rayset::points::{ArraySource, PointBatch, PointSource, ReadOptions, open};

use crate::common::{Random, real_data};

type Point = [f64; 3];

const PER_DISTANCE: f64 = 0.85;
const NEIGHBOUR: usize = 8;

/// A point as it was built.
#[derive(Clone, Copy)]
pub(crate) struct Built {
    pub(crate) position: Point,
    pub(crate) radius: f64,
    pub(crate) shape: Shape,
}

/// Builds a cloud with automatic radii and shapes and returns its points.
fn built(points: &[Point]) -> Vec<Built> {
    let options = BuildOptions { radius: Some(Rule::Auto), ..BuildOptions::default() };
    built_of(vec![Box::new(ArraySource::new(points.to_vec(), vec![]))], &options)
}

/// Builds a cloud and returns its points.
pub(crate) fn built_of(sources: Vec<Box<dyn PointSource>>, options: &BuildOptions) -> Vec<Built> {
    let (cloud, _) =
        build::run_in_memory(sources, options, &BuildControl::default()).expect("the cloud builds");
    let (header, mut built) = (cloud.header(), Vec::new());
    let add = |run: Run<'_>| {
        let shapes: Vec<Shape> = match run.shapes(header) {
            Some(shapes) => shapes.map(StoredShape::decode).collect(),
            None => vec![Shape::BALL; run.head.len()],
        };
        let radii: Vec<f32> = match run.radii(header) {
            Some(radii) => radii.collect(),
            None => vec![header.radius.min(); run.head.len()],
        };
        let positions = run.positions(header.root_cell());
        for ((position, radius), shape) in positions.into_iter().zip(radii).zip(shapes) {
            built.push(Built { position: position.to_array(), radius: f64::from(radius), shape });
        }
    };
    let mut add = add;
    cloud.for_each_run(|_, run| add(run)).expect("the cloud reads");
    built
}

/// Builds a cloud of balls with automatic radii and returns its points with them.
fn measured(points: &[Point]) -> Vec<(Point, f64)> {
    let options = BuildOptions {
        radius: Some(Rule::Auto),
        shape: ShapeRule::Round,
        precision: Precision::Exact,
        page_bytes: Some(262_144),
        ..BuildOptions::default()
    };
    let source = ArraySource::new(points.to_vec(), vec![]);
    let (cloud, _) = build::run_in_memory(vec![Box::new(source)], &options, &BuildControl::default())
        .expect("the cloud builds");
    let all = cloud.sample(usize::MAX).expect("the cloud reads");
    assert_eq!(all.len() as u64 + cloud.header().copies, points.len() as u64, "a sample of all points");
    let radius = cloud.sample_schema().find("radius").expect("a column of radii");
    (0..all.len()).map(|i| (all.position[i], all.columns[radius].get(i))).collect()
}

fn square(a: Point, b: Point) -> f64 {
    (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum()
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    sorted[sorted.len() / 2]
}

/// A square of 1 × 1 in which points lie at random.
fn sheet(count: usize, random: &mut Random) -> Vec<Point> {
    (0..count).map(|_| [random.unit(), random.unit(), 0.0]).collect()
}

#[test]
fn a_radius_is_0_85_times_the_distance_of_the_eighth_neighbour_across_all_cells() {
    let lattice: Vec<Point> = (0..3600).map(|i| [f64::from(i % 60), f64::from(i / 60), 7.0]).collect();
    let cube = |random: &mut Random| (0..3000).map(|_| std::array::from_fn(|_| random.unit())).collect();
    let random = &mut Random(5);
    for (name, points) in [("lattice", lattice), ("sheet", sheet(5000, random)), ("cube", cube(random))] {
        let built = measured(&points);
        let mut error = 0.0;
        for &(p, radius) in &built {
            let mut squares: Vec<f64> = points.iter().map(|&q| square(p, q)).collect();
            let expected = PER_DISTANCE * squares.select_nth_unstable_by(NEIGHBOUR, f64::total_cmp).1.sqrt();
            error += (radius - expected).abs() / expected / built.len() as f64;
        }
        assert!(error < 1e-6, "{name}: radii are wrong by {error} in the mean");
    }
}

#[test]
fn points_on_a_surface_are_discs_in_it_and_those_that_fill_space_are_balls() {
    let random = &mut Random(15);
    let slope: Vec<Point> =
        sheet(4000, random).into_iter().map(|[x, y, _]| [x, y, 0.5 * x - 0.3 * y]).collect();
    let normal = DVec3::new(-0.5, 0.3, 1.0).normalize();
    let (discs, balls) = (built(&slope), measured(&slope));
    let radii: HashMap<[u64; 3], f64> = balls.iter().map(|(p, r)| (p.map(f64::to_bits), *r)).collect();
    assert!(radii.len() == discs.len());
    for disc in &discs {
        assert!(
            disc.shape.ratios[0] > 0.99 && (disc.shape.ratios[1] - 0.15).abs() < 0.01,
            "{:?}",
            disc.shape
        );
        assert!((disc.shape.rotation * DVec3::Z).dot(normal).abs() > 0.9999);
    }
    // Positions are rounded, so that radii are compared as a whole.
    let sum = |radii: &mut dyn Iterator<Item = f64>| radii.sum::<f64>();
    let ratio = sum(&mut discs.iter().map(|d| d.radius)) / sum(&mut radii.values().copied());
    assert!((ratio - 1.15 / PER_DISTANCE).abs() < 1e-3, "{ratio}");
    let cube: Vec<Point> = (0..4000).map(|_| std::array::from_fn(|_| random.unit())).collect();
    assert!(built(&cube).iter().all(|point| point.shape == Shape::BALL));
}

#[test]
fn stray_points_are_drawn_with_the_median_radius() {
    let random = &mut Random(6);
    let mut points = sheet(20_000, random);
    // Above the sheet, alone and in pairs.
    let strays = 40;
    for i in 0..strays / 2 {
        let p = [random.unit(), random.unit(), 0.5 + 0.1 * f64::from(i)];
        points.extend([p, [p[0], p[1], p[2] + if i % 2 == 0 { 1e-3 } else { 0.04 }]]);
    }
    let built = measured(&points);
    let typical = median(built.iter().map(|&(_, radius)| radius));
    let (stray, sheet): (Vec<_>, Vec<_>) = built.iter().partition(|(p, _)| p[2] > 0.0);
    assert_eq!(stray.len(), strays as usize);
    for (p, radius) in stray {
        assert!((0.98..=1.0).contains(&(radius / typical)), "{p:?}: {radius}, where {typical} is usual");
    }
    let wide = sheet.iter().filter(|(_, radius)| *radius > 1.2 * typical).count();
    assert!(wide > 100, "corners and sparse parts of the sheet keep their own: {wide}");
}

#[test]
fn a_scan_whose_spacing_varies_widely_has_no_stray_points() {
    // As around a scanner: spacing in proportion to distance, over a factor of 50.
    let random = &mut Random(8);
    let points: Vec<Point> = (0..20_000)
        .map(|_| {
            let (distance, angle) = (50_f64.powf(random.unit()), std::f64::consts::TAU * random.unit());
            [distance * angle.cos(), distance * angle.sin(), 0.0]
        })
        .collect();
    let built = measured(&points);
    let far: Vec<_> = built.iter().filter(|(p, _)| square(*p, [0.0; 3]) > 1600.0).collect();
    let near: Vec<_> = built.iter().filter(|(p, _)| square(*p, [0.0; 3]) < 2.0).collect();
    let ratio = median(far.iter().map(|(_, r)| *r)) / median(near.iter().map(|(_, r)| *r));
    assert!(ratio > 25.0, "radii follow the spacing: {ratio}");
}

#[test]
fn clusters_a_thousand_million_times_as_far_apart_as_they_are_wide_have_one_radius_each() {
    const COUNT: usize = 12_000;
    let random = &mut Random(4);
    let cluster = |random: &mut Random, at: f64, side: f64| -> Vec<Point> {
        (0..COUNT).map(|_| std::array::from_fn(|_| at + side * random.unit())).collect()
    };
    let (near, far) = (cluster(random, 0.0, 1e-3), cluster(random, 1e6, 2e-3));
    let built = measured(&[near, far].concat());
    for (side, is_far) in [(1e-3, false), (2e-3, true)] {
        let expected = 0.75 * side / (COUNT as f64).sqrt();
        let of_cluster = built.iter().filter(|(p, _)| (p[0] > 5e5) == is_far);
        assert!(of_cluster.clone().count() == COUNT);
        assert!(of_cluster.clone().all(|&(_, radius)| (radius / expected - 1.0).abs() < 0.01));
    }
}

/// Radii by position, of points that are there as often as is said.
fn radii_of_copies(points: &[Point], copies: impl Fn(usize) -> usize) -> HashMap<[u64; 3], f64> {
    let all: Vec<Point> =
        points.iter().enumerate().flat_map(|(i, &p)| std::iter::repeat_n(p, copies(i))).collect();
    let mut radii = HashMap::new();
    for (p, radius) in measured(&all) {
        let known = *radii.entry(p.map(f64::to_bits)).or_insert(radius);
        assert_eq!(known, radius, "points at one place, {p:?}, have one radius");
    }
    radii
}

#[test]
fn copies_of_points_change_no_radius() {
    let random = &mut Random(12);
    let lattice: Vec<Point> = (0..900).map(|i| [f64::from(i % 30), f64::from(i / 30), 7.0]).collect();
    for (name, points) in [("lattice", lattice), ("sheet", sheet(1500, random))] {
        let once = radii_of_copies(&points, |_| 1);
        for copies in [2, 9, 100] {
            assert!(radii_of_copies(&points, |_| copies) == once, "{name}: {copies} of each");
        }
        // Runs of copies of any length, which begin and end anywhere in what is read together; and
        // more of a point than go into a block.
        let uneven = |i: usize| {
            if i % 100 == 7 {
                3000
            } else if i == 50 {
                9000
            } else {
                1 + i % 3
            }
        };
        assert!(radii_of_copies(&points, uneven) == once, "{name}: some copied");
    }
}

#[test]
fn few_places_have_the_radius_of_their_number_however_often_they_occur() {
    let two: Vec<Point> = vec![[0.0; 3], [1.0, 0.0, 0.0]];
    let seven: Vec<Point> = (0..7).map(|i| [f64::from(i), f64::from(i * i % 5), 0.0]).collect();
    for (points, expected) in
        [(vec![[3.0, 4.0, 5.0]], 1.0), (two, 0.75 / 2_f64.sqrt()), (seven, 0.75 * 6.0 / 7_f64.sqrt())]
    {
        for copies in [1, 20, 20_000] {
            let radii = radii_of_copies(&points, |_| copies);
            assert_eq!(radii.len(), points.len());
            assert!(radii.values().all(|r| (r / expected - 1.0).abs() < 1e-6), "{copies} copies: {radii:?}");
        }
    }
    // Where very many places share a cell of the curve, too: two clusters, a thousand million times
    // as far apart as wide.
    let random = &mut Random(13);
    let cluster = |random: &mut Random, at: f64| -> Vec<Point> {
        (0..9000).map(|_| std::array::from_fn(|_| at + 1e-3 * random.unit())).collect()
    };
    let clusters = [cluster(random, 0.0), cluster(random, 1e6)].concat();
    // So far from the origin a stored position depends on its neighbours in the file, which are
    // others: radii are compared alone.
    let radii = |copies: usize| {
        let all: Vec<Point> = clusters.iter().flat_map(|&p| std::iter::repeat_n(p, copies)).collect();
        let mut radii: Vec<u64> = measured(&all).iter().map(|(_, radius)| radius.to_bits()).collect();
        radii.sort_unstable();
        radii.dedup();
        radii
    };
    let once = radii(1);
    assert_eq!(once.len(), 2, "a radius for each cluster");
    assert_eq!(radii(3), once);
}

/// The density of a cloud.
struct Density {
    /// Each with the map that takes its ellipsoid to the unit ball.
    points: Vec<(Point, DMat3)>,
    cell: f64,
    /// Points the balls about which meet a cell.
    cells: HashMap<[i64; 3], Vec<u32>>,
}

impl Density {
    fn new(built: &[Built]) -> Self {
        let cell = 2.0 * median(built.iter().map(|point| point.radius));
        let mut cells: HashMap<[i64; 3], Vec<u32>> = HashMap::new();
        for (i, Built { position: p, radius: r, .. }) in built.iter().enumerate() {
            let range =
                |axis: usize| ((p[axis] - r) / cell).floor() as i64..=((p[axis] + r) / cell).floor() as i64;
            for x in range(0) {
                for y in range(1) {
                    range(2).for_each(|z| cells.entry([x, y, z]).or_default().push(i as u32));
                }
            }
        }
        let map = |point: &Built| (point.position, point.shape.unit_from_local() * (1.0 / point.radius));
        Self { points: built.iter().map(map).collect(), cell, cells }
    }

    fn at(&self, q: Point) -> f64 {
        let cell = q.map(|v| (v / self.cell).floor() as i64);
        let near = self.cells.get(&cell).into_iter().flatten().map(|&i| self.points[i as usize]);
        let q = DVec3::from_array(q);
        near.map(|(p, map)| Kernel::Wyvill.value((map * (q - DVec3::from_array(p))).length_squared())).sum()
    }
}

/// How far a scan is from the surface of the cloud that was made of a part of it.
#[derive(Debug)]
struct Fit {
    /// Root of the mean squared distance of points of the scan from the surface, in spacings of the
    /// part, where those with no surface within 1.5 spacings count as that far.
    rms: f64,
    /// The share of points of the scan with no surface within one spacing.
    holes: f64,
}

/// Distances of up to `most` points of a scan to the surface on which the density is `level`: the
/// nearest along 66 directions, which can only be too far.
fn fit(scan: &[Point], density: &Density, spacing: f64, level: f64, most: usize) -> Fit {
    const DIRECTIONS: usize = 66;
    const STEPS: usize = 30;
    let reach = 1.5 * spacing;
    let directions: Vec<Point> = (0..DIRECTIONS)
        .map(|i| {
            let (z, turn) = (1.0 - (2 * i + 1) as f64 / DIRECTIONS as f64, 2.399_963 * i as f64);
            let across = (1.0 - z * z).sqrt();
            [across * turn.cos(), across * turn.sin(), z]
        })
        .collect();
    let (mut squares, mut holes) = (0.0, 0.0);
    let every = scan.len().div_ceil(most);
    let asked: Vec<Point> = scan.iter().copied().step_by(every).collect();
    for &p in &asked {
        let here = density.at(p) - level;
        let mut nearest = reach;
        for direction in &directions {
            let (mut before, mut step) = (here, 1);
            while step <= STEPS && reach * ((step - 1) as f64) < nearest * STEPS as f64 {
                let t = reach * step as f64 / STEPS as f64;
                let now = density.at(std::array::from_fn(|axis| p[axis] + t * direction[axis])) - level;
                if (now < 0.0) != (before < 0.0) {
                    nearest = nearest.min(t - reach / STEPS as f64 * now / (now - before));
                    break;
                }
                (before, step) = (now, step + 1);
            }
        }
        squares += (nearest / spacing).powi(2);
        holes += f64::from(u8::from(nearest > spacing));
    }
    let count = asked.len() as f64;
    Fit { rms: (squares / count).sqrt(), holes: holes / count }
}

/// A part of the points, drawn at random.
fn thinned(scan: &[Point], part: f64, random: &mut Random) -> Vec<Point> {
    scan.iter().copied().filter(|_| random.unit() < part).collect()
}

/// A point that is moved along the normal of its disc, by as much in the mean square.
fn moved(point: &Built, by: f64, random: &mut Random) -> Point {
    // Of Box and Muller.
    let (a, b) = (random.unit().max(1e-12), random.unit());
    let normal = (-2.0 * a.ln()).sqrt() * (std::f64::consts::TAU * b).cos();
    let position = DVec3::from_array(point.position) + point.shape.rotation * DVec3::Z * (by * normal);
    position.to_array()
}

/// Where the opacity of a scan's look is one half, and where density is.
const LEVELS: [f64; 2] = [0.4, 0.5];

#[test]
fn thinned_scans_have_a_surface_nearer_than_a_quarter_of_a_spacing_and_few_holes() {
    let random = &mut Random(9);
    let sphere: Vec<Point> = (0..30_000)
        .map(|_| {
            let (z, turn) = (2.0 * random.unit() - 1.0, std::f64::consts::TAU * random.unit());
            let across = (1.0 - z * z).sqrt();
            [across * turn.cos(), across * turn.sin(), z]
        })
        .collect();
    let plane = sheet(20_000, random);
    // Lines of flight over a slope: four times as far from each other as the points along them.
    let slope: Vec<Point> = (0..30_000)
        .map(|i| {
            let (along, line) = (0.25 * f64::from(i % 480), f64::from(i / 480));
            let [x, y] = [along, line].map(|v| v + 0.1 * (random.unit() - 0.5));
            [x, y, 0.7 * x]
        })
        .collect();
    let areas = [4.0 * std::f64::consts::PI, 1.0, 120.0 * 62.5 * 1.49_f64.sqrt()];
    for ((name, scan), area) in
        [("sphere", sphere), ("plane", plane), ("slope", slope)].into_iter().zip(areas)
    {
        for part in [0.5, 0.25, 0.1] {
            let points = thinned(&scan, part, random);
            let spacing = (area / points.len() as f64).sqrt();
            let density = Density::new(&built(&points));
            let found = fit(&scan, &density, spacing, LEVELS[1], 400);
            let what = format!("{name}, {part} of the points: {found:?}");
            assert!(found.holes <= 0.01 && found.rms <= 0.25 && found.rms > 0.1, "{what}");
        }
    }
}

/// Measures real scans in the folder `RAYSET_TEST_DATA` and prints the table of docs/benchmarks.md.
#[test]
#[ignore = "a measurement, not a promise: `cargo test --test it -- --ignored --nocapture thinned_real_scans`"]
fn thinned_real_scans() {
    let names = ["lidar/Topography.laz", "scan/lucy.ply", "scan/bun_zipper.ply", "pcd/office1.pcd"];
    println!(
        "| scan | part | spacing | balls: RMS | holes | shapes: RMS | holes | with noise: RMS | holes |\n\
         | --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |"
    );
    for name in names {
        let Some(path) = real_data(name) else { continue };
        let mut source = open(&path, &ReadOptions::default()).expect("it opens");
        let (mut scan, mut batch) = (Vec::new(), PointBatch::default());
        source.select(&[]);
        loop {
            source.fill(&mut batch, 4096).expect("it reads");
            if batch.is_empty() {
                break;
            }
            scan.extend(batch.position.iter().copied().filter(|p| p.iter().all(|v| v.is_finite())));
        }
        let random = &mut Random(10);
        for part in [0.5, 0.25, 0.1] {
            let points = thinned(&scan, part, random);
            let balls = measured(&points);
            // The mean area that belongs to a point, eight of which lie within the distance of the
            // eighth neighbour; those of the hundredth part that is sparsest are left out.
            let mut areas: Vec<f64> = balls
                .iter()
                .map(|(_, radius)| std::f64::consts::PI * (radius / PER_DISTANCE).powi(2) / NEIGHBOUR as f64)
                .collect();
            areas.sort_by(f64::total_cmp);
            areas.truncate(areas.len() * 99 / 100);
            let spacing = (areas.iter().sum::<f64>() / areas.len() as f64).sqrt();
            let ball = |&(position, radius)| Built { position, radius, shape: Shape::BALL };
            let round: Vec<Built> = balls.iter().map(ball).collect();
            let shaped = built(&points);
            let noisy: Vec<Point> = shaped.iter().map(|point| moved(point, 0.5 * spacing, random)).collect();
            let of = |built: &[Built]| fit(&scan, &Density::new(built), spacing, LEVELS[0], 3000);
            let fits = [of(&round), of(&shaped), of(&built(&noisy))];
            let cells = fits.map(|fit| format!("{:.2} | {:.2} %", fit.rms, 100.0 * fit.holes));
            println!("| {name} | {part} | {spacing:.4} | {} |", cells.join(" | "));
        }
    }
}

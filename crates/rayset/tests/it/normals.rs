//! Normals of files decide which way points face: discs lie in the surface that was scanned or
//! modelled, not in the one that its noise suggests.

use rayset::geometry::{DVec3, Shape};
use rayset::octree::build::{BuildOptions, Rule, ShapeRule};
use rayset::points::{ArraySource, MeshSource, PointSource};

use crate::automatic_radii::{Built, built_of};
use crate::build_parts;
use crate::common::{Random, folder};

type Point = [f64; 3];

/// Points of a sloping sheet with a noise of a spacing, and their normals, some of which are none.
struct Scan {
    positions: Vec<Point>,
    normals: [Vec<f32>; 3],
}

const NORMAL: DVec3 = DVec3::new(-0.5, 0.3, 1.0);

impl Scan {
    fn new(count: usize, lacks: impl Fn(usize) -> bool) -> Self {
        let random = &mut Random(41);
        let noise = 1.0 / (count as f64).sqrt();
        let mut place = || {
            let (x, y) = (random.unit(), random.unit());
            [x, y, -x * NORMAL.x - y * NORMAL.y + noise * (random.unit() - 0.5) * 2.0]
        };
        let positions = (0..count).map(|_| place()).collect();
        // Of any length and either sign.
        let normal = |i: usize| {
            if lacks(i) { DVec3::ZERO } else { NORMAL * [1.0, -3.0, 1e-6, 1e9][i % 4] }
        };
        let normals = [0, 1, 2].map(|axis| (0..count).map(|i| normal(i).to_array()[axis] as f32).collect());
        Self { positions, normals }
    }

    fn source(&self, names: [&str; 3]) -> Box<dyn PointSource> {
        let columns = names.into_iter().zip(self.normals.clone()).collect();
        Box::new(ArraySource::new(self.positions.clone(), columns))
    }
}

fn automatic() -> BuildOptions {
    BuildOptions::default().with_radius(Some(Rule::Auto))
}

/// How many points are discs that face along a normal.
fn facing(built: &[Built], normal: DVec3) -> usize {
    let faces = |point: &&Built| {
        let [middle, shortest] = point.shape.ratios;
        let along = (point.shape.rotation * DVec3::Z).dot(normal.normalize()).abs();
        middle == 1.0 && (shortest - 0.15).abs() < 1e-3 && along > 1.0 - 1e-7
    };
    built.iter().filter(faces).count()
}

#[test]
fn points_with_normals_are_discs_that_face_along_them_under_any_name_of_the_columns() {
    let scan = Scan::new(3000, |_| false);
    for names in [
        ["nx", "ny", "nz"],
        ["NX", "NY", "NZ"],
        ["normal_x", "normal_y", "normal_z"],
        ["normalX", "normalY", "normalZ"],
        ["Normals_x", "Normals_y", "Normals_z"],
    ] {
        let built = built_of(vec![scan.source(names)], &automatic());
        assert_eq!((built.len(), facing(&built, NORMAL)), (3000, 3000), "{names:?}");
    }
    let without = built_of(vec![scan.source(["a", "b", "c"])], &automatic());
    assert!(facing(&without, NORMAL) < 30, "the noise hides the surface");
    // Radii are those of discs: 1.15 of the distance of which those of balls are 0.85.
    let round = built_of(vec![scan.source(["nx", "ny", "nz"])], &automatic().with_shape(ShapeRule::Round));
    assert!(round.iter().all(|point| point.shape == Shape::BALL));
    let discs = built_of(vec![scan.source(["nx", "ny", "nz"])], &automatic());
    let sum = |built: &[Built]| built.iter().map(|point| point.radius).sum::<f64>();
    assert!((sum(&discs) / sum(&round) - 1.15 / 0.85).abs() < 1e-3);
    // Those whose radii are given are balls.
    let given = automatic().with_radius(Some(Rule::Number(0.02)));
    let given = built_of(vec![scan.source(["nx", "ny", "nz"])], &given);
    assert!(given.iter().all(|point| point.shape == Shape::BALL && point.radius == f64::from(0.02_f32)));
}

#[test]
fn points_whose_normal_is_none_have_the_shape_that_their_neighbours_suggest() {
    let some = Scan::new(3000, |i| i % 3 == 0);
    let built = built_of(vec![some.source(["nx", "ny", "nz"])], &automatic());
    assert!((2000..2030).contains(&facing(&built, NORMAL)), "{}", facing(&built, NORMAL));
    let measured = built_of(vec![some.source(["a", "b", "c"])], &automatic());
    // Positions are rounded by radii, which differ.
    let key = |point: &Built| point.position.map(f64::to_bits);
    let near = |a: &Built, b: &Built| (0..3).all(|axis| (a.position[axis] - b.position[axis]).abs() < 1e-4);
    let lacking = some.positions.iter().enumerate().filter(|(i, _)| i % 3 == 0).map(|(_, p)| *p);
    for position in lacking.step_by(10) {
        let at = Built { position, radius: 0.0, shape: Shape::BALL };
        let of = |built: &[Built]| *built.iter().find(|point| near(point, &at)).expect("the point");
        let (is, alone) = (of(&built), of(&measured));
        assert_eq!((is.shape, is.radius), (alone.shape, alone.radius), "{position:?}");
    }
    // Columns that are all zero, as of splats, change nothing but the identity of the file.
    let none = Scan::new(3000, |_| true);
    let zero = built_of(vec![none.source(["nx", "ny", "nz"])], &automatic());
    let shapes = |built: &[Built]| {
        built.iter().map(|point| (key(point), point.shape.ratios.map(f64::to_bits))).collect::<Vec<_>>()
    };
    assert_eq!(shapes(&zero), shapes(&built_of(vec![none.source(["a", "b", "c"])], &automatic())));
}

#[test]
fn a_file_with_normals_beside_one_without_is_built_in_parts_as_at_once() {
    let (with, without) = (Scan::new(9000, |i| i % 5 == 0), Scan::new(4000, |_| false));
    let sources = || vec![with.source(["nx", "ny", "nz"]), without.source(["a", "b", "c"])];
    build_parts::check("with normals and without", &sources, &automatic());
    let twice = || vec![with.source(["nx", "ny", "nz"]), with.source(["nx", "ny", "nz"])];
    build_parts::check("twice the same", &twice, &automatic());
}

#[test]
fn points_of_a_mesh_are_discs_in_the_planes_of_its_triangles_up_to_its_edges() {
    let folder = folder();
    let path = folder.path().join("wedge.obj");
    // Two faces at a right angle.
    let text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nv 1 0 1\nf 1 2 3 4\nf 1 2 6 5\n";
    std::fs::write(&path, text).expect("written");
    let source = MeshSource::open(&path, 5000).expect("a mesh");
    let built = built_of(vec![Box::new(source)], &automatic());
    let (level, upright) = (facing(&built, DVec3::Z), facing(&built, DVec3::Y));
    assert_eq!((built.len(), level + upright), (5000, 5000), "{level} and {upright}");
    let near = built.iter().filter(|point| point.position[1].max(point.position[2]) < 0.02);
    assert!(near.count() > 50, "some lie near the edge");
}

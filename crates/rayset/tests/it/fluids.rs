//! Shapes of particles of a fluid: flat along its surface, balls inside.

use rayset::geometry::{DVec3, Shape};
use rayset::octree::build::{self, BuildControl, BuildOptions, Rule, ShapeRule};
use rayset::points::{ArraySource, PointSource};

use crate::automatic_radii::{Built, built_of};
use crate::build_parts;
use crate::common::Random;

/// Particles in a basin of 20 × 20 × 10, one in each unit of space, and a sheet that splashes out
/// of it.
fn basin() -> Box<dyn PointSource> {
    let random = &mut Random(23);
    let mut place = |at: [i32; 3]| at.map(|v| f64::from(v) + 0.4 * (random.unit() - 0.5));
    let body = (0..4000).map(|i| [i % 20, i / 20 % 20, i / 400]);
    let sheet = (0..400).map(|i| [10, i % 20, 10 + i / 20]);
    let positions = body.chain(sheet).map(&mut place).collect();
    let radius = vec![0.5; 4400];
    Box::new(ArraySource::new(positions, vec![("radius", radius)]))
}

fn options() -> BuildOptions {
    BuildOptions::default().with_shape(ShapeRule::Fluid)
}

#[test]
fn particles_of_a_fluid_are_balls_inside_and_flat_along_its_surface() {
    let built = built_of(vec![basin()], &options());
    let of = |is_there: &dyn Fn([f64; 3]) -> bool, normal: DVec3| {
        let there: Vec<Shape> = built.iter().filter(|p| is_there(p.position)).map(|p| p.shape).collect();
        let ratio = there.iter().map(|shape| shape.ratios[1]).sum::<f64>() / there.len() as f64;
        let across = there.iter().map(|shape| (shape.rotation * DVec3::Z).dot(normal).abs());
        (ratio, across.sum::<f64>() / there.len() as f64)
    };
    let middle = |v: f64| (5.0..15.0).contains(&v);
    let (inside, _) = of(&|[x, y, z]| middle(x) && middle(y) && (3.0..6.0).contains(&z), DVec3::Z);
    assert!(inside > 0.95, "{inside}");
    let (surface, upright) = of(&|[x, y, z]| x < 6.0 && middle(y) && (8.7..9.5).contains(&z), DVec3::Z);
    assert!(surface < 0.65 && upright > 0.9, "{surface}, {upright}");
    let (sheet, across) = of(&|[_, y, z]| middle(y) && (16.0..25.0).contains(&z), DVec3::X);
    assert!(sheet < 0.27 && across > 0.99, "{sheet}, {across}");
    // Each has the volume of the ball that it would be, so far as it does not grow too long.
    let round =
        built_of(vec![basin()], &options().with_shape(ShapeRule::Round).with_radius(Some(Rule::Auto)));
    let volume = |built: &[Built]| {
        let inner = built.iter().filter(|point| point.position[2] < 9.5);
        inner.map(|point| point.radius.powi(3) * point.shape.volume()).sum::<f64>()
    };
    let ratio = volume(&built) / volume(&round);
    assert!((0.9..1.001).contains(&ratio), "{ratio}");
}

#[test]
fn a_fluid_is_built_in_parts_as_at_once() {
    build_parts::check("a fluid", &|| vec![basin()], &options());
    build_parts::check("a fluid twice", &|| vec![basin(), basin()], &options());
}

#[test]
fn a_fluid_whose_radii_are_given_is_refused_with_what_to_do() {
    let given = options().with_radius(Some(Rule::Attribute("radius".into())));
    let error =
        build::run_in_memory(vec![basin()], &given, &BuildControl::default()).map(drop).expect_err("refused");
    let expected =
        "shape: shapes of a fluid are measured with the radii: give no radius, and a radius scale if need be";
    assert!(error.to_string().contains(expected), "{error}");
}

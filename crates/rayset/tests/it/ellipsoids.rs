//! Points that are ellipsoids: in files, in the field, in pictures.

use std::sync::Arc;

use rayset::field::{Kernel, SimdLevel};
use rayset::geometry::{DAffine3, DQuat, DVec3};
use rayset::octree::Cloud;
use rayset::octree::build::{BuildError, BuildOptions, InvalidPolicy, Rule, ShapeRule, run_in_memory};
use rayset::octree::verify::Depth;
use rayset::points::{ArraySource, PointSource};
use rayset::scene::{Camera, Node, OpacityRule, Projection, RenderSettings, Scene, Shape, Step};
use rayset::trace::{ExecSettings, render_once};

use crate::common::{Random, bits, folder, look, paged, plain_picture, scene_of, settings};
use crate::right_picture::{check_field, count_wrong_pixels};
use crate::{build_is_pure, build_parts, steps_by_place};

const NAMES: [&str; 12] = [
    "radius",
    "semi_axis_1",
    "semi_axis_2",
    "semi_axis_3",
    "rotation_x",
    "rotation_y",
    "rotation_z",
    "rotation_w",
    "weight",
    "red",
    "green",
    "blue",
];

/// Positions and columns of points as `mixed_points` has them, that are ellipsoids of any
/// directions, whose ratios are down to `2^-thin`.
fn columns(count: usize, octaves: f64, thin: f64, seed: u64) -> (Vec<[f64; 3]>, Vec<Vec<f32>>) {
    let mut random = Random(seed);
    let (mut position, mut columns) = (Vec::new(), vec![Vec::new(); NAMES.len()]);
    for _ in 0..count {
        position.push(std::array::from_fn(|_| 2.0 * random.unit() - 1.0));
        let radius = 0.35 * 2_f64.powf(-octaves * random.unit());
        let ratios = [0, 1].map(|_| 2_f64.powf(-thin * random.unit()));
        let mut axes = [1.0, ratios[0], ratios[1]].map(|ratio| radius * ratio);
        axes.rotate_left((3.0 * random.unit()) as usize);
        let rotation = [0, 1, 2, 3].map(|_| random.unit() - 0.5);
        let rest = [0; 4].map(|_| 0.2 + 0.8 * random.unit());
        let values = [radius].into_iter().chain(axes).chain(rotation).chain(rest);
        columns.iter_mut().zip(values).for_each(|(column, value)| column.push(value as f32));
    }
    (position, columns)
}

fn source((position, columns): (Vec<[f64; 3]>, Vec<Vec<f32>>)) -> ArraySource {
    ArraySource::new(position, NAMES.into_iter().zip(columns).collect())
}

fn built(points: (Vec<[f64; 3]>, Vec<Vec<f32>>)) -> Arc<Cloud> {
    let source: Box<dyn PointSource> = Box::new(source(points));
    let (cloud, _) =
        run_in_memory(vec![source], &BuildOptions::default(), &Default::default()).expect("it builds");
    Arc::new(cloud)
}

#[test]
fn density_and_normals_of_ellipsoids_are_right_for_every_kernel_and_instruction_set() {
    let cloud = built(columns(3000, 4.0, 4.0, 1));
    assert!(cloud.header().shape.is_some());
    for &kernel in Kernel::OF_DENSITIES {
        for simd in SimdLevel::available() {
            check_field(&cloud, 1.0, kernel, simd);
        }
    }
}

#[test]
fn density_is_right_where_ellipsoids_are_a_thousand_times_as_wide_as_thick() {
    let cloud = built(columns(3000, 1.0, 11.0, 2));
    check_field(&cloud, 1.0, Kernel::Wyvill, SimdLevel::default());
}

#[test]
fn many_ellipsoids_in_one_place_have_the_sum_of_their_densities() {
    let (mut position, mut columns) = columns(42, 1.0, 2.0, 9);
    for copy in 0..21 {
        position.push(position[0]);
        // Each has a colour of its own.
        for (number, column) in columns.iter_mut().enumerate() {
            column.push(if number > 8 { copy as f32 / 21.0 } else { column[0] });
        }
    }
    check_field(&built((position, columns)), 1.0, Kernel::Wyvill, SimdLevel::default());
}

#[test]
fn pictures_of_ellipsoids_are_right_with_every_opacity_rule_and_under_any_transform() {
    let cloud = built(columns(2500, 1.0, 2.0, 3));
    let step = f64::from(cloud.header().details().0) * 0.5;
    let mirrored = DAffine3::from_scale_rotation_translation(
        DVec3::new(0.7, -1.2, 1.0),
        DQuat::from_rotation_z(0.4),
        DVec3::new(0.1, 0.0, -0.2),
    );
    let rules = [OpacityRule::Clamp, OpacityRule::Extinction(1.5)];
    for (i, (rule, map)) in rules.iter().flat_map(|r| [(r, DAffine3::IDENTITY), (r, mirrored)]).enumerate() {
        let mut object = look(&cloud, Kernel::OF_DENSITIES[i]);
        object.normalised = i >= 2;
        object.transfer.opacity = rule.clone();
        let mut scene = scene_of(object.clone(), true);
        let node = Node::new(Shape::Cloud(object));
        scene.root = Node { parent_from_local: map, ..node }.into();
        scene.unit_distance = 0.05;
        let settings = RenderSettings { step: Step::Fixed(step), ..settings(48, 48) };
        let wrong = count_wrong_pixels(&scene, &settings, step, 300);
        assert!(wrong <= 1, "scene {i}: {wrong} of 300 pixels beyond 1/1024");
        steps_by_place::check("automatic steps", &scene, 2);
    }
}

#[test]
fn a_file_of_ellipsoids_is_what_it_says_and_the_same_however_it_is_built() {
    let folder = folder();
    let sources = || -> Vec<Box<dyn PointSource>> {
        let sphere = ArraySource::new(sphere(20_000), vec![]);
        vec![Box::new(source(columns(20_000, 4.0, 8.0, 3))), Box::new(sphere)]
    };
    let radius = Some(Rule::Number(0.03));
    let given = BuildOptions { radius, ..BuildOptions::default() };
    let sphere = || -> Vec<Box<dyn PointSource>> { vec![Box::new(ArraySource::new(sphere(40_000), vec![]))] };
    let measured = BuildOptions { radius: Some(Rule::Auto), ..BuildOptions::default() };
    for (name, sources, options) in
        [("given", &sources as &dyn Fn() -> _, &given), ("measured", &sphere, &measured)]
    {
        build_is_pure::check(folder.path(), sources, options);
        build_parts::check(name, sources, options);
        let path = folder.path().join("c.rset");
        rayset::octree::build::run(sources(), &path, options, &Default::default()).expect("it builds");
        let cloud = Cloud::open(&path).expect("it opens");
        assert!(cloud.header().shape.is_some(), "{name}");
        cloud.verify(Depth::Deep).expect("it is whole");
    }
}

/// Points at random on a sphere.
fn sphere(count: usize) -> Vec<[f64; 3]> {
    let mut random = Random(4);
    let place = |random: &mut Random| {
        let (z, turn) = (2.0 * random.unit() - 1.0, std::f64::consts::TAU * random.unit());
        let across = (1.0 - z * z).sqrt();
        [across * turn.cos(), across * turn.sin(), z]
    };
    (0..count).map(|_| place(&mut random)).collect()
}

#[test]
fn ellipsoids_that_are_balls_are_stored_without_shape_and_draw_the_bytes_of_balls() {
    let (position, mut columns) = columns(4000, 2.0, 0.0, 5);
    let ellipsoids = built((position.clone(), columns.clone()));
    let all = NAMES.into_iter().zip(columns.drain(..));
    let without = all.filter(|(name, _)| !name.starts_with("semi") && !name.starts_with("rotation"));
    let balls: Box<dyn PointSource> = Box::new(ArraySource::new(position, without.collect()));
    let (balls, _) =
        run_in_memory(vec![balls], &BuildOptions::default(), &Default::default()).expect("it builds");
    assert_eq!(ellipsoids.header().shape, None);
    assert_eq!(ellipsoids.header().file_bytes, balls.header().file_bytes);
    let [a, b] = [ellipsoids, Arc::new(balls)].map(|cloud| {
        let scene = scene_of(look(&cloud, Kernel::Wyvill), true);
        bits(&plain_picture(&scene, &settings(64, 64)))
    });
    assert!(a == b);
}

#[test]
fn shapes_are_left_out_if_points_are_to_be_round() {
    let source: Box<dyn PointSource> = Box::new(source(columns(2000, 2.0, 4.0, 6)));
    let options = BuildOptions { shape: ShapeRule::Round, ..BuildOptions::default() };
    let (cloud, _) = run_in_memory(vec![source], &options, &Default::default()).expect("it builds");
    assert_eq!(cloud.header().shape, None);
}

#[test]
fn a_turned_object_looks_as_if_the_camera_were_turned_back() {
    let cloud = built(columns(3000, 2.0, 4.0, 7));
    let turn = DQuat::from_xyzw(0.2, -0.5, 0.3, 0.7).normalize();
    let object = look(&cloud, Kernel::Wyvill);
    let node = Node::new(Shape::Cloud(object.clone()));
    let mut turned = scene_of(object.clone(), false);
    turned.root = Node { parent_from_local: DAffine3::from_quat(turn), ..node }.into();
    let settings = settings(64, 64);
    let eye = DVec3::new(0.3, 0.4, 4.0);
    let seen = |scene: &Scene, back: DQuat| {
        let camera = Camera::look_at(back * eye, DVec3::ZERO, back * DVec3::Y, 0.6);
        let files = paged(scene, u64::MAX / 2);
        render_once(scene, &camera, &settings, &ExecSettings::default(), &files).expect("a picture").0.pixels
    };
    let (a, b) = (seen(&turned, DQuat::IDENTITY), seen(&scene_of(object, false), turn.inverse()));
    let differing = a.iter().zip(&b).filter(|(a, b)| (0..4).any(|c| (a[c] - b[c]).abs() > 1.0 / 1024.0));
    assert!(differing.count() <= 4, "of 4096 pixels");
    assert!(a.iter().filter(|pixel| pixel[3] > 0.5).count() > 500);
}

#[test]
fn points_without_a_shape_or_of_impossible_ones_are_skipped_and_counted() {
    let hostile: [[f32; 7]; 8] = [
        [0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        [-1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        [f32::NAN, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        [f32::INFINITY, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        [1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0],
        [1.0, 1.0, 1.0, f32::NAN, 0.0, 0.0, 1.0],
        [1.0, 1.0, 1.0, 0.0, f32::INFINITY, 0.0, 1.0],
        // Thinner than anything that is stored: as thin as that.
        [1.0, 1e-30, 1e-38, 0.0, 0.0, 1e-30, 1e30],
    ];
    let (mut position, mut columns) = columns(500, 1.0, 2.0, 8);
    for shape in hostile {
        position.push([0.0; 3]);
        let values = [0.1].into_iter().chain(shape).chain([1.0; 4]);
        columns.iter_mut().zip(values).for_each(|(column, value)| column.push(value));
    }
    let source =
        || -> Vec<Box<dyn PointSource>> { vec![Box::new(source((position.clone(), columns.clone())))] };
    let (cloud, report) =
        run_in_memory(source(), &BuildOptions::default(), &Default::default()).expect("it builds");
    assert_eq!((report.points, report.skipped.radius), (501, 7));
    cloud.verify(Depth::Deep).expect("it is whole");
    let scene = scene_of(look(&Arc::new(cloud), Kernel::Gaussian), true);
    assert!(plain_picture(&scene, &settings(32, 32)).iter().flatten().all(|v| v.is_finite()));
    let options = BuildOptions { invalid: InvalidPolicy::Reject, ..BuildOptions::default() };
    let error = run_in_memory(source(), &options, &Default::default()).map(drop);
    assert!(
        matches!(&error, Err(BuildError::InvalidRecord { index: 500, what, .. }) if what.contains("semi-axes"))
    );
}

#[test]
fn the_mass_of_the_stored_shapes_is_that_of_their_weights() {
    let cloud = built(columns(60, 1.0, 3.0, 9));
    let mut object = look(&cloud, Kernel::Triweight);
    object.normalised = true;
    // So thin that light is lost in proportion to what a ray meets.
    object.transfer.opacity = OpacityRule::Extinction(1e-4);
    let scene = scene_of(object, false);
    let step = f64::from(cloud.header().details().0) * 0.25;
    let settings = RenderSettings { step: Step::Fixed(step), stop_transmittance: 0.0, ..settings(300, 300) };
    let width = 3.0;
    let camera = Camera {
        projection: Projection::Orthographic { height: width },
        ..Camera::look_at(DVec3::new(0.0, 0.0, 8.0), DVec3::ZERO, DVec3::Y, 0.5)
    };
    let files = paged(&scene, u64::MAX / 2);
    let (picture, _) =
        render_once(&scene, &camera, &settings, &ExecSettings::default(), &files).expect("a picture");
    let depths = picture.pixels.iter().map(|pixel| -f64::from(-pixel[3]).ln_1p());
    let mass = depths.sum::<f64>() / 1e-4 * (width / 300.0_f64).powi(2);
    let mut weights = 0.0;
    cloud
        .for_each_run(|_, run| {
            weights += run.weights(cloud.header()).into_iter().flatten().map(f64::from).sum::<f64>();
        })
        .expect("it reads");
    assert!((mass / weights - 1.0).abs() < 1e-3, "{mass} of {weights}");
}

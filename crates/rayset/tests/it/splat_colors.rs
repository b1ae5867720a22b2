//! Colours of splats that change with the direction from which they are seen.

use std::sync::Arc;

use rayset::field::{Kernel, linear_from_srgb};
use rayset::geometry::{DAffine3, DQuat, DVec3};
use rayset::octree::Cloud;
use rayset::octree::build::{BuildError, BuildOptions, BuildReport, run_in_memory};
use rayset::octree::harmonics::decode;
use rayset::points::{ArraySource, HARMONIC, HARMONIC_CONSTANTS, PointSource};
use rayset::scene::{Camera, CloudObject, Compositing, Node, OpacityRule, Projection, RenderSettings, Scene};
use rayset::scene::{Shape, Step};
use rayset::trace::ExecSettings;

use crate::common::{Random, bits, camera, look, paged, picture, plain_picture, scene_of, settings};
use crate::right_picture::count_wrong_pixels;

/// Y₀, the constant harmonic.
const CONSTANT: f64 = 0.282_094_791_773_878_14;

/// Coefficients of a point of some degree: for each channel the constant one, then the others.
type Coefficients = [Vec<f64>; 3];

/// Splats at places, all balls of the same size and opacity.
fn built(
    places: &[[f64; 3]],
    coefficients: &[Coefficients],
    options: &BuildOptions,
) -> Result<(Arc<Cloud>, BuildReport), BuildError> {
    let count = coefficients[0][0].len();
    let column =
        |channel: usize, k: usize| coefficients.iter().map(|c| c[channel][k] as f32).collect::<Vec<_>>();
    let color =
        |channel: usize| column(channel, 0).iter().map(|c| 0.5 + CONSTANT as f32 * c).collect::<Vec<_>>();
    let names: Vec<String> = (0..3 * (count - 1)).map(|i| format!("{HARMONIC}{i}")).collect();
    let mut columns: Vec<(&str, Vec<f32>)> = vec![
        ("radius", vec![0.4; places.len()]),
        ("weight", vec![0.9; places.len()]),
        ("red", color(0)),
        ("green", color(1)),
        ("blue", color(2)),
    ];
    columns.extend(HARMONIC_CONSTANTS.iter().enumerate().map(|(channel, name)| (*name, column(channel, 0))));
    let rest = (0..3).flat_map(|channel| (1..count).map(move |k| (channel, k)));
    columns.extend(
        names.iter().map(String::as_str).zip(rest).map(|(name, (channel, k))| (name, column(channel, k))),
    );
    let source: Box<dyn PointSource> = Box::new(ArraySource::new(places.to_vec(), columns));
    run_in_memory(vec![source], options, &Default::default())
        .map(|(cloud, summary)| (Arc::new(cloud), summary))
}

fn random_splats(count: usize, degree: usize, seed: u64) -> (Vec<[f64; 3]>, Vec<Coefficients>) {
    let mut random = Random(seed);
    let mut number = |size: f64| (2.0 * random.unit() - 1.0) * size;
    let places = (0..count).map(|_| [number(0.8), number(0.8), number(0.8)]).collect();
    let of_channel = |number: &mut dyn FnMut(f64) -> f64| -> Vec<f64> {
        let constant = std::iter::once(number(2.5));
        constant.chain((1..(degree + 1).pow(2)).map(|_| number(0.4))).collect()
    };
    let coefficients = (0..count).map(|_| std::array::from_fn(|_| of_channel(&mut number))).collect();
    (places, coefficients)
}

fn object(cloud: &Arc<Cloud>) -> CloudObject {
    let mut object = look(cloud, Kernel::Splat);
    object.transfer.opacity = OpacityRule::Extinction(1.0);
    object
}

#[test]
fn a_splat_shows_the_colour_of_the_direction_it_is_seen_in_turned_with_its_object() {
    // Red where it is seen along -z, blue along +y; darker than black along the other ways.
    let red = vec![0.0, 0.0, -1.0, 0.0];
    let blue = vec![0.0, -1.0, 0.0, 0.0];
    let (cloud, _) =
        built(&[[0.0; 3]], &[[red, vec![0.0; 4], blue]], &BuildOptions::default()).expect("it builds");
    assert_eq!(cloud.header().harmonics, 1);
    let exec = ExecSettings::default();
    let settings = RenderSettings { stop_transmittance: 0.0, ..settings(9, 9) };
    for (eye, turned) in [
        (DVec3::new(0.0, 0.0, 3.0), DQuat::IDENTITY),
        (DVec3::new(0.0, -3.0, 0.0), DQuat::IDENTITY),
        (DVec3::new(0.0, 3.0, 0.0), DQuat::IDENTITY),
        (DVec3::new(0.0, 0.0, 3.0), DQuat::from_rotation_x(1.0)),
        (DVec3::new(1.0, 2.0, -2.0), DQuat::from_rotation_z(2.0)),
    ] {
        for compositing in [Compositing::Linear, Compositing::Display] {
            for is_parallel in [false, true] {
                let node = Node::new(Shape::Cloud(object(&cloud)));
                let root = Arc::new(node.moved(DAffine3::from_quat(turned)));
                let scene = Scene { root, compositing, ..scene_of(object(&cloud), false) };
                let mut camera = Camera::look_at(eye, DVec3::ZERO, DVec3::X, 0.6);
                if is_parallel {
                    camera.projection = Projection::Orthographic { height: 1.0 };
                }
                let files = paged(&scene, u64::MAX / 2);
                let pixels = picture(&scene, &camera, &settings, &exec, &files).expect("a picture");
                let [r, g, b, opacity] = pixels[40].map(f64::from);
                let direction = turned.inverse() * -eye.normalize();
                let factor = 0.488_602_511_902_919_9;
                let expected = [0.5 - factor * direction.z, 0.5, 0.5 + factor * direction.y];
                for (shown, expected) in [r, g, b].into_iter().zip(expected) {
                    let expected = linear_from_srgb(expected.max(0.0));
                    assert!(
                        (shown / opacity - expected).abs() < 0.01,
                        "{eye}: {shown} / {opacity}, {expected}"
                    );
                }
            }
        }
    }
}

#[test]
fn colours_of_every_degree_are_those_of_the_reference_under_any_transform() {
    let mirrored = DAffine3::from_scale_rotation_translation(
        DVec3::new(0.7, -1.2, 1.0),
        DQuat::from_rotation_z(0.4),
        DVec3::new(0.1, 0.0, -0.2),
    );
    for (degree, map) in [(1, DAffine3::IDENTITY), (2, mirrored), (3, DAffine3::IDENTITY), (3, mirrored)] {
        let (places, coefficients) = random_splats(300, degree, degree as u64);
        let (cloud, _) = built(&places, &coefficients, &BuildOptions::default()).expect("it builds");
        assert_eq!(usize::from(cloud.header().harmonics), degree);
        let node = Node { parent_from_local: map, ..Node::new(Shape::Cloud(object(&cloud))) };
        for (compositing, is_lit) in [(Compositing::Display, false), (Compositing::Linear, true)] {
            let root = Arc::new(node.clone());
            let scene = Scene { root, compositing, unit_distance: 0.03, ..scene_of(object(&cloud), is_lit) };
            let settings = RenderSettings { step: Step::Fixed(0.05), ..settings(48, 48) };
            let wrong = count_wrong_pixels(&scene, &settings, 0.05, 200);
            assert!(wrong <= 1, "degree {degree}, {compositing:?}: {wrong} of 200 pixels beyond 1/1024");
        }
    }
}

#[test]
fn coefficients_are_stored_in_a_byte_each_and_what_colours_leave_out_with_them() {
    for degree in 1..=3 {
        let (places, coefficients) = random_splats(400, degree, 5);
        let (cloud, _) = built(&places, &coefficients, &BuildOptions::default()).expect("it builds");
        let (count, bytes) = ((degree + 1).pow(2), [0, 12, 28, 48][degree]);
        let header = cloud.header();
        let mut seen = 0;
        let found = cloud.for_each_run(|_, run| {
            let stored = run.harmonics(header).expect("coefficients");
            let colors = run.colors(header).expect("colours");
            let positions = run.positions(header.root_cell());
            assert_eq!(stored.len(), bytes * run.head.len());
            for ((position, color), stored) in positions.iter().zip(colors).zip(stored.chunks_exact(bytes)) {
                let is_here = |p: &&[f64; 3]| position.distance(DVec3::from_array(**p)) < 1e-3;
                let of = places.iter().position(|p| is_here(&p)).expect("a place");
                for channel in 0..3 {
                    let given = &coefficients[of][channel];
                    let shown = f64::from(color[channel]) / 255.0 + f64::from(decode(stored[channel]));
                    assert!((shown - (0.5 + CONSTANT * given[0])).abs() < 0.007, "{shown}, {}", given[0]);
                    for k in 1..count {
                        let found = f64::from(decode(stored[3 * k + channel]));
                        assert!((found - given[k]).abs() < 0.0112 * given[k].abs().sqrt() + 2e-4, "{found}");
                    }
                }
                assert!(stored[3 * count..].iter().all(|byte| *byte == 0));
                seen += 1;
            }
        });
        found.expect("it reads");
        assert_eq!(seen, places.len());
    }
}

#[test]
fn splats_without_finite_coefficients_are_skipped_and_without_colours_there_are_none() {
    let (places, mut coefficients) = random_splats(20, 2, 9);
    coefficients[3][1][4] = f64::INFINITY;
    coefficients[7][2][0] = f64::NAN;
    coefficients[11][0][8] = 1e30;
    let (cloud, summary) = built(&places, &coefficients, &BuildOptions::default()).expect("it builds");
    assert_eq!((summary.skipped.weight, cloud.header().points), (2, 18));
    let (plain, _) =
        built(&places, &coefficients, &BuildOptions::default().with_keep_color(false)).expect("it builds");
    assert_eq!((plain.header().harmonics, plain.header().points), (0, 20));
}

#[test]
fn threads_and_memory_do_not_change_colours() {
    let (places, coefficients) = random_splats(3000, 3, 4);
    let (cloud, _) = built(&places, &coefficients, &BuildOptions::default()).expect("it builds");
    let scene = scene_of(object(&cloud), false);
    let settings = settings(40, 40);
    let whole = bits(&plain_picture(&scene, &settings));
    let exec = ExecSettings { threads: 1, slab_samples: 8, ..ExecSettings::default() };
    let small = picture(&scene, &camera(), &settings, &exec, &paged(&scene, 3 << 20)).expect("a picture");
    assert_eq!(whole, bits(&small));
}

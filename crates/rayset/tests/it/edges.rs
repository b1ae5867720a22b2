//! Promise 7: edges are defined.

use rayset::field::Kernel;
use rayset::geometry::DVec3;
use rayset::octree::Cloud;
use rayset::octree::build::{
    self, BuildControl, BuildError, BuildOptions, InvalidPolicy, Precision, Quantity, Rule,
};
use rayset::octree::verify::Depth;
use rayset::points::ArraySource;
use rayset::scene::Camera;
use rayset::trace::ExecSettings;
use rayset::trace::reference::{ReferenceRenderer, ReferenceSteps};

use crate::common::{
    Random, build_at, camera, folder, look, paged, picture, plain_picture, scene, scene_of, settings,
};

#[test]
fn invalid_positions_radii_and_weights_are_counted_and_skipped_or_rejected() {
    let folder = folder();
    let (nan, inf) = (f32::NAN, f32::INFINITY);
    let cases: [([f64; 3], f32, f32); 11] = [
        ([0.0; 3], 0.5, 1.0),
        ([f64::NAN, 0.0, 0.0], 0.5, 1.0),
        ([0.0, f64::INFINITY, 0.0], 0.5, 1.0),
        ([0.0, 0.0, 1e300], 0.5, 1.0),
        ([0.1, 0.0, 0.0], 0.0, 1.0),
        ([0.1, 0.0, 0.0], -1.0, 1.0),
        ([0.1, 0.0, 0.0], nan, 1.0),
        ([0.1, 0.0, 0.0], inf, 1.0),
        ([0.1, 0.0, 0.0], 0.5, nan),
        ([0.1, 0.0, 0.0], 0.5, -inf),
        // A weight of zero or below is a number like any other.
        ([0.2, 0.0, 0.0], 0.5, -0.5),
    ];
    let source = || {
        let column = |f: fn(&([f64; 3], f32, f32)) -> f32| cases.iter().map(f).collect();
        let columns = vec![("radius", column(|c| c.1)), ("weight", column(|c| c.2))];
        ArraySource::new(cases.iter().map(|c| c.0).collect(), columns)
    };
    let path = folder.path().join("c.rset");
    let error =
        build::run(vec![Box::new(source())], &path, &BuildOptions::default(), &BuildControl::default())
            .expect_err("a coordinate of 1e300 is no missing value by itself");
    assert!(
        matches!(error, BuildError::OutOfRange { quantity: Quantity::Position, count: 1, .. }),
        "{error}"
    );
    let options = BuildOptions { invalid: InvalidPolicy::SkipAll, ..BuildOptions::default() };
    let report =
        build::run(vec![Box::new(source())], &path, &options, &BuildControl::default()).expect("it builds");
    assert_eq!(
        (report.points, report.skipped.position, report.skipped.radius, report.skipped.weight),
        (2, 3, 4, 2)
    );
    let cloud = std::sync::Arc::new(Cloud::open(&path).expect("it opens"));
    assert_eq!(cloud.header().skipped, 9);
    let pixels = plain_picture(&scene(&cloud, Kernel::Wyvill, true), &settings(32, 32));
    assert!(pixels.iter().flatten().all(|v| v.is_finite()));

    let options = BuildOptions { invalid: InvalidPolicy::Reject, ..BuildOptions::default() };
    let error = build::run(vec![Box::new(source())], &path, &options, &BuildControl::default())
        .expect_err("it is rejected");
    assert!(matches!(error, BuildError::InvalidRecord { input: 1, index: 1, .. }), "{error}");
}

#[test]
fn no_points_make_an_empty_cloud_and_an_empty_picture() {
    let folder = folder();
    for rule in [None, Some(Rule::Number(1.0))] {
        let options = BuildOptions { radius: rule, ..BuildOptions::default() };
        let cloud =
            build_at(&folder.path().join("c.rset"), Box::new(ArraySource::new(vec![], vec![])), &options);
        assert_eq!(cloud.header().points, 0);
        cloud.verify(Depth::Deep).expect("an empty cloud is whole");
        let pixels = plain_picture(&scene(&cloud, Kernel::Wyvill, true), &settings(16, 16));
        assert!(pixels.iter().all(|p| *p == [0.0; 4]));
    }
}

#[test]
fn one_point_and_equal_points_are_balls() {
    let folder = folder();
    for count in [1, 2, 500] {
        for rule in [Rule::Number(0.8), Rule::Auto] {
            let radius_scale = if rule == Rule::Auto { 0.8 } else { 1.0 };
            let options = BuildOptions { radius: Some(rule), radius_scale, ..BuildOptions::default() };
            let source = ArraySource::new(vec![[0.0; 3]; count], vec![]);
            let cloud = build_at(&folder.path().join("c.rset"), Box::new(source), &options);
            assert_eq!(cloud.header().radius.max(), 0.8, "{count} points");
            let pixels = plain_picture(&scene(&cloud, Kernel::Wyvill, true), &settings(33, 33));
            assert!(pixels[16 * 33 + 16][3] > 0.1, "the ball shows");
            assert_eq!(pixels[0], [0.0; 4]);
        }
    }
}

#[test]
fn coordinates_too_small_for_their_squares_are_kept_within_what_the_file_says() {
    let folder = folder();
    for size in [1e-300, 1e-170, 1e-40, 1e-18, 1e-9] {
        for offset in [0.0, 1e-12] {
            let place = |i: u32| [-0.3, 0.7, 0.1].map(|v| offset + size * (2.0 + (v * f64::from(i)).sin()));
            let source = ArraySource::new((0..40).map(place).collect(), vec![]);
            let radius = Some(Rule::Number(size.max(1e-18)));
            let options = BuildOptions { radius, ..BuildOptions::default() };
            let cloud = build_at(&folder.path().join("c.rset"), Box::new(source), &options);
            cloud.verify(Depth::Deep).unwrap_or_else(|e| panic!("size {size}, offset {offset}: {e}"));
        }
    }
}

#[test]
fn clouds_of_few_points_at_decimal_places_are_whole() {
    let folder = folder();
    let mut random = Random(17);
    for round in 0..400 {
        let digits = 10_f64.powi(round % 4);
        let count = 1 + round as usize / 100;
        let mut place = || std::array::from_fn(|_| ((random.unit() - 0.3) * 50.0 * digits).round() / digits);
        let mut position: Vec<[f64; 3]> = (0..count).map(|_| place()).collect();
        if round == 0 {
            // The bounds of its run round to less than 2.1 along x.
            position = vec![[2.1, 1.0, 2.0]];
        }
        for rule in [Rule::Auto, Rule::Number(1e-17)] {
            let source = ArraySource::new(position.clone(), vec![]);
            let options = BuildOptions { radius: Some(rule), ..BuildOptions::default() };
            let cloud = build_at(&folder.path().join("c.rset"), Box::new(source), &options);
            cloud.verify(Depth::Deep).unwrap_or_else(|e| panic!("{position:?}: {e}"));
        }
    }
}

#[test]
fn millimetres_at_ten_million_metres_keep_their_shape() {
    let folder = folder();
    // A ring of millimetre points, near the origin and ten million metres away.
    let ring = |offset: f64| {
        let position = (0..2000)
            .map(|i| {
                let (s, c) = (f64::from(i) * 0.01).sin_cos();
                [offset + c, offset + s, 0.2 * (f64::from(i) * 0.77).sin() - offset]
            })
            .collect();
        ArraySource::new(position, vec![])
    };
    for precision in [Precision::Exact, Precision::default()] {
        let options =
            BuildOptions { radius: Some(Rule::Number(0.004)), precision, ..BuildOptions::default() };
        let offset = 1e7;
        let cloud = build_at(&folder.path().join("far.rset"), Box::new(ring(offset)), &options);
        assert!(cloud.header().position_error <= 0.004 / 4096.0);
        let far = scene(&cloud, Kernel::Wyvill, false);
        let center = DVec3::new(offset, offset, -offset);
        let eye = Camera::look_at(center + DVec3::Z * 3.0, center, DVec3::Y, 45_f64.to_radians());
        let exec = ExecSettings { threads: 2, ..ExecSettings::default() };
        let size = settings(64, 64);
        let found = picture(&far, &eye, &size, &exec, &paged(&far, 1 << 30)).expect("a picture");
        let reference_renderer = ReferenceRenderer::load(&far).expect("it reads");
        let (mut covered, mut wrong) = (0, 0);
        for y in 0..64 {
            for x in 0..64 {
                let exact = reference_renderer
                    .pixel(&eye, &size, &ReferenceSteps::same(0.001), x, y)
                    .expect("a camera");
                covered += usize::from(exact[3] > 0.01);
                wrong +=
                    usize::from((exact[3] - f64::from(found[(y * 64 + x) as usize][3])).abs() > 1.0 / 1024.0);
            }
        }
        assert!(covered > 20, "the ring shows: {covered} pixels");
        // The reference renderer itself has digits to 2e-9 m there, and samples a hundred times
        // wider apart.
        assert!(wrong <= 4, "{wrong} of 4096 pixels differ ({precision:?})");
    }
}

#[test]
fn rays_along_the_axes_and_from_inside_are_like_any_other() {
    let folder = folder();
    let cloud = crate::common::workload_cloud("cube-20k", folder.path());
    let scene = scene(&cloud, Kernel::Triweight, false);
    let exec = ExecSettings { threads: 2, ..ExecSettings::default() };
    let size = settings(24, 24);
    for (eye, target) in
        [(DVec3::ZERO, DVec3::X), (DVec3::new(0.0, 2.0, 0.0), DVec3::ZERO), (DVec3::splat(0.2), DVec3::NEG_Z)]
    {
        let up = if (target - eye).normalize().abs().y > 0.9 { DVec3::X } else { DVec3::Y };
        let mut view = Camera::look_at(eye, target, up, 1.0);
        for orthographic in [false, true] {
            if orthographic {
                view.projection = rayset::scene::Projection::Orthographic { height: 1.2 };
            }
            let found = picture(&scene, &view, &size, &exec, &paged(&scene, 1 << 30)).expect("a picture");
            let reference_renderer = ReferenceRenderer::load(&scene).expect("it reads");
            let step = f64::from(cloud.header().radius.max()) * 0.25;
            for (x, y) in [(3, 4), (12, 12), (20, 7), (11, 23)] {
                let exact = reference_renderer
                    .pixel(&view, &size, &ReferenceSteps::same(step), x, y)
                    .expect("a camera");
                let error = (exact[3] - f64::from(found[(y * 24 + x) as usize][3])).abs();
                assert!(error < 1.0 / 1024.0, "{eye} to {target}: {error}");
            }
        }
    }
}

#[test]
fn cameras_and_settings_out_of_range_are_errors() {
    let folder = folder();
    let cloud = crate::common::workload_cloud("cube-1k", folder.path());
    let scene = scene(&cloud, Kernel::Wyvill, false);
    let exec = ExecSettings::default();
    let set = paged(&scene, 1 << 30);
    let mut bad = camera();
    bad.up = bad.direction;
    assert!(picture(&scene, &bad, &settings(8, 8), &exec, &set).is_err());
    assert!(picture(&scene, &camera(), &settings(0, 8), &exec, &set).is_err());
    let mut dark = scene.clone();
    dark.unit_distance = 0.0;
    assert!(picture(&dark, &camera(), &settings(8, 8), &exec, &set).is_err());
    let mut object = look(&cloud, Kernel::Wyvill);
    object.transfer.color = rayset::scene::ColorRule::Points;
    let colored = scene_of(object, false);
    let error = picture(&colored, &camera(), &settings(8, 8), &exec, &set).expect_err("there are no colours");
    assert!(error.to_string().contains("stores no colours"), "{error}");
}

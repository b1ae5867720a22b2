//! The filters by which splats are kept from being seen smaller than a pixel.

use std::path::Path;
use std::sync::Arc;

use rayset::geometry::{DAffine3, DMat3, DQuat, DVec3};
use rayset::octree::Cloud;
use rayset::scene::{
    Camera, CloudObject, Compositing, Form, Kernel, Light, LightKind, Lighting, Node, Operator, Projection,
    RenderSettings, Scene, SceneError, Shadows, Shape, SplatFilter, Step, TransferError,
};
use rayset::scene_file::SceneFile;
use rayset::trace::ExecSettings;

use crate::common::{bits, camera, paged, picture, plain_picture, scene_of, settings};
use crate::graph::solid;
use crate::right_picture::count_wrong_pixels;
use crate::splat_light::{CUT, Splat, built, object, splats};

const FILTERS: [SplatFilter; 2] = [SplatFilter::Dilated, SplatFilter::Mip];

fn filtered(cloud: &Arc<Cloud>, filter: SplatFilter) -> CloudObject {
    CloudObject { splat_filter: filter, ..object(cloud) }
}

/// A parallel camera, of which a picture is so high.
fn parallel(height: f64) -> Camera {
    Camera { projection: Projection::Orthographic { height }, ..camera() }
}

fn seen(object: CloudObject, camera: &Camera, width: u32, step: f64) -> Vec<[f32; 4]> {
    let scene = scene_of(object, false);
    let settings =
        RenderSettings { step: Step::Fixed(step), stop_transmittance: 0.0, ..settings(width, width) };
    picture(&scene, camera, &settings, &ExecSettings::default(), &paged(&scene, u64::MAX / 2))
        .expect("a picture")
}

/// What a renderer of splats leaves of the light of a pixel, seen along -z, `pixel` wide: of each
/// splat the covariance is projected to the picture, and its filter added. At least, and at most
/// where what is less than one part in [`CUT`] is left out.
fn left(splats: &[Splat], filter: SplatFilter, pixel: f64, at: DVec3) -> (f64, f64) {
    let (variance, compensates) = match filter {
        SplatFilter::Mip => (0.1, true),
        SplatFilter::Dilated => (0.3, false),
        _ => (0.0, false),
    };
    splats.iter().fold((1.0, 1.0), |(least, most), (center, deviations, rotation, opacity)| {
        let axes = DMat3::from_quat(*rotation);
        let sigma = axes * DMat3::from_diagonal(*deviations * *deviations) * axes.transpose();
        let (a, b, c) = (sigma.x_axis.x, sigma.x_axis.y, sigma.y_axis.y);
        let added = variance * pixel * pixel;
        let (wide_a, wide_c) = (a + added, c + added);
        let (before, after) = (a * c - b * b, wide_a * wide_c - b * b);
        let (x, y) = (at.x - center.x, at.y - center.y);
        let distance = (wide_c * x * x - 2.0 * b * x * y + wide_a * y * y) / after;
        let opacity = if compensates { opacity * (before / after).sqrt() } else { *opacity };
        let alpha = opacity * (-0.5 * distance).exp();
        let cut = if alpha < 1.0 / CUT { 0.0 } else { (alpha - 1.0 / CUT).max(0.0) };
        (least * (1.0 - alpha), most * (1.0 - cut))
    })
}

#[test]
fn pixels_show_what_splat_renderers_leave_with_their_filter_however_small_splats_are() {
    const WIDTH: u32 = 40;
    let pixel = 2.0 / f64::from(WIDTH);
    // From a third of a pixel to several, and from a fiftieth.
    for (count, size) in [(1, 0.1), (300, 0.05), (300, 0.01)] {
        let splats = splats(count, size, 0.95, 11);
        let cloud = built(&splats);
        for filter in FILTERS {
            for step in [0.02, 0.9] {
                let shown = seen(filtered(&cloud, filter), &parallel(2.0), WIDTH, step);
                let mut covered = 0;
                for (i, pixels) in shown.iter().enumerate() {
                    let (x, y) = (i as u32 % WIDTH, i as u32 / WIDTH);
                    let at = DVec3::new(
                        (f64::from(x) + 0.5) * pixel - 1.0,
                        1.0 - (f64::from(y) + 0.5) * pixel,
                        0.0,
                    );
                    let (least, most) = left(&splats, filter, pixel, at);
                    let transmittance = 1.0 - f64::from(pixels[3]);
                    assert!(
                        (least - 1e-3..=most + 1e-3).contains(&transmittance),
                        "{count} of {size}, {filter}, pixel {x}, {y}: {transmittance}, {least} to {most}"
                    );
                    covered += usize::from(least < 0.99);
                }
                assert!(covered > 4, "{count} of {size}, {filter}: {covered} pixels show anything");
            }
        }
    }
}

#[test]
fn filtered_splats_are_those_of_the_reference_lit_cut_and_under_any_transform() {
    let cloud = built(&splats(300, 0.08, 0.99, 7));
    let mirrored = DAffine3::from_scale_rotation_translation(
        DVec3::new(0.7, -1.2, 1.0),
        DQuat::from_rotation_z(0.4),
        DVec3::new(0.1, 0.0, -0.2),
    );
    for filter in FILTERS {
        for map in [DAffine3::IDENTITY, mirrored] {
            let node = Node::new(Shape::Cloud(filtered(&cloud, filter)));
            let splats = Arc::new(Node { parent_from_local: map, ..node });
            let solid = solid(Form::Box { size: DVec3::new(3.0, 1.0, 1.0) }, [0.6; 3]);
            let solid = Arc::new(solid.moved(DAffine3::from_translation(DVec3::new(0.0, 0.4, 0.3))));
            let cut = Node::new(Shape::Operator(Operator::Difference, vec![splats.clone(), solid]));
            for root in [splats, Arc::new(cut)] {
                let mut scene = scene_of(object(&cloud), true);
                (scene.root, scene.unit_distance, scene.compositing) = (root, 0.03, Compositing::Display);
                let settings = RenderSettings { step: Step::Fixed(0.05), ..settings(24, 24) };
                let wrong = count_wrong_pixels(&scene, &settings, 0.05, 200);
                assert!(wrong <= 1, "{filter}: {wrong} of 200 pixels beyond 1/1024");
            }
        }
    }
}

#[test]
fn splats_smaller_than_a_pixel_are_shown_whole_beyond_the_box_of_their_points() {
    // Balls without shapes, and discs; each so small that its pixel says nothing of its form.
    let of = |thin: f64| (DVec3::ZERO, DVec3::new(1e-4, 1e-4, 1e-4 * thin), DQuat::IDENTITY, 0.9);
    for thin in [1.0, 0.1] {
        let cloud = built(&[of(thin)]);
        assert_eq!(cloud.header().shape.is_some(), thin < 1.0);
        for camera in [parallel(2.0), camera()] {
            let shown = seen(filtered(&cloud, SplatFilter::Dilated), &camera, 9, 0.01);
            for (i, pixel) in shown.iter().enumerate() {
                let (x, y) = ((i % 9) as f64 - 4.0, (i / 9) as f64 - 4.0);
                let alpha = 0.9 * (-(x * x + y * y) / 0.6).exp();
                let is_close = (f64::from(pixel[3]) - alpha).abs() < 2.5e-3;
                assert!(is_close, "{thin}, pixel {x}, {y}: {} and {alpha}", pixel[3]);
            }
        }
    }
}

#[test]
fn what_is_farther_than_splats_reach_without_a_filter_cuts_what_they_reach_with_it() {
    // Pixels of a quarter, and what is cut away begins a pixel beyond a splat that is far smaller.
    let small = (DVec3::new(-0.125, 0.125, 0.0), DVec3::splat(1e-3), DQuat::IDENTITY, 0.9);
    let cloud = built(&[small]);
    let cut = solid(Form::Box { size: DVec3::splat(4.0) }, [1.0; 3]);
    let beyond = Arc::new(cut.moved(DAffine3::from_translation(DVec3::new(2.0, 0.0, 0.0))));
    let splats = Arc::new(Node::new(Shape::Cloud(filtered(&cloud, SplatFilter::Dilated))));
    let shown = |operator, other: &Arc<Node>| {
        let mut scene = scene_of(object(&cloud), false);
        let children = vec![splats.clone(), other.clone()];
        (scene.root, scene.unit_distance) = (Arc::new(Node::new(Shape::Operator(operator, children))), 0.01);
        let settings = RenderSettings { step: Step::Fixed(0.02), stop_transmittance: 0.0, ..settings(8, 8) };
        let files = paged(&scene, u64::MAX / 2);
        picture(&scene, &parallel(2.0), &settings, &ExecSettings::default(), &files).expect("a picture")
    };
    let alpha = |pixels: f64| 0.9 * (-pixels * pixels / 0.6).exp();
    let row = |pixels: Vec<[f32; 4]>| [2, 3, 4].map(|x| f64::from(pixels[3 * 8 + x][3]));
    let close = |found: [f64; 3], expected: [f64; 3]| {
        let is_close = found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 4e-3);
        assert!(is_close, "{found:?} and {expected:?}");
    };
    close(row(shown(Operator::Difference, &beyond)), [alpha(1.0), alpha(0.0), 0.0]);
    close(row(shown(Operator::Intersection, &beyond)), [0.0, 0.0, alpha(1.0)]);
}

#[test]
fn the_mip_filter_keeps_what_splats_absorb_in_all_at_any_resolution() {
    let cloud = built(&splats(60, 0.05, 0.3, 5));
    let absorbed = |width: u32, filter| {
        let shown = seen(filtered(&cloud, filter), &parallel(2.4), width, 0.05);
        let depth = |pixel: &[f32; 4]| -f64::from(1.0 - pixel[3]).ln();
        shown.iter().map(depth).sum::<f64>() / f64::from(width * width)
    };
    let truth = absorbed(256, SplatFilter::None);
    for width in [32, 64] {
        let (mip, dilated) = (absorbed(width, SplatFilter::Mip), absorbed(width, SplatFilter::Dilated));
        // Of what becomes fainter, more is cut off.
        assert!((0.93..1.01).contains(&(mip / truth)), "{width}: {mip} of {truth}");
        assert!(dilated > 1.1 * truth, "{width}: {dilated} of {truth}: what is dilated absorbs more");
    }
}

#[test]
fn shadows_do_not_depend_on_the_filter_nor_on_the_eye() {
    let cloud = built(&splats(200, 0.03, 0.9, 9));
    let floor = solid(Form::Box { size: DVec3::new(3.0, 0.2, 3.0) }, [0.8; 3]);
    let floor = Arc::new(floor.moved(DAffine3::from_translation(DVec3::new(0.0, -1.2, 0.0))));
    let kind = LightKind::Directional { direction: DVec3::new(0.0, -1.0, 0.0) };
    let sun = Light { kind, color: [3.0; 3], shadow: true };
    for shadows in [Shadows::Exact, Shadows::Cached { resolution: 64 }] {
        let shown = |filter| {
            // High above what the picture shows.
            let splats = Node::new(Shape::Cloud(filtered(&cloud, filter)));
            let splats = Arc::new(splats.moved(DAffine3::from_translation(DVec3::new(0.0, 3.0, 0.0))));
            let mut scene = scene_of(object(&cloud), true);
            scene.root = Arc::new(Node::new(Shape::Operator(Operator::Union, vec![splats, floor.clone()])));
            scene.lighting = Lighting::Lit(vec![sun]);
            scene.unit_distance = 0.03;
            let settings = RenderSettings { step: Step::Fixed(0.05), shadows, ..settings(48, 48) };
            plain_picture(&scene, &settings)
        };
        let plain = shown(SplatFilter::None);
        let (dark, light) =
            plain[48 * 44..].iter().fold((f32::MAX, 0.0_f32), |(a, b), p| (a.min(p[1]), b.max(p[1])));
        assert!(dark < 0.8 * light, "{dark} and {light}: a shadow falls on the floor");
        for filter in FILTERS {
            assert!(bits(&shown(filter)) == bits(&plain), "{filter}, {shadows:?}");
        }
    }
}

#[test]
fn a_filter_of_what_is_no_splat_is_refused() {
    let cloud = built(&splats(10, 0.1, 0.9, 3));
    let plain = CloudObject { kernel: Kernel::Gaussian, ..filtered(&cloud, SplatFilter::Mip) };
    let refused = Scene::of_cloud(plain).check();
    assert!(matches!(refused, Err(SceneError::Transfer(TransferError::Filter))), "{refused:?}");
    let text = r#"{"rayset": 1, "root": {"type": "cloud", "file": "c.rset", "kernel": "splat", "splatFilter": "fine"}}"#;
    let error = SceneFile::parse(Path::new("scene.json"), text).map(drop).expect_err("refused").to_string();
    assert!(error.contains("c.rset") || error.contains("splatFilter"), "{error}");
}

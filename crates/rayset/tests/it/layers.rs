//! What is known of pixels besides their colour, and OpenEXR files of it.

use std::sync::Arc;

use rayset::geometry::{DAffine3, DVec3};
use rayset::image::LayerPixel;
use rayset::scene::{
    Camera, Compositing, Form, Lighting, Node, OpacityRule, Operator, Projection, RenderSettings, Samples,
    Scene, Shape, Step,
};
use rayset::trace::{ExecSettings, Picture, render_once};

use crate::common::{camera, paged, settings};
use crate::graph::{Parts, parts, scene, soft, solid};

fn layered(
    scene: &Scene,
    camera: &Camera,
    settings: &RenderSettings,
    exec: &ExecSettings,
    pages: u64,
) -> Picture {
    let settings = RenderSettings { layers: true, ..*settings };
    let paged = paged(scene, pages * (16 << 10));
    render_once(scene, camera, &settings, exec, &paged).expect("a picture").0
}

/// In degrees.
fn angle(a: [f32; 3], b: DVec3) -> f64 {
    DVec3::from_array(a.map(f64::from)).dot(b).clamp(-1.0, 1.0).acos().to_degrees()
}

#[test]
fn cut_faces_have_the_cutters_normal_within_five_degrees() {
    let Parts { cloud, _folder, .. } = parts();
    // A cylinder along the line of sight, its axis through (0.1, 0.05), cuts clouds and solids
    // open.
    let cutter = |radius: f64| {
        solid(Form::Cylinder { radius, height: 4.0 }, [0.2, 0.3, 0.8]).moved(
            DAffine3::from_translation(DVec3::new(0.1, 0.05, 0.0))
                * DAffine3::from_rotation_x(std::f64::consts::FRAC_PI_2),
        )
    };
    let seen_from_above = Camera {
        position: DVec3::new(0.1, 0.55, 3.0),
        direction: DVec3::new(0.0, -0.17, -1.0),
        up: DVec3::Y,
        projection: Projection::Perspective { fovy: 40_f64.to_radians() },
    };
    let Shape::Cloud(mut object) = cloud.shape else { panic!("a cloud") };
    object.transfer.opacity = OpacityRule::Clamp;
    let cloud = Node::new(Shape::Cloud(object));
    let block = solid(Form::Box { size: DVec3::new(1.4, 1.2, 0.8) }, [0.8, 0.6, 0.4]);
    for (name, object, unit_distance) in [("a block", block, 0.02), ("a cloud", cloud, 0.02)] {
        let cut = Node::operator(Operator::Difference, [object, cutter(0.4)]);
        let scene = Scene { unit_distance, ..scene(cut, vec![]) };
        let settings = RenderSettings { step: Step::Fixed(0.004), ..settings(64, 64) };
        let found = layered(&scene, &seen_from_above, &settings, &ExecSettings::default(), 10_000);
        let rays = |x: u32, y: u32| {
            let (height, aspect) = (20_f64.to_radians().tan(), 1.0);
            let at = |i: u32| (f64::from(i) + 0.5) / 32.0 - 1.0;
            let forward = seen_from_above.direction.normalize();
            let right = forward.cross(DVec3::Y).normalize();
            let up = right.cross(forward);
            (forward + at(x) * height * aspect * right - at(y) * height * up).normalize()
        };
        let (mut faces, mut wrong) = (0, 0);
        for y in 0..64 {
            for x in 0..64 {
                let pixel: LayerPixel = found.layers[(y * 64 + x) as usize];
                let place = seen_from_above.position + rays(x, y) * f64::from(pixel.depth);
                let from_axis = DVec3::new(place.x - 0.1, place.y - 0.05, 0.0);
                // On the wall of the hole, and the ray came through the hole and not past its rim.
                let on_wall = (from_axis.length() - 0.4).abs() < 0.004 && place.z.abs() < 0.3;
                if pixel.opacity > 0.98 && on_wall {
                    faces += 1;
                    wrong += usize::from(angle(pixel.normal, -from_axis.normalize()) > 5.0);
                }
            }
        }
        assert!(faces > 40, "{name}: only {faces} pixels show the wall");
        // A cloud's own surface meets the cut here and there, and a pixel shows both.
        assert!(wrong * 50 <= faces, "{name}: {wrong} of {faces} normals are off");
    }
}

#[test]
fn layers_tell_distance_leaf_colour_and_normal_of_what_is_seen() {
    let wall = |z: f64, color| {
        solid(Form::Box { size: DVec3::new(9.0, 9.0, 0.4) }, color)
            .moved(DAffine3::from_translation(DVec3::new(0.0, 0.0, z - 0.2)))
    };
    let right = solid(Form::HalfSpace { normal: DVec3::NEG_X, offset: 0.0 }, [1.0; 3]);
    // Half of the nearer wall is missing; the light does not matter.
    let near = Node::operator(Operator::Intersection, [wall(1.0, [0.25, 0.5, 0.75]), right]);
    let scene = Scene {
        unit_distance: 0.01,
        compositing: Compositing::Linear,
        lighting: Lighting::Unlit,
        background: Some([1.0; 3]),
        ..scene(Node::operator(Operator::Union, [near, wall(-1.0, [0.75, 0.25, 0.5])]), vec![])
    };
    let ahead = Camera { projection: Projection::Orthographic { height: 2.0 }, ..camera() };
    let settings = RenderSettings { step: Step::Fixed(0.01), samples: Samples::Fixed(2), ..settings(32, 32) };
    let found = layered(&scene, &ahead, &settings, &ExecSettings::default(), 100);
    // The first leaf is the nearer wall, the second what cuts it, the third the wall behind.
    for (x, depth, leaf, albedo) in [(28, 2.0, 1, [0.25, 0.5, 0.75]), (3, 4.0, 3, [0.75, 0.25, 0.5])] {
        for y in [2, 15, 29] {
            let pixel = found.layers[y * 32 + x];
            assert!((pixel.depth - depth).abs() < 0.02, "{pixel:?}");
            assert!(pixel.opacity > 0.98 && pixel.instance == leaf && pixel.samples > 0, "{pixel:?}");
            assert!(angle(pixel.normal, DVec3::Z) < 0.1, "{pixel:?}");
            assert!((0..3).all(|c| (pixel.albedo[c] - albedo[c]).abs() < 1e-4), "{pixel:?}");
        }
    }
}

#[test]
fn layers_are_the_same_whatever_the_means_and_change_no_colour() {
    let Parts { cloud, other, _folder } = parts();
    let veil = soft(Form::Sphere { radius: 0.6 }, [0.3, 0.6, 0.9], 0.3);
    let root = Node::operator(Operator::Blend, [cloud, other, veil]);
    let scene =
        Scene { root: Arc::new(root), ..scene(Node::new(Shape::Operator(Operator::Union, vec![])), vec![]) };
    let settings = settings(48, 40);
    let exec = |threads, slab_samples, tile_pixels| ExecSettings {
        threads,
        slab_samples,
        tile_pixels,
        ..ExecSettings::default()
    };
    let known = |whole: &Picture| -> Vec<String> {
        whole.layers.iter().map(|l| format!("{:?}", LayerPixel { bytes: 0.0, ..*l })).collect()
    };
    let first = layered(&scene, &camera(), &settings, &exec(1, 32, 8), 10_000);
    assert!(first.layers.iter().any(|l| l.bytes > 0.0));
    for (threads, slab_samples, tile_pixels, pages) in [(2, 32, 8, 8), (1, 7, 8, 100), (2, 16, 3, 100)] {
        let again = layered(&scene, &camera(), &settings, &exec(threads, slab_samples, tile_pixels), pages);
        assert!(known(&again) == known(&first), "slabs of {slab_samples}, tiles of {tile_pixels}");
    }
    assert!(first.pixels == crate::common::plain_picture(&scene, &settings));
}

#[test]
fn depths_alone_are_those_of_all_layers_and_change_no_colour() {
    let Parts { cloud, other, _folder } = parts();
    let veil = soft(Form::Sphere { radius: 0.6 }, [0.3, 0.6, 0.9], 0.3);
    let scene = scene(Node::operator(Operator::Union, [cloud, other, veil]), vec![]);
    let settings = settings(24, 20);
    let all = layered(&scene, &camera(), &settings, &ExecSettings::default(), 10_000);
    let with_depths = RenderSettings { depths: true, ..settings };
    let paged = paged(&scene, 10_000 * (16 << 10));
    let seen = render_once(&scene, &camera(), &with_depths, &ExecSettings::default(), &paged);
    let alone = seen.expect("a picture").0;
    let known = |l: &LayerPixel| (l.depth.to_bits(), l.opacity.to_bits());
    assert!(alone.layers.iter().map(known).eq(all.layers.iter().map(known)));
    assert!(all.layers.iter().any(|l| l.depth.is_finite() && l.samples > 0 && l.normal != [0.0; 3]));
    assert!(alone.layers.iter().all(|l| l.samples == 0 && l.normal == [0.0; 3]));
    assert!(alone.pixels == all.pixels);
}

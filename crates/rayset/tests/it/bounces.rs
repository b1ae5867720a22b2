//! Reflection and refraction, against the reference renderer and against optics.

use std::sync::Arc;

use rayset::geometry::{DAffine3, DQuat, DVec3};
use rayset::image::LayerPixel;
use rayset::scene::{
    Form, LightKind, Lighting, Material, Node, Operator, Pattern, RenderSettings, Scene, Shape, Solid, Step,
};
use rayset::trace::{ExecSettings, render_once};

use crate::common::{bits, camera, paged, picture, plain_picture, settings};
use crate::graph::{Parts, check, light, parts, scene, soft, solid};

/// Of the 1600 pixels of a picture, those that may differ: one in a hundred.
const WRONG: usize = 16;

fn mirror(reflectance: f64) -> Material {
    Material { reflectance, ..Material::default() }
}

fn glass(refractive_index: f64) -> Material {
    Material { refractive_index, specular: 0.4, ..Material::default() }
}

fn checkered(form: Form, size: f64) -> Node {
    let pattern = Pattern::Checker { colors: [[0.9, 0.85, 0.7], [0.1, 0.2, 0.4]], size };
    Node::new(Shape::Procedural(Arc::new(Solid { pattern, ..Solid::new(form) })))
}

fn floor() -> Node {
    checkered(Form::Box { size: DVec3::new(3.0, 0.2, 3.0) }, 0.5)
        .moved(DAffine3::from_translation(DVec3::new(0.0, -0.8, 0.0)))
}

fn wall() -> Node {
    checkered(Form::Box { size: DVec3::new(4.0, 4.0, 0.2) }, 0.6)
        .moved(DAffine3::from_translation(DVec3::new(0.05, 0.1, -1.4)))
}

/// A ball that is hardly seen but for what it does to rays.
fn clear_ball(radius: f64, material: Material) -> Node {
    let ball = Solid { opacity: 0.02, ..Solid::new(Form::Sphere { radius }) };
    Node::new(Shape::Procedural(Arc::new(ball))).of(material)
}

fn sun() -> rayset::scene::Light {
    light(LightKind::Directional { direction: DVec3::new(0.3, -1.0, -0.6) }, [0.8; 3], false)
}

#[test]
fn mirrors_of_solids_and_clouds_agree_with_the_reference_renderer() {
    let Parts { cloud, _folder, .. } = parts();
    let ball = solid(Form::Sphere { radius: 0.6 }, [0.8, 0.3, 0.2]).of(mirror(0.6));
    let lights = || vec![light(LightKind::Ambient, [0.4; 3], false), sun()];
    check(
        "a ball over a floor",
        &scene(Node::operator(Operator::Union, [ball.clone(), floor()]), lights()),
        WRONG,
    );
    let seen = Scene {
        background: Some([0.3, 0.5, 0.9]),
        ..scene(Node::operator(Operator::Union, [ball.clone(), floor().of(mirror(0.3))]), lights())
    };
    check("mirrors in mirrors before a sky", &seen, WRONG);
    let small = cloud.of(mirror(0.5)).moved(DAffine3::from_scale(DVec3::splat(0.6)));
    check(
        "a cloud that reflects",
        &scene(Node::operator(Operator::Union, [small, floor()]), lights()),
        WRONG,
    );
    let veil = soft(Form::Sphere { radius: 0.5 }, [0.3, 0.6, 0.9], 0.3).of(mirror(0.4));
    check("a veil that reflects", &scene(Node::operator(Operator::Blend, [veil, floor()]), lights()), WRONG);
    let shadows =
        vec![light(LightKind::Ambient, [0.3; 3], false), rayset::scene::Light { shadow: true, ..sun() }];
    check("shadows in mirrors", &scene(Node::operator(Operator::Union, [ball, floor()]), shadows), WRONG);
}

#[test]
fn bent_rays_agree_with_the_reference_renderer() {
    let lights = || vec![light(LightKind::Ambient, [0.8; 3], false), sun()];
    let with_wall = |node: Node| scene(Node::operator(Operator::Union, [node, wall()]), lights());
    check("a ball of glass", &with_wall(clear_ball(0.6, glass(1.5))), WRONG);
    check("a bubble", &with_wall(clear_ball(0.6, glass(0.7))), WRONG);
    let block = Solid { opacity: 0.1, ..Solid::new(Form::Box { size: DVec3::new(0.9, 0.7, 0.5) }) };
    let turned = DAffine3::from_quat(DQuat::from_rotation_x(0.4) * DQuat::from_rotation_y(0.7));
    let block = Node::new(Shape::Procedural(Arc::new(block))).of(glass(1.3)).moved(turned);
    check("a block of ice", &with_wall(block), WRONG);
    let inner = clear_ball(0.3, glass(2.0)).moved(DAffine3::from_translation(DVec3::new(0.2, 0.1, 0.0)));
    let nested = Node::operator(Operator::Union, [inner, clear_ball(0.7, glass(1.3))]);
    check("a ball in a ball", &with_wall(nested), 2 * WRONG);
    let both = Material { reflectance: 0.3, ..glass(1.4) };
    let seen = Scene { background: Some([0.2, 0.3, 0.5]), ..scene(clear_ball(0.8, both), lights()) };
    check("glass that reflects, before a sky", &seen, WRONG);
}

#[test]
fn a_flat_mirror_shows_what_a_camera_behind_it_would_see() {
    // A mirror in the plane z = 0 that faces the camera; behind the camera stands a checkered wall.
    let mirror_node = solid(Form::HalfSpace { normal: DVec3::Z, offset: 0.0 }, [0.0; 3]);
    let bounded = Node::operator(
        Operator::Intersection,
        [mirror_node, solid(Form::Box { size: DVec3::new(4.0, 4.0, 1.0) }, [0.0; 3])],
    );
    let no_light = Material { ambient: 0.0, diffuse: 0.0, specular: 0.0, ..mirror(1.0) };
    let place = DAffine3::from_translation(DVec3::new(0.1, 0.2, 4.5));
    let behind = checkered(Form::Box { size: DVec3::new(8.0, 8.0, 0.5) }, 0.7).moved(place);
    let lights = vec![light(LightKind::Ambient, [1.0; 3], false)];
    let union = Node::operator(Operator::Union, [bounded.of(no_light), behind.clone()]);
    let with_mirror = Scene { unit_distance: 0.02, ..scene(union, lights.clone()) };
    // The same wall, mirrored in the plane.
    let image = behind.moved(DAffine3::from_scale(DVec3::new(1.0, 1.0, -1.0)));
    let direct = Scene { unit_distance: 0.02, ..scene(image, lights) };
    let settings = RenderSettings { step: Step::Fixed(0.01), ..settings(48, 48) };
    let (reflected, seen) = (plain_picture(&with_mirror, &settings), plain_picture(&direct, &settings));
    let far = |(a, b): (&[f32; 4], &[f32; 4])| (0..3).any(|c| (a[c] - b[c]).abs() > 0.02);
    let differ = reflected.iter().zip(&seen).filter(|&pair| far(pair)).count();
    assert!(seen.iter().all(|p| p[3] > 0.9), "the wall fills the view");
    // Edges of the pattern lie on a pixel or beside it.
    assert!(differ < 48 * 48 / 50, "{differ} pixels differ");
}

#[test]
fn depth_zero_and_scenes_without_light_know_no_mirrors() {
    let ball = solid(Form::Sphere { radius: 0.6 }, [0.8, 0.3, 0.2]);
    let root = |material| Node::operator(Operator::Union, [ball.clone().of(material), floor()]);
    let plain = RenderSettings { max_depth: 0, ..settings(40, 40) };
    let (mirrors, dull) =
        (scene(root(mirror(0.8)), vec![sun()]), scene(root(Material::default()), vec![sun()]));
    assert!(bits(&plain_picture(&mirrors, &plain)) == bits(&plain_picture(&dull, &plain)));
    let unlit = |scene: &Scene| {
        plain_picture(&Scene { lighting: Lighting::Unlit, ..scene.clone() }, &settings(40, 40))
    };
    assert!(bits(&unlit(&mirrors)) == bits(&unlit(&dull)));
}

#[test]
fn rays_that_turn_give_the_same_picture_whatever_the_means() {
    let Parts { cloud, other, _folder } = parts();
    let small = |node: Node, x: f64| {
        node.moved(DAffine3::from_scale_rotation_translation(
            DVec3::splat(0.45),
            DQuat::IDENTITY,
            DVec3::new(x, 0.0, 0.0),
        ))
    };
    let ball = clear_ball(0.4, Material { reflectance: 0.2, ..glass(1.5) })
        .moved(DAffine3::from_translation(DVec3::new(0.1, 0.1, 0.9)));
    let nodes =
        [small(cloud.of(mirror(0.5)), -0.4), small(other, 0.5), ball, floor().of(mirror(0.4)), wall()];
    let lamp = LightKind::Point { position: DVec3::new(-0.8, 1.2, 0.9), decays: false };
    let lights = vec![light(LightKind::Ambient, [0.3; 3], false), light(lamp, [0.7; 3], true)];
    let scene = scene(Node::operator(Operator::Union, nodes), lights);
    let settings = RenderSettings { width: 32, height: 24, ..RenderSettings::default() };
    let found = |threads, slab_samples, tile_pixels, pages: u64| {
        let exec = ExecSettings { threads, slab_samples, tile_pixels, ..ExecSettings::default() };
        let paged = paged(&scene, pages * (16 << 10));
        bits(&picture(&scene, &camera(), &settings, &exec, &paged).expect("a picture"))
    };
    let first = found(1, 32, 8, 10_000);
    for (threads, slab_samples, tile_pixels, pages) in
        [(2, 32, 8, 8), (1, 7, 8, 10_000), (2, 32, 3, 10_000), (3, 16, 8, 12), (1, 32, 1, 10_000)]
    {
        let again = found(threads, slab_samples, tile_pixels, pages);
        assert!(
            again == first,
            "{threads} threads, slabs of {slab_samples}, tiles of {tile_pixels}, {pages} pages"
        );
    }
}

#[test]
fn more_rays_than_are_held_at_a_time_give_the_same_picture_as_each_pixel_alone() {
    // Panes one behind the other, each of which mirrors a little: more rays than a whole tile may
    // have.
    let pane = |i: i32| {
        let pane = Solid { opacity: 0.2, ..Solid::new(Form::Box { size: DVec3::new(2.0, 2.0, 0.012) }) };
        let place = DVec3::new(0.0, 0.0, 0.03 * f64::from(i - 25));
        Node::new(Shape::Procedural(Arc::new(pane))).moved(DAffine3::from_translation(place))
    };
    let panes = Node::operator(Operator::Union, (0..50).map(pane)).of(mirror(1.0));
    let lights = vec![light(LightKind::Ambient, [0.3; 3], false), sun()];
    let scene = scene(Node::operator(Operator::Union, [panes, floor()]), lights);
    let found = |tile_pixels, layers| {
        let settings = RenderSettings { step: Step::Fixed(0.01), max_depth: 2, layers, ..settings(24, 16) };
        let exec = ExecSettings { tile_pixels, ..ExecSettings::default() };
        let paged = paged(&scene, 1 << 20);
        let (whole, counts) = render_once(&scene, &camera(), &settings, &exec, &paged).expect("a picture");
        (bits(&whole.pixels), whole.layers, counts)
    };
    let (first, layers, counts) = found(8, true);
    let (alone, layers_alone, counts_alone) = found(1, true);
    assert!(counts_alone.bounced_rays > 24 * 16 * 20, "{} rays follow", counts_alone.bounced_rays);
    // Some rays from the eye were traced again, of half a tile.
    let [together, apart] = [counts, counts_alone].map(|c| c.nonzero_samples);
    assert!(together > apart, "{together} samples, {apart} pixel by pixel");
    assert!(first == alone);
    // Without layers, the rays that follow from several tiles are held together.
    assert!(found(8, false).0 == alone && found(1, false).0 == alone);
    let told =
        |l: &LayerPixel| (l.samples, l.depth.to_bits(), l.normal.map(f32::to_bits), l.opacity.to_bits());
    assert!(layers.iter().map(told).eq(layers_alone.iter().map(told)));
}

#[test]
fn a_blend_takes_no_boundary_of_what_is_transparent_there_however_slabs_are_cut() {
    let ball = |radius, x, color| {
        let ball = Solid { opacity: 0.8, ..Solid::new(Form::Sphere { radius }).colored(color) };
        let moved = DAffine3::from_translation(DVec3::new(x, 0.0, 0.0));
        Node::new(Shape::Procedural(Arc::new(ball))).moved(moved).of(mirror(0.4))
    };
    // Rays leave the small ball within the large one.
    let root = Node::operator(
        Operator::Blend,
        [ball(0.35, 0.3, [0.9, 0.4, 0.2]), ball(0.5, -0.1, [0.2, 0.4, 0.9]), floor()],
    );
    let sun = rayset::scene::Light { shadow: true, ..sun() };
    let scene = scene(root, vec![light(LightKind::Ambient, [0.4; 3], false), sun]);
    check("balls that overlap", &scene, WRONG);
    let settings = RenderSettings { step: Step::Fixed(0.03), ..settings(40, 40) };
    let expected = bits(&plain_picture(&scene, &settings));
    for slab_samples in [1, 7, 13] {
        let exec = ExecSettings { slab_samples, ..ExecSettings::default() };
        let found = picture(&scene, &camera(), &settings, &exec, &paged(&scene, 1 << 20));
        assert!(bits(&found.expect("a picture")) == expected, "slabs of {slab_samples}");
    }
}

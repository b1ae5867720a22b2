//! Intersections and differences of hard solids have the surfaces that geometry says, in both
//! renderers.
//!
//! Solids are equally opaque inside, so opacities alone do not say which of them a surface belongs
//! to.

use rayset::geometry::{DAffine3, DVec3};
use rayset::scene::{
    Camera, ColorMap, Form, Light, LightKind, Material, Node, Operator, Palette, Pattern, Projection,
    RenderSettings, Scene, Shape, Solid, Step,
};
use rayset::trace::reference::{ReferenceRenderer, ReferenceSteps};
use rayset::trace::{ExecSettings, render_once};

use crate::common::{paged, settings};
use crate::graph::{light, solid};

const SIDE: u32 = 48;
const STEP: f64 = 0.002;
const UNIT: f64 = 0.008;
const COLOR: [f64; 3] = [0.8, 0.6, 0.4];
/// The width of the scene, in world units.
const WIDTH: f64 = 1.2;

fn camera_along(position: DVec3, direction: DVec3, up: DVec3) -> Camera {
    Camera { position, direction, up, projection: Projection::Orthographic { height: WIDTH } }
}

/// Where the ray of a pixel passes the picture's plane, from its middle.
fn place(x: u32, y: u32) -> [f64; 2] {
    let at = |i: u32| (f64::from(i) + 0.5) / f64::from(SIDE) - 0.5;
    [WIDTH * at(x), -WIDTH * at(y)]
}

fn scene_of(root: Node, lights: Vec<Light>) -> Scene {
    Scene { unit_distance: UNIT, ..crate::graph::scene(root, lights) }
}

fn fixed() -> RenderSettings {
    RenderSettings { step: Step::Fixed(STEP), ..settings(SIDE, SIDE) }
}

fn rendered(scene: &Scene, camera: &Camera) -> Vec<[f32; 4]> {
    let exec = ExecSettings { threads: 2, ..ExecSettings::default() };
    render_once(scene, camera, &fixed(), &exec, &paged(scene, 1 << 20)).expect("a picture").0.pixels
}

/// The red of pixels, each by both renderers, which agree with what is expected within a bound, but
/// for some.
fn compare(
    what: &str,
    scene: &Scene,
    camera: &Camera,
    (bound, allowed): (f64, usize),
    expected: impl Fn(u32, u32) -> Option<f64>,
) {
    let found = rendered(scene, camera);
    let reference = ReferenceRenderer::load(scene).expect("nothing to read");
    let (mut known, mut wrong) = (0, Vec::new());
    for y in 0..SIDE {
        for x in 0..SIDE {
            let Some(right) = expected(x, y) else { continue };
            known += 1;
            let mut red = vec![("fast", f64::from(found[(y * SIDE + x) as usize][0]))];
            // The reference renderer is slow: some rows of it.
            if y % 8 == 3 {
                let exact =
                    reference.pixel(camera, &fixed(), &ReferenceSteps::same(STEP), x, y).expect("a camera");
                red.push(("reference", exact[0]));
            }
            for (renderer, red) in red {
                if (red - right).abs() > bound || red.is_nan() {
                    wrong.push(format!("{renderer} ({x}, {y}): {red:.4}, not {right:.4}"));
                }
            }
        }
    }
    assert!(known > 100, "{what}: only {known} pixels are known");
    assert!(
        wrong.len() <= allowed,
        "{what}: {} values of {known} pixels: {}",
        wrong.len(),
        wrong[..wrong.len().min(5)].join("; ")
    );
}

/// The share of a hard solid's light that reaches the eye.
fn covered() -> f64 {
    0.998
}

fn matt(node: Node) -> Node {
    node.of(Material { ambient: 0.0, diffuse: 1.0, specular: 0.0, ..Material::default() })
}

fn ball(radius: f64, at: DVec3) -> Node {
    solid(Form::Sphere { radius }, COLOR).moved(DAffine3::from_translation(at))
}

fn half_space(normal: DVec3, offset: f64) -> Node {
    solid(Form::HalfSpace { normal: normal.normalize(), offset }, COLOR)
}

/// All orders of some nodes that are intersected.
fn intersections(nodes: &[Node]) -> Vec<Node> {
    let mut orders = vec![nodes.to_vec()];
    orders.push(nodes.iter().rev().cloned().collect());
    let mut turned = nodes.to_vec();
    turned.rotate_left(1);
    orders.push(turned);
    orders.into_iter().map(|order| Node::operator(Operator::Intersection, order)).collect()
}

#[test]
fn the_flat_face_of_half_a_ball_is_flat_however_it_is_made() {
    const RADIUS: f64 = 0.5;
    // The half with z < 0.1, seen from the side of the plane.
    let parts = [ball(RADIUS, DVec3::ZERO), half_space(DVec3::Z, 0.1)];
    let mut made = intersections(&parts);
    made.push(Node::operator(Operator::Difference, [parts[0].clone(), half_space(DVec3::NEG_Z, -0.1)]));
    let toward = DVec3::new(0.4, -0.3, -1.0).normalize();
    let sun = light(LightKind::Directional { direction: toward }, [1.0; 3], false);
    let camera = camera_along(DVec3::new(0.0, 0.0, 2.0), DVec3::NEG_Z, DVec3::Y);
    let rim = (RADIUS * RADIUS - 0.01_f64).sqrt();
    for (number, root) in made.into_iter().enumerate() {
        let expected = |x: u32, y: u32| {
            let [x, y] = place(x, y);
            // Near the rim, the samples below the face are nearer to the ball's surface.
            (x.hypot(y) < rim - 4.0 * UNIT).then(|| covered() * COLOR[0] * -toward.z)
        };
        let what = format!("half a ball, made in way {number}");
        compare(&what, &scene_of(matt(root), vec![sun]), &camera, (0.01, 0), expected);
    }
}

#[test]
fn each_side_of_a_lens_has_the_curvature_of_its_own_ball() {
    const RADIUS: f64 = 0.8;
    // Two balls whose middles are 1 apart: the front of what they share is of the one behind.
    let (behind, before) = (DVec3::new(0.0, 0.0, -0.5), DVec3::new(0.0, 0.0, 0.5));
    let toward = DVec3::new(0.5, 0.2, -1.0).normalize();
    let sun = light(LightKind::Directional { direction: toward }, [1.0; 3], false);
    let camera = camera_along(DVec3::new(0.0, 0.0, 2.0), DVec3::NEG_Z, DVec3::Y);
    let rim = (RADIUS * RADIUS - 0.25_f64).sqrt();
    for root in intersections(&[ball(RADIUS, behind), ball(RADIUS, before)]) {
        let expected = |x: u32, y: u32| {
            let [x, y] = place(x, y);
            let normal = DVec3::new(x, y, (RADIUS * RADIUS - x * x - y * y).max(0.0).sqrt()) / RADIUS;
            (x.hypot(y) < rim - 4.0 * UNIT).then(|| covered() * COLOR[0] * normal.dot(toward).abs())
        };
        compare("a lens", &scene_of(matt(root), vec![sun]), &camera, (0.015, 0), expected);
    }
}

/// A solid that is hardly seen but for what it does to rays.
fn clear(form: Form) -> Node {
    let clear = Solid { opacity: 1e-5, ..Solid::new(form) };
    Node::new(Shape::Procedural(std::sync::Arc::new(clear)))
}

fn glass(node: Node) -> Node {
    node.of(Material {
        refractive_index: 1.5,
        ambient: 1.0,
        diffuse: 0.0,
        specular: 0.0,
        ..Material::default()
    })
}

/// A wall in a plane across an axis, whose red tells the place along another: from 0 at −1 to 1
/// at 1.
fn wall(across: DVec3, along: DVec3, at: f64) -> Node {
    let steps = (0..=64).map(|i| {
        let linear = f64::from(i) / 64.0;
        let shown =
            if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 };
        (linear, [shown, 0.0, 0.0])
    });
    let map = ColorMap { palette: Palette::Stops(steps.collect::<Vec<_>>().into()), range: (0.0, 1.0) };
    let pattern = Pattern::Gradient { from: -along, to: along, map };
    let size = across.abs() * 0.1 + (DVec3::ONE - across.abs()) * 2.0;
    let wall = Solid { pattern, ..Solid::new(Form::Box { size }) };
    let material = Material { ambient: 1.0, diffuse: 0.0, specular: 0.0, ..Material::default() };
    let moved = DAffine3::from_translation(across * (at + 0.05 * at.signum()));
    Node::new(Shape::Procedural(std::sync::Arc::new(wall))).moved(moved).of(material)
}

fn daylight() -> Vec<Light> {
    vec![light(LightKind::Ambient, [1.0; 3], false)]
}

#[test]
fn a_lens_of_glass_bends_rays_as_its_two_surfaces_do() {
    const RADIUS: f64 = 0.8;
    const WALL: f64 = -0.7;
    let (behind, before) = (DVec3::new(0.0, 0.0, -0.5), DVec3::new(0.0, 0.0, 0.5));
    let clear_ball = |at| clear(Form::Sphere { radius: RADIUS }).moved(DAffine3::from_translation(at));
    let camera = camera_along(DVec3::new(0.0, 0.0, 2.0), DVec3::NEG_Z, DVec3::Y);
    let rim = (RADIUS * RADIUS - 0.25_f64).sqrt();
    // A ray through the front, which is of the ball behind, and out of the back.
    let seen_at = |x: f64, y: f64| {
        let meets = |origin: DVec3, direction: DVec3, center: DVec3, far: f64| {
            let from = origin - center;
            let b = from.dot(direction);
            -b + far * (b * b - from.length_squared() + RADIUS * RADIUS).max(0.0).sqrt()
        };
        let (origin, direction) = (DVec3::new(x, y, 2.0), DVec3::NEG_Z);
        let enters = origin + direction * meets(origin, direction, behind, -1.0);
        let inside = direction.refract((enters - behind) / RADIUS, 1.0 / 1.5);
        let leaves = enters + inside * meets(enters, inside, before, 1.0);
        let out = inside.refract(-(leaves - before) / RADIUS, 1.5);
        leaves + out * ((WALL - leaves.z) / out.z)
    };
    for root in intersections(&[clear_ball(behind), clear_ball(before)]) {
        let root = Node::operator(Operator::Union, [glass(root), wall(DVec3::Z, DVec3::X, WALL)]);
        let expected = |x: u32, y: u32| {
            let [x, y] = place(x, y);
            let red = covered() * (0.5 + 0.5 * seen_at(x, y).x);
            (x.hypot(y) < rim - 0.08).then_some(red)
        };
        // Where a ray enters right at a sample, it may start outside by an error of first order:
        // one in a hundred.
        compare("a lens of glass", &scene_of(root, daylight()), &camera, (0.01, 24), expected);
    }
}

#[test]
fn a_right_angled_prism_reflects_all_light_at_its_long_face() {
    // Legs at z = 0.5, where rays come in, and at x = 0.5, where they go out; the long face is x +
    // z = 0.
    let prism = [
        clear(Form::HalfSpace { normal: DVec3::Z, offset: 0.5 }),
        clear(Form::HalfSpace { normal: DVec3::X, offset: 0.5 }),
        clear(Form::HalfSpace { normal: DVec3::new(-1.0, 0.0, -1.0).normalize(), offset: 0.0 }),
        clear(Form::Box { size: DVec3::new(3.0, 0.8, 3.0) }),
    ];
    let camera = camera_along(DVec3::new(0.0, 0.0, 2.0), DVec3::NEG_Z, DVec3::Y);
    for root in intersections(&prism) {
        // What is seen lies to the side; behind the prism there is nothing.
        let root = Node::operator(Operator::Union, [glass(root), wall(DVec3::X, DVec3::Z, 0.8)]);
        let expected = |x: u32, y: u32| {
            let [x, y] = place(x, y);
            // Mirrored in the long face, the ray goes on at z = −x.
            let within = x > -0.42 && x < 0.42 && y.abs() < 0.34;
            within.then(|| covered() * (0.5 + 0.5 * -x))
        };
        compare("a prism", &scene_of(root, daylight()), &camera, (0.01, 0), expected);
    }
}

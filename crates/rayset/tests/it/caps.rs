//! Caps: a cut through a hollow scan shows a solid, what is outside stays empty, and open scans
//! have none.

use std::sync::Arc;

use rayset::Session;
use rayset::geometry::{DAffine3, DVec3};
use rayset::octree::Cloud;
use rayset::octree::build::BuildOptions;
use rayset::points::ArraySource;
use rayset::scene::{
    CloudObject, ColorRule, Form, Lighting, Node, OpacityRule, Operator, RenderSettings, Scene, SceneError,
    Shape, Step,
};
use rayset::trace::predict::NoPredictor;
use rayset::trace::{ExecSettings, RenderError, SettingError, render_once};

use crate::common::{Random, bits, build_at, camera, folder, paged, picture, plain_picture, settings};
use crate::graph::{scene, solid};

const SIDE: u32 = 96;
const RADIUS: f64 = 0.8;
const POINT_RADIUS: f32 = 0.06;
const SCAN: [f64; 3] = [0.1, 0.5, 0.1];
const CAP: [f64; 3] = [0.9, 0.2, 0.1];

/// A scan of points of which `keep` holds, placed at random on a surface that `place` draws from
/// two numbers below 1.
fn scan(
    folder: &tempfile::TempDir,
    count: usize,
    place: impl Fn(f64, f64) -> DVec3,
    keep: impl Fn(DVec3) -> bool,
) -> Node {
    let mut random = Random(17);
    let position: Vec<[f64; 3]> = (0..count)
        .map(|_| place(random.unit(), random.unit()))
        .filter(|&p| keep(p))
        .map(|p| p.to_array())
        .collect();
    let radius = vec![POINT_RADIUS; position.len()];
    let source = ArraySource::new(position, vec![("radius", radius)]);
    let path = folder.path().join(format!("{count}.rset"));
    let cloud: Arc<Cloud> = build_at(&path, Box::new(source), &BuildOptions::default());
    let mut object = CloudObject::plain(cloud);
    object.transfer.opacity = OpacityRule::Curve(vec![(0.25, 0.0), (0.55, 1.0)]);
    object.transfer.color = ColorRule::Uniform(SCAN.map(|v| v as f32));
    Node::new(Shape::Cloud(object))
}

fn on_a_ball(u: f64, v: f64) -> DVec3 {
    let (height, angle) = (2.0 * u - 1.0, std::f64::consts::TAU * v);
    let around = (1.0 - height * height).sqrt();
    DVec3::new(around * angle.cos(), around * angle.sin(), height) * RADIUS
}

/// What lies in front of the plane z = 0.1, which the camera looks at.
fn front() -> Node {
    solid(Form::Box { size: DVec3::splat(4.0) }, [1.0; 3])
        .moved(DAffine3::from_translation(DVec3::new(0.0, 0.0, 2.1)))
}

fn cut(scan: Node) -> Node {
    Node::operator(Operator::Difference, [scan, front()])
}

fn unlit(root: Node) -> Scene {
    Scene { lighting: Lighting::Unlit, unit_distance: 0.02, ..scene(root, vec![]) }
}

fn small() -> RenderSettings {
    settings(SIDE, SIDE).with_cap_resolution(64)
}

/// Pixels, each with its distance from the ball's axis on the plane of the cut.
fn around(pixels: &[[f32; 4]]) -> impl Iterator<Item = (f64, [f32; 4])> + '_ {
    let tangent = 22.5_f64.to_radians().tan();
    pixels.iter().enumerate().map(move |(i, &pixel)| {
        let offset = |at: u32| (2.0 * (f64::from(at) + 0.5) / f64::from(SIDE) - 1.0) * tangent * 2.9;
        let (x, y) = (offset(i as u32 % SIDE), offset(i as u32 / SIDE));
        ((x * x + y * y).sqrt(), pixel)
    })
}

fn is(pixel: [f32; 4], color: [f64; 3]) -> bool {
    (0..3).all(|c| (f64::from(pixel[c]) - color[c]).abs() < 0.02)
}

fn remarks(scene: &Scene, settings: &RenderSettings) -> Vec<String> {
    let session = Session::over(paged(scene, 1 << 26), ExecSettings::default()).expect("a session");
    session.prepare(scene, settings).expect("a scene").remarks().to_vec()
}

#[test]
fn a_cut_through_a_hollow_ball_shows_a_solid_and_nothing_around_it() {
    let folder = folder();
    let ball = scan(&folder, 6000, on_a_ball, |_| true);
    let hollow = plain_picture(&unlit(cut(ball.clone())), &small());
    let capped = unlit(cut(ball).capped(CAP));
    assert_eq!(remarks(&capped, &small()), Vec::<String>::new());
    let filled = plain_picture(&capped, &small());
    let thick = f64::from(POINT_RADIUS);
    let (mut inside, mut outside) = (0, 0);
    for ((far, before), (_, pixel)) in around(&hollow).zip(around(&filled)) {
        if far < RADIUS - 1.5 * thick {
            // Here and there a pore lets the background through.
            assert!(before[0] <= 0.11, "hollow, {far}: {before:?}");
            assert!(is(pixel, CAP), "filled, {far}: {pixel:?}");
            inside += 1;
        } else if far > RADIUS + 2.0 * thick {
            assert_eq!(pixel, [0.0; 4], "{far}");
            outside += 1;
        } else if far < RADIUS {
            // No gap between the fill and the shell.
            assert!(pixel[3] > 0.98, "{far}: {pixel:?}");
        }
    }
    assert!(inside > 1000 && outside > 1000, "{inside} {outside}");
}

#[test]
fn a_cap_is_lit_and_placed_as_a_solid_in_its_place_would_be() {
    let folder = folder();
    let ball = scan(&folder, 6000, on_a_ball, |_| true);
    let kernel = solid(Form::Sphere { radius: RADIUS }, CAP);
    let with_solid = Node::operator(Operator::Union, [ball.clone(), kernel]);
    // Turned, stretched and moved as a whole: what is inside is found in the space of the
    // difference.
    let moved = DAffine3::from_scale_rotation_translation(
        DVec3::new(0.8, 1.1, 0.9),
        rayset::geometry::DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 0.5).normalize(), 0.4),
        DVec3::new(0.1, -0.1, 0.2),
    );
    let fixed = RenderSettings { step: Step::Fixed(0.01), ..small() };
    let lit = |root: Node| Scene { unit_distance: 0.05, ..scene(root.moved(moved), vec![]) };
    let expected = plain_picture(&lit(cut(with_solid)), &fixed);
    let found = plain_picture(&lit(cut(ball).capped(CAP)), &fixed);
    let differs = |(a, b): (&[f32; 4], &[f32; 4])| (0..4).any(|c| (a[c] - b[c]).abs() > 1.0 / 256.0);
    let wrong = found.iter().zip(&expected).filter(|&pair| differs(pair)).count();
    let seen = expected.iter().filter(|pixel| pixel[3] > 0.5).count();
    // Both edges lie within the shell; where they are seen through it, they may differ by a part of
    // a cell.
    assert!(seen > 2000 && wrong <= seen / 40, "{wrong} of {seen} pixels differ");
}

#[test]
fn a_scan_without_a_bottom_has_a_cap_and_a_sheet_has_none() {
    let folder = folder();
    let standing = scan(&folder, 6000, on_a_ball, |p| p.y > -0.5 * RADIUS);
    let capped = unlit(cut(standing).capped(CAP));
    assert_eq!(remarks(&capped, &small()), Vec::<String>::new());
    let pixels = plain_picture(&capped, &small());
    let middle = pixels[(SIDE / 2 * SIDE + SIDE / 2) as usize];
    assert!(is(middle, CAP), "{middle:?}");

    let waves = |u: f64, v: f64| DVec3::new(2.0 * u - 1.0, 0.2 * (9.0 * u).sin(), 2.0 * v - 1.0);
    let sheet = scan(&folder, 5000, waves, |_| true);
    let capped = unlit(cut(sheet.clone()).capped(CAP));
    let said = remarks(&capped, &small());
    assert!(said.len() == 1 && said[0].contains("cap is left out: the surface is open"), "{said:?}");
    let bare = plain_picture(&unlit(cut(sheet)), &small());
    assert_eq!(bits(&plain_picture(&capped, &small())), bits(&bare));
}

#[test]
fn scattered_leaves_enclose_nothing() {
    let folder = folder();
    let mut random = Random(5);
    let leaves: Vec<DVec3> =
        (0..300).map(|_| DVec3::from_array(std::array::from_fn(|_| random.unit() - 0.5))).collect();
    let shrub = |u: f64, v: f64| {
        let leaf = leaves[(u * 300.0) as usize];
        leaf + 0.05 * DVec3::new((999.0 * v).sin(), (777.0 * v).sin(), (555.0 * v).sin())
    };
    let capped = unlit(cut(scan(&folder, 6000, shrub, |_| true)).capped(CAP));
    let said = remarks(&capped, &small());
    assert!(said.len() == 1 && said[0].contains("the surface is open"), "{said:?}");
}

#[test]
fn what_is_never_half_opaque_or_has_no_end_has_no_cap_and_says_so() {
    let folder = folder();
    let mut ball = scan(&folder, 2000, on_a_ball, |_| true);
    if let Shape::Cloud(object) = &mut ball.shape {
        object.transfer.opacity = OpacityRule::Curve(vec![(0.2, 0.0), (0.6, 0.4)]);
    }
    let said = remarks(&unlit(cut(ball).capped(CAP)), &small());
    assert!(said.len() == 1 && said[0].contains("no surface that is half opaque"), "{said:?}");
    let half = solid(Form::HalfSpace { normal: DVec3::Y, offset: 0.0 }, SCAN);
    let endless = Node::operator(Operator::Difference, [half, front()]).capped(CAP);
    let ended = Node::operator(Operator::Intersection, [endless, front()]);
    let said = remarks(&unlit(ended), &small());
    assert!(said.len() == 1 && said[0].contains("empty or has no end"), "{said:?}");
}

#[test]
fn threads_memory_and_prediction_change_no_pixel_of_a_cap() {
    let folder = folder();
    let ball = scan(&folder, 6000, on_a_ball, |_| true);
    let capped = unlit(cut(ball).capped(CAP));
    let expected = bits(&plain_picture(&capped, &small()));
    let default = ExecSettings::default();
    let ways = [
        (ExecSettings { threads: 1, slab_samples: 7, ..default.clone() }, u64::MAX / 2),
        (ExecSettings { threads: 3, tile_pixels: 5, ..default.clone() }, 200_000),
        (ExecSettings { threads: 2, predictor: Arc::new(NoPredictor), ..default }, 120_000),
    ];
    for (exec, budget) in ways {
        let found = picture(&capped, &camera(), &small(), &exec, &paged(&capped, budget));
        assert_eq!(bits(&found.expect("a picture")), expected);
    }
}

#[test]
fn only_differences_have_caps_of_a_resolution_in_range() {
    let ball = || solid(Form::Sphere { radius: 0.5 }, SCAN);
    let made = |root: Node, settings: &RenderSettings| {
        let scene = unlit(root);
        render_once(&scene, &camera(), settings, &ExecSettings::default(), &paged(&scene, 1 << 20))
    };
    let union = Node::operator(Operator::Union, [ball(), front()]).capped(CAP);
    let refused = made(union, &small());
    assert!(matches!(refused, Err(RenderError::Scene(SceneError::Cap))), "{:?}", refused.err());
    let bright = made(cut(ball()).capped([0.0, f64::NAN, 0.0]), &small());
    assert!(matches!(bright, Err(RenderError::Scene(SceneError::Number { .. }))), "{:?}", bright.err());
    for resolution in [7, 1025] {
        let refused = made(cut(ball()).capped(CAP), &small().with_cap_resolution(resolution));
        assert!(
            matches!(refused, Err(RenderError::Setting(SettingError::CapResolution(_)))),
            "{:?}",
            refused.err()
        );
    }
}

//! Scene graphs: every operator, transform, leaf and light, against the reference renderer.

use std::sync::Arc;

use rayset::field::Kernel;
use rayset::geometry::{DAffine3, DMat3, DQuat, DVec3};
use rayset::octree::build::{BuildOptions, Rule};
use rayset::scene::{
    Channel, ColorMap, ColorRule, Compositing, Form, Light, LightKind, Lighting, MapInput, Material, Node,
    NoiseCloud, Operator, Pattern, RenderSettings, Scene, Shadows, Shape, Solid, Step, Transfer,
};
use rayset::trace::ExecSettings;
use rayset::trace::predict::NoPredictor;
use rayset::trace::reference::{ReferenceRenderer, ReferenceSteps};

use rayset::points::{ArraySource, Workload};

use crate::common::{Random, bits, build_at, camera, folder, look, mixed_points, plain_picture, settings};

/// Pixels may differ by this in linear light, save for one in a thousand.
const PIXEL_BOUND: f64 = 1.0 / 1024.0;
const SIDE: u32 = 40;
const STEP: f64 = 0.03;

pub(crate) fn solid(form: Form, color: [f64; 3]) -> Node {
    Node::new(Shape::Procedural(Arc::new(Solid::new(form).colored(color))))
}

pub(crate) fn soft(form: Form, color: [f64; 3], edge: f64) -> Node {
    Node::new(Shape::Procedural(Arc::new(Solid { edge, opacity: 0.7, ..Solid::new(form).colored(color) })))
}

pub(crate) fn light(kind: LightKind, color: [f32; 3], shadow: bool) -> Light {
    Light { kind, color, shadow }
}

pub(crate) fn turned_and_stretched() -> DAffine3 {
    let turn = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 0.5).normalize(), 0.7);
    DAffine3::from_scale_rotation_translation(DVec3::new(0.6, 1.1, 0.8), turn, DVec3::new(0.2, -0.1, 0.3))
}

fn mirrored() -> DAffine3 {
    DAffine3::from_mat3_translation(
        DMat3::from_cols(DVec3::NEG_X, DVec3::Y, DVec3::new(0.2, 0.0, 0.9)),
        DVec3::new(-0.1, 0.2, 0.0),
    )
}

pub(crate) fn scene(root: Node, lights: Vec<Light>) -> Scene {
    Scene {
        root: Arc::new(root),
        lighting: if lights.is_empty() { Lighting::headlight() } else { Lighting::Lit(lights) },
        background: None,
        unit_distance: 0.15,
        compositing: Compositing::Linear,
    }
}

/// Every pixel of a small picture against the reference renderer.
pub(crate) fn check(what: &str, scene: &Scene, wrong_allowed: usize) {
    let settings = RenderSettings { step: Step::Fixed(STEP), ..settings(SIDE, SIDE) };
    let found = plain_picture(scene, &settings);
    let reference_renderer = ReferenceRenderer::load(scene).expect("the clouds read");
    let (mut covered, mut wrong) = (0, 0);
    for y in 0..SIDE {
        for x in 0..SIDE {
            let exact = reference_renderer
                .pixel(&camera(), &settings, &ReferenceSteps::same(STEP), x, y)
                .expect("a camera");
            let pixel = found[(y * SIDE + x) as usize];
            covered += usize::from(exact[3] > 0.05);
            let worst = (0..4).map(|c| (f64::from(pixel[c]) - exact[c]).abs()).fold(0.0, f64::max);
            wrong += usize::from(worst > PIXEL_BOUND || worst.is_nan());
        }
    }
    assert!(covered > 50, "{what}: only {covered} pixels show anything");
    assert!(wrong <= wrong_allowed, "{what}: {wrong} pixels differ");
}

pub(crate) struct Parts {
    pub(crate) _folder: tempfile::TempDir,
    pub(crate) cloud: Node,
    pub(crate) other: Node,
}

pub(crate) fn parts() -> Parts {
    let folder = folder();
    let options = BuildOptions { page_bytes: Some(16 << 10), ..BuildOptions::default() };
    let first = build_at(&folder.path().join("a.rset"), Box::new(mixed_points(700, 1.0, 31)), &options);
    let second = build_at(&folder.path().join("b.rset"), Box::new(mixed_points(500, 2.0, 32)), &options);
    let node = |cloud, kernel| Node::new(Shape::Cloud(look(cloud, kernel)));
    Parts { cloud: node(&first, Kernel::Wyvill), other: node(&second, Kernel::Triweight), _folder: folder }
}

#[test]
fn every_operator_over_clouds_and_solids_agrees_with_the_reference_renderer() {
    let Parts { cloud, other, _folder } = parts();
    let ball = || solid(Form::Sphere { radius: 0.7 }, [0.8, 0.3, 0.2]);
    let block = || soft(Form::Box { size: DVec3::new(0.8, 0.9, 1.0) }, [0.2, 0.5, 0.9], 0.2);
    for operator in [Operator::Union, Operator::Intersection, Operator::Difference, Operator::Blend] {
        let name = operator.name();
        check(
            &format!("{name} of clouds"),
            &scene(Node::operator(operator, [cloud.clone(), other.clone()]), vec![]),
            2,
        );
        check(
            &format!("{name} of a cloud and a ball"),
            &scene(Node::operator(operator, [cloud.clone(), ball().moved(mirrored())]), vec![]),
            2,
        );
        check(
            &format!("{name} of solids"),
            &scene(
                Node::operator(
                    operator,
                    [ball(), block().moved(DAffine3::from_translation(DVec3::splat(0.3)))],
                ),
                vec![],
            ),
            2,
        );
        let three = [ball(), block(), cloud.clone()];
        check(&format!("{name} of three"), &scene(Node::operator(operator, three), vec![]), 2);
    }
}

#[test]
fn nested_graphs_with_shared_nodes_agree_with_the_reference_renderer() {
    let Parts { cloud, other, _folder } = parts();
    let shared = Arc::new(cloud);
    let hole = solid(Form::Cylinder { radius: 0.4, height: 3.0 }, [0.3, 0.9, 0.4]);
    let slot = solid(Form::Box { size: DVec3::new(3.0, 0.2, 3.0) }, [0.9, 0.9, 0.2]);
    let cut = Node::new(Shape::Operator(
        Operator::Difference,
        vec![shared.clone(), Arc::new(Node::operator(Operator::Union, [hole, slot]))],
    ));
    let both = Node::new(Shape::Operator(
        Operator::Union,
        vec![Arc::new(cut.moved(turned_and_stretched())), shared.clone(), Arc::new(other.moved(mirrored()))],
    ));
    check("a cut, moved copy beside the original", &scene(both, vec![]), 3);
}

#[test]
fn every_transform_of_a_cloud_agrees_with_the_reference_renderer() {
    let Parts { cloud, _folder, .. } = parts();
    for (name, transform) in [
        ("moved", DAffine3::from_translation(DVec3::new(0.4, 0.2, -0.6))),
        ("shrunk", DAffine3::from_scale(DVec3::splat(0.5))),
        ("turned and stretched", turned_and_stretched()),
        ("mirrored and sheared", mirrored()),
    ] {
        check(name, &scene(cloud.clone().moved(transform), vec![]), 2);
    }
}

#[test]
fn every_procedural_field_agrees_with_the_reference_renderer() {
    let checker = Pattern::Checker { colors: [[0.9, 0.9, 0.9], [0.1, 0.2, 0.5]], size: 0.3 };
    let gradient = Pattern::Gradient {
        from: DVec3::new(-0.5, -0.5, 0.0),
        to: DVec3::new(0.5, 0.5, 0.0),
        map: ColorMap::named("viridis".parse().expect("a map"), (0.0, 1.0)),
    };
    let forms = [
        Form::Sphere { radius: 0.8 },
        Form::Box { size: DVec3::new(1.2, 0.7, 0.9) },
        Form::Cylinder { radius: 0.5, height: 1.1 },
        Form::Cone { radius: 0.7, height: 1.2 },
        Form::Torus { major: 0.6, minor: 0.2 },
        Form::Ellipsoid { radii: DVec3::new(0.9, 0.4, 0.6) },
    ];
    for (i, form) in forms.into_iter().enumerate() {
        let pattern = if i % 2 == 0 { checker.clone() } else { gradient.clone() };
        let solid = Solid { form, opacity: 0.9, edge: if i % 3 == 0 { 0.0 } else { 0.15 }, pattern };
        let node = Node::new(Shape::Procedural(Arc::new(solid)));
        check(&format!("{form:?}"), &scene(node.moved(turned_and_stretched()), vec![]), 2);
    }
    let noise = NoiseCloud {
        radii: DVec3::new(1.0, 0.8, 0.9),
        scale: 0.5,
        octaves: 4,
        roughness: 0.5,
        opacity: 0.4,
        cover: 0.7,
        seed: 3,
        pattern: gradient,
    };
    check("noise", &scene(Node::new(Shape::Procedural(Arc::new(noise))), vec![]), 2);
    let half = solid(Form::HalfSpace { normal: DVec3::new(0.6, 0.8, 0.0), offset: 0.1 }, [0.4, 0.6, 0.3]);
    let ball = solid(Form::Sphere { radius: 0.8 }, [0.8, 0.7, 0.3]);
    check("half a ball", &scene(Node::operator(Operator::Intersection, [half, ball]), vec![]), 2);
}

#[test]
fn transfer_functions_and_materials_at_any_node_agree_with_the_reference_renderer() {
    let Parts { cloud, other, _folder } = parts();
    let shiny = Material { specular: 0.6, shininess: 12.5, diffuse: 0.5, ..Material::default() };
    let faded =
        Transfer::Opacity { input: Channel::Opacity, curve: vec![(0.0, 0.0), (0.4, 0.6), (1.0, 0.3)] };
    let by_red = Transfer::Color {
        input: Channel::Red,
        map: ColorMap::named("inferno".parse().expect("a map"), (0.0, 0.8)),
    };
    let mut blend = Node::operator(Operator::Blend, [cloud.of(shiny), other]);
    blend.transfers = vec![faded, by_red];
    check("a blend of materials, faded and mapped", &scene(blend.clone(), vec![]), 2);
    let block =
        solid(Form::Box { size: DVec3::splat(0.9) }, [0.6, 0.5, 0.4]).of(Material { ambient: 0.6, ..shiny });
    check("and a block cut into it", &scene(Node::operator(Operator::Difference, [block, blend]), vec![]), 3);
}

/// Points with a temperature and a pressure, in the order given.
fn with_columns(count: usize, seed: u64, names: [&str; 2]) -> ArraySource {
    let mut random = Random(seed);
    let mut position = Vec::new();
    let mut columns = vec![Vec::new(); 6];
    for _ in 0..count {
        position.push(std::array::from_fn(|_| 2.0 * random.unit() - 1.0));
        columns[0].push(0.35);
        columns.iter_mut().skip(1).for_each(|column| column.push(random.unit() as f32));
    }
    let names = ["radius", "red", "green", "blue"].into_iter().chain(names);
    ArraySource::new(position, names.zip(columns).collect())
}

fn by_attribute(name: &str) -> [Transfer; 2] {
    let input = || Channel::Attribute(name.into());
    let map = ColorMap::named("plasma".parse().expect("a map"), (0.2, 0.8));
    [
        Transfer::Opacity { input: input(), curve: vec![(0.3, 0.1), (0.5, 0.7), (0.7, 0.2)] },
        Transfer::Color { input: input(), map },
    ]
}

#[test]
fn attributes_travel_through_operators_as_the_reference_renderer_says() {
    let folder = folder();
    let cloud = |name: &str, seed, columns: [&str; 2]| {
        let source = with_columns(600, seed, columns);
        let options = BuildOptions {
            page_bytes: Some(16 << 10),
            attributes: columns.map(String::from).to_vec(),
            ..BuildOptions::default()
        };
        let cloud = build_at(&folder.path().join(name), Box::new(source), &options);
        Node::new(Shape::Cloud(look(&cloud, Kernel::Wyvill)))
    };
    let first = cloud("a.rset", 41, ["temperature", "pressure"]);
    let second = cloud("b.rset", 42, ["pressure", "temperature"]);
    let gradient = Pattern::Gradient {
        from: DVec3::new(-0.5, -0.5, 0.0),
        to: DVec3::new(0.5, 0.6, 0.2),
        map: ColorMap::named("viridis".parse().expect("a map"), (0.0, 1.0)),
    };
    let ball = Solid { opacity: 0.6, edge: 0.3, pattern: gradient, form: Form::Sphere { radius: 0.8 } };
    let ball = Node::new(Shape::Procedural(Arc::new(ball)));
    for operator in [Operator::Union, Operator::Intersection, Operator::Difference, Operator::Blend] {
        let mut both = Node::operator(operator, [first.clone(), second.clone()]);
        both.transfers = by_attribute("temperature").into();
        check(&format!("the temperature of a {}", operator.name()), &scene(both, vec![]), 2);
        // What one child has and the other has not.
        let mut mixed = Node::operator(operator, [ball.clone(), second.clone()]);
        mixed.transfers = by_attribute("gradient").into();
        let mut whole = Node::operator(Operator::Union, [mixed, first.clone()]);
        whole.transfers = vec![by_attribute("pressure")[0].clone()];
        check(&format!("two attributes around a {}", operator.name()), &scene(whole, vec![]), 2);
    }
    // A leaf in its own colours, of which a scalar decides how much is seen; and with shadows of
    // what is seen.
    let mut leaf = first.clone();
    leaf.transfers = vec![by_attribute("pressure")[0].clone()];
    let down = LightKind::Directional { direction: DVec3::new(0.3, -1.0, -0.4) };
    check("a leaf", &scene(leaf, vec![light(down, [0.9, 0.8, 0.7], true)]), 2);
    let mut unknown = first;
    unknown.transfers = by_attribute("entropy").into();
    let error = scene(unknown, vec![]).check().expect_err("no such attribute").to_string();
    assert!(error.contains("\"entropy\"") && error.contains("temperature"), "{error}");
}

#[test]
fn every_colour_of_a_cloud_goes_under_a_colour_map_of_its_own_transfers() {
    let folder = folder();
    let options = BuildOptions { attributes: vec!["heat".into(), "mass".into()], ..BuildOptions::default() };
    let source = with_columns(300, 44, ["heat", "mass"]);
    let cloud = build_at(&folder.path().join("c.rset"), Box::new(source), &options);
    let map = |name: &str| ColorMap::named(name.parse().expect("a map"), (0.2, 0.8));
    let by = |input| ColorRule::Map { map: map("viridis"), input };
    let rules = [
        ColorRule::Points,
        ColorRule::Uniform([0.9, 0.4, 0.2]),
        by(MapInput::Density),
        by(MapInput::Attribute(0)),
    ];
    let mass = || Channel::Attribute("mass".into());
    let inputs = [
        Channel::Opacity,
        Channel::Red,
        mass(),
        Channel::Attribute("x".into()),
        Channel::Attribute("height".into()),
    ];
    for (number, rule) in rules.into_iter().enumerate() {
        // The points' own colours are the ones that a field would have to carry.
        let inputs = if number == 0 { &inputs[..] } else { &inputs[..2] };
        for input in inputs {
            let mut object = look(&cloud, Kernel::Wyvill);
            object.transfer.color = rule.clone();
            let mut leaf = Node::new(Shape::Cloud(object));
            leaf.transfers = vec![Transfer::Color { input: input.clone(), map: map("plasma") }];
            let what = format!("rule {number} under a map of {input:?}");
            check(&what, &scene(leaf.clone(), vec![]), 2);
            let ball = solid(Form::Sphere { radius: 0.4 }, [0.8, 0.3, 0.2]);
            let both = Node::operator(Operator::Union, [leaf, ball]);
            if number > 0 {
                continue;
            }
            check(&format!("{what}, in a union"), &scene(both, vec![]), 2);
        }
    }
}

#[test]
fn nothing_shows_where_weights_add_up_to_less_than_nothing_whatever_its_attributes() {
    let folder = folder();
    let mut random = Random(43);
    let (mut position, mut columns) = (Vec::new(), vec![Vec::new(); 3]);
    for i in 0..600 {
        // Two heaps apart, one of either sign, so that no sum of weights is close to zero by
        // cancellation.
        let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
        position.push([sign * (0.4 + 0.6 * random.unit()), 2.0 * random.unit() - 1.0, random.unit()]);
        columns[0].push(0.35);
        columns[1].push((sign * (0.2 + random.unit())) as f32);
        columns[2].push(random.unit() as f32);
    }
    let source = ArraySource::new(position, ["radius", "weight", "heat"].into_iter().zip(columns).collect());
    let options = BuildOptions { attributes: vec!["heat".into()], ..BuildOptions::default() };
    let cloud = build_at(&folder.path().join("c.rset"), Box::new(source), &options);
    let mut leaf = Node::new(Shape::Cloud(look(&cloud, Kernel::Wyvill)));
    // Transfer functions take effect where the opacity is above 0, and it is 0 where the density is
    // not above 0.
    leaf.transfers = by_attribute("heat").into();
    let scene = scene(leaf, vec![]);
    check("weights of both signs", &scene, 2);
    let pixels = plain_picture(&scene, &settings(32, 32));
    let covered = |half: std::ops::Range<usize>| {
        (0..32 * 32).filter(|i| half.contains(&(i % 32)) && pixels[*i][3] > 0.0).count()
    };
    assert_eq!(covered(0..14), 0);
    assert!(covered(18..32) > 50);
}

#[test]
fn every_light_and_exact_shadow_agrees_with_the_reference_renderer() {
    let Parts { cloud, _folder, .. } = parts();
    let small = cloud.moved(DAffine3::from_scale_rotation_translation(
        DVec3::splat(0.4),
        DQuat::IDENTITY,
        DVec3::new(0.0, 0.4, 0.2),
    ));
    let floor = solid(Form::Box { size: DVec3::new(2.0, 0.2, 2.0) }, [0.8, 0.8, 0.7])
        .moved(DAffine3::from_translation(DVec3::new(0.0, -0.7, 0.0)));
    let veil = soft(Form::Sphere { radius: 0.3 }, [0.3, 0.6, 0.9], 0.3)
        .moved(DAffine3::from_translation(DVec3::new(-0.5, 0.1, 0.3)));
    let root = Node::operator(Operator::Union, [small, floor, veil]);
    let down = LightKind::Directional { direction: DVec3::new(0.3, -1.0, -0.4) };
    let lamp = |decays| LightKind::Point { position: DVec3::new(-0.8, 1.2, 0.9), decays };
    let ambient = light(LightKind::Ambient, [0.5, 0.5, 0.6], false);
    for (name, lights) in [
        ("ambient", vec![ambient]),
        ("directional", vec![ambient, light(down, [0.9, 0.8, 0.7], true)]),
        ("point", vec![light(lamp(true), [1.5, 1.4, 1.2], true)]),
        ("unshadowed", vec![light(down, [0.5; 3], false), light(lamp(false), [0.3, 0.4, 0.5], false)]),
        ("all", vec![ambient, light(down, [0.4; 3], true), light(lamp(false), [0.4, 0.3, 0.3], true)]),
    ] {
        check(name, &scene(root.clone(), lights), 4);
    }
    let inside =
        light(LightKind::Point { position: DVec3::new(0.0, -0.2, 0.2), decays: true }, [0.3; 3], true);
    check("a light among the objects", &scene(root, vec![inside]), 4);
}

#[test]
fn twenty_leaves_over_one_cloud_use_the_pages_of_one() {
    let folder = folder();
    let options = BuildOptions { page_bytes: Some(16 << 10), ..BuildOptions::default() };
    let cloud = build_at(&folder.path().join("c.rset"), Box::new(mixed_points(8000, 1.0, 33)), &options);
    let leaf = Arc::new(Node::new(Shape::Cloud(look(&cloud, Kernel::Wyvill))));
    let place = |i: u32| {
        let at = DVec3::new(f64::from(i % 5) - 2.0, f64::from(i / 5) - 1.5, 0.0) * 0.45;
        let moved = DAffine3::from_scale_rotation_translation(
            DVec3::splat(0.2),
            DQuat::from_rotation_y(f64::from(i)),
            at,
        );
        Arc::new(Node {
            parent_from_local: moved,
            ..Node::new(Shape::Operator(Operator::Union, vec![leaf.clone()]))
        })
    };
    let root = Node::new(Shape::Operator(Operator::Union, (0..20).map(place).collect()));
    let scene = scene(root, vec![]);
    let exec = rayset::trace::ExecSettings { threads: 2, ..Default::default() };
    let paged = crate::common::paged(&scene, 1 << 30);
    let picture =
        crate::common::picture(&scene, &camera(), &settings(64, 64), &exec, &paged).expect("a picture");
    assert!(picture.iter().filter(|p| p[3] > 0.1).count() > 500);
    let statistics = paged.pages.statistics();
    let header = cloud.header();
    let all = u64::from(header.pages()) * u64::from(header.page_bytes);
    assert!(statistics.peak_bytes <= all, "{} bytes of pages for a cloud of {all}", statistics.peak_bytes);
    // Every page is read once, whichever leaf comes first.
    let small = bits(&picture);
    let tight = crate::common::paged(&scene, 12 * u64::from(header.page_bytes));
    let again =
        crate::common::picture(&scene, &camera(), &settings(64, 64), &exec, &tight).expect("a picture");
    assert!(bits(&again) == small);
}

#[test]
fn cached_shadows_are_the_same_whatever_the_means_and_close_to_exact_ones() {
    let Parts { cloud, _folder, .. } = parts();
    let small = cloud.moved(DAffine3::from_scale_rotation_translation(
        DVec3::splat(0.4),
        DQuat::IDENTITY,
        DVec3::new(0.0, 0.4, 0.2),
    ));
    let floor = solid(Form::Box { size: DVec3::new(2.0, 0.2, 2.0) }, [0.8, 0.8, 0.7])
        .moved(DAffine3::from_translation(DVec3::new(0.0, -0.7, 0.0)));
    let down = LightKind::Directional { direction: DVec3::new(0.3, -1.0, -0.4) };
    let lamp = LightKind::Point { position: DVec3::new(-0.8, 1.2, 0.9), decays: false };
    let among = LightKind::Point { position: DVec3::new(0.3, 0.0, 0.9), decays: false };
    let lights = [down, lamp, among].map(|kind| light(kind, [0.4; 3], true)).to_vec();
    let scene = scene(Node::operator(Operator::Union, [small, floor]), lights);
    let exact = RenderSettings { step: Step::Fixed(STEP), ..settings(64, 64) };
    let cached = RenderSettings { shadows: Shadows::Cached { resolution: 512 }, ..exact };
    let picture = |settings: &RenderSettings, exec: ExecSettings, pages: u64| {
        let paged = crate::common::paged(&scene, pages * (16 << 10));
        crate::common::picture(&scene, &camera(), settings, &exec, &paged).expect("a picture")
    };
    let exec = |threads| ExecSettings { threads, ..ExecSettings::default() };
    let found = picture(&cached, exec(1), 10_000);
    for (slab_samples, tile_pixels, threads, pages) in
        [(32, 8, 2, 150), (7, 8, 1, 10_000), (32, 3, 2, 10_000), (16, 8, 3, 300)]
    {
        let again = picture(&cached, ExecSettings { slab_samples, tile_pixels, ..exec(threads) }, pages);
        assert!(
            bits(&again) == bits(&found),
            "slabs of {slab_samples}, tiles of {tile_pixels}, {pages} pages"
        );
    }
    let reference = picture(&exact, exec(2), 10_000);
    let mut errors: Vec<f32> = (found.iter().zip(&reference))
        .map(|(a, b)| (0..3).map(|c| (a[c] - b[c]).abs()).fold(0.0, f32::max))
        .collect();
    errors.sort_unstable_by(f32::total_cmp);
    let (mean, p99) = (errors.iter().sum::<f32>() / errors.len() as f32, errors[errors.len() * 99 / 100]);
    assert!(mean < 0.0005 && p99 < 0.009, "mean {mean}, 99 % within {p99}");
}

#[test]
fn pages_are_asked_for_only_where_they_reach_samples_that_matter() {
    let folder = folder();
    let options = BuildOptions { page_bytes: Some(16 << 10), ..BuildOptions::default() };
    let workload: Workload = "cube-200k".parse().expect("a workload");
    let options = BuildOptions { radius: Some(Rule::Number(0.01)), ..options };
    let cloud = build_at(&folder.path().join("c.rset"), workload.source(), &options);
    let cloud =
        Node::new(Shape::Cloud(look(&cloud, Kernel::Wyvill))).moved(DAffine3::from_scale(DVec3::splat(1.6)));
    // A thin plate: a slab of 32 samples is as deep as the cloud, and one or two of its samples are
    // inside.
    let plate = solid(Form::Box { size: DVec3::new(2.0, 2.0, 0.06) }, [1.0; 3])
        .moved(DAffine3::from_translation(DVec3::new(0.0, 0.0, 0.1)));
    let scene = scene(Node::operator(Operator::Intersection, [cloud.clone(), plate]), vec![]);
    let settings = RenderSettings { step: Step::Fixed(0.05), ..settings(64, 64) };
    let read = |scene: &Scene, slab_samples| {
        let exec = ExecSettings { slab_samples, predictor: Arc::new(NoPredictor), ..ExecSettings::default() };
        let paged = crate::common::paged(scene, 1 << 30);
        let picture = crate::common::picture(scene, &camera(), &settings, &exec, &paged).expect("a picture");
        (bits(&picture), paged.pages.statistics().total(|kind| kind.bytes_unique))
    };
    let (picture, deep) = read(&scene, 32);
    let (again, thin) = read(&scene, 1);
    let (_, whole) = read(&Scene { root: Arc::new(cloud), ..scene.clone() }, 32);
    assert!(picture == again);
    assert!(deep as f64 <= 1.1 * thin as f64, "{deep} bytes in slabs of 32 samples, {thin} of one by one");
    assert!(10 * deep < 6 * whole, "{deep} bytes of the plates, {whole} of everything");
}

#[test]
fn more_solids_than_a_march_remembers_agree_with_the_reference_renderer() {
    // Faint balls behind each other, so that a packet meets them all; it remembers its way in 64
    // fields.
    let ball = |i: u32| {
        let place = DVec3::new(
            f64::from(i % 4) * 0.1 - 0.15,
            f64::from(i / 4 % 4) * 0.1 - 0.15,
            0.8 - f64::from(i) * 0.02,
        );
        let faint = Solid { edge: 0.08, opacity: 0.05, ..Solid::new(Form::Sphere { radius: 0.15 }) };
        Node::new(Shape::Procedural(Arc::new(faint))).moved(DAffine3::from_translation(place))
    };
    let root = Node::operator(Operator::Union, (0..80).map(ball));
    check("eighty balls", &scene(root, Vec::new()), 16);
}

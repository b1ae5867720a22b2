//! Automatic steps are those of the rule that `docs/rendering.md` states: the reference renderer
//! states it anew, looks at every detail of a scene for every ray, and comes to the same pictures.

use std::path::Path;
use std::sync::Arc;

use rayset::field::Kernel;
use rayset::geometry::{DAffine3, DVec3};
use rayset::grid::VoxelKind;
use rayset::octree::Cloud;
use rayset::octree::build::BuildOptions;
use rayset::points::ArraySource;
use rayset::scene::{
    Compositing, Form, Light, LightKind, Lighting, Node, NoiseCloud, OpacityRule, Operator, Pattern,
    RenderSettings, Scene, Shadows, Shape, Step,
};
use rayset::trace::reference::{ReferenceRenderer, ReferenceSteps};

use crate::common::{Random, build_at, camera, folder, look, plain_picture, settings, workload_cloud};
use crate::graph::{light, soft, turned_and_stretched};
use crate::grids;

const SIDE: u32 = 32;

/// Points in clumps, each of a size of its own, with radii to match: from 0.2 down by some octaves.
fn clumps(count: usize, octaves: f64, seed: u64) -> (Vec<[f64; 3]>, Vec<f32>) {
    let mut random = Random(seed);
    let (mut position, mut radius) = (Vec::new(), Vec::new());
    for _ in 0..count / 40 {
        let center: [f64; 3] = std::array::from_fn(|_| 1.2 * (random.unit() - 0.5));
        let size = 2_f64.powf(-octaves * random.unit());
        for _ in 0..40 {
            position.push(center.map(|c| c + 0.6 * size * (random.unit() - 0.5)));
            radius.push((0.2 * size * (0.7 + 0.3 * random.unit())) as f32);
        }
    }
    (position, radius)
}

fn built(folder: &Path, name: &str, (position, radius): (Vec<[f64; 3]>, Vec<f32>)) -> Arc<Cloud> {
    let options = BuildOptions { page_bytes: Some(16 << 10), ..BuildOptions::default() };
    let source = ArraySource::new(position, vec![("radius", radius)]);
    build_at(&folder.join(name), Box::new(source), &options)
}

fn node(cloud: &Arc<Cloud>, depth_of_largest: f64) -> Node {
    let largest = f64::from(cloud.header().radius.max());
    let mut object = look(cloud, Kernel::Wyvill);
    object.transfer.opacity = OpacityRule::Extinction(depth_of_largest / largest);
    Node::new(Shape::Cloud(object))
}

pub(crate) fn unlit(root: Node) -> Scene {
    Scene {
        root: Arc::new(root),
        lighting: Lighting::Unlit,
        background: None,
        unit_distance: 0.1,
        compositing: Compositing::Linear,
    }
}

fn lit(root: Node) -> Scene {
    let sun = LightKind::Directional { direction: DVec3::new(-0.4, -1.0, -0.6) };
    let lights: Vec<Light> =
        vec![light(LightKind::Ambient, [0.4; 3], false), light(sun, [0.8, 0.8, 0.7], true)];
    Scene { lighting: Lighting::Lit(lights), ..unlit(root) }
}

/// Every pixel against the reference, by the rule and with the coarsest step alone. Returns how
/// many differ by more than 1/1024, of the first and of the second. One of a thousand may by the
/// documents; a picture of so few pixels is allowed two, and six where edges of exact shadows are
/// in it, which both renderers find with different rounding.
fn differing(scene: &Scene, settings: &RenderSettings) -> (usize, usize) {
    let found = plain_picture(scene, settings);
    let reference = ReferenceRenderer::load(scene).expect("the clouds read");
    let by_place = ReferenceSteps::of(scene, settings).expect("the clouds read");
    let same = ReferenceSteps::same(by_place.coarsest_world());
    let differ = |steps: &ReferenceSteps| {
        let pixels = (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| (x, y)));
        let worst = pixels.map(|(x, y)| {
            let exact = reference.pixel(&camera(), settings, steps, x, y).expect("a camera");
            let pixel = found[(y * SIDE + x) as usize];
            (0..4).map(|c| (f64::from(pixel[c]) - exact[c]).abs()).fold(0.0, f64::max)
        });
        worst.filter(|worst| worst.is_nan() || *worst > 1.0 / 1024.0).count()
    };
    (differ(&by_place), differ(&same))
}

/// How many pixels with automatic steps are beyond 1/1024 of the reference's.
pub(crate) fn count_differing(scene: &Scene) -> usize {
    differing(scene, &settings(SIDE, SIDE)).0
}

pub(crate) fn check(what: &str, scene: &Scene, allowed: usize) {
    let (by_place, same) = differing(scene, &settings(SIDE, SIDE));
    assert!(by_place <= allowed, "{what}: {by_place} pixels differ, {same} with the coarsest step");
    assert!(same > 20, "{what}: the coarsest step alone makes the same picture but for {same} pixels");
}

#[test]
fn clouds_whose_radii_differ_have_the_steps_of_their_nodes_groups_and_scattered_points() {
    let folder = folder();
    let folder = folder.path();
    for (what, octaves) in [("a few octaves", 3.0), ("many octaves", 9.0)] {
        let cloud = built(folder, "a.rset", clumps(4000, octaves, 7));
        check(what, &unlit(node(&cloud, 1.0)), 2);
        check(&format!("{what}, transformed"), &unlit(node(&cloud, 1.0).moved(turned_and_stretched())), 2);
    }
    let mut random = Random(9);
    let place = |random: &mut Random| std::array::from_fn(|_| 1.6 * (random.unit() - 0.5));
    let position = (0..3000).map(|_| place(&mut random)).collect();
    let radius = (0..3000).map(|_| 0.2 * 2_f32.powf(-3.5 * random.unit() as f32)).collect();
    let cloud = built(folder, "mixed.rset", (position, radius));
    check("radii of all sizes side by side", &unlit(node(&cloud, 1.0)), 2);
    let (mut position, mut radius) = clumps(1000, 1.0, 8);
    for _ in 0..3000 {
        position.push(place(&mut random));
        radius.push(2e-4);
    }
    let cloud = built(folder, "scattered.rset", (position, radius));
    check("scattered points between large ones", &unlit(node(&cloud, 40.0)), 2);
    let (mut position, mut radius) = clumps(2000, 0.0, 10);
    radius.iter_mut().for_each(|radius| *radius *= 0.1);
    position.push([0.1, 0.2, -0.3]);
    radius.push(1.5);
    let cloud = built(folder, "large.rset", (position, radius));
    check("one large point among small ones", &unlit(node(&cloud, 10.0)), 2);
}

#[test]
fn scenes_of_several_objects_have_the_steps_of_what_a_ray_is_in() {
    let folder = folder();
    let folder = folder.path();
    let cloud = built(folder, "a.rset", clumps(2000, 4.0, 11));
    let fog = NoiseCloud {
        radii: DVec3::new(0.9, 0.7, 0.8),
        scale: 0.3,
        octaves: 3,
        roughness: 0.5,
        opacity: 0.2,
        cover: 0.6,
        seed: 5,
        pattern: Pattern::Uniform([0.9; 3]),
    };
    let coarse = NoiseCloud { octaves: 1, ..fog.clone() };
    let fog = || Node::new(Shape::Procedural(Arc::new(fog.clone())));
    let thin = || soft(Form::Box { size: DVec3::new(1.2, 0.06, 0.9) }, [0.2, 0.5, 0.9], 0.02);
    let ball = || soft(Form::Sphere { radius: 0.5 }, [0.8, 0.3, 0.2], 0.3);
    let of = |operator, nodes: Vec<Node>| Node::operator(operator, nodes);
    let low = || DAffine3::from_translation(DVec3::new(0.0, -0.4, 0.0));
    check("a cloud and a thin plate", &unlit(of(Operator::Union, vec![node(&cloud, 1.0), thin()])), 2);
    check("the same, lit", &lit(of(Operator::Union, vec![node(&cloud, 1.0), thin().moved(low())])), 6);
    check("noise, a ball and a plate", &lit(of(Operator::Blend, vec![fog(), ball(), thin()])), 6);
    let voxels = || grids::object(&grids::grid(folder, VoxelKind::U8), 0.0);
    let (position, radius) = clumps(400, 0.0, 13);
    let wide = built(folder, "wide.rset", (position, radius.iter().map(|r| 3.0 * r).collect()));
    check("wide points in a grid", &unlit(of(Operator::Blend, vec![node(&wide, 0.3), voxels()])), 2);
    check("a grid without a cloud", &lit(of(Operator::Difference, vec![voxels(), node(&cloud, 30.0)])), 6);
    let holed = || of(Operator::Difference, vec![ball(), thin()]);
    check("a ball without a plate", &lit(of(Operator::Union, vec![holed(), fog()])), 6);
    let coarse = Node::new(Shape::Procedural(Arc::new(coarse)));
    let shell = soft(Form::Sphere { radius: 0.4 }, [0.9; 3], 0.02);
    check("a ball with a thin edge in noise", &unlit(of(Operator::Union, vec![coarse, shell])), 2);
}

#[test]
fn opaque_clouds_under_shadows_are_as_bright_with_an_eighth_of_the_step() {
    let folder = folder();
    let cloud = workload_cloud("knot-20k", folder.path());
    let mut object = look(&cloud, Kernel::Wyvill);
    object.transfer.opacity = OpacityRule::Clamp;
    let unit_distance = cloud.header().radius_mean;
    let scene = Scene { unit_distance, ..lit(Node::new(Shape::Cloud(object))) };
    for shadows in [Shadows::Exact, Shadows::Cached { resolution: 256 }] {
        let mean = |fraction: f64| {
            let step = Step::Automatic { fraction };
            let picture = plain_picture(&scene, &RenderSettings { shadows, step, ..settings(SIDE, SIDE) });
            let covered = picture.iter().filter(|pixel| pixel[3] > 0.9);
            let (count, sum) = covered.fold((0, 0.0), |(count, sum), p| (count + 1, sum + f64::from(p[0])));
            assert!(count > 100, "{count} pixels are covered");
            sum / f64::from(count)
        };
        let (coarse, default, fine) = (mean(1.0), mean(0.25), mean(1.0 / 32.0));
        assert!(coarse > 0.92 * default, "{shadows:?}: {coarse} with four times the step, {default}");
        assert!(
            (default - fine).abs() < 0.01,
            "{shadows:?}: {default} and {fine} with an eighth of the step"
        );
    }
}

#[test]
fn a_scene_of_one_object_whose_details_are_alike_has_one_step() {
    let folder = folder();
    let (position, _) = clumps(1000, 0.0, 12);
    let radius = vec![0.1; position.len()];
    let cloud = built(folder.path(), "a.rset", (position, radius));
    let scene = unlit(node(&cloud, 1.0));
    let settings = settings(SIDE, SIDE);
    assert_eq!(differing(&scene, &settings), (0, 0));
}

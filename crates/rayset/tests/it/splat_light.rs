//! Gaussian splats as extinction: what they leave of the light of a pixel, alone and in scenes.

use std::path::Path;
use std::sync::Arc;

use rayset::field::{Kernel, linear_from_srgb};
use rayset::geometry::{DAffine3, DMat3, DQuat, DVec3};
use rayset::image::srgb_from_linear;
use rayset::octree::Cloud;
use rayset::octree::build::{BuildOptions, run_in_memory};
use rayset::points::{ArraySource, PointSource};
use rayset::scene::{
    CloudObject, Compositing, Form, Material, Node, OpacityRule, Operator, RenderSettings, Scene, SceneError,
    Shape, Step, TransferError,
};
use rayset::scene_file::SceneFile;
use rayset::trace::{ExecSettings, RenderError};

use crate::common::{Random, camera, look, paged, picture, plain_picture, scene_of, settings};
use crate::graph::solid;
use crate::right_picture::count_wrong_pixels;
use crate::steps_by_place;

/// A splat: centre, deviations, rotation, opacity.
pub(crate) type Splat = (DVec3, DVec3, DQuat, f64);

/// Splats absorb nothing where they would absorb less than one part in so many.
pub(crate) const CUT: f64 = 512.0;

pub(crate) fn splats(count: usize, size: f64, most_opaque: f64, seed: u64) -> Vec<Splat> {
    let mut random = Random(seed);
    let mut number = |low: f64, high: f64| low + (high - low) * random.unit();
    (0..count)
        .map(|_| {
            let center = DVec3::from_array(std::array::from_fn(|_| number(-0.8, 0.8)));
            let deviations = DVec3::new(1.0, number(0.05, 1.0), number(0.05, 1.0)) * size * number(0.4, 1.0);
            let rotation = DQuat::from_array(std::array::from_fn(|_| number(-1.0, 1.0))).normalize();
            (center, deviations, rotation, number(0.02, most_opaque))
        })
        .collect()
}

pub(crate) fn built(splats: &[Splat]) -> Arc<Cloud> {
    let column = |of: &dyn Fn(&Splat) -> f64| splats.iter().map(|s| of(s) as f32).collect::<Vec<_>>();
    let radius = |s: &Splat| (2.0 * (CUT * s.3).ln()).sqrt();
    let columns = vec![
        ("radius", column(&|s| radius(s) * s.1.x)),
        ("semi_axis_1", column(&|s| radius(s) * s.1.x)),
        ("semi_axis_2", column(&|s| radius(s) * s.1.y)),
        ("semi_axis_3", column(&|s| radius(s) * s.1.z)),
        ("rotation_x", column(&|s| s.2.x)),
        ("rotation_y", column(&|s| s.2.y)),
        ("rotation_z", column(&|s| s.2.z)),
        ("rotation_w", column(&|s| s.2.w)),
        ("weight", column(&|s| s.3)),
        ("red", column(&|s| s.3)),
        ("green", column(&|s| 1.0 - s.3)),
        ("blue", column(&|_| 0.5)),
    ];
    let position = splats.iter().map(|s| s.0.to_array()).collect();
    let source: Box<dyn PointSource> = Box::new(ArraySource::new(position, columns));
    let (cloud, _) =
        run_in_memory(vec![source], &BuildOptions::default(), &Default::default()).expect("it builds");
    Arc::new(cloud)
}

pub(crate) fn object(cloud: &Arc<Cloud>) -> CloudObject {
    let mut object = look(cloud, Kernel::Splat);
    object.transfer.opacity = OpacityRule::Extinction(1.0);
    object
}

/// What splats leave of the ray of a pixel in a splat renderer, and at least and at most where each
/// may absorb up to one part in [`CUT`] less, as it ends there.
fn left(splats: &[Splat], width: u32, (x, y): (u32, u32)) -> (f64, f64) {
    // The camera of the standard workloads.
    let (eye, slope) = (DVec3::new(0.0, 0.0, 3.0), 22.5_f64.to_radians().tan());
    let place = |pixel: u32| (f64::from(pixel) + 0.5) / f64::from(width) * 2.0 - 1.0;
    let direction = DVec3::new(place(x) * slope, -place(y) * slope, -1.0);
    splats.iter().fold((1.0, 1.0), |(least, most), (center, deviations, rotation, opacity)| {
        let map = DMat3::from_diagonal(1.0 / *deviations) * DMat3::from_quat(*rotation).transpose();
        let (o, d) = (map * (eye - *center), map * direction);
        let distance: f64 = o.cross(d).length() / d.length();
        let alpha = opacity * (-0.5 * distance * distance).exp();
        let cut = if alpha < 1.0 / CUT { 0.0 } else { (alpha - 1.0 / CUT).max(0.0) };
        (least * (1.0 - alpha), most * (1.0 - cut))
    })
}

#[test]
fn pixels_show_what_splat_renderers_leave_whatever_the_step_and_however_many_overlap() {
    let width = 40;
    for (count, size, most_opaque) in [(1, 0.3, 0.999), (2, 0.4, 0.99), (50, 0.3, 0.95), (5000, 0.05, 0.6)] {
        let splats = splats(count, size, most_opaque, count as u64);
        let cloud = built(&splats);
        let mut pictures = Vec::new();
        for step in [0.01, 0.07, 0.9, 40.0] {
            let scene = scene_of(object(&cloud), false);
            let settings =
                RenderSettings { step: Step::Fixed(step), stop_transmittance: 0.0, ..settings(width, width) };
            pictures.push(plain_picture(&scene, &settings));
        }
        let (mut covered, mut worst) = (0, 0.0_f64);
        for (i, first) in pictures[0].iter().enumerate() {
            let transmittance = 1.0 - f64::from(first[3]);
            let (least, most) = left(&splats, width, (i as u32 % width, i as u32 / width));
            // Positions and shapes are rounded in the file.
            let within = least - 1e-3..=most + 1e-3;
            assert!(
                within.contains(&transmittance),
                "{count}, pixel {i}: {transmittance}, {least} to {most}"
            );
            covered += usize::from(transmittance < 0.9);
            for other in &pictures {
                worst = worst.max(f64::from((other[i][3] - first[3]).abs()));
            }
        }
        assert!(worst < 1e-3, "{count} splats differ by {worst} from step to step");
        assert!(covered > 20, "{count} splats cover {covered} pixels");
    }
}

#[test]
fn splats_are_right_lit_and_cut_and_under_any_transform() {
    let cloud = built(&splats(300, 0.15, 0.99, 7));
    let mirrored = DAffine3::from_scale_rotation_translation(
        DVec3::new(0.7, -1.2, 1.0),
        DQuat::from_rotation_z(0.4),
        DVec3::new(0.1, 0.0, -0.2),
    );
    for (map, step) in [(DAffine3::IDENTITY, 0.02), (mirrored, 0.05)] {
        let node = Node::new(Shape::Cloud(object(&cloud)));
        let splats = Arc::new(Node { parent_from_local: map, ..node });
        let solid = solid(Form::Box { size: DVec3::new(3.0, 1.0, 1.0) }, [0.6; 3]);
        let solid = Arc::new(solid.moved(DAffine3::from_translation(DVec3::new(0.0, 0.4, 0.3))));
        let operator = |operator, children: Vec<_>| Arc::new(Node::new(Shape::Operator(operator, children)));
        let roots = [
            splats.clone(),
            operator(Operator::Difference, vec![splats.clone(), solid.clone()]),
            operator(Operator::Union, vec![solid, splats]),
        ];
        for (i, root) in roots.into_iter().enumerate() {
            let mut scene = scene_of(object(&cloud), true);
            scene.root = root;
            // Most splats absorb more of a unit than other objects may.
            scene.unit_distance = 0.03;
            let settings = RenderSettings { step: Step::Fixed(step), ..settings(48, 48) };
            for compositing in [Compositing::Display, Compositing::Linear] {
                scene.compositing = compositing;
                let wrong = count_wrong_pixels(&scene, &settings, step, 300);
                assert!(wrong <= 1, "scene {i}, {compositing:?}: {wrong} of 300 pixels beyond 1/1024");
            }
            if i == 0 {
                let differing = steps_by_place::count_differing(&scene);
                assert!(differing <= 2, "automatic steps: {differing} pixels differ");
            }
        }
    }
}

#[test]
fn display_values_are_composited_as_splat_renderers_do() {
    let flat = |z: f64, opacity: f64| {
        (DVec3::new(0.0, 0.0, z), DVec3::new(0.6, 0.6, 0.05), DQuat::IDENTITY, opacity)
    };
    let (front, back) = (flat(0.6, 0.5), flat(-0.6, 0.97));
    let behind = [0.6_f32, 0.05, 0.3];
    let width = 32;
    let mut scene = scene_of(object(&built(&[back, front])), false);
    (scene.background, scene.compositing) = (Some(behind), Compositing::Display);
    let settings = RenderSettings { stop_transmittance: 0.0, ..settings(width, width) };
    let picture = plain_picture(&scene, &settings);
    let mut farthest_from_linear = 0.0_f64;
    for (i, pixel) in picture.iter().enumerate() {
        let passes = |splat: Splat| left(&[splat], width, (i as u32 % width, i as u32 / width)).0;
        let (of_front, of_back) = (passes(front), passes(back));
        let over = |front: f64, back: f64, behind: f64| {
            (1.0 - of_front) * front + of_front * ((1.0 - of_back) * back + of_back * behind)
        };
        // Colours in the file are bytes.
        let bytes = |c: f64| (c * 255.0).round() / 255.0;
        let colors = [[0.5, 0.97], [0.5, 0.03], [0.5, 0.5]].map(|pair| pair.map(bytes));
        for ((shown, [front, back]), behind) in pixel.iter().zip(colors).zip(behind) {
            let shown = srgb_from_linear(f64::from(*shown));
            let displayed = over(front, back, srgb_from_linear(f64::from(behind)));
            assert!((shown - displayed).abs() < 3e-3, "pixel {i}: {shown}, {displayed}");
            let linear = over(linear_from_srgb(front), linear_from_srgb(back), f64::from(behind));
            farthest_from_linear = farthest_from_linear.max((shown - srgb_from_linear(linear)).abs());
        }
    }
    assert!(farthest_from_linear > 0.05, "linear light would differ by {farthest_from_linear} at most");
    scene.background = None;
    let open = plain_picture(&scene, &settings);
    let open = open.iter().zip(&picture).filter(|(open, whole)| open[3] > 0.5 && open[0] <= whole[0]);
    assert!(open.count() > 50);
}

#[test]
fn display_values_are_not_composited_where_light_is_added_after_the_fact() {
    let cloud = built(&splats(10, 0.1, 0.9, 3));
    let render = |scene: &Scene, settings: &RenderSettings| {
        picture(scene, &camera(), settings, &ExecSettings::default(), &paged(scene, u64::MAX / 2))
    };
    let refused = |scene: &Scene, settings: &RenderSettings, said: &str| matches!(render(scene, settings), Err(RenderError::Scene(SceneError::Compositing { what })) if what == said);
    let mut scene = scene_of(object(&cloud), true);
    scene.compositing = Compositing::Display;
    let plain = settings(8, 8);
    assert!(refused(&scene, &RenderSettings { ambient_occlusion: 1.0, ..plain }, "ambient occlusion"));
    assert!(render(&scene, &plain).is_ok());
    let mut mirror = Node::new(Shape::Cloud(object(&cloud)));
    mirror.material = Some(Material { reflectance: 0.5, ..Material::default() });
    let mut glass = mirror.clone();
    glass.material = Some(Material { refractive_index: 1.5, ..Material::default() });
    for (root, what) in [(mirror, "reflectance"), (glass, "refraction")] {
        scene.root = Arc::new(root);
        assert!(refused(&scene, &plain, what));
        assert!(render(&scene, &RenderSettings { max_depth: 0, ..plain }).is_ok(), "no ray is followed");
    }
    let text = r#"{"rayset": 1, "rendering": {"compositing": "display"}, "root": {"type": "sphere", "radius": 1, "material": {"reflectance": 0.5}}}"#;
    let error = SceneFile::parse(Path::new("scene.json"), text).map(drop).expect_err("refused").to_string();
    assert!(error.contains("rendering.compositing") && error.contains("without reflectance"), "{error}");
}

#[test]
fn splats_of_another_opacity_rule_or_normalised_are_refused() {
    let cloud = built(&splats(10, 0.1, 0.9, 3));
    let refused = |object: CloudObject| match Scene::of_cloud(object).check() {
        Err(SceneError::Transfer(TransferError::Splats)) => true,
        other => panic!("{other:?}"),
    };
    assert!(refused(CloudObject { normalised: true, ..object(&cloud) }));
    let mut clamped = object(&cloud);
    clamped.transfer.opacity = OpacityRule::Clamp;
    assert!(refused(clamped));
    assert!(Scene::of_cloud(object(&cloud)).check().is_ok());
}

//! Lights see soft clouds from afar as the judge says, and solid ones point by point. How the work
//! is done makes no difference.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use rayset::cancel::CancelToken;
use rayset::field::{Eye, Sight};
use rayset::geometry::{DAffine3, DVec3, Ray};
use rayset::octree::Cloud;
use rayset::octree::aggregates::{AggregateOptions, add_to_file};
use rayset::octree::build::BuildOptions;
use rayset::scene::{
    Camera, CloudObject, ColorRule, Form, Light, LightKind, Lighting, Lod, Node, OpacityRule, Operator,
    Projection, RenderSettings, Scene, Shadows, Shape, Solid, Step, TransferFunction,
};
use rayset::trace::ExecSettings;
use rayset::trace::reference::far::Far;
use rayset::working_set::Limits;
use rayset::{Picture, Session};
use rayset_lab::simulated::Behaviour;

use crate::common::{bits, build_at, folder, mixed_points, paged, picture, settings};
use crate::remote_storage::{quick, remote};

/// Where the cloud is, above a floor at height 0.
const ABOVE: DVec3 = DVec3::new(0.1, 2.6, -0.2);
const SIZE: u32 = 9;
/// Edge of a pixel on the floor.
const PIXEL: f64 = 0.11;

fn cloud_at(path: &Path, opacity: OpacityRule) -> CloudObject {
    build_at(path, Box::new(mixed_points(20_000, 6.0, 8)), &BuildOptions::default());
    let options = AggregateOptions::default().with_memory_bytes(64 << 20).with_threads(2);
    add_to_file(path, path, &options, &|_, _| {}, &CancelToken::new()).expect("aggregates");
    let cloud = Arc::new(Cloud::open(path).expect("it opens"));
    let transfer = TransferFunction { opacity, color: ColorRule::Uniform([1.0; 3]) };
    CloudObject { transfer, ..CloudObject::plain(cloud) }
}

/// A white floor, and above it a cloud, and above that a light.
fn scene(object: &CloudObject, kind: LightKind) -> Scene {
    let floor = Solid::new(Form::Box { size: DVec3::new(6.0, 0.2, 6.0) }).colored([1.0; 3]);
    let floor = Node::new(Shape::Procedural(Arc::new(floor)));
    let cloud = Node::new(Shape::Cloud(object.clone())).moved(DAffine3::from_translation(ABOVE));
    let parts = vec![floor.moved(DAffine3::from_translation(DVec3::new(0.0, -0.1, 0.0))), cloud];
    Scene {
        root: Arc::new(Node::operator(Operator::Union, parts)),
        lighting: Lighting::Lit(vec![Light { kind, color: [1.0; 3], shadow: true }]),
        unit_distance: 0.01,
        ..Scene::of_cloud(object.clone())
    }
}

/// It sees the floor alone, from below the cloud.
fn camera() -> Camera {
    let projection = Projection::Orthographic { height: PIXEL * f64::from(SIZE) };
    Camera { position: DVec3::new(0.0, 0.5, 0.0), direction: DVec3::NEG_Y, up: DVec3::Z, projection }
}

fn sun() -> LightKind {
    LightKind::Directional { direction: DVec3::new(0.15, -1.0, 0.1) }
}

fn lamp() -> LightKind {
    LightKind::Point { position: DVec3::new(-0.3, 9.0, 0.4), decays: false }
}

fn fine() -> RenderSettings {
    settings(SIZE, SIZE).with_step(Step::Automatic { fraction: 0.1 }).with_stop_transmittance(0.0)
}

fn seen(scene: &Scene, settings: &RenderSettings) -> Vec<[f32; 4]> {
    let paged = paged(scene, 1 << 30);
    picture(scene, &camera(), settings, &ExecSettings::default(), &paged).expect("a picture")
}

/// What the cloud leaves of the light on each pixel of the floor, which dims it a little, too.
fn left(object: &CloudObject, kind: LightKind, settings: &RenderSettings) -> Vec<f64> {
    let mut clear = object.clone();
    clear.transfer.opacity = OpacityRule::Extinction(0.0);
    let (dim, bright) = (seen(&scene(object, kind), settings), seen(&scene(&clear, kind), settings));
    dim.iter().zip(&bright).map(|(dim, bright)| f64::from(dim[1]) / f64::from(bright[1])).collect()
}

/// The same as the judge has it, seen with pixels so wide.
fn judged(object: &CloudObject, kind: LightKind, sight: Sight, lod: Lod) -> Vec<f64> {
    let unit = scene(object, kind).unit_distance;
    let far = Far::with_sight(object, unit, sight, lod).expect("a file").expect("aggregates");
    let of_pixel = |at: u32| {
        let across = |i: u32| (f64::from(i) + 0.5 - f64::from(SIZE) / 2.0) * PIXEL;
        let place = DVec3::new(-across(at % SIZE), 0.0, -across(at / SIZE));
        let toward = match kind {
            LightKind::Point { position, .. } => position - place,
            LightKind::Directional { direction } => -direction,
            _ => DVec3::Y,
        };
        1.0 - far.along(&Ray { origin: place - ABOVE, direction: toward.normalize() }).opacity
    };
    (0..SIZE * SIZE).map(of_pixel).collect()
}

/// The mean and the largest difference.
fn off(a: &[f64], b: &[f64]) -> (f64, f64) {
    let off = a.iter().zip(b).map(|(a, b)| (a - b).abs());
    (off.clone().sum::<f64>() / a.len() as f64, off.fold(0.0, f64::max))
}

fn direction(kind: LightKind) -> DVec3 {
    if let LightKind::Directional { direction } = kind { direction } else { DVec3::NEG_Y }
}

/// By rays from samples, pixels are as wide as those of the picture, rounded down to a power of
/// two.
#[test]
fn exact_shadows_from_afar_are_those_of_the_judge() {
    let folder = folder();
    let object = cloud_at(&folder.path().join("c.rset"), OpacityRule::Extinction(0.06));
    for kind in [sun(), lamp()] {
        let eye = match kind {
            LightKind::Point { position, .. } => Eye::Toward(position - ABOVE),
            _ => Eye::Along(direction(kind).normalize()),
        };
        let sight = Sight { eye, forward: DVec3::Z, pixel: 0.0625, corner_cosine: 1.0, is_shown: false };
        for lod in [Lod::Footprint(4.0), Lod::Coarse(8.0)] {
            let settings = fine().with_lod(lod);
            let (is, was) = (left(&object, kind, &settings), judged(&object, kind, sight, lod));
            let (mean, most) = off(&is, &was);
            let whole = off(&left(&object, kind, &settings.with_lod(Lod::Off)), &was);
            assert!(mean < 2e-4 && most < 1e-3, "{kind:?}, {lod:?}: {mean}, {most}");
            assert!(whole.0 > 20.0 * mean, "{kind:?}, {lod:?}: all points {}, {mean}", whole.0);
        }
    }
}

/// Cells of the table are the pixels, which are taken to be 16 times as wide: light is interpolated
/// between their corners.
#[test]
fn cached_shadows_from_afar_are_those_of_the_judge() {
    let folder = folder();
    let object = cloud_at(&folder.path().join("c.rset"), OpacityRule::Extinction(0.06));
    let bounds = scene(&object, sun()).root.bounds();
    let (center, radius) = (bounds.center(), 0.5 * bounds.size().length());
    let resolution = 256;
    for kind in [sun(), lamp()] {
        // The square of the table, and its cells: at the distance of 1 from a lamp.
        let half = match kind {
            LightKind::Point { position, .. } => {
                let sine = radius / position.distance(center);
                assert!(sine < 0.8, "the table has one face");
                sine / (1.0 - sine * sine).sqrt()
            }
            _ => radius,
        };
        let (eye, forward) = match kind {
            LightKind::Point { position, .. } => (Eye::At(position - ABOVE), (center - position).normalize()),
            _ => (Eye::Along(direction(kind).normalize()), direction(kind).normalize()),
        };
        let pixel = 2.0 * 1.001 * half / f64::from(resolution);
        let sight = Sight { eye, forward, pixel, corner_cosine: 0.0, is_shown: false };
        let lod = Lod::Footprint(16.0);
        let settings = RenderSettings { shadows: Shadows::Cached { resolution }, ..fine().with_lod(lod) };
        let (is, was) = (left(&object, kind, &settings), judged(&object, kind, sight, lod));
        let (mean, most) = off(&is, &was);
        let whole = off(&left(&object, kind, &settings.with_lod(Lod::Off)), &was);
        assert!(mean < 2e-3 && most < 0.02, "{kind:?}: {mean}, {most}");
        assert!(whole.0 > 10.0 * mean, "{kind:?}: all points {}, {mean}", whole.0);
    }
}

/// Their surfaces would throw shadows on themselves.
#[test]
fn shadows_of_solid_clouds_are_those_of_all_points() {
    let folder = folder();
    for opacity in [OpacityRule::Clamp, OpacityRule::Curve(vec![(0.1, 0.0), (0.6, 1.0)])] {
        let object = cloud_at(&folder.path().join("c.rset"), opacity);
        for shadows in [Shadows::Exact, Shadows::Cached { resolution: 64 }] {
            let settings = RenderSettings { shadows, ..settings(SIZE, SIZE).with_step(Step::Fixed(0.02)) };
            let of = |lod: Lod| left(&object, sun(), &settings.with_lod(lod));
            let (mean, most) = off(&of(Lod::Footprint(4.0)), &of(Lod::Off));
            assert!(mean == 0.0 && most == 0.0, "{shadows:?}: {mean}, {most}");
        }
    }
}

/// By sun and lamp, from this machine and from another.
#[test]
fn shadows_from_afar_depend_on_no_execution_setting() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    let object = cloud_at(&path, OpacityRule::Extinction(0.06));
    let file = std::fs::read(&path).expect("the file");
    let lights = |kind: LightKind| Light { kind, color: [0.7; 3], shadow: true };
    let eye = Camera::look_at(DVec3::new(0.5, 4.0, 7.0), DVec3::new(0.0, 1.3, 0.0), DVec3::Y, 0.8);
    for shadows in [Shadows::Exact, Shadows::Cached { resolution: 48 }] {
        let settings = RenderSettings { shadows, ..settings(20, 24).with_lod(Lod::Footprint(2.0)) };
        let seen = |cloud: Arc<Cloud>, threads: usize, tile_pixels: u32, budget: u64| {
            let object = CloudObject { cloud, ..object.clone() };
            let lighting = Lighting::Lit(vec![lights(sun()), lights(lamp())]);
            let scene = Scene { lighting, ..scene(&object, sun()) };
            let session = Session::builder().threads(threads).page_limits(Limits::total(budget)).build();
            let prepared = session.expect("a session").prepare(&scene, &settings).expect("a scene");
            let view = prepared.view(&eye).expect("a view");
            let mut seen = Picture::default();
            let bands = view.render_bands(&view.region(), tile_pixels, &CancelToken::new(), &mut seen);
            bands.expect("a picture");
            bits(&seen.pixels)
        };
        let plain = seen(object.cloud.clone(), 1, 8, 1 << 30);
        for (threads, rows, budget) in [(3, 5, 1 << 30), (2, 24, 2 << 20)] {
            assert!(seen(object.cloud.clone(), threads, rows, budget) == plain, "{shadows:?}: {threads}");
            let behaviour = Behaviour { latency: Duration::from_millis(1), ..Behaviour::default() };
            let (_, storage) = remote(&file, behaviour, quick());
            let cloud = Arc::new(Cloud::from_storage("remote", Arc::new(storage)).expect("a cloud"));
            assert!(seen(cloud, threads, rows, budget) == plain, "{shadows:?}, remote: {threads}");
        }
    }
}

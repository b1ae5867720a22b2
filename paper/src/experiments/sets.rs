//! Twenty objects under three lights, over some point sets that take turns, and the engine that
//! ships on them.

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context as _, Result};
use rayset::PagedFiles;
use rayset::geometry::{DAffine3, DQuat, DVec3};
use rayset::octree::Cloud;
use rayset::scene::{
    Camera, Compositing, Light, LightKind, Lighting, Node, Operator, RenderSettings, Scene, Shape, Step,
};
use rayset::trace::{ExecSettings, Session};
use rayset::working_set::read::{self, BackendKind};
use rayset::working_set::{Limits, WorkingSet};

use super::object;

pub(super) const OBJECTS: usize = 20;

/// Table 3's scene of some clouds.
#[derive(clap::Args)]
pub struct SetsArgs {
    /// Cloud files, one or more point sets
    #[arg(required = true)]
    clouds: Vec<PathBuf>,
    /// Pixels along each side
    #[arg(long, default_value_t = 112)]
    side: u32,
}

/// Renders twice, with nothing in memory and with all pages there, and says what the processor
/// spent.
///
/// # Errors
/// Whatever stopped it.
pub fn run(args: &SetsArgs) -> Result<String> {
    let open = |path: &PathBuf| Ok(Arc::new(Cloud::open(path)?));
    let clouds: Vec<Arc<Cloud>> = args.clouds.iter().map(open).collect::<Result<_>>()?;
    let first = clouds.first().context("no point set")?;
    let scene = scene(&clouds);
    let (camera, settings, _) = view(&scene, first, args.side);
    let (cold, warm) = shipping_cpu_seconds(&scene, &camera, &settings)?;
    Ok(format!("{} point sets: {cold:.3} s of the processor cold, {warm:.3} s warm", clouds.len()))
}

/// Processor seconds of a render with nothing in memory, and of the same with all pages there.
pub(super) fn shipping_cpu_seconds(
    scene: &Scene,
    camera: &Camera,
    settings: &RenderSettings,
) -> Result<(f64, f64)> {
    let set = WorkingSet::new(Limits::total(1 << 40), read::backend(BackendKind::Auto)?);
    let exec = ExecSettings { threads: 1, direct: true, ..ExecSettings::default() };
    let session = Session::over(PagedFiles::new(set), exec)?;
    let once = || -> Result<f64> {
        let started = cpu_seconds();
        session.prepare(scene, settings)?.view(camera)?.picture()?;
        Ok(cpu_seconds() - started)
    };
    Ok((once()?, once()?))
}

/// Seconds that the processor has spent on this process.
fn cpu_seconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

/// Objects in four rows on a grid, each turned another way; sets take turns.
pub(super) fn scene(clouds: &[Arc<Cloud>]) -> Scene {
    let bounds = object(&clouds[0]).bounds();
    let scale = 1.0 / bounds.size().max_element();
    let leaves: Vec<Arc<Node>> =
        clouds.iter().map(|cloud| Arc::new(Node::new(Shape::Cloud(object(cloud))))).collect();
    let place = |i: usize| {
        let at = DVec3::new((i % 5) as f64 - 2.0, 0.0, (i / 5) as f64 - 1.5) * 1.1;
        let moved = DAffine3::from_scale_rotation_translation(
            DVec3::splat(scale),
            DQuat::from_rotation_y(1.3 * i as f64),
            at,
        ) * DAffine3::from_translation(-bounds.center());
        let leaf = leaves[i % leaves.len()].clone();
        Arc::new(Node { parent_from_local: moved, ..Node::new(Shape::Operator(Operator::Union, vec![leaf])) })
    };
    let light = |direction: DVec3, color: [f32; 3]| Light {
        kind: LightKind::Directional { direction },
        color,
        shadow: true,
    };
    Scene {
        root: Arc::new(Node::new(Shape::Operator(Operator::Union, (0..OBJECTS).map(place).collect()))),
        lighting: Lighting::Lit(vec![
            light(DVec3::new(0.3, -1.0, -0.4), [0.5, 0.45, 0.4]),
            light(DVec3::new(-0.8, -0.9, -0.2), [0.3, 0.3, 0.4]),
            light(DVec3::new(0.1, -0.6, 0.8), [0.2, 0.25, 0.2]),
        ]),
        background: None,
        unit_distance: clouds[0].header().radius_mean * scale,
        compositing: Compositing::Linear,
    }
}

pub(super) fn view(scene: &Scene, cloud: &Arc<Cloud>, side: u32) -> (Camera, RenderSettings, f64) {
    let bounds = scene.root.bounds();
    let eye = bounds.center() + DVec3::new(0.2, 0.6, 1.0).normalize() * 1.1 * bounds.size().length();
    let camera = Camera::look_at(eye, bounds.center(), DVec3::Y, 35_f64.to_radians());
    let scale = 1.0 / object(cloud).bounds().size().max_element();
    let step = 0.25 * cloud.header().radius_mean * scale;
    let settings =
        RenderSettings { width: side, height: side, step: Step::Fixed(step), ..RenderSettings::default() };
    (camera, settings, step)
}

//! `rayset check`

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use rayset::memory::SceneNeeds;
use rayset::scene::{Lighting, Shape};
use rayset::scene_file::SceneFile;

use rayset_terminal::memory::PROCESS_BYTES;
use rayset_terminal::report;

/// Check a scene file: everything that can be wrong with it, before any rendering
#[derive(Args)]
pub(crate) struct CheckArgs {
    /// Scene file
    scene: PathBuf,
}

pub(crate) fn run(args: &CheckArgs) -> Result<()> {
    let SceneFile { scene, settings, loading_bytes, .. } = SceneFile::load(&args.scene)?;
    let (mut leaves, mut operators) = (0, 0);
    scene.root.for_each(&mut |node| match node.shape {
        Shape::Operator(..) => operators += 1,
        _ => leaves += 1,
    });
    let lights = match &scene.lighting {
        Lighting::Unlit => 0,
        Lighting::Lit(lights) => lights.len(),
    };
    let bounds = scene.root.bounds();
    let needs = SceneNeeds::of(&scene, &settings).with_loading(loading_bytes);
    let points: u64 = needs.clouds().iter().map(|cloud| cloud.header().points).sum();
    report::say(format_args!(
        "{}: {leaves} objects, {operators} operators, {lights} lights; {} points in {} cloud files",
        args.scene.display(),
        report::count(points),
        needs.clouds().len()
    ));
    report::say(format_args!("bounds         {} to {}", bounds.min, bounds.max));
    report::say(format_args!("unit distance  {}", scene.unit_distance));
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let (width, height) = (settings.width, settings.height);
    if let Ok(plan) = needs.with_threads(threads).with_process(PROCESS_BYTES).plan(u64::MAX / 2) {
        report::say(format_args!(
            "memory         a {width}x{height} picture runs in {} and runs well in {}",
            report::bytes(plan.least_bytes),
            report::bytes(plan.comfortable_bytes)
        ));
    }
    Ok(())
}

//! `rayset render`: [`run`] is the way from arguments to a picture.

mod camera;
mod picture;
mod report;
mod shot;
mod sink;
mod work;

pub(crate) use work::PredictorArg;

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result};
use clap::Args;
use rayset::scene::Camera;
use rayset::trace::memory::MemoryPlan;
use rayset::trace::{Region, render_region};

pub(crate) use self::camera::CameraArgs;
use self::picture::{LookArgs, PictureArgs};
use self::report::RenderReport;
use self::shot::Shot;
use self::sink::{Format, PictureSink};
use self::work::{Work, WorkArgs};
use crate::report::{bytes, remark};
use crate::values::{self, Frames};

/// Render a scene or a cloud to a PNG picture.
///
/// The picture depends on the input and on the options under "Picture", "Look" and "Camera"; those under "Work" never
/// change a pixel.
#[derive(Args, Clone)]
pub(crate) struct RenderArgs {
    /// Scene file (.json) or cloud file
    input: PathBuf,
    /// Picture to write: PNG, or OpenEXR (.exr) in linear light with layers: depth, normal, albedo, opacity, instanceId,
    /// samples, bytes
    #[arg(short, long)]
    output: PathBuf,
    /// As many pictures from all around: the camera turns about the scene, OUTPUT gets numbers
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    turntable: Option<u32>,
    /// Pictures along the camera's path in the scene: `all`, one, or FIRST..LAST; OUTPUT gets numbers
    #[arg(long, conflicts_with = "turntable", value_parser = values::frames)]
    frames: Option<Frames>,
    #[command(flatten)]
    picture: PictureArgs,
    #[command(flatten)]
    look: LookArgs,
    #[command(flatten)]
    camera: CameraArgs,
    #[command(flatten)]
    work: WorkArgs,
    /// Write statistics to this file, as JSON
    #[arg(long)]
    stats: Option<PathBuf>,
}

pub(crate) fn run(args: &RenderArgs) -> Result<()> {
    let mut shot = Shot::new(args)?;
    shot.settings.layers = Format::of(&args.output)? == Format::Exr;
    let region = args.picture.region(shot.settings)?;
    let (work, plan) = Work::prepare(&args.work, &shot)?;
    let numbered_picture =
        |frame, camera| picture(args, &shot, &camera, &region, &numbered(&args.output, frame), &work, &plan);
    match (args.turntable, args.frames) {
        (Some(turns), _) => (0..turns)
            .try_for_each(|frame| numbered_picture(frame, shot.turned(f64::from(frame) / f64::from(turns)))),
        (None, Some(frames)) => {
            let path = shot.path.as_ref().with_context(|| {
                format!("{} has no \"animation\"; --frames has nothing to follow", args.input.display())
            })?;
            frames.of(path)?.try_for_each(|frame| numbered_picture(frame, path.camera(frame)))
        }
        (None, None) => picture(args, &shot, &shot.camera, &region, &args.output, &work, &plan),
    }
}

/// Renders one picture.
fn picture(
    args: &RenderArgs,
    shot: &Shot,
    camera: &Camera,
    region: &Region,
    output: &Path,
    work: &Work,
    plan: &MemoryPlan,
) -> Result<()> {
    let started = Instant::now();
    let mut sink = PictureSink::create(output, region, &shot.settings, shot.development)?;
    work.paged.pages.reset_statistics();
    let counts =
        render_region(&shot.scene, camera, &shot.settings, region, &work.exec, &work.paged, &mut sink)?;
    sink.finish()?;
    let report = RenderReport::new(work, plan, counts, started.elapsed());
    if let Some(path) = &args.stats {
        let text = serde_json::to_string_pretty(&report)?;
        std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))?;
    }
    report.describe(output);
    if report.memory_bytes < plan.comfortable_bytes && report.pages.reads_per_page > 2.0 {
        remark(format_args!(
            "pages were read {:.1} times each; --memory {} would do better",
            report.pages.reads_per_page,
            bytes(plan.comfortable_bytes)
        ));
    }
    Ok(())
}

/// `turn.png` becomes `turn.0007.png`.
fn numbered(path: &Path, frame: u32) -> PathBuf {
    let extension = path.extension().map_or_else(|| "png".into(), |e| e.to_string_lossy().into_owned());
    path.with_extension(format!("{frame:04}.{extension}"))
}

/// The options of a render with default values, for commands that render on the way.
pub(crate) fn defaults(cloud: &Path, output: &Path) -> Result<RenderArgs> {
    #[derive(clap::Parser)]
    struct Wrapper {
        #[command(flatten)]
        args: RenderArgs,
    }
    let words = [Path::new("render"), cloud, Path::new("--output"), output];
    Ok(<Wrapper as clap::Parser>::try_parse_from(words.map(Path::as_os_str))?.args)
}

impl RenderArgs {
    pub(crate) fn with_memory(mut self, memory: u64) -> Self {
        self.work.memory = Some(memory);
        self
    }

    pub(crate) fn with_camera(mut self, camera: CameraArgs) -> Self {
        self.camera = camera;
        self
    }

    pub(crate) fn with_size(mut self, width: u32, height: u32) -> Self {
        self.picture.size = Some((width, height));
        self
    }
}

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
use rayset::CancelToken;
use rayset::memory::MemoryPlan;
use rayset::output::Destination;
use rayset::scene::Camera;
use rayset::{PreparedScene, Region};

pub(crate) use self::camera::CameraArgs;
use self::picture::{LookArgs, PictureArgs};
use self::report::RenderReport;
use self::shot::Shot;
use self::sink::{Format, PictureSink};
use self::work::{Work, WorkArgs};
use crate::outputs::{self, Outputs};
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
    // The scene may be long to read: what can be refused before is.
    let format = Format::of(&Destination::new(&args.output)?)?;
    let mut shot = Shot::new(args)?;
    shot.settings.layers = format == Format::Exr;
    let region = args.picture.region(shot.settings)?;
    let mut outputs = Outputs::beside(&shot.files);
    let pictures = pictures(args, &shot)?
        .into_iter()
        .map(|(path, camera)| Ok((outputs.add(&path, None)?, camera)))
        .collect::<Result<Vec<_>>>()?;
    let stats = args.stats.as_ref().map(|path| outputs.add(path, None)).transpose()?;
    let (work, plan) = Work::prepare(&args.work, &shot)?;
    let prepared = work.session.prepare(&shot.scene, &shot.settings)?;
    for (picture, camera) in &pictures {
        render(&shot, &prepared, camera, &region, picture, stats.as_ref(), &work, &plan)?;
    }
    Ok(())
}

/// Every picture that is wanted: its path, and where it is taken from.
fn pictures(args: &RenderArgs, shot: &Shot) -> Result<Vec<(PathBuf, Camera)>> {
    let numbered = |frame| numbered(&args.output, frame);
    Ok(match (args.turntable, args.frames) {
        (Some(turns), _) => (0..turns)
            .map(|frame| (numbered(frame), shot.turned(f64::from(frame) / f64::from(turns))))
            .collect(),
        (None, Some(frames)) => {
            let path = shot.path.as_ref().with_context(|| {
                format!("{} has no \"animation\"; --frames has nothing to follow", args.input.display())
            })?;
            frames.of(path)?.map(|frame| (numbered(frame), path.camera(frame))).collect()
        }
        (None, None) => vec![(args.output.clone(), shot.camera)],
    })
}

/// Renders one picture.
#[expect(clippy::too_many_arguments, reason = "what is seen, from where, by what means, and where it goes")]
fn render(
    shot: &Shot,
    prepared: &PreparedScene,
    camera: &Camera,
    region: &Region,
    output: &Destination,
    stats: Option<&Destination>,
    work: &Work,
    plan: &MemoryPlan,
) -> Result<()> {
    let started = Instant::now();
    let mut sink = PictureSink::create(output, region, &shot.settings, shot.display_transform)?;
    work.session.reset_statistics();
    let view = prepared.view(camera)?;
    let counts = view.render_bands(region, plan.band_rows, &CancelToken::new(), &mut sink)?;
    sink.finish()?;
    let report = RenderReport::new(work, plan, counts, started.elapsed());
    if let Some(stats) = stats {
        outputs::write(stats, serde_json::to_string_pretty(&report)?.as_bytes())?;
    }
    report.describe(output.path());
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

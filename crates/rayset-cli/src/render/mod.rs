//! `rayset render`

mod camera;
mod picture;
mod report;
mod sink;
mod work;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result};
use clap::Args;
use rayset::octree::Cloud;
use rayset::trace::render_region;

pub(crate) use self::camera::CameraArgs;
use self::camera::warn_of_small_radii;
use self::picture::PictureArgs;
use self::report::RenderReport;
use self::sink::PngSink;
use self::work::{Work, WorkArgs};
use crate::report::{bytes, remark};

/// Render a cloud to a PNG picture.
///
/// The picture depends on the cloud and on the options under "Picture"; those under "Work" never change a pixel.
#[derive(Args, Clone)]
pub(crate) struct RenderArgs {
    /// Cloud file
    cloud: PathBuf,
    /// Picture to write
    #[arg(short, long)]
    output: PathBuf,
    #[command(flatten)]
    picture: PictureArgs,
    #[command(flatten)]
    camera: CameraArgs,
    #[command(flatten)]
    work: WorkArgs,
    /// Write statistics to this file, as JSON
    #[arg(long)]
    stats: Option<PathBuf>,
}

pub(crate) fn run(args: &RenderArgs) -> Result<()> {
    let started = Instant::now();
    let cloud = Arc::new(Cloud::open(&args.cloud)?);
    let header = cloud.header();
    let settings = args.picture.settings()?;
    let scene = args.picture.scene(&cloud)?;
    let camera = args.camera.camera(header, settings)?;
    let region = args.picture.region(settings)?;
    warn_of_small_radii(header, &camera, settings);
    let (work, plan) = Work::prepare(&args.work, &scene, settings)?;
    let mut sink = PngSink::create(&args.output, &region)?;
    let counts = render_region(&scene, &camera, &settings, &region, &work.exec, &work.paged, &mut sink)?;
    sink.finish()?;
    let report = RenderReport::new(&work, &plan, counts, header, started.elapsed());
    if let Some(path) = &args.stats {
        let text = serde_json::to_string_pretty(&report)?;
        std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))?;
    }
    report.describe(&args.output);
    if report.memory_bytes < plan.comfortable_bytes && report.pages.reads_per_page > 2.0 {
        remark(format_args!(
            "pages were read {:.1} times each; --memory {} would do better",
            report.pages.reads_per_page,
            bytes(plan.comfortable_bytes)
        ));
    }
    Ok(())
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
        self.picture.size = (width, height);
        self
    }
}

//! `rayset render`: [`run`] is the way from arguments to a picture.

mod args;
mod picture;
mod report;
mod sanity;
mod shot;
mod sink;
mod warnings;
mod work;

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use rayset::CancelToken;
use rayset::memory::{MemoryPlan, SceneNeeds};
use rayset::output::Destination;
use rayset::scene::Camera;
use rayset::{PreparedScene, Region};

pub(crate) use self::args::{RenderArgs, defaults};
use self::report::RenderReport;
use self::sanity::Circumstances;
use self::shot::Shot;
use self::sink::{Format, PictureSink};
pub(crate) use self::work::PredictorArg;
use self::work::Work;
use crate::outputs::{self, Outputs};
use crate::report::{bytes, remark};

pub(crate) fn run(args: &RenderArgs) -> Result<()> {
    // Reading the scene may take long: what can be refused before that is refused first.
    let format = Format::of(&Destination::new(&args.output)?)?;
    ensure!(
        !args.annotate.annotate || format == Format::Png,
        "--annotate draws on pictures for display; an OpenEXR file holds the light as computed: write a .png"
    );
    let mut shot = Shot::new(args)?;
    shot.settings.layers = format == Format::Exr;
    let region = args.picture.region(shot.settings)?;
    let mut outputs = Outputs::beside(&shot.files);
    let pictures = pictures(args, &shot)?
        .into_iter()
        .map(|(path, camera)| Ok((outputs.add(&path, None)?, camera)))
        .collect::<Result<Vec<_>>>()?;
    let stats = args.stats.as_ref().map(|path| outputs.add(path, None)).transpose()?;
    if let Some(path) = &args.write_scene {
        shot.write_scene(&outputs.add(path, None)?)?;
    }
    let annotations = shot.annotations(args)?;
    let drawing_bytes = annotations.as_ref().map_or(0, |annotations| annotations.bytes(&shot.camera));
    let needs = SceneNeeds::of(&shot.scene, &shot.settings).with_loading(shot.loading_bytes + drawing_bytes);
    let (work, plan) = Work::prepare(&args.work, &needs, &shot.settings)?;
    let prepared = work.session.prepare(&shot.scene, &shot.settings)?;
    prepared.remarks().iter().for_each(remark);
    for (picture, camera) in &pictures {
        let sink = PictureSink::create(picture, &region, &shot)?
            .under(annotations.as_ref().map(|annotations| annotations.overlay(camera)));
        render(&shot, &prepared, camera, &region, sink, picture, stats.as_ref(), &work, &plan)?;
    }
    Ok(())
}

/// Every picture to render: its path and its camera.
fn pictures(args: &RenderArgs, shot: &Shot) -> Result<Vec<(PathBuf, Camera)>> {
    let numbered = |frame| numbered(&args.output, frame);
    Ok(match (args.turntable, args.frames) {
        (Some(turns), _) => (0..turns)
            .map(|frame| (numbered(frame), shot.turned(f64::from(frame) / f64::from(turns))))
            .collect(),
        (None, Some(frames)) => {
            let path = shot.path.as_ref().with_context(|| {
                format!("{} has no \"animation\"; --frames has nothing to follow", args.inputs[0].display())
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
    mut sink: PictureSink,
    output: &Destination,
    stats: Option<&Destination>,
    work: &Work,
    plan: &MemoryPlan,
) -> Result<()> {
    let started = Instant::now();
    work.session.reset_statistics();
    let view = prepared.view(camera)?;
    let counts = view.render_bands(region, plan.band_rows, &CancelToken::new(), &mut sink)?;
    let census = sink.finish()?;
    let report = RenderReport::new(work, plan, counts, started.elapsed());
    if let Some(stats) = stats {
        outputs::write(stats, serde_json::to_string_pretty(&report)?.as_bytes())?;
    }
    report.describe(output.path());
    let settings = &shot.settings;
    census.remark(
        &counts,
        &Circumstances {
            points: shot.points,
            chosen: shot.chosen.is_some(),
            rays_per_pixel: u64::from(settings.samples) * u64::from(settings.samples),
            cropped: region.pixels() < u64::from(settings.width) * u64::from(settings.height),
        },
    );
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

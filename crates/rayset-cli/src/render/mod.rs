//! `rayset render`: [`run`] is the way from arguments to a picture.

mod advice;
mod args;
mod joined;
mod kept;
mod part;
mod picture;
mod pictures;
mod report;
mod sanity;
mod shot;
mod sink;
mod warnings;
mod work;

use std::time::{Duration, Instant};

use anyhow::{Result, ensure};
use rayset::memory::{MemoryPlan, SceneNeeds};
use rayset::output::Destination;
use rayset::parts::{PartOptions, Share};
use rayset::scene::Camera;
use rayset::{CancelToken, PreparedScene, Region, RenderCounts, RenderError, View};

use self::advice::Advice;
pub(crate) use self::args::{RenderArgs, defaults};
pub(crate) use self::joined::{Joining, write_joined};
use self::kept::Keeping;
use self::pictures::{Output, pictures};
use self::report::RenderReport;
use self::sanity::{Census, Circumstances};
use self::shot::Shot;
pub(crate) use self::sink::Format;
use self::sink::PictureSink;
use self::work::Work;
use crate::annotate::{Mount, Overlay};
use rayset_terminal::outputs::{self, Outputs};
use rayset_terminal::report::{bytes, json_text, remark};

pub(crate) fn run(args: &RenderArgs) -> Result<()> {
    // Reading the scene may take long: what can be refused before that is refused first.
    let has_layers = check_output(args)?;
    let mut shot = Shot::new(args)?;
    shot.settings.layers = has_layers;
    let (region, mount) = shot.mounted(args.picture.region(shot.whole())?)?;
    let mut outputs = Outputs::beside(&shot.files);
    let pictures = pictures(args, &shot, &mut outputs)?;
    let stats = args.stats.as_ref().map(|path| outputs.add(path, None)).transpose()?;
    if let Some(path) = &args.write_scene {
        shot.write_scene(&outputs.add(path, None)?)?;
    }
    let annotations = shot.annotations(args)?;
    let drawing_bytes = annotations.as_ref().map_or(0, |annotations| annotations.bytes(&shot.camera));
    // A part has a copy of what is drawn, and that compressed.
    let part_bytes = args.part.map_or(0, |share| share.index_bytes(&region) + 2 * drawing_bytes);
    let kept = args.keeps().then(|| kept::bytes(args.part, &shot.settings, &region, drawing_bytes));
    let loading_bytes = shot.loading_bytes + drawing_bytes + part_bytes + kept.unwrap_or(0);
    let needs = SceneNeeds::of(&shot.scene, &shot.settings).with_loading(loading_bytes);
    let (work, plan, prepared) = prepared(args, &shot, needs)?;
    prepared.remarks().iter().for_each(remark);
    let rendering = Rendering { shot: &shot, prepared, region, mount, work, plan, keeps: args.keeps() };
    let keeping = args.keeps().then(|| Keeping::new(args.resume));
    for (number, (output, camera)) in pictures.iter().enumerate() {
        let overlay = annotations.as_ref().map(|annotations| annotations.overlay(camera));
        let report = match (&keeping, args.part) {
            (Some(keeping), share) => rendering.kept(camera, overlay, share, keeping, output)?,
            (None, None) => rendering.picture(camera, overlay, &output.destination)?,
            (None, Some(share)) => rendering.part(camera, overlay, share, &output.destination)?,
        };
        if let Some(stats) = &stats {
            outputs::write(stats, json_text(&report)?.as_bytes())?;
        }
        if let (Some(keeping), Some((next, _))) = (&keeping, pictures.get(number + 1)) {
            let go_on = || format!("the same command with {} goes on", next.resuming());
            keeping.stopped(|| {
                format!("{} of {} pictures are finished; {}", number + 1, pictures.len(), go_on())
            })?;
        }
    }
    Ok(())
}

/// The scene ready to be rendered, with what renders it. How much its caps take may be known only
/// once they are counted; then all begins again with the right division of the memory, or its least
/// is said.
fn prepared(
    args: &RenderArgs,
    shot: &Shot,
    mut needs: SceneNeeds,
) -> Result<(Work, MemoryPlan, PreparedScene)> {
    loop {
        let (work, plan) = Work::prepare(&args.work, &needs)?;
        match work.session.prepare(&shot.scene, &shot.settings) {
            Err(RenderError::Memory { needed, .. }) if needed > plan.caps_bytes => {
                needs = needs.with_caps(needed);
            }
            prepared => return Ok((work, plan, prepared?)),
        }
    }
}

/// Refuses what cannot be written. Returns whether the output has layers.
fn check_output(args: &RenderArgs) -> Result<bool> {
    let destination = Destination::new(&args.output)?;
    if args.keeps() {
        kept::check_output(&destination)?;
    }
    ensure!(
        args.annotate.caption.is_none() || args.annotate.is_wanted(),
        "--caption is drawn by --annotate or --annotate-over; add one of them"
    );
    if args.part.is_some() {
        part::check_name(&destination)?;
        return Ok(args.layers);
    }
    let format = Format::of(&destination)?;
    ensure!(
        !args.annotate.is_wanted() || format == Format::Png,
        "--annotate draws on pictures for display; an OpenEXR file holds the light as computed: write a .png"
    );
    Ok(format == Format::Exr)
}

/// What is rendered, and by what means.
struct Rendering<'a> {
    shot: &'a Shot,
    prepared: PreparedScene,
    region: Region,
    mount: Option<Mount>,
    work: Work,
    plan: MemoryPlan,
    /// Whether what is finished is kept if the render is interrupted.
    keeps: bool,
}

impl Rendering<'_> {
    /// Renders one picture.
    fn picture(
        &self,
        camera: &Camera,
        overlay: Option<Overlay>,
        output: &Destination,
    ) -> Result<RenderReport> {
        let (shot, settings) = (self.shot, &self.shot.settings);
        let (started, view) = self.begin(camera)?;
        let whole = (settings.width, settings.height);
        let display = shot.display_transform;
        let mut sink = PictureSink::create(output, &self.region, whole, display, self.mount, "")?
            .seen_by(self.census())
            .advised(self.advice())
            .under(overlay);
        let counts = view.render_bands(&self.region, self.plan.band_rows, &CancelToken::new(), &mut sink)?;
        let census = sink.finish()?;
        let report = self.report(counts, started.elapsed(), output);
        if let Some(census) = census {
            census.remark(&counts, &self.circumstances());
        }
        self.remark_on_memory(&report);
        Ok(report)
    }

    /// Renders a share of one picture.
    fn part(
        &self,
        camera: &Camera,
        overlay: Option<Overlay>,
        share: Share,
        output: &Destination,
    ) -> Result<RenderReport> {
        let (started, view) = self.begin(camera)?;
        let options = self.part_options(share, overlay)?;
        let counts = part::write(&view, &self.region, &options, &mut self.advice(), output)?;
        let report = self.report(counts, started.elapsed(), output);
        self.remark_on_memory(&report);
        Ok(report)
    }

    fn part_options(&self, share: Share, overlay: Option<Overlay>) -> Result<PartOptions> {
        let held_pixels = u64::from(self.plan.band_rows) * self.region.columns.len() as u64;
        Ok(part::options(share, self.shot, overlay, self.mount)?.with_held_pixels(held_pixels))
    }

    fn advice(&self) -> Advice<'_> {
        Advice::new(&self.work.session, self.keeps)
    }

    /// Who looks at the pixels of a picture.
    fn census(&self) -> Census {
        Census::new(self.shot.scene.background, self.shot.display_transform)
    }

    fn begin(&self, camera: &Camera) -> Result<(Instant, View)> {
        let started = Instant::now();
        self.work.session.reset_statistics();
        Ok((started, self.prepared.view(camera)?))
    }

    fn report(&self, counts: RenderCounts, elapsed: Duration, output: &Destination) -> RenderReport {
        let report = RenderReport::new(&self.work, &self.plan, counts, elapsed);
        report.describe(output.path());
        report
    }

    fn circumstances(&self) -> Circumstances {
        let settings = &self.shot.settings;
        Circumstances {
            points: self.shot.points,
            chosen: self.shot.chosen.is_some(),
            is_solid: self.shot.look == Some("labels"),
            cropped: self.region.pixels() < u64::from(settings.width) * u64::from(settings.height),
        }
    }

    fn remark_on_memory(&self, report: &RenderReport) {
        let comfortable = self.plan.comfortable_bytes;
        if report.memory_bytes < comfortable && report.pages.reads_per_page > 2.0 {
            remark(format_args!(
                "pages were read {:.1} times each; --memory {} would do better",
                report.pages.reads_per_page,
                bytes(comfortable)
            ));
        }
    }
}

//! One picture of a scene that is ready, or a share of one.

use std::time::{Duration, Instant};

use anyhow::Result;
use rayset::memory::MemoryPlan;
use rayset::output::Destination;
use rayset::parts::{PartOptions, Share};
use rayset::scene::Camera;
use rayset::{CancelToken, PreparedScene, Region, RenderCounts, View};

use super::advice::Advice;
use super::part;
use super::report::RenderReport;
use super::sanity::{Census, Circumstances};
use super::shot::Shot;
use super::sink::PictureSink;
use super::work::Work;
use crate::annotate::{Mount, Overlay};
use crate::part_note::Note;
use rayset_terminal::report::{bytes, remark};

/// What is rendered, and by what means.
pub(super) struct Rendering<'a> {
    pub(super) shot: &'a Shot,
    pub(super) prepared: PreparedScene,
    pub(super) region: Region,
    pub(super) mount: Option<Mount>,
    pub(super) work: Work,
    pub(super) plan: MemoryPlan,
    /// Whether what is finished is kept if the render is interrupted.
    pub(super) keeps: bool,
}

impl Rendering<'_> {
    /// Renders one picture.
    pub(super) fn picture(
        &self,
        camera: &Camera,
        overlay: Option<Overlay>,
        output: &Destination,
    ) -> Result<RenderReport> {
        let (shot, settings) = (self.shot, &self.shot.settings);
        let (started, view) = self.begin(camera)?;
        let whole = (settings.width, settings.height);
        let note = Note { pixels: shot.pixels(), mount: self.mount, overlay };
        let mut sink = PictureSink::create(output, &self.region, whole, note, "")?
            .seen_by(self.census())
            .advised(self.advice());
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
    pub(super) fn part(
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

    pub(super) fn part_options(&self, share: Share, overlay: Option<Overlay>) -> Result<PartOptions> {
        let held_pixels = u64::from(self.plan.band_rows) * self.region.columns.len() as u64;
        Ok(part::options(share, self.shot, overlay, self.mount)?.with_held_pixels(held_pixels))
    }

    pub(super) fn advice(&self) -> Advice<'_> {
        Advice::new(&self.work.session, self.keeps)
    }

    /// Who looks at the pixels of a picture.
    pub(super) fn census(&self) -> Census {
        Census::new(self.shot.scene.background, self.shot.display_transform)
    }

    pub(super) fn begin(&self, camera: &Camera) -> Result<(Instant, View)> {
        let started = Instant::now();
        self.work.session.reset_statistics();
        Ok((started, self.prepared.view(camera)?))
    }

    pub(super) fn report(
        &self,
        counts: RenderCounts,
        elapsed: Duration,
        output: &Destination,
    ) -> RenderReport {
        let report = RenderReport::new(&self.work, &self.plan, counts, elapsed);
        report.describe(output.path());
        report
    }

    pub(super) fn circumstances(&self) -> Circumstances {
        let settings = &self.shot.settings;
        Circumstances {
            points: self.shot.points,
            chosen: self.shot.chosen.is_some(),
            is_solid: self.shot.look == Some("labels"),
            cropped: self.region.pixels() < u64::from(settings.width) * u64::from(settings.height),
        }
    }

    pub(super) fn remark_on_memory(&self, report: &RenderReport) {
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

//! `--keep-partial` and `--resume`: what is finished of a picture outlives what interrupts its
//! render.
//!
//! The picture is rendered as its only part, square by square, into a file beside it, and made of
//! that at the end. If the render is interrupted, that file is an unfinished part, which another
//! render goes on with.

use std::fs::File;
use std::io;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use rayset::output::{Destination, OutputFile};
use rayset::parts::{Joined, Part, PartError, Share};
use rayset::scene::{Camera, RenderSettings};
use rayset::storage::address_of;
use rayset::{CancelToken, Region, RenderError};

use super::joined::{Joining, write_joined};
use super::part;
use super::pictures::Output;
use super::rendering::Rendering;
use super::report::RenderReport;
use super::sanity::Census;
use crate::annotate::Overlay;
use rayset_terminal::interrupts::{self, Stopped, Stopping};
use rayset_terminal::report::{name_of, remark};

/// Most time between two squares of pixels that are kept, about.
const KEPT_EVERY: Duration = Duration::from_secs(3);

/// What keeps the finished squares of pictures.
pub(super) struct Keeping {
    cancel: CancelToken,
    stopping: Stopping,
    resumes: bool,
}

/// Refuses outputs beside which nothing can be kept.
pub(super) fn check_output(to: &Destination) -> Result<()> {
    to.require_file()?;
    ensure!(
        address_of(to.path()).is_none(),
        "--output {}: --keep-partial and --resume keep what is finished beside the output, for which it has to be a \
         file on a disk",
        to.path().display()
    );
    Ok(())
}

/// Memory that keeping takes besides the render: the index of what is finished and, where a picture
/// is made of it, its rows.
pub(super) fn bytes(
    share: Option<Share>,
    settings: &RenderSettings,
    region: &Region,
    drawing_bytes: u64,
) -> u64 {
    match share {
        Some(_) => 0,
        None => {
            Share::WHOLE.index_bytes(region)
                + 3 * drawing_bytes
                + Joined::bytes_of_one(settings, region, drawing_bytes)
        }
    }
}

impl Keeping {
    /// Makes signals stop the render instead of ending the process.
    pub(super) fn new(resumes: bool) -> Self {
        let cancel = CancelToken::new();
        Self { stopping: interrupts::stop_work(&cancel), cancel, resumes }
    }

    /// The unfinished part to go on with.
    fn resumed(&self, unfinished: &Destination) -> Result<Option<Part>> {
        let path = unfinished.path();
        if !path.exists() {
            return Ok(None);
        }
        if !self.resumes {
            remark(format_args!("{} is not gone on with, for which --resume would be", path.display()));
            return Ok(None);
        }
        let part = Part::open(path)?;
        remark(format_args!("going on with {}: {} is finished", path.display(), percent(&part)));
        Ok(Some(part))
    }

    /// The error that a signal has stopped the work, if one has; `left` says what is finished.
    pub(super) fn stopped(&self, left: impl FnOnce() -> String) -> Result<()> {
        match self.stopping.signal() {
            Some(signal) => Err(Stopped { signal, left: left() }.into()),
            None => Ok(()),
        }
    }
}

impl Rendering<'_> {
    /// Renders one picture, or a share of it, and keeps what is finished if it is interrupted.
    pub(super) fn kept(
        &self,
        camera: &Camera,
        overlay: Option<Overlay>,
        share: Option<Share>,
        keeping: &Keeping,
        output: &Output,
    ) -> Result<RenderReport> {
        let unfinished = output.unfinished.as_ref().context("an output beside which something is kept")?;
        let (started, view) = self.begin(camera)?;
        let options = self
            .part_options(share.unwrap_or(Share::WHOLE), overlay)?
            .with_resumed(keeping.resumed(unfinished)?)
            .with_kept_every(Some(KEPT_EVERY));
        let file = OutputFile::create(unfinished)?;
        let rendered =
            part::render(&view, &self.region, &options, &keeping.cancel, &mut self.advice(), &file)?;
        let rendered = match rendered {
            Ok(counts) => Ok(counts),
            Err(PartError::Render(error)) => Err(error),
            Err(error) => return Err(error.into()),
        };
        file.publish()?;
        let whole = |census| self.joined(&output.destination, unfinished, "", census);
        let (counts, census) = match (rendered, share) {
            (Err(error), _) => return Err(self.interrupted(error, share, keeping, output, unfinished)?),
            (Ok(counts), None) => (counts, whole(Some(self.census()))?),
            (Ok(counts), Some(_)) => {
                copy(unfinished, &output.destination)?;
                (counts, None)
            }
        };
        remove(unfinished);
        let report = self.report(counts, started.elapsed(), &output.destination);
        if let Some(census) = census {
            census.remark(&counts, &self.circumstances());
        }
        self.remark_on_memory(&report);
        Ok(report)
    }

    /// Makes the picture of what is finished of it.
    fn joined(
        &self,
        output: &Destination,
        unfinished: &Destination,
        comment: &str,
        census: Option<Census>,
    ) -> Result<Option<Census>> {
        // Its memory is planned for.
        let joined = Joined::join_partly([Part::open(unfinished.path())], u64::MAX)?;
        write_joined(&joined, output, Joining { doing: "writing", census, comment })
    }

    /// Writes what is finished of a render that has ended too early. Returns the error that says
    /// so.
    fn interrupted(
        &self,
        error: RenderError,
        share: Option<Share>,
        keeping: &Keeping,
        output: &Output,
        unfinished: &Destination,
    ) -> Result<anyhow::Error> {
        let part = Part::open(unfinished.path())?;
        let name = name_of(output.destination.path());
        let left = if part.finished_pixels().0 == 0 {
            remove(unfinished);
            format!("nothing of {name} is finished")
        } else {
            let finished = percent(&part);
            if share.is_none() {
                let comment = format!("unfinished: {finished} of the picture is rendered");
                self.joined(&output.destination, unfinished, &comment, None)?;
            }
            let (kept, options) = (unfinished.path().display(), output.resuming());
            format!("{finished} of {name} is finished; the same command with {options} goes on from {kept}")
        };
        Ok(match keeping.stopped(|| left.clone()) {
            Err(stopped) => stopped,
            Ok(()) => anyhow::Error::new(error).context(left),
        })
    }
}

/// How much of its share a part has, rounded down.
fn percent(part: &Part) -> String {
    let (finished, of) = part.finished_pixels();
    format!("{:.1} %", (finished as f64 / of.max(1) as f64 * 1000.0).floor() / 10.0)
}

/// Copies a finished part to its place.
fn copy(from: &Destination, to: &Destination) -> Result<()> {
    let doing = || format!("cannot write {}", to.path().display());
    let file = OutputFile::create(to)?;
    io::copy(&mut File::open(from.path()).with_context(doing)?, &mut file.writer()).with_context(doing)?;
    Ok(file.publish()?)
}

/// Removes what is not needed any more.
fn remove(unfinished: &Destination) {
    if let Err(error) = std::fs::remove_file(unfinished.path()) {
        remark(format_args!("{} is not needed any more, and stays: {error}", unfinished.path().display()));
    }
}

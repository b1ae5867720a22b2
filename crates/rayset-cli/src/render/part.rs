//! `--part`: a share of a picture instead of all of it.

use std::hash::{DefaultHasher, Hasher};
use std::io::{BufWriter, Read, Write};

use anyhow::{Context, Result, ensure};
use rayset::output::{Destination, OutputFile};
use rayset::parts::{PartError, PartOptions, Share};
use rayset::{CancelToken, Region, RenderCounts, View};

use super::advice::Advice;
use super::shot::Shot;
use crate::annotate::{Mount, Overlay};
use crate::part_note::Note;
use rayset_terminal::progress::Meter;

/// Refuses names of pictures.
pub(super) fn check_name(to: &Destination) -> Result<()> {
    let extension = to.path().extension().map(|e| e.to_string_lossy().to_lowercase());
    ensure!(
        !matches!(extension.as_deref(), Some("png" | "exr")),
        "--output {}: a part is no picture yet, which `rayset merge` makes; name it picture.1.part, for example",
        to.path().display()
    );
    Ok(())
}

/// What is written into a part besides pixels.
pub(super) fn options(
    share: Share,
    shot: &Shot,
    overlay: Option<Overlay>,
    mount: Option<Mount>,
) -> Result<PartOptions> {
    let note = Note { pixels: shot.pixels(), mount, overlay };
    Ok(PartOptions::new(share).with_note(note.encode()).with_build(build()?))
}

/// Renders a share into a file that appears under its name only when it is complete.
pub(super) fn write(
    view: &View,
    region: &Region,
    options: &PartOptions,
    advice: &mut Advice<'_>,
    to: &Destination,
) -> Result<RenderCounts> {
    let file = OutputFile::create(to)?;
    let rendered = render(view, region, options, &CancelToken::new(), advice, &file)?;
    let counts = rendered.with_context(|| cannot_write(to))?;
    file.publish()?;
    Ok(counts)
}

/// Renders a share into a file that has no name yet. If the render is what fails, the file is an
/// unfinished part.
pub(super) fn render(
    view: &View,
    region: &Region,
    options: &PartOptions,
    cancel: &CancelToken,
    advice: &mut Advice<'_>,
    file: &OutputFile,
) -> Result<Result<RenderCounts, PartError>> {
    let meter = Meter::of_time();
    let mut writer = BufWriter::new(file.writer());
    let mut progress = |done, total| {
        meter.show("tracing", done, total);
        advice.told(done, total);
    };
    let rendered = view.render_part(region, options, cancel, &mut progress, &mut writer);
    meter.finish();
    writer.flush().with_context(|| cannot_write(file.destination()))?;
    Ok(rendered)
}

fn cannot_write(to: &Destination) -> String {
    format!("cannot write {}", to.path().display())
}

/// A hash of this program's file: two versions of one number may differ.
fn build() -> Result<String> {
    let path = if cfg!(target_os = "linux") {
        // Also if the file has been replaced since.
        "/proc/self/exe".into()
    } else {
        std::env::current_exe().context("where is this program?")?
    };
    let reading = || format!("cannot read this program, {}", path.display());
    let mut file = std::fs::File::open(&path).with_context(reading)?;
    let (mut hasher, mut buffer) = (DefaultHasher::new(), vec![0; 1 << 16]);
    loop {
        let count = file.read(&mut buffer).with_context(reading)?;
        if count == 0 {
            return Ok(format!("build {:016x}", hasher.finish()));
        }
        hasher.write(&buffer[..count]);
    }
}

//! Where a picture goes.

use std::io::BufWriter;

use anyhow::{Context, Result, bail};
use rayset::image::{Band, DisplayTransform, ExrBands, PngBands};
use rayset::output::{Destination, OutputFile, OutputWriter};
use rayset::{BandSink, Region, SinkError};

use super::sanity::Census;
use crate::annotate::Overlay;
use crate::progress::Meter;

/// Picture formats, by file extension.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Format {
    Png,
    Exr,
}

impl Format {
    pub(crate) fn of(to: &Destination) -> Result<Self> {
        match to.path().extension().map(|e| e.to_string_lossy().to_lowercase()).as_deref() {
            Some("png") => Ok(Self::Png),
            Some("exr") => {
                to.require_file()?;
                Ok(Self::Exr)
            }
            // Pipes and devices seldom have the extension of a picture.
            _ if to.is_stream() => Ok(Self::Png),
            _ => bail!("--output {}: the name of a picture ends in .png or .exr", to.path().display()),
        }
    }
}

/// Writes bands to a file that appears under its name only when it is complete.
pub(crate) struct PictureSink {
    // Dropped before the file: an encoder writes when it is dropped.
    encoder: Encoder,
    file: OutputFile,
    meter: Meter<'static>,
    doing: &'static str,
    census: Option<Census>,
    /// What is laid over the picture, and the picture's first column of the whole.
    overlay: Option<Overlay>,
    left: u32,
}

enum Encoder {
    Png(Box<PngBands<BufWriter<OutputWriter>>>),
    Exr(ExrBands),
}

impl PictureSink {
    /// For a region of a picture whose size is `whole`.
    pub(crate) fn create(
        to: &Destination,
        region: &Region,
        whole: (u32, u32),
        display_transform: DisplayTransform,
    ) -> Result<Self> {
        let doing = || format!("cannot write {}", to.path().display());
        let format = Format::of(to)?;
        let file = OutputFile::create(to)?;
        let output = BufWriter::new(file.writer());
        let (width, height) = (region.columns.len() as u32, region.rows.len() as u32);
        let encoder = match format {
            Format::Png => {
                let png = PngBands::new(output, width, height, display_transform).with_context(doing)?;
                Encoder::Png(Box::new(png))
            }
            Format::Exr => {
                let corner = (region.columns.start, region.rows.start);
                Encoder::Exr(ExrBands::new(output, (width, height), corner, whole).with_context(doing)?)
            }
        };
        let meter = Meter::new("pixels", false);
        Ok(Self {
            encoder,
            file,
            meter,
            doing: "tracing",
            census: None,
            overlay: None,
            left: region.columns.start,
        })
    }

    /// With another word for what is being done.
    pub(crate) fn doing(self, doing: &'static str) -> Self {
        Self { doing, ..self }
    }

    /// With something laid over the picture, if anything.
    pub(crate) fn under(self, overlay: Option<Overlay>) -> Self {
        Self { overlay, ..self }
    }

    /// With somebody who looks at the pixels.
    pub(super) fn seen_by(self, census: Census) -> Self {
        Self { census: Some(census), ..self }
    }

    /// Completes the file. Returns who has looked at its pixels.
    pub(crate) fn finish(self) -> Result<Option<Census>> {
        self.meter.finish();
        let doing = || format!("cannot write {}", self.file.destination().path().display());
        match self.encoder {
            Encoder::Png(png) => png.finish().with_context(doing)?,
            Encoder::Exr(exr) => exr.finish().with_context(doing)?,
        }
        self.file.publish()?;
        Ok(self.census)
    }
}

impl BandSink for PictureSink {
    fn band(&mut self, band: &Band) -> Result<(), SinkError> {
        if let Some(census) = &mut self.census {
            census.add(band);
        }
        let written = match &mut self.encoder {
            Encoder::Png(png) => {
                let retouch = |row: u32, rgba: &mut [u8]| {
                    if let Some(overlay) = &self.overlay {
                        overlay.over(row, self.left, rgba);
                    }
                };
                png.write_with(band, retouch).map_err(|e| e.to_string())
            }
            Encoder::Exr(exr) => exr.write(band).map_err(|e| e.to_string()),
        };
        written.map_err(|e| format!("{}: {e}", self.file.destination().path().display()).into())
    }

    fn progress(&mut self, done: u64, total: u64) {
        self.meter.show(self.doing, done, total);
    }
}

//! Where a picture goes.

use std::io::BufWriter;

use anyhow::{Context, Result, bail};
use rayset::image::{Band, ExrBands, PngBands};
use rayset::output::{Destination, OutputFile, OutputWriter};
use rayset::{BandSink, Region, SinkError};

use super::advice::Advice;
use super::sanity::Census;
use crate::annotate::{Mount, Overlay};
use crate::part_note::Note;
use rayset_terminal::progress::Meter;

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
pub(crate) struct PictureSink<'a> {
    // Dropped before the file: an encoder writes when it is dropped.
    encoder: Encoder,
    file: OutputFile,
    meter: Meter<'static>,
    doing: &'static str,
    census: Option<Census>,
    advice: Option<Advice<'a>>,
    /// What is laid over the picture, and the picture's first column of the whole.
    overlay: Option<Overlay>,
    left: u32,
    margin: Option<Margin>,
}

/// The rows and columns of background around a picture that has its place on a sheet.
struct Margin {
    mount: Mount,
    /// Number of the picture's first row.
    first_row: u32,
    /// Rows of the picture.
    rows: u32,
    /// A row of the sheet.
    row: Band,
}

enum Encoder {
    Png(Box<PngBands<BufWriter<OutputWriter>>>),
    Exr(ExrBands),
}

impl<'a> PictureSink<'a> {
    /// For a region of a picture whose size is `whole`, with what its note says; with a comment,
    /// unless it is empty.
    pub(crate) fn create(
        to: &Destination,
        region: &Region,
        whole: (u32, u32),
        note: Note,
        comment: &str,
    ) -> Result<Self> {
        let doing = || format!("cannot write {}", to.path().display());
        let format = Format::of(to)?;
        let file = OutputFile::create(to)?;
        let output = BufWriter::new(file.writer());
        let Note { pixels, mount, overlay } = note;
        let (columns, rows) = (region.columns.len() as u32, region.rows.len() as u32);
        let (width, height) = mount.map_or((columns, rows), |mount| mount.size);
        let encoder = match format {
            Format::Png => {
                let display = pixels.display_transform;
                let png = PngBands::with_comment(output, width, height, display, comment);
                Encoder::Png(Box::new(png.with_context(doing)?))
            }
            Format::Exr => {
                let remarks = [comment, pixels.remark()];
                let comment = remarks.into_iter().filter(|r| !r.is_empty()).collect::<Vec<_>>().join("\n");
                let corner = (region.columns.start, region.rows.start);
                let exr = ExrBands::with_comment(output, (width, height), corner, whole, &comment);
                Encoder::Exr(exr.with_context(doing)?)
            }
        };
        let meter = Meter::of_time();
        Ok(Self {
            encoder,
            file,
            meter,
            doing: "tracing",
            census: None,
            advice: None,
            overlay,
            left: mount.map_or(region.columns.start, |mount| mount.origin.0),
            margin: mount.map(|mount| Margin {
                mount,
                first_row: region.rows.start,
                rows,
                row: Band::new(0, width, 1, false),
            }),
        })
    }

    /// With another word for what is being done.
    pub(crate) fn doing(self, doing: &'static str) -> Self {
        Self { doing, ..self }
    }

    /// With somebody who looks at the pixels.
    pub(super) fn seen_by(self, census: Census) -> Self {
        Self { census: Some(census), ..self }
    }

    /// With advice where it takes long.
    pub(super) fn advised(self, advice: Advice<'a>) -> Self {
        Self { advice: Some(advice), ..self }
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

impl Margin {
    /// Writes the rows of the sheet that a band has pixels of; with the first band those above the
    /// picture, with the last those below it.
    fn rows_of<E>(&mut self, band: &Band, mut write: impl FnMut(&Band) -> Result<(), E>) -> Result<(), E> {
        let Mount { origin, size, place, background } = self.mount;
        let top = origin.1 + place.1;
        let mut write_row = |number: u32, pixels: &[[f32; 4]]| {
            self.row.first_row = number;
            self.row.pixels.fill(background);
            let after = self.row.pixels.iter_mut().skip(place.0 as usize);
            after.zip(pixels).for_each(|(to, from)| *to = *from);
            write(&self.row)
        };
        if band.first_row == self.first_row {
            (origin.1..top).try_for_each(|number| write_row(number, &[]))?;
        }
        let mut next = top + (band.first_row - self.first_row);
        for pixels in band.pixels.chunks(band.width.max(1) as usize) {
            write_row(next, pixels)?;
            next += 1;
        }
        if next == top + self.rows {
            (next..origin.1 + size.1).try_for_each(|number| write_row(number, &[]))?;
        }
        Ok(())
    }
}

impl BandSink for PictureSink<'_> {
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
                let written = match &mut self.margin {
                    Some(margin) => margin.rows_of(band, |row| png.write_with(row, retouch)),
                    None => png.write_with(band, retouch),
                };
                written.map_err(|e| e.to_string())
            }
            Encoder::Exr(exr) => exr.write(band).map_err(|e| e.to_string()),
        };
        written.map_err(|e| format!("{}: {e}", self.file.destination().path().display()).into())
    }

    fn progress(&mut self, done: u64, total: u64) {
        self.meter.show(self.doing, done, total);
        if let Some(advice) = &mut self.advice {
            advice.told(done, total);
        }
    }
}

//! Where a picture goes.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use rayset::image::{Band, Development, ExrBands, PngBands};
use rayset::scene::RenderSettings;
use rayset::trace::{Region, Sink};

use crate::progress::Meter;

/// Kinds of picture, by the ends of their names.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Format {
    Png,
    Exr,
}

impl Format {
    pub(super) fn of(path: &Path) -> Result<Self> {
        match path.extension().map(|e| e.to_string_lossy().to_lowercase()).as_deref() {
            Some("png") => Ok(Self::Png),
            Some("exr") => Ok(Self::Exr),
            _ => bail!("--output {}: the name of a picture ends in .png or .exr", path.display()),
        }
    }
}

/// Writes bands to a file beside its name, which it gets when it is whole.
pub(super) struct PictureSink {
    encoder: Encoder,
    partial: PathBuf,
    path: PathBuf,
    meter: Meter,
}

enum Encoder {
    Png(Box<PngBands<BufWriter<File>>>),
    Exr(ExrBands),
}

impl PictureSink {
    pub(super) fn create(
        path: &Path,
        region: &Region,
        settings: &RenderSettings,
        development: Development,
    ) -> Result<Self> {
        let name = path.file_name().context("--output names no file")?.to_string_lossy();
        let partial = path.with_file_name(format!(".{name}.partial"));
        let file = File::create(&partial).with_context(|| format!("cannot write {}", path.display()))?;
        let output = BufWriter::new(file);
        let (width, height) = (region.columns.len() as u32, region.rows.len() as u32);
        let encoder = match Format::of(path)? {
            Format::Png => Encoder::Png(Box::new(PngBands::new(output, width, height, development)?)),
            Format::Exr => {
                let corner = (region.columns.start, region.rows.start);
                let whole = (settings.width, settings.height);
                Encoder::Exr(ExrBands::new(output, (width, height), corner, whole)?)
            }
        };
        Ok(Self { encoder, partial, path: path.to_owned(), meter: Meter::new("pixels", false) })
    }

    pub(super) fn finish(self) -> Result<()> {
        self.meter.finish();
        match self.encoder {
            Encoder::Png(png) => png.finish()?,
            Encoder::Exr(exr) => exr.finish()?,
        }
        std::fs::rename(&self.partial, &self.path)
            .with_context(|| format!("cannot write {}", self.path.display()))
    }
}

impl Sink for PictureSink {
    fn band(&mut self, band: &Band) -> Result<(), String> {
        match &mut self.encoder {
            Encoder::Png(png) => png.write(band).map_err(|e| e.to_string()),
            Encoder::Exr(exr) => exr.write(band).map_err(|e| e.to_string()),
        }
    }

    fn progress(&mut self, done: u64, total: u64) -> bool {
        self.meter.show("tracing", done, total);
        true
    }
}

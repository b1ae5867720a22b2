//! Where a picture goes.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use rayset::image::{Band, Development, PngBands};
use rayset::trace::{Region, Sink};

use crate::progress::Meter;

/// Writes bands to a PNG file beside its name, which it gets when it is whole.
pub(super) struct PngSink {
    png: PngBands<BufWriter<File>>,
    partial: PathBuf,
    path: PathBuf,
    meter: Meter,
}

impl PngSink {
    pub(super) fn create(path: &Path, region: &Region, development: Development) -> Result<Self> {
        let name = path.file_name().context("--output names no file")?.to_string_lossy();
        let partial = path.with_file_name(format!(".{name}.partial"));
        let file = File::create(&partial).with_context(|| format!("cannot write {}", path.display()))?;
        let (width, height) = (region.columns.len() as u32, region.rows.len() as u32);
        let png = PngBands::new(BufWriter::new(file), width, height, development)?;
        Ok(Self { png, partial, path: path.to_owned(), meter: Meter::new("pixels", false) })
    }

    pub(super) fn finish(self) -> Result<()> {
        self.meter.finish();
        self.png.finish()?;
        std::fs::rename(&self.partial, &self.path)
            .with_context(|| format!("cannot write {}", self.path.display()))
    }
}

impl Sink for PngSink {
    fn band(&mut self, band: &Band) -> Result<(), String> {
        self.png.write(band).map_err(|e| e.to_string())
    }

    fn progress(&mut self, done: u64, total: u64) -> bool {
        self.meter.show("tracing", done, total);
        true
    }
}

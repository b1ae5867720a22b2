//! Rendering a view into memory, or band by band as file encoders need it.

use std::slice::from_ref;

use super::ambient_occlusion::{AmbientOcclusion, Footprint, Surroundings};
use super::sink::{BandSink, Picture};
use super::view::View;
use super::work::{Region, Tile};
use super::{RenderCounts, RenderError, SettingError};
use rayset_base::cancel::CancelToken;

impl View {
    /// Renders the whole picture into memory.
    ///
    /// # Errors
    /// As [`View::render`].
    pub fn picture(&self) -> Result<Picture, RenderError> {
        let mut picture = Picture::default();
        self.render_bands(&self.region(), u32::MAX, &CancelToken::new(), &mut picture)?;
        Ok(picture)
    }

    /// Renders a region of the picture in bands of at most `band_rows` rows, holding one band in
    /// memory at a time. Each pixel is the same, bit for bit, as in the whole picture.
    ///
    /// # Errors
    /// As [`View::render`], and [`RenderError::Setting`] if the region is empty or not within the
    /// picture.
    pub fn render_bands(
        &self,
        region: &Region,
        band_rows: u32,
        cancel: &CancelToken,
        sink: &mut (impl BandSink + ?Sized),
    ) -> Result<RenderCounts, RenderError> {
        self.check_region(region)?;
        let Some(surroundings) = self.surroundings() else {
            return self.bands(region, band_rows, cancel, sink);
        };
        let mut shading = AmbientOcclusion::new(&surroundings, region, sink);
        let rendered = shading.rendered().clone();
        self.bands(&rendered, band_rows, cancel, &mut shading)
    }

    /// Refuses a region that is empty or not within the picture.
    pub(super) fn check_region(&self, region: &Region) -> Result<(), RenderError> {
        let whole = self.region();
        let within = region.columns.end <= whole.columns.end && region.rows.end <= whole.rows.end;
        if region.columns.is_empty() || region.rows.is_empty() || !within {
            return Err(SettingError::Region.into());
        }
        Ok(())
    }

    /// What ambient occlusion needs, if the picture has any.
    pub(super) fn surroundings(&self) -> Option<Surroundings> {
        let (width, height) = (self.settings.width, self.settings.height);
        (self.settings.ambient_occlusion > 0.0).then(|| Surroundings {
            size: (width, height),
            strength: self.settings.ambient_occlusion,
            footprint: Footprint::of(&self.rays, width, height),
            step: self.prepared.world.steps.coarsest_world() as f32,
            background: self.prepared.world.background.unwrap_or_default(),
            layers: self.settings.layers,
        })
    }

    /// The bands of a region that lies in the picture, as tiles make them.
    fn bands(
        &self,
        region: &Region,
        band_rows: u32,
        cancel: &CancelToken,
        sink: &mut (impl BandSink + ?Sized),
    ) -> Result<RenderCounts, RenderError> {
        let mut counts = RenderCounts::default();
        let mut costs = self.costs(region, std::iter::once(region.clone()));
        let mut row = region.rows.start;
        while row < region.rows.end {
            let rows = row..self.end_of_band(row, band_rows, region.rows.end);
            let of_band = Region { columns: region.columns.clone(), rows };
            let upcoming = self.after(&of_band, band_rows, region);
            let mut progress = |done| sink.progress(done, region.pixels());
            let told: (_, &mut dyn FnMut(u64)) = (&mut costs, &mut progress);
            let (bands, of_band_counts) = self.regions(from_ref(&of_band), upcoming, cancel, told)?;
            counts += of_band_counts;
            bands.iter().try_for_each(|band| sink.band(band)).map_err(RenderError::Sink)?;
            row = of_band.rows.end;
        }
        sink.progress(region.pixels(), region.pixels());
        Ok(counts)
    }

    /// The first tiles of the band after one, if its files are remote: their pages are asked for
    /// before this one is finished, so that it does not begin with waiting.
    fn after(&self, band: &Region, band_rows: u32, region: &Region) -> Vec<Tile> {
        /// More pages than fit are not asked for.
        const MOST: usize = 512;
        let row = band.rows.end;
        if row >= region.rows.end || !self.prepared.world.foresight.policy.asks_along_rays() {
            return Vec::new();
        }
        let rows = row..self.end_of_band(row, band_rows, region.rows.end);
        let mut tiles = self.tiles(&Region { columns: region.columns.clone(), rows });
        tiles.truncate(MOST);
        tiles.shrink_to_fit();
        tiles
    }

    /// Where a band of at most `band_rows` rows ends that begins with a row: between two rows of
    /// tiles if it can, so that tiles are the same for all budgets, and with them the layer of the
    /// bytes that each requested.
    fn end_of_band(&self, row: u32, band_rows: u32, last: u32) -> u32 {
        let end = row + band_rows.clamp(1, last - row);
        let between = end / self.prepared.engine.exec.tile_pixels * self.prepared.engine.exec.tile_pixels;
        if end < last && between > row { between } else { end }
    }
}

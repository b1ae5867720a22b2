//! Regions of a picture that are rendered at the same time, each into a band of its own; and, with
//! [`Samples::Auto`], where the picture varies.
//!
//! A picture of one ray through the middle of each pixel comes first. A pixel that differs in that
//! picture from the mean of two opposite neighbours is traced again, with all rays. Neighbours
//! outside a region are traced for this too, so that a pixel depends neither on regions nor on
//! tiles.

use std::ops::Range;

use super::costs::Costs;
use super::sink::{FinishedTile, SinkError, TileSink};
use super::view::View;
use super::work::{PixelMask, Region, Tile, Work};
use super::{RenderCounts, RenderError};
use crate::image::Band;
use crate::scene::{RenderSettings, Samples, Sampling};
use rayset_base::cancel::CancelToken;

/// A pixel varies if it differs by more than half of this from the mean of two opposite neighbours:
/// in opacity, or in the square root of light as it is shown.
const BEND: f32 = 5.0 / 255.0;
/// Where one of two opposite neighbours is.
const LINES: [(i64, i64); 4] = [(1, 0), (0, 1), (1, 1), (1, -1)];

impl View {
    /// Renders regions that lie in the picture, in the order of the list. `progress` is told how
    /// many pixels of all that the costs are of are finished.
    pub(super) fn regions(
        &self,
        regions: &[Region],
        upcoming: Vec<Tile>,
        cancel: &CancelToken,
        (costs, progress): (&mut Costs, &mut dyn FnMut(u64)),
    ) -> Result<(Vec<Band>, RenderCounts), RenderError> {
        let told = Told { view: self, cancel, costs, progress, pass: 0 };
        let Samples::Auto { exposure } = self.settings.samples else {
            let mut canvas = Canvas::new(regions, regions.to_vec(), told);
            let work = canvas.all().before(upcoming);
            let counts = canvas.paint(self, &work)?;
            return Ok((canvas.bands, counts));
        };
        let whole = self.region();
        let widened = regions.iter().map(|region| Region {
            columns: widened(&region.columns, whole.columns.end),
            rows: widened(&region.rows, whole.rows.end),
        });
        let mut canvas = Canvas::new(regions, widened.collect(), told);
        let middles = canvas.all();
        let mut counts = canvas.paint(&self.of_middles(), &middles)?;
        let varying = canvas.varying(exposure.exp2()).before(upcoming);
        counts += canvas.paint(self, &varying)?;
        Ok((canvas.cropped(), counts))
    }

    /// What it is known by how far a render of some regions has come.
    pub(super) fn costs(&self, around: &Region, regions: impl Iterator<Item = Region>) -> Costs {
        let traces_again = matches!(self.settings.samples, Samples::Auto { .. });
        Costs::of(around, regions, traces_again, self.prepared.engine.exec.estimates_after)
    }

    /// The view with one ray through the middle of each pixel.
    fn of_middles(&self) -> Self {
        let (samples, sampling) = (Samples::Fixed(1), Sampling::Fixed);
        Self { settings: RenderSettings { samples, sampling, ..self.settings }, ..self.clone() }
    }
}

/// With a pixel more on either side, as far as there is any.
fn widened(range: &Range<u32>, end: u32) -> Range<u32> {
    range.start.saturating_sub(1)..range.end.saturating_add(1).min(end)
}

/// Who is told how far a render has come, and how that is known.
struct Told<'p> {
    view: &'p View,
    cancel: &'p CancelToken,
    costs: &'p mut Costs,
    progress: &'p mut dyn FnMut(u64),
    /// How often the regions have been painted.
    pass: usize,
}

impl Told<'_> {
    /// A tile is finished; `is_wanted` if it is of the regions, not around them.
    fn finished(&mut self, tile: &FinishedTile<'_>, is_wanted: bool) {
        self.costs.finished(&tile.tile, tile.traced.len(), self.pass, tile.seconds, is_wanted);
        if self.costs.are_due() {
            self.probe();
        }
        (self.progress)(self.costs.done());
    }

    /// Traces a tile in each cell, to know what that costs. Where it fails, nothing
    /// more is known: the render meets the same error.
    fn probe(&mut self) {
        for regions in self.costs.begin_probes() {
            for is_warm in [false, true] {
                self.costs.probe(is_warm);
                let told: (&mut Costs, &mut dyn FnMut(u64)) = (self.costs, &mut |_| {});
                let _ = self.view.regions(&regions, Vec::new(), self.cancel, told);
            }
        }
        let one_ray = self.costs.end_probes();
        let rays = self.view.settings.samples.along_a_side().pow(2);
        let again = matches!(self.view.settings.samples, Samples::Auto { .. });
        let share = if again { one_ray } else { 1.0 / f64::from(rays) };
        self.view.prepared.engine.set_share_of_one_ray(share);
    }
}

/// Bands that are being filled with finished tiles.
struct Canvas<'p> {
    /// What is wanted, and that with what is around it.
    wanted: &'p [Region],
    regions: Vec<Region>,
    /// Of each region.
    bands: Vec<Band>,
    /// For each tile of the work, the number of its region; empty if there is one region.
    owners: Vec<u32>,
    told: Told<'p>,
}

impl<'p> Canvas<'p> {
    fn new(wanted: &'p [Region], regions: Vec<Region>, told: Told<'p>) -> Self {
        let layers = told.view.settings.records_layers();
        let band = |region: &Region| {
            let (width, rows) = (region.columns.len() as u32, region.rows.len() as u32);
            Band::new(region.rows.start, width, rows, layers)
        };
        let bands = regions.iter().map(band).collect();
        Self { wanted, regions, bands, owners: Vec::new(), told }
    }

    /// All tiles of the regions.
    fn all(&mut self) -> Work {
        let mut all = Vec::new();
        for number in 0..self.regions.len() {
            let tiles = self.told.view.tiles(&self.regions[number]);
            self.own(number, tiles.len());
            if all.is_empty() { all = tiles } else { all.extend(tiles) }
        }
        Work::tiles(all)
    }

    /// The tiles that come next in the work are of a region.
    fn own(&mut self, region: usize, tiles: usize) {
        if region == 0 {
            self.owners.clear();
        }
        if self.regions.len() > 1 {
            self.owners.extend(std::iter::repeat_n(region as u32, tiles));
        }
    }

    /// Renders tiles into the bands.
    fn paint(&mut self, view: &View, work: &Work) -> Result<RenderCounts, RenderError> {
        let cancel = self.told.cancel;
        let counts = view.render(work, cancel, self)?;
        self.told.pass += 1;
        Ok(counts)
    }

    /// Of the wanted pixels, those that vary.
    fn varying(&mut self, brightness: f32) -> Work {
        let (mut all, mut varying) = (Vec::new(), Vec::new());
        for (number, region) in self.wanted.iter().enumerate() {
            let (columns, band) = (&self.regions[number].columns, &self.bands[number]);
            let middles = Middles { columns, band, brightness };
            let (mut tiles, before) = (self.told.view.tiles(region), varying.len());
            tiles.retain(|tile| {
                let of_tile = middles.varying(tile);
                self.told.costs.decided(tile, of_tile.len());
                if of_tile != PixelMask(0) {
                    varying.push(of_tile);
                }
                of_tile != PixelMask(0)
            });
            self.own(number, varying.len() - before);
            if all.is_empty() { all = tiles } else { all.extend(tiles) }
        }
        Work::pixels(all, varying)
    }

    /// The wanted parts of the bands.
    fn cropped(self) -> Vec<Band> {
        let crop = |((mut band, of_band), region): ((Band, &Region), &Region)| {
            let (width, left) =
                (band.width as usize, (region.columns.start - of_band.columns.start) as usize);
            let top = (region.rows.start - of_band.rows.start) as usize;
            let (columns, rows) = (region.columns.len(), region.rows.len());
            crop(&mut band.pixels, width, (left, top), (columns, rows));
            if !band.layers.is_empty() {
                crop(&mut band.layers, width, (left, top), (columns, rows));
            }
            (band.first_row, band.width) = (region.rows.start, columns as u32);
            band
        };
        self.bands.into_iter().zip(&self.regions).zip(self.wanted).map(crop).collect()
    }
}

impl TileSink for Canvas<'_> {
    fn tile(&mut self, finished: &FinishedTile<'_>) -> Result<(), SinkError> {
        let owner = self.owners.get(finished.number).map_or(0, |&owner| owner as usize);
        finished.paste(&mut self.bands[owner], self.regions[owner].columns.start);
        let Region { columns, rows } = &self.wanted[owner];
        let is_wanted = columns.contains(&finished.tile.x) && rows.contains(&finished.tile.y);
        self.told.finished(finished, is_wanted);
        Ok(())
    }
}

/// Makes a rectangle of rows of `width` the whole, in its place.
fn crop<T: Copy>(
    all: &mut Vec<T>,
    width: usize,
    (left, top): (usize, usize),
    (columns, rows): (usize, usize),
) {
    for row in 0..rows {
        let from = (top + row) * width + left;
        all.copy_within(from..from + columns, row * columns);
    }
    all.truncate(columns * rows);
}

/// A picture of one ray through the middle of each pixel.
struct Middles<'a> {
    columns: &'a Range<u32>,
    band: &'a Band,
    /// What light is multiplied by to be shown.
    brightness: f32,
}

impl Middles<'_> {
    /// The pixels of a tile that vary.
    fn varying(&self, tile: &Tile) -> PixelMask {
        let bit = |pixel: usize| {
            let (x, y) = (tile.x + pixel as u32 % tile.width, tile.y + pixel as u32 / tile.width);
            u64::from(self.varies(x, y)) << pixel
        };
        PixelMask((0..tile.pixels()).map(bit).fold(0, |all, bit| all | bit))
    }

    /// Whether a pixel is not midway between two opposite neighbours. What lies outside the picture
    /// is not compared.
    fn varies(&self, x: u32, y: u32) -> bool {
        let rows = self.band.first_row..self.band.first_row + self.band.rows();
        let neighbour = |i: i64, j: i64| {
            let (x, y) = (i64::from(x) + i, i64::from(y) + j);
            let (x, y) = (u32::try_from(x).ok()?, u32::try_from(y).ok()?);
            (self.columns.contains(&x) && rows.contains(&y)).then(|| self.pixel(x, y))
        };
        let here = self.pixel(x, y);
        LINES.iter().any(|&(i, j)| match (neighbour(i, j), neighbour(-i, -j)) {
            (Some(a), Some(b)) => {
                (0..4).any(|channel| (a[channel] + b[channel] - 2.0 * here[channel]).abs() > BEND)
            }
            _ => false,
        })
    }

    /// A pixel as it is compared.
    fn pixel(&self, x: u32, y: u32) -> [f32; 4] {
        let row = (y - self.band.first_row) as usize * self.columns.len();
        let [red, green, blue, opacity] = self.band.pixels[row + (x - self.columns.start) as usize];
        let [red, green, blue] = [red, green, blue].map(|light| (light * self.brightness).max(0.0).sqrt());
        [red, green, blue, opacity]
    }
}

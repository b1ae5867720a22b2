//! Ambient occlusion from the depths of a picture: creases, and surfaces close behind an edge,
//! become darker. It gives form to what has one colour, at a small fraction of the cost of shadows.
//!
//! From each pixel four lines are followed in the picture, both ways. On either side the horizon is
//! the steepest rise toward the eye (as in Bavoil & Sainz, *Multi-layer dual-resolution
//! screen-space ambient occlusion*, 2009). The sines of both horizons are added before anything is
//! said about the line: a plane, however it is tilted, rises on one side as it falls on the other,
//! and remains bright.
//!
//! A pixel depends on depths up to [`AmbientOcclusion::apron`] pixels away. They are rendered too
//! where they lie outside the region that is asked for, so pixels do not depend on regions or
//! bands.

use std::collections::VecDeque;
use std::ops::Range;

use super::sink::{BandSink, SinkError};
use super::work::Region;
use crate::image::{Band, LayerPixel};
use crate::scene::RayMaker;

/// Distances at which horizons are looked for, as fractions of the picture's height; at least one
/// pixel.
const RINGS: [f32; 3] = [1.0 / 400.0, 1.0 / 130.0, 1.0 / 50.0];
/// Directions of the lines, in pixels.
const LINES: [(i64, i64); 4] = [(1, 0), (0, 1), (1, 1), (1, -1)];
/// Mean sines of two horizons up to this are grain, not form.
const GRAIN: f32 = 0.08;
/// How much light a strength of 1 takes: what is left is `exp(-TAKEN × occlusion)`.
const TAKEN: f32 = 2.5;

/// Most rows that are taken in, and sent, at a time: at the end of a picture all that are kept are
/// ready.
pub(super) const ROWS_SENT: u32 = 16;

/// Darkens the bands of a picture on their way to a sink.
pub(super) struct AmbientOcclusion<'s, S: BandSink + ?Sized> {
    strength: f32,
    rings: [i64; 3],
    footprint: Footprint,
    /// How far behind a surface its depth may be: one step; world space.
    step: f32,
    background: [f32; 3],
    /// What the sink receives, and the rows that are rendered for it.
    region: Region,
    rendered: Region,
    /// Whether the sink receives layers.
    layers: bool,
    /// The latest rows, from number `first` on.
    rows: Rows,
    first: u32,
    /// The next row of the sink's.
    next: u32,
    sink: &'s mut S,
}

/// Consecutive rows, in two blocks of memory. Tall pictures keep many rows of few pixels, so rows
/// have none of their own.
struct Rows {
    width: usize,
    pixels: VecDeque<[f32; 4]>,
    layers: VecDeque<LayerPixel>,
}

impl Rows {
    /// None yet, with room for `most` rows.
    fn new(width: usize, most: u32) -> Self {
        let room = width * most as usize;
        Self { width, pixels: VecDeque::with_capacity(room), layers: VecDeque::with_capacity(room) }
    }

    fn len(&self) -> u32 {
        (self.pixels.len() / self.width) as u32
    }

    fn push(&mut self, pixels: &[[f32; 4]], layers: &[LayerPixel]) {
        self.pixels.extend(pixels);
        self.layers.extend(layers);
    }

    fn pop(&mut self) {
        self.pixels.drain(..self.width.min(self.pixels.len()));
        self.layers.drain(..self.width.min(self.layers.len()));
    }
}

/// The distance between the centres of two pixels in the world: a length, and a part of the
/// distance from the eye.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Footprint {
    pub(super) length: f32,
    pub(super) of_depth: f32,
}

impl Footprint {
    pub(super) fn of(rays: &RayMaker, width: u32, height: u32) -> Self {
        let (x, y) = (0.5 * f64::from(width), 0.5 * f64::from(height));
        let (ray, next) = (rays.ray(x, y), rays.ray(x, y + 1.0));
        Self {
            length: (next.origin - ray.origin).length() as f32,
            of_depth: (next.direction - ray.direction).length() as f32,
        }
    }

    fn at(self, depth: f32) -> f32 {
        self.length + self.of_depth * depth
    }
}

/// What a picture with ambient occlusion is made of, besides colours, depths and opacities.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Surroundings {
    /// Width and height of the whole picture in pixels.
    pub(super) size: (u32, u32),
    pub(super) strength: f32,
    pub(super) footprint: Footprint,
    /// The longest step of a ray; world space.
    pub(super) step: f32,
    /// Black if the background is transparent.
    pub(super) background: [f32; 3],
    /// Whether the sink receives layers.
    pub(super) layers: bool,
}

impl Surroundings {
    /// What has to be rendered of a picture for a region of it.
    pub(super) fn rendered(&self, region: &Region) -> Region {
        with_apron(region, self.size)
    }
}

/// A region of a picture of a size with what its pixels look at around it.
pub(super) fn with_apron(region: &Region, (width, height): (u32, u32)) -> Region {
    let apron = apron(height);
    Region { columns: widened(&region.columns, apron, width), rows: widened(&region.rows, apron, height) }
}

/// The most rows that are kept of a picture of `height` rows.
pub(super) fn rows_kept(height: u32) -> u32 {
    (2 * apron(height)).saturating_add(ROWS_SENT).min(height)
}

/// How many pixels away a pixel of a picture of `height` pixels sees what makes it darker.
pub(super) fn apron(height: u32) -> u32 {
    rings(height)[2] as u32
}

fn rings(height: u32) -> [i64; 3] {
    let [near, middle, far] = RINGS.map(|part| (part * height as f32).round() as i64);
    let near = near.max(1);
    let middle = middle.max(near + 1);
    [near, middle, far.max(middle + 1)]
}

fn widened(range: &Range<u32>, by: u32, end: u32) -> Range<u32> {
    range.start.saturating_sub(by)..range.end.saturating_add(by).min(end)
}

impl<'s, S: BandSink + ?Sized> AmbientOcclusion<'s, S> {
    pub(super) fn new(of: &Surroundings, region: &Region, sink: &'s mut S) -> Self {
        let rendered = of.rendered(region);
        let most = rows_kept(of.size.1).min(rendered.rows.len() as u32);
        Self {
            strength: of.strength,
            rings: rings(of.size.1),
            footprint: of.footprint,
            step: of.step,
            background: of.background,
            region: region.clone(),
            first: rendered.rows.start,
            rows: Rows::new(rendered.columns.len(), most),
            rendered,
            layers: of.layers,
            next: region.rows.start,
            sink,
        }
    }

    /// What has to be rendered.
    pub(super) fn rendered(&self) -> &Region {
        &self.rendered
    }

    /// Sends the rows that have all their neighbours.
    fn send(&mut self) -> Result<(), SinkError> {
        let known = self.first + self.rows.len();
        let apron = self.rings[2] as u32;
        let ready = if known == self.rendered.rows.end { known } else { known.saturating_sub(apron) };
        let ready = ready.min(self.region.rows.end);
        while self.next < ready {
            let band = self.band_until(ready.min(self.next + ROWS_SENT));
            self.next += band.rows();
            self.sink.band(&band)?;
            while self.first + apron < self.next && self.rows.len() > 0 {
                self.rows.pop();
                self.first += 1;
            }
        }
        Ok(())
    }

    /// The shaded rows from the next one on.
    fn band_until(&self, end: u32) -> Band {
        let columns = self.region.columns.clone();
        let mut band = Band::new(self.next, columns.len() as u32, end - self.next, self.layers);
        let left = (columns.start - self.rendered.columns.start) as usize;
        for (i, y) in (self.next..end).enumerate() {
            let row = i * columns.len()..(i + 1) * columns.len();
            for (x, pixel) in columns.clone().zip(&mut band.pixels[row.clone()]) {
                *pixel = self.shaded(x, y);
            }
            if self.layers {
                let first = self.index(left as u32, y);
                let known = self.rows.layers.range(first..first + columns.len());
                band.layers[row].iter_mut().zip(known).for_each(|(to, from)| *to = *from);
            }
        }
        band
    }

    /// The index of a pixel that is kept, `x` columns from the first that is rendered.
    fn index(&self, x: u32, y: u32) -> usize {
        (y - self.first) as usize * self.rows.width + x as usize
    }

    /// Depth of a pixel; infinite if nothing is there, `None` outside the picture.
    fn depth(&self, x: i64, y: i64) -> Option<f32> {
        let (left, columns) = (self.rendered.columns.start, self.rendered.columns.len());
        let x = usize::try_from(x - i64::from(left)).ok().filter(|&x| x < columns)?;
        let row = usize::try_from(y - i64::from(self.first)).ok()?;
        Some(self.rows.layers.get(row * columns + x)?.depth)
    }

    fn shaded(&self, x: u32, y: u32) -> [f32; 4] {
        let at = self.index(x - self.rendered.columns.start, y);
        let (pixel, LayerPixel { depth, opacity, .. }) = (self.rows.pixels[at], self.rows.layers[at]);
        if !depth.is_finite() {
            return pixel;
        }
        // Depths are of samples, and differ by up to a step even on a plane. Were it not for this,
        // hard surfaces would have grain.
        let nearest = depth.min(self.deepest_beside(i64::from(x), i64::from(y))) - self.step;
        let left = (-TAKEN * self.strength * self.occlusion(i64::from(x), i64::from(y), nearest)).exp();
        let [red, green, blue] = self.background;
        // The background shines through undimmed.
        let behind = (1.0 - opacity) * (1.0 - left);
        [
            pixel[0] * left + red * behind,
            pixel[1] * left + green * behind,
            pixel[2] * left + blue * behind,
            pixel[3],
        ]
    }

    /// The greatest depth of the eight pixels beside one. Where all of them are nearer, a ray has
    /// slipped between the points of a surface: that is no pit, which would be a black dot.
    fn deepest_beside(&self, x: i64, y: i64) -> f32 {
        let beside = LINES.into_iter().flat_map(|(i, j)| [(x + i, y + j), (x - i, y - j)]);
        beside.filter_map(|(x, y)| self.depth(x, y)).fold(f32::NEG_INFINITY, f32::max)
    }

    /// What fraction of the surroundings hides the sky from a pixel, 0 to 1.
    fn occlusion(&self, x: i64, y: i64, depth: f32) -> f32 {
        let pixel = self.footprint.at(depth);
        let lines = LINES.map(|(i, j)| {
            let forth = self.horizon(x, y, (i, j), depth, pixel);
            let back = self.horizon(x, y, (-i, -j), depth, pixel);
            match (forth, back) {
                (Some(forth), Some(back)) => (0.5 * (forth + back) - GRAIN).max(0.0),
                // At the edge of the picture one side is unknown.
                _ => 0.0,
            }
        });
        lines.iter().sum::<f32>() * 0.25
    }

    /// Sine of the elevation of the horizon in one direction, above the plane of the picture
    /// through the pixel; -1 if nothing is there, `None` if all of it is outside the picture.
    fn horizon(&self, x: i64, y: i64, (i, j): (i64, i64), depth: f32, pixel: f32) -> Option<f32> {
        let length = ((i * i + j * j) as f32).sqrt();
        let farthest = self.rings[2] as f32 * pixel;
        let mut horizon: Option<f32> = None;
        for (number, ring) in self.rings.into_iter().enumerate() {
            // Rings are circles.
            let steps = ((ring as f32 / length).round() as i64).max(1);
            let Some(there) = self.depth(x + i * steps, y + j * steps) else { continue };
            let (run, rise) = (steps as f32 * length * pixel, depth - there);
            let mut sine = if there.is_finite() { rise / (run * run + rise * rise).sqrt() } else { -1.0 };
            if number > 0 && sine > 0.0 {
                // What is far in front throws a thin line, not a wide halo.
                sine *= 1.0 / (1.0 + (rise / farthest) * (rise / farthest));
            }
            horizon = Some(horizon.map_or(sine, |known| known.max(sine)));
        }
        horizon
    }
}

impl<S: BandSink + ?Sized> BandSink for AmbientOcclusion<'_, S> {
    fn band(&mut self, band: &Band) -> Result<(), SinkError> {
        let some = band.width as usize * ROWS_SENT as usize;
        for (pixels, layers) in band.pixels.chunks(some).zip(band.layers.chunks(some)) {
            self.rows.push(pixels, layers);
            self.send()?;
        }
        Ok(())
    }

    fn progress(&mut self, done: u64, total: u64) {
        self.sink.progress(done, total);
    }
}

//! The layers of a picture besides colour: depth, normal and so on, accumulated over the samples
//! that primary rays meet.

use super::composite::Shares;
use super::node_samples::{Constants, LEAF, NodeSamples, each_lane};
use crate::field::{LANES, Packet, Slab};
use crate::image::LayerPixel;
use crate::lod::bound_of_error;

/// Sums over the samples of a pixel, each weighted by its contribution to the pixel.
#[derive(Clone, Copy, Debug, Default)]
struct Gathered {
    weight: f32,
    depth: f64,
    normal: [f32; 3],
    albedo: [f32; 3],
    /// The largest weight of a sample, and the number of the leaf that it belongs to.
    largest: (f32, f32),
    samples: u32,
    /// Sum of the weights times the opacity of lumps.
    lump_opacity: f32,
    /// Sum of the opacities of the pixel's rays, and the number of these rays.
    opacity: (f32, u32),
}

/// The pixels of a tile.
#[derive(Clone)]
pub(super) struct Layers {
    pixels: [Gathered; LANES],
    /// Otherwise depth and opacity alone.
    all: bool,
    /// The number of the attribute of that name.
    lump_opacity: Option<usize>,
}

impl Layers {
    /// For all layers, or depth and opacity alone.
    pub(super) fn new(all: bool, lump_opacity: Option<usize>) -> Self {
        Self { pixels: [Gathered::default(); LANES], all, lump_opacity }
    }

    /// Clears the sums of the previous tile.
    pub(super) fn begin(&mut self) {
        self.pixels.fill(Gathered::default());
    }

    /// Adds the samples of a slab; `pixels` maps a lane to its pixel.
    pub(super) fn gather(
        &mut self,
        packet: &Packet,
        slab: Slab,
        node: &NodeSamples,
        shares: &Shares,
        constants: &Constants,
        pixels: impl Fn(usize) -> usize,
    ) {
        each_lane(shares.lanes(), |lane| {
            let pixel = &mut self.pixels[pixels(lane)];
            let mut samples = shares.samples[lane];
            while samples != 0 {
                let j = samples.trailing_zeros() as usize;
                samples &= samples - 1;
                let share = shares.share[lane].0[j];
                pixel.weight += share;
                pixel.depth += f64::from(share) * packet.sample_t_world(lane, slab.first + j as u64);
                if let Some(number) = self.lump_opacity {
                    pixel.lump_opacity += share * node.attributes[number][lane].0[j];
                }
                if !self.all {
                    continue;
                }
                pixel.samples += 1;
                let color = constants.color_at(node, lane, j);
                for axis in 0..3 {
                    pixel.normal[axis] += share * node.normal[axis][lane].0[j];
                    pixel.albedo[axis] += share * color[axis];
                }
                if share > pixel.largest.0 {
                    pixel.largest = (share, node.material[LEAF][lane].0[j]);
                }
            }
        });
    }

    /// Adds the opacity of one ray of a pixel: the fraction of the background that it hides.
    pub(super) fn hide(&mut self, pixel: usize, opacity: f32) {
        let (sum, rays) = &mut self.pixels[pixel].opacity;
        *sum += opacity;
        *rays += 1;
    }

    /// The bounds of the errors of the first `count` pixels' opacities.
    pub(super) fn bounds_of_errors(&self, count: usize) -> impl Iterator<Item = f32> {
        self.pixels[..count].iter().map(Gathered::bound_of_error)
    }

    /// The layers of a tile of `count` pixels, for which pages of `bytes` bytes in all were
    /// requested.
    pub(super) fn pixels(&self, count: usize, bytes: u64) -> [LayerPixel; LANES] {
        self.pixels.map(|g| {
            let bytes = bytes as f32 / count as f32;
            let (opacity, lod_error) = (g.opacity(), g.bound_of_error());
            if g.weight <= 0.0 {
                return LayerPixel { bytes, opacity, ..LayerPixel::default() };
            }
            let [x, y, z] = g.normal;
            let length = (x * x + y * y + z * z).sqrt();
            let unit = if length > 0.0 { 1.0 / length } else { 0.0 };
            LayerPixel {
                opacity,
                depth: (g.depth / f64::from(g.weight)) as f32,
                normal: g.normal.map(|v| v * unit),
                albedo: g.albedo.map(|v| v / g.weight),
                instance: g.largest.1 as u32,
                samples: g.samples,
                bytes,
                lod_error,
            }
        })
    }
}

impl Gathered {
    fn opacity(&self) -> f32 {
        self.opacity.0 / self.opacity.1.max(1) as f32
    }

    fn bound_of_error(&self) -> f32 {
        let lump_opacity = if self.weight > 0.0 { self.lump_opacity / self.weight } else { 0.0 };
        bound_of_error(self.opacity().into(), lump_opacity.into()) as f32
    }
}

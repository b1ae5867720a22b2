//! Pictures as messages: a whole one as JPEG, or finished parts of one, compressed without loss.

use std::io::Write;

use flate2::Compression;
use flate2::write::ZlibEncoder;
use jpeg_encoder::{Encoder, ImageBuffer, JpegColorType, SamplingFactor, rgb_to_ycbcr};

use crate::protocol::{FrameHead, FrameKind, HEAD_BYTES};

/// Quality of JPEG, 1 to 100: of pictures with many pixels, and of those with fewer than
/// [`FEW_PIXELS`], whose pixels are seen much larger.
const QUALITY: [u8; 2] = [82, 93];
const FEW_PIXELS: u32 = 100_000;

/// A picture for display: 8-bit RGBA, straight alpha, row by row.
#[derive(Clone, Debug, Default)]
pub(crate) struct DisplayPicture {
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) rgba: Vec<u8>,
}

impl DisplayPicture {
    /// Makes it a transparent picture of another size.
    pub(crate) fn resize(&mut self, [width, height]: [u32; 2]) {
        (self.width, self.height) = (width, height);
        self.rgba.clear();
        self.rgba.resize(4 * width as usize * height as usize, 0);
    }

    /// Sets pixels of a row, from column `x` on.
    pub(crate) fn set_row(&mut self, x: u32, y: u32, pixels: impl Iterator<Item = [u8; 4]>) {
        let at = 4 * (y as usize * self.width as usize + x as usize);
        for (to, pixel) in self.rgba[at..].chunks_exact_mut(4).zip(pixels) {
            to.copy_from_slice(&pixel);
        }
    }

    fn size(&self) -> [u16; 2] {
        [self.width as u16, self.height as u16]
    }
}

/// A rectangle of pixels: left, top, width, height.
pub(crate) type Rectangle = [u16; 4];

/// Distances from the eye, one for each pixel; infinite where there is nothing.
#[derive(Clone, Debug, Default)]
pub(crate) struct Depths {
    width: u32,
    distances: Vec<f32>,
    /// How far behind where a surface begins its distance may be: the length of a step.
    step: f32,
}

impl Depths {
    /// Forgets all distances of a picture of another size.
    pub(crate) fn resize(&mut self, [width, height]: [u32; 2], step: f64) {
        (self.width, self.step) = (width, step as f32);
        self.distances.clear();
        self.distances.resize(width as usize * height as usize, f32::INFINITY);
    }

    /// Sets distances of a row, from column `x` on.
    pub(crate) fn set_row(&mut self, x: u32, y: u32, distances: impl Iterator<Item = f32>) {
        let at = y as usize * self.width as usize + x as usize;
        self.distances[at..].iter_mut().zip(distances).for_each(|(to, distance)| *to = distance);
    }

    /// Every so many-th distance of every so many-th row, such that rows have at most
    /// [`MOST_DEPTHS`]: their number in a row, in a column, the least distance, how far behind the
    /// surface they may be, and for each the quotient of the least by it, in 65535ths; 0 is
    /// infinite.
    fn encode(&self, into: &mut Vec<u8>) {
        let stride = self.width.div_ceil(MOST_DEPTHS).max(1) as usize;
        let rows: Vec<&[f32]> = self.distances.chunks(self.width.max(1) as usize).step_by(stride).collect();
        let picked = || rows.iter().flat_map(|row| row.iter().step_by(stride));
        let nearest =
            picked().fold(f32::INFINITY, |nearest, &distance| nearest.min(distance.max(f32::MIN_POSITIVE)));
        let columns = (self.width as usize).div_ceil(stride);
        into.extend_from_slice(&(columns as u16).to_le_bytes());
        into.extend_from_slice(&(rows.len() as u16).to_le_bytes());
        into.extend_from_slice(&nearest.to_le_bytes());
        into.extend_from_slice(&self.step.to_le_bytes());
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
        for &distance in picked() {
            // An infinite distance gives 0, one that is not a number too.
            let part = (nearest / distance * 65535.0).round() as u16;
            // Writing to memory does not fail.
            let _ = encoder.write_all(&part.to_le_bytes());
        }
        let compressed = encoder.finish().unwrap_or_default();
        into.extend_from_slice(&(compressed.len() as u32).to_le_bytes());
        into.extend_from_slice(&compressed);
    }
}

/// Most distances in a row that are sent.
const MOST_DEPTHS: u32 = 360;

/// The whole picture as JPEG, over a background, and its distances before it.
pub(crate) fn whole(
    generation: u32,
    frame: u32,
    shown: &DisplayPicture,
    depths: &Depths,
    background: [u8; 3],
) -> Vec<u8> {
    let size = shown.size();
    let head = FrameHead { kind: FrameKind::Whole, generation, frame, size, rectangles: 0 };
    let mut message = head.bytes().to_vec();
    depths.encode(&mut message);
    let is_small = shown.width * shown.height < FEW_PIXELS;
    let mut encoder = Encoder::new(&mut message, QUALITY[usize::from(is_small)]);
    // Colours of one side of an edge do not reach over it: the page moves both sides apart.
    encoder.set_sampling_factor(SamplingFactor::F_1_1);
    // Writing to memory does not fail, and the size has been checked; a message without a picture
    // is left out by the page.
    let _ = encoder.encode_image(OverBackground { shown, background });
    message
}

/// A picture over a background. The encoder compiles itself for each kind of image; this is the
/// only one.
struct OverBackground<'a> {
    shown: &'a DisplayPicture,
    background: [u8; 3],
}

impl ImageBuffer for OverBackground<'_> {
    fn get_jpeg_color_type(&self) -> JpegColorType {
        JpegColorType::Ycbcr
    }

    fn width(&self) -> u16 {
        self.shown.size()[0]
    }

    fn height(&self) -> u16 {
        self.shown.size()[1]
    }

    fn fill_buffers(&self, y: u16, [luma, blue, red, _]: &mut [Vec<u8>; 4]) {
        let row_bytes = 4 * self.shown.width as usize;
        let row = &self.shown.rgba[usize::from(y) * row_bytes..][..row_bytes];
        for &[r, g, b, alpha] in row.as_chunks().0 {
            let alpha = u32::from(alpha);
            let over = |color: u8, behind: u8| {
                ((u32::from(color) * alpha + u32::from(behind) * (255 - alpha) + 127) / 255) as u8
            };
            let [r_behind, g_behind, b_behind] = self.background;
            let (y, cb, cr) = rgb_to_ycbcr(over(r, r_behind), over(g, g_behind), over(b, b_behind));
            luma.push(y);
            blue.push(cb);
            red.push(cr);
        }
    }
}

/// Parts of a picture, without loss.
pub(crate) fn parts(
    generation: u32,
    frame: u32,
    shown: &DisplayPicture,
    rectangles: &[Rectangle],
) -> Vec<u8> {
    let count = rectangles.len() as u16;
    let head =
        FrameHead { kind: FrameKind::Rectangles, generation, frame, size: shown.size(), rectangles: count };
    let mut message = Vec::with_capacity(HEAD_BYTES + 8 * rectangles.len());
    message.extend_from_slice(&head.bytes());
    for value in rectangles.iter().flatten() {
        message.extend_from_slice(&value.to_le_bytes());
    }
    let mut encoder = ZlibEncoder::new(message, Compression::fast());
    for [x, y, width, height] in rectangles.iter().map(|r| r.map(usize::from)) {
        for row in y..y + height {
            let at = 4 * (row * shown.width as usize + x);
            // Writing to memory does not fail.
            let _ = encoder.write_all(&shown.rgba[at..at + 4 * width]);
        }
    }
    encoder.finish().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use super::*;

    #[test]
    fn a_picture_is_encoded_over_its_background() {
        let mut shown = DisplayPicture::default();
        shown.resize([3, 2]);
        shown.set_row(0, 1, [[9, 8, 7, 255], [9, 8, 7, 0], [100, 0, 50, 128]].into_iter());
        let picture = OverBackground { shown: &shown, background: [20, 200, 250] };
        assert_eq!([picture.width(), picture.height()], [3, 2]);
        let mut rows = [const { Vec::new() }; 4];
        picture.fill_buffers(1, &mut rows);
        // Of the last pixel, 128 of 255 parts are its own: 60, 100 and 150, rounded.
        for (i, [r, g, b]) in [[9, 8, 7], [20, 200, 250], [60, 100, 150]].into_iter().enumerate() {
            assert_eq!((rows[0][i], rows[1][i], rows[2][i]), rgb_to_ycbcr(r, g, b), "pixel {i}");
        }
        assert_eq!(rows.map(|row| row.len()), [3, 3, 3, 0]);
    }

    #[test]
    fn parts_of_a_picture_come_back_as_they_were() {
        let mut shown = DisplayPicture::default();
        shown.resize([40, 30]);
        for y in 0..30 {
            shown.set_row(0, y, (0..40).map(|x| [x as u8, y as u8, (x * y) as u8, 255 - x as u8]));
        }
        let message = parts(7, 9, &shown, &[[3, 4, 5, 6], [0, 0, 40, 30]]);
        assert_eq!(message[..HEAD_BYTES], {
            let (kind, size) = (FrameKind::Rectangles, [40, 30]);
            FrameHead { kind, generation: 7, frame: 9, size, rectangles: 2 }.bytes()
        });
        let mut pixels = Vec::new();
        let mut decoder = flate2::read::ZlibDecoder::new(&message[HEAD_BYTES + 16..]);
        decoder.read_to_end(&mut pixels).expect("it is whole");
        assert_eq!(pixels.len(), 4 * (30 + 1200));
        assert_eq!(pixels[..4], [3, 4, 12, 252]);
        assert_eq!(pixels[4 * 30..], shown.rgba);
    }

    #[test]
    fn distances_come_back_within_a_65535th_of_the_nearest_and_nothing_stays_nothing() {
        let mut depths = Depths::default();
        depths.resize([700, 3], 0.5);
        depths.set_row(0, 0, (0..700).map(|x| if x % 7 == 0 { f32::INFINITY } else { 2.0 + x as f32 }));
        let mut message = Vec::new();
        depths.encode(&mut message);
        let number = |at| u16::from_le_bytes([message[at], message[at + 1]]);
        // Every second of 700, and of three rows two.
        assert_eq!([number(0), number(2)], [350, 2]);
        let nearest = f32::from_le_bytes([message[4], message[5], message[6], message[7]]);
        assert_eq!(nearest, 4.0);
        assert_eq!(message[8..12], 0.5_f32.to_le_bytes());
        let mut parts = Vec::new();
        flate2::read::ZlibDecoder::new(&message[16..]).read_to_end(&mut parts).expect("it is whole");
        for (at, part) in parts.as_chunks::<2>().0.iter().enumerate() {
            let part = f32::from(u16::from_le_bytes(*part));
            let x = 2 * (at % 350);
            if x % 7 == 0 || at >= 350 {
                assert_eq!(part, 0.0);
            } else {
                assert!((part / 65535.0 - nearest / (2.0 + x as f32)).abs() <= 1.0 / 65535.0, "{x}");
            }
        }
    }
}

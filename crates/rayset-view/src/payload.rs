//! Pictures as messages: a whole one as JPEG, or finished parts of one, compressed without loss.

use std::io::Write;

use flate2::Compression;
use flate2::write::ZlibEncoder;
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};

use crate::protocol::{FrameHead, FrameKind, HEAD_BYTES};

/// Quality of JPEG, 1 to 100.
const QUALITY: u8 = 82;

/// A picture for display: 8-bit RGBA, straight alpha, row by row.
#[derive(Clone, Debug, Default)]
pub(crate) struct Shown {
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) rgba: Vec<u8>,
}

impl Shown {
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

/// The whole picture as JPEG, over a background.
pub(crate) fn whole(generation: u32, frame: u32, shown: &Shown, background: [u8; 3]) -> Vec<u8> {
    let size = shown.size();
    let head = FrameHead { kind: FrameKind::Whole, generation, frame, size, rectangles: 0 };
    let mut message = head.bytes().to_vec();
    let over = |pixel: &[u8]| -> [u8; 3] {
        let alpha = u32::from(pixel[3]);
        std::array::from_fn(|k| {
            ((u32::from(pixel[k]) * alpha + u32::from(background[k]) * (255 - alpha) + 127) / 255) as u8
        })
    };
    let rgb: Vec<u8> = shown.rgba.chunks_exact(4).flat_map(over).collect();
    let mut encoder = Encoder::new(&mut message, QUALITY);
    encoder.set_sampling_factor(SamplingFactor::F_2_2);
    // Writing to memory does not fail, and the size has been checked; a message without a picture is left out by the page.
    let _ = encoder.encode(&rgb, size[0], size[1], ColorType::Rgb);
    message
}

/// Parts of a picture, without loss.
pub(crate) fn parts(generation: u32, frame: u32, shown: &Shown, rectangles: &[Rectangle]) -> Vec<u8> {
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
    fn parts_of_a_picture_come_back_as_they_were() {
        let mut shown = Shown::default();
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
}

//! The pixels of a block as bytes: channel after channel, of each channel the lowest bytes of all
//! pixels first, then compressed by LZ4. Exponents and empty pixels, which repeat, come together
//! that way.

use crate::image::LayerPixel;

/// What parts hold of each pixel besides its colour and opacity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Contents {
    /// Nothing.
    Color,
    /// What ambient occlusion looks at: depth, and how much of the background is hidden.
    Depth,
    /// All layers.
    Layers,
}

/// A value of a pixel, as bits.
#[derive(Clone, Copy)]
struct Channel {
    get: fn(&[f32; 4], &LayerPixel) -> u32,
    set: fn(&mut [f32; 4], &mut LayerPixel, u32),
}

macro_rules! float {
    (color $i:literal) => {
        Channel { get: |c, _| c[$i].to_bits(), set: |c, _, bits| c[$i] = f32::from_bits(bits) }
    };
    ($field:ident $([$i:literal])?) => {
        Channel {
            get: |_, l| l.$field $([$i])?.to_bits(),
            set: |_, l, bits| l.$field $([$i])? = f32::from_bits(bits),
        }
    };
}

macro_rules! whole {
    ($field:ident) => {
        Channel { get: |_, l| l.$field, set: |_, l, bits| l.$field = bits }
    };
}

/// All channels; those that contents have come first.
const CHANNELS: [Channel; 16] = [
    float!(color 0),
    float!(color 1),
    float!(color 2),
    float!(color 3),
    float!(depth),
    float!(opacity),
    float!(normal[0]),
    float!(normal[1]),
    float!(normal[2]),
    float!(albedo[0]),
    float!(albedo[1]),
    float!(albedo[2]),
    whole!(instance),
    whole!(samples),
    float!(bytes),
    float!(lod_error),
];

impl Contents {
    /// Of a picture with layers, or with ambient occlusion.
    pub(super) fn of(layers: bool, is_occluded: bool) -> Self {
        match (layers, is_occluded) {
            (true, _) => Self::Layers,
            (false, true) => Self::Depth,
            (false, false) => Self::Color,
        }
    }

    /// Bytes of a pixel.
    pub(super) fn pixel_bytes(self) -> usize {
        4 * self.channels().len()
    }

    pub(super) fn has_layers(self) -> bool {
        self != Self::Color
    }

    fn channels(self) -> &'static [Channel] {
        match self {
            Self::Color => &CHANNELS[..4],
            Self::Depth => &CHANNELS[..6],
            Self::Layers => &CHANNELS,
        }
    }

    /// The bytes of pixels. `layers` has as many as `pixels` if these contents have layers.
    pub(super) fn encode(self, pixels: &[[f32; 4]], layers: &[LayerPixel]) -> Vec<u8> {
        let none = LayerPixel::default();
        let count = pixels.len();
        let mut planes = vec![0; self.pixel_bytes() * count];
        for (channel, planes) in self.channels().iter().zip(planes.chunks_exact_mut(4 * count.max(1))) {
            for (i, pixel) in pixels.iter().enumerate() {
                let value = (channel.get)(pixel, layers.get(i).unwrap_or(&none)).to_le_bytes();
                (0..4).for_each(|byte| planes[byte * count + i] = value[byte]);
            }
        }
        let packed = lz4_flex::block::compress(&planes);
        if packed.len() < planes.len() { packed } else { planes }
    }

    /// Reads pixels into slices, which are as long as they are many; `layers` may be empty if there
    /// are none. Returns what is wrong with the bytes, if anything.
    pub(super) fn decode(
        self,
        bytes: &[u8],
        pixels: &mut [[f32; 4]],
        layers: &mut [LayerPixel],
    ) -> Result<(), String> {
        let count = pixels.len();
        let expected = self.pixel_bytes() * count;
        let mut unpacked = Vec::new();
        let planes = if bytes.len() == expected {
            bytes
        } else {
            unpacked.resize(expected, 0);
            let found = lz4_flex::block::decompress_into(bytes, &mut unpacked)
                .map_err(|error| format!("compressed pixels do not unpack: {error}"))?;
            if found != expected {
                return Err(format!("compressed pixels have {found} bytes, expected {expected}"));
            }
            &unpacked
        };
        let mut unwanted = LayerPixel::default();
        for (channel, planes) in self.channels().iter().zip(planes.chunks_exact(4 * count.max(1))) {
            for (i, pixel) in pixels.iter_mut().enumerate() {
                let value = std::array::from_fn(|byte| planes[byte * count + i]);
                (channel.set)(pixel, layers.get_mut(i).unwrap_or(&mut unwanted), u32::from_le_bytes(value));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pixels(count: usize) -> (Vec<[f32; 4]>, Vec<LayerPixel>) {
        let value = |i: usize| f32::from_bits((i as u32).wrapping_mul(0x9e37_79b9) & 0x7f7f_ffff);
        let colors = (0..count).map(|i| std::array::from_fn(|c| value(5 * i + c))).collect();
        let layers = (0..count).map(|i| LayerPixel {
            opacity: value(i),
            depth: if i % 3 == 0 { f32::INFINITY } else { value(7 * i) },
            normal: [value(i + 1), -value(i + 2), value(i + 3)],
            albedo: [0.0, -0.0, value(i)],
            instance: i as u32,
            samples: u32::MAX - i as u32,
            bytes: value(3 * i),
            lod_error: value(11 * i),
        });
        (colors, layers.collect())
    }

    #[test]
    fn pixels_come_back_to_the_bit_whether_they_compress_or_not() {
        for count in [1, 2, 37, 1024] {
            let (colors, layers) = pixels(count);
            let blank = vec![[0.25, 0.5, 0.75, 1.0]; count];
            for contents in [Contents::Color, Contents::Depth, Contents::Layers] {
                for colors in [&colors, &blank] {
                    let bytes = contents.encode(colors, &layers);
                    assert!(bytes.len() <= count * contents.pixel_bytes());
                    let mut back = (vec![[9.0; 4]; count], vec![LayerPixel::default(); count]);
                    contents.decode(&bytes, &mut back.0, &mut back.1).expect("it decodes");
                    assert_eq!(&back.0, colors);
                    let depths = |of: &[LayerPixel]| of.iter().map(|l| l.depth.to_bits()).collect::<Vec<_>>();
                    match contents {
                        Contents::Color => assert!(back.1.iter().all(|l| *l == LayerPixel::default())),
                        Contents::Depth => assert_eq!(depths(&back.1), depths(&layers)),
                        Contents::Layers => assert_eq!(format!("{:?}", back.1), format!("{layers:?}")),
                    }
                }
            }
        }
    }

    #[test]
    fn bytes_that_are_no_pixels_are_errors() {
        let mut pixels = [[0.0; 4]; 8];
        for bytes in [&[][..], &[0xff; 20], &[0; 127], &[7; 129], &[0xf0, 0xff, 0xff, 0xff, 0xff]] {
            assert!(Contents::Color.decode(bytes, &mut pixels, &mut []).is_err(), "{bytes:?}");
        }
    }
}

//! What pixels of a finished picture are, which goes with them into parts and files.

use rayset::image::{DisplayTransform, ToneMapping};
use rayset::scene::Compositing;

/// How pixels are displayed, and in which values the light in them was added up.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pixels {
    /// How they are displayed.
    pub display_transform: DisplayTransform,
    /// In which values light was added up along rays.
    pub compositing: Compositing,
}

impl Pixels {
    /// Length of what [`encode`](Self::encode) returns.
    pub const BYTES: usize = 9;

    /// As bytes: the exposure, and a byte with bit 0 for filmic tone mapping and bit 1 for
    /// composited display values.
    #[must_use]
    pub fn encode(&self) -> [u8; Self::BYTES] {
        let filmic = self.display_transform.tone_mapping == ToneMapping::Filmic;
        let display = self.compositing == Compositing::Display;
        let mut bytes = [u8::from(filmic) | u8::from(display) << 1; Self::BYTES];
        bytes[..8].copy_from_slice(&self.display_transform.exposure.to_le_bytes());
        bytes
    }

    /// What [`encode`](Self::encode) made bytes of; `None` if they are anything else.
    #[must_use]
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let (exposure, rest) = bytes.split_first_chunk::<8>()?;
        let &[flags @ 0..=3] = rest else { return None };
        let tone_mapping = if flags & 1 == 1 { ToneMapping::Filmic } else { ToneMapping::None };
        let compositing = if flags & 2 == 2 { Compositing::Display } else { Compositing::Linear };
        let display_transform = DisplayTransform { exposure: f64::from_le_bytes(*exposure), tone_mapping };
        Some(Self { display_transform, compositing })
    }

    /// What the comment of an OpenEXR file says of its light; nothing of what everybody expects.
    #[must_use]
    pub fn remark(&self) -> &'static str {
        match self.compositing {
            Compositing::Display => {
                "composited in display values (sRGB) along each ray, as Gaussian splats are trained; pixels are \
                 converted to linear light"
            }
            _ => "",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_pixels_are_comes_back_and_anything_else_is_none() {
        for (tone_mapping, compositing) in
            [(ToneMapping::None, Compositing::Display), (ToneMapping::Filmic, Compositing::Linear)]
        {
            let display_transform = DisplayTransform { exposure: -1.3, tone_mapping };
            let pixels = Pixels { display_transform, compositing };
            assert_eq!(Pixels::decode(&pixels.encode()), Some(pixels));
            assert_eq!(pixels.remark().is_empty(), compositing == Compositing::Linear);
        }
        for bytes in [&[][..], &[0; 8], &[0; 10], &[0, 0, 0, 0, 0, 0, 0, 0, 4]] {
            assert_eq!(Pixels::decode(bytes), None, "{bytes:?}");
        }
    }
}

//! What a part of a picture has besides pixels: how they are displayed, and what is drawn over
//! them.

use rayset_inputs::Pixels;

use crate::annotate::{Mount, Overlay};

/// What whoever merges needs besides pixels.
pub(crate) struct Note {
    pub(crate) pixels: Pixels,
    /// The sheet that the picture has its place on.
    pub(crate) mount: Option<Mount>,
    pub(crate) overlay: Option<Overlay>,
}

impl Note {
    /// As bytes: what pixels are, the sheet, and the pixels that are laid over the picture, if any.
    pub(crate) fn encode(&self) -> Vec<u8> {
        let mut bytes = self.pixels.encode().to_vec();
        bytes.push(u8::from(self.mount.is_some()));
        bytes.extend(self.mount.as_ref().map(Mount::encode).unwrap_or_default());
        bytes.push(u8::from(self.overlay.is_some()));
        bytes.extend(self.overlay.as_ref().map(Overlay::encode).unwrap_or_default());
        bytes
    }

    /// What [`encode`](Self::encode) made bytes of; `None` if they are anything else.
    pub(crate) fn decode(mut bytes: &[u8]) -> Option<Self> {
        let pixels = Pixels::decode(bytes.split_off(..Pixels::BYTES)?)?;
        let mount = match bytes.split_off_first()? {
            0 => None,
            1 => Some(Mount::decode(&mut bytes)?),
            _ => return None,
        };
        let overlay = match (bytes.split_off_first()?, bytes) {
            (0, []) => None,
            (1, rest) => Some(Overlay::decode(rest)?),
            _ => return None,
        };
        Some(Self { pixels, mount, overlay })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayset::image::{DisplayTransform, ToneMapping};
    use rayset::scene::Compositing;

    #[test]
    fn notes_come_back_and_anything_else_is_none() {
        let display_transform = DisplayTransform { exposure: -1.3, tone_mapping: ToneMapping::Filmic };
        let pixels = Pixels { display_transform, compositing: Compositing::Display };
        let note = Note { pixels, mount: None, overlay: None };
        let back = Note::decode(&note.encode()).expect("a note");
        assert_eq!(back.pixels, pixels);
        assert!(back.overlay.is_none());
        let overlay = Overlay::decode(&[]);
        let mut bytes = Note { overlay, ..note }.encode();
        assert!(Note::decode(&bytes).expect("a note").overlay.is_some());
        // A raster of two by one pixels, whole and cut off.
        for number in [3_u32, 4, 2, 1] {
            bytes.extend(number.to_le_bytes());
        }
        assert!(Note::decode(&bytes).is_none());
        bytes.extend([7; 8]);
        let again = Note::decode(&bytes).expect("a note").encode();
        assert_eq!(again, bytes);
        for length in [0, 8, 9, 10, bytes.len() - 1] {
            assert!(Note::decode(&bytes[..length]).is_none(), "{length}");
        }
        let mount = Mount { origin: (0, 0), size: (9, 9), place: (1, 2), background: [0.5; 4] };
        let mounted = Note { mount: Some(mount), ..Note::decode(&bytes).expect("a note") };
        assert_eq!(Note::decode(&mounted.encode()).expect("a note").mount, Some(mount));
        assert!(Note::decode(&[0, 0, 0, 0, 0, 0, 0, 0, 4, 0, 0]).is_none());
    }
}

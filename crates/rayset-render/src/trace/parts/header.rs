//! How a part begins and ends.
//!
//! | bytes | |
//! | --- | --- |
//! | 36 | magic, version, lengths and CRC-32C of the two that follow, CRC-32C of these 32 bytes |
//! | | what the part says of itself, JSON |
//! | | the caller's note, compressed by LZ4 |
//! | | the blocks of the share, in order; of an unfinished part, the first of them |
//! | 8 each | of every block its length and its CRC-32C |
//! | 28 | where that index is, number of blocks, CRC-32C of the index and of this, magic |
//!
//! Numbers are little-endian. All checksums behind the first 36 bytes continue the one of these:
//! what belongs to another part is damage.

use serde::{Deserialize, Serialize};

use super::block::Contents;
use super::same::Same;
use super::share::{Blocks, MOST_BLOCKS, Share};
use crate::trace::Region;
use crate::trace::ambient_occlusion::{Footprint, Surroundings};
use rayset_store::container::{Reader, Writer};

/// The first eight bytes of a part.
pub const PART_MAGIC: [u8; 8] = *b"RAYPART\n";
/// The last eight.
const END: [u8; 8] = *b"PARTEND\n";
/// Version of the format that is written and read.
pub(super) const VERSION: u32 = 2;
pub(super) const HEAD_BYTES: usize = 36;
pub(super) const FOOT_BYTES: usize = 28;
/// Bytes of a block in the index.
pub(super) const ENTRY_BYTES: u64 = 8;
/// Longest text of what a part says of itself.
pub(super) const MOST_TEXT_BYTES: u32 = 1 << 16;
/// Longest note, unpacked.
pub(super) const MOST_NOTE_BYTES: u64 = 1 << 26;
/// Longest side of a picture.
const MOST_PIXELS: u32 = 1 << 20;

/// The first bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Head {
    pub(super) text_bytes: u32,
    pub(super) note_bytes: u64,
    pub(super) text_crc: u32,
    pub(super) note_crc: u32,
}

impl Head {
    pub(super) fn encode(&self) -> Vec<u8> {
        let mut w = Writer::default();
        w.put(&PART_MAGIC);
        w.u32(VERSION);
        w.u32(self.text_bytes);
        w.u64(self.note_bytes);
        w.u32(self.text_crc);
        w.u32(self.note_crc);
        let crc = crc32c::crc32c(&w.bytes);
        w.u32(crc);
        w.bytes
    }

    /// What the bytes behind magic and version say, with their checksum, if that is right.
    pub(super) fn decode(bytes: &[u8; HEAD_BYTES]) -> Option<(Self, u32)> {
        let mut r = Reader::new(bytes);
        r.slice(12)?;
        let text_bytes = r.u32()?;
        let note_bytes = r.u64()?;
        let head = Self { text_bytes, note_bytes, text_crc: r.u32()?, note_crc: r.u32()? };
        let crc = crc32c::crc32c(&bytes[..HEAD_BYTES - 4]);
        (r.u32()? == crc).then_some((head, crc))
    }

    /// Where the blocks begin.
    pub(super) fn blocks_at(&self) -> u64 {
        HEAD_BYTES as u64 + u64::from(self.text_bytes) + self.note_bytes
    }
}

/// The last bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Foot {
    pub(super) index_at: u64,
    pub(super) blocks: u32,
    pub(super) index_crc: u32,
}

impl Foot {
    pub(super) fn encode(&self, seed: u32) -> Vec<u8> {
        let mut w = Writer::default();
        w.u64(self.index_at);
        w.u32(self.blocks);
        w.u32(self.index_crc);
        let crc = crc32c::crc32c_append(seed, &w.bytes);
        w.u32(crc);
        w.put(&END);
        w.bytes
    }

    pub(super) fn decode(bytes: &[u8; FOOT_BYTES], seed: u32) -> Option<Self> {
        let mut r = Reader::new(bytes);
        let foot = Self { index_at: r.u64()?, blocks: r.u32()?, index_crc: r.u32()? };
        let crc = crc32c::crc32c_append(seed, &bytes[..16]);
        (r.u32()? == crc && r.take()? == END).then_some(foot)
    }
}

/// What a part says of itself. Numbers that matter to the last bit are bits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct About {
    /// Number and count.
    share: (u32, u32),
    /// Of the whole picture.
    size: (u32, u32),
    /// What the picture shows of it: columns and rows.
    columns: (u32, u32),
    rows: (u32, u32),
    pub(super) contents: Contents,
    /// What ambient occlusion needs, if there is any.
    occlusion: Option<Occlusion>,
    /// Of the note, unpacked.
    pub(super) note_bytes: u64,
    pub(super) same: Same,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Occlusion {
    strength: u32,
    footprint: (u32, u32),
    step: u32,
    background: (u32, u32, u32),
}

impl About {
    pub(super) fn new(
        share: Share,
        size: (u32, u32),
        region: &Region,
        contents: Contents,
        surroundings: Option<&Surroundings>,
        (note_bytes, same): (u64, Same),
    ) -> Self {
        let occlusion = surroundings.map(|of| {
            let [red, green, blue] = of.background.map(f32::to_bits);
            Occlusion {
                strength: of.strength.to_bits(),
                footprint: (of.footprint.length.to_bits(), of.footprint.of_depth.to_bits()),
                step: of.step.to_bits(),
                background: (red, green, blue),
            }
        });
        Self {
            share: (share.number(), share.of()),
            size,
            columns: (region.columns.start, region.columns.end),
            rows: (region.rows.start, region.rows.end),
            contents,
            occlusion,
            note_bytes,
            same,
        }
    }

    /// Reads a text, and says what is wrong with it, if anything.
    pub(super) fn parse(text: &[u8]) -> Result<Self, String> {
        let about: Self =
            serde_json::from_slice(text).map_err(|error| format!("its description: {error}"))?;
        if about.share().is_none() {
            return Err(format!("share {}/{} is none of a picture", about.share.0, about.share.1));
        }
        let within = |(start, end): (u32, u32), length: u32| {
            (1..=MOST_PIXELS).contains(&length) && start < end && end <= length
        };
        if !within(about.columns, about.size.0) || !within(about.rows, about.size.1) {
            return Err(format!(
                "columns {:?} and rows {:?} of a picture of {:?} pixels; expected some within it",
                about.columns, about.rows, about.size
            ));
        }
        if about.note_bytes > MOST_NOTE_BYTES {
            return Err(format!("a note of {} bytes; expected up to {MOST_NOTE_BYTES}", about.note_bytes));
        }
        if about.occlusion.is_some() && !about.contents.has_layers() {
            return Err("ambient occlusion without depths".into());
        }
        if about.blocks().count() > MOST_BLOCKS {
            return Err(format!("{} blocks; expected up to {MOST_BLOCKS}", about.blocks().count()));
        }
        Ok(about)
    }

    pub(super) fn share(&self) -> Option<Share> {
        Share::new(self.share.0, self.share.1)
    }

    /// Width and height of the whole picture.
    pub(super) fn size(&self) -> (u32, u32) {
        self.size
    }

    /// What the picture shows of the whole.
    pub(super) fn region(&self) -> Region {
        Region { columns: self.columns.0..self.columns.1, rows: self.rows.0..self.rows.1 }
    }

    pub(super) fn surroundings(&self) -> Option<Surroundings> {
        self.occlusion.map(|of| {
            let (length, of_depth) = of.footprint;
            let (red, green, blue) = of.background;
            Surroundings {
                size: self.size,
                strength: f32::from_bits(of.strength),
                footprint: Footprint { length: f32::from_bits(length), of_depth: f32::from_bits(of_depth) },
                step: f32::from_bits(of.step),
                background: [red, green, blue].map(f32::from_bits),
                layers: self.contents == Contents::Layers,
            }
        })
    }

    /// What is rendered: the region, and what ambient occlusion looks at around it.
    pub(super) fn rendered(&self) -> Region {
        self.surroundings().map_or_else(|| self.region(), |of| of.rendered(&self.region()))
    }

    pub(super) fn blocks(&self) -> Blocks {
        Blocks::of(&self.rendered())
    }

    /// How this differs from what another render makes, if it does; in words.
    pub(super) fn other_render(&self, other: &Self) -> Option<String> {
        if self == other {
            return None;
        }
        let share = |of: &Self| format!("{}/{}", of.share.0, of.share.1);
        self.same
            .difference(&other.same)
            .map(|difference| difference.what)
            .or_else(|| self.other_picture(other))
            .or_else(|| Some(format!("it is part {}, and that part {}", share(self), share(other))))
    }

    /// Whether everything but the share and what proves sameness is equal; otherwise both, in
    /// words.
    pub(super) fn other_picture(&self, other: &Self) -> Option<String> {
        let text = |of: &Self| {
            let Region { columns, rows } = of.region();
            let (width, height) = of.size;
            let what = match of.contents {
                Contents::Layers => ", with layers",
                Contents::Color | Contents::Depth => "",
            };
            format!(
                "columns {columns:?} and rows {rows:?} of {width}x{height} pixels in {} parts{what}",
                of.share.1
            )
        };
        let (own, others) = (text(self), text(other));
        if own != others {
            return Some(format!("it is of {own}, and that of {others}"));
        }
        let equal = self.contents == other.contents && self.occlusion == other.occlusion;
        (!equal).then(|| "its ambient occlusion differs".into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = r#"{"share": [1, 2], "size": [64, 40], "columns": [0, 64], "rows": [8, 40], "contents": "depth",
        "occlusion": {"strength": 1, "footprint": [1, 2], "step": 3, "background": [0, 0, 0]}, "note_bytes": 0,
        "same": {"program": "", "build": "", "files": "", "scene": "", "settings": "", "view": "", "fused": true, "simd": "",
        "functions": "", "note": ""}}"#;

    #[test]
    fn descriptions_that_no_picture_has_are_errors() {
        assert!(About::parse(TEXT.as_bytes()).is_ok());
        for (from, to) in [
            ("[1, 2]", "[3, 2]"),
            ("[1, 2]", "[0, 0]"),
            ("[64, 40]", "[64, 0]"),
            ("[64, 40]", "[64, 4000000000]"),
            ("[0, 64]", "[64, 64]"),
            ("[0, 64]", "[0, 65]"),
            ("[8, 40]", "[40, 8]"),
            ("[8, 40]", "[-1, 40]"),
            ("\"depth\"", "\"color\""),
            ("\"depth\"", "\"smell\""),
            ("\"note_bytes\": 0", "\"note_bytes\": 99999999999"),
            ("true", "1"),
            ("\"note\": \"\"", "\"note\": \"\", \"more\": 1"),
        ] {
            let text = TEXT.replacen(from, to, 1);
            assert!(text != TEXT && About::parse(text.as_bytes()).is_err(), "{from} as {to}");
        }
        let vast = TEXT.replace("64", "1048576").replace("40", "1048576");
        assert!(About::parse(vast.as_bytes()).expect_err("vast").contains("blocks"));
    }

    #[test]
    fn heads_and_feet_come_back() {
        let head = Head { text_bytes: 3, note_bytes: 1 << 40, text_crc: 5, note_crc: 6 };
        let bytes: [u8; HEAD_BYTES] = head.encode().try_into().expect("its length");
        let (back, seed) = Head::decode(&bytes).expect("a head");
        assert_eq!(back, head);
        let foot = Foot { index_at: 1 << 50, blocks: 7, index_crc: 8 };
        let bytes: [u8; FOOT_BYTES] = foot.encode(seed).try_into().expect("its length");
        assert_eq!(Foot::decode(&bytes, seed), Some(foot));
        assert_eq!(Foot::decode(&bytes, seed ^ 1), None, "of another part");
    }
}

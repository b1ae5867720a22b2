//! Rendering a share of a picture into a part.

use std::io::Write;

use super::block::Contents;
use super::error::PartError;
use super::header::{About, ENTRY_BYTES, Foot, Head, MOST_NOTE_BYTES, MOST_TEXT_BYTES};
use super::same::Same;
use super::share::{MOST_BLOCKS, Share};
use crate::trace::work::{LOOKAHEAD_TILE_PIXELS, Region};
use crate::trace::{RenderCounts, View};
use rayset_base::cancel::CancelToken;
use rayset_base::setters;

/// Which part is rendered, and what is written into it besides pixels.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct PartOptions {
    /// The share of the picture.
    pub share: Share,
    /// Most pixels that are held in memory at a time, but always those of a square of 32×32; 16
    /// bytes each, and 60 with layers or ambient occlusion. 2²⁰ by default.
    pub held_pixels: u64,
    /// Whatever whoever joins the parts needs besides pixels, up to 64 MiB; the same in all parts.
    /// Empty by default.
    pub note: Vec<u8>,
    /// Which build of the program renders, if that is known; the same in all parts. Empty by
    /// default.
    pub build: String,
}

setters!(PartOptions {
    with_held_pixels => held_pixels: u64,
    with_note => note: Vec<u8>,
    with_build => build: String,
});

impl PartOptions {
    /// A part of a picture, with nothing besides pixels.
    #[must_use]
    pub fn new(share: Share) -> Self {
        Self { share, held_pixels: 1 << 20, note: Vec::new(), build: String::new() }
    }
}

impl View {
    /// Renders a share of a region of the picture, and writes it as a part. `progress` is told how
    /// many pixels of how many are finished.
    ///
    /// The bytes are a function of view, region and options, whatever session renders them.
    ///
    /// # Errors
    /// [`PartError`] as [`View::render`] and [`View::render_bands`], if the output refuses bytes,
    /// or if the picture is too large.
    pub fn render_part(
        &self,
        region: &Region,
        options: &PartOptions,
        cancel: &CancelToken,
        progress: &mut dyn FnMut(u64, u64),
        output: &mut dyn Write,
    ) -> Result<RenderCounts, PartError> {
        self.check_region(region)?;
        let about = self.about(region, options);
        let blocks = about.blocks();
        if blocks.count() > MOST_BLOCKS {
            let (pixels, edge) = (about.rendered().pixels(), u64::from(LOOKAHEAD_TILE_PIXELS));
            return Err(PartError::TooLarge { pixels, most: MOST_BLOCKS * edge * edge });
        }
        let mut writing = Writing::begin(&about, &options.note, output)?;
        let mut own = blocks.of_share(options.share).peekable();
        let total = blocks.of_share(options.share).map(|block| blocks.region(block).pixels()).sum();
        let (mut counts, mut done) = (RenderCounts::default(), 0);
        while own.peek().is_some() {
            let mut held: Vec<Region> = Vec::new();
            let pixels = |held: &[Region]| held.iter().map(Region::pixels).sum::<u64>();
            while pixels(&held) < options.held_pixels.max(1)
                && let Some(block) = own.next()
            {
                held.push(blocks.region(block));
            }
            let mut of_held = |finished| progress(done + finished, total);
            let (bands, of_bands) = self.regions(&held, Vec::new(), cancel, &mut of_held)?;
            counts += of_bands;
            done += pixels(&held);
            for band in bands {
                writing.block(&about.contents.encode(&band.pixels, &band.layers))?;
            }
        }
        writing.finish()?;
        Ok(counts)
    }

    fn about(&self, region: &Region, options: &PartOptions) -> About {
        let surroundings = self.surroundings();
        let contents = match (self.settings.layers, &surroundings) {
            (true, _) => Contents::Layers,
            (false, Some(_)) => Contents::Depth,
            (false, None) => Contents::Color,
        };
        let same = Same::of(self, self.prepared.engine.exec.simd, &options.build, &options.note);
        let size = (self.settings.width, self.settings.height);
        let note = (options.note.len() as u64, same);
        About::new(options.share, size, region, contents, surroundings.as_ref(), note)
    }
}

/// A part that is being written.
struct Writing<'a> {
    output: &'a mut dyn Write,
    /// The checksum that all others continue.
    seed: u32,
    at: u64,
    index: Vec<u8>,
}

impl<'a> Writing<'a> {
    fn begin(about: &About, note: &[u8], output: &'a mut dyn Write) -> Result<Self, PartError> {
        let wrong = |what: &str| PartError::Write(std::io::Error::other(what.to_owned()));
        let text = serde_json::to_vec(about).map_err(|error| PartError::Write(error.into()))?;
        if text.len() as u64 > u64::from(MOST_TEXT_BYTES) || note.len() as u64 > MOST_NOTE_BYTES {
            return Err(wrong("what it says of itself is longer than 64 KiB, or its note than 64 MiB"));
        }
        let note = lz4_flex::block::compress(note);
        let head = Head {
            text_bytes: text.len() as u32,
            note_bytes: note.len() as u64,
            text_crc: crc32c::crc32c(&text),
            note_crc: crc32c::crc32c(&note),
        };
        let bytes = head.encode();
        let seed = crc32c::crc32c(&bytes[..bytes.len() - 4]);
        for bytes in [&bytes, &text, &note] {
            output.write_all(bytes).map_err(PartError::Write)?;
        }
        Ok(Self { output, seed, at: head.blocks_at(), index: Vec::new() })
    }

    fn block(&mut self, bytes: &[u8]) -> Result<(), PartError> {
        self.output.write_all(bytes).map_err(PartError::Write)?;
        self.at += bytes.len() as u64;
        self.index.extend_from_slice(&(bytes.len() as u32).to_le_bytes());
        self.index.extend_from_slice(&crc32c::crc32c_append(self.seed, bytes).to_le_bytes());
        Ok(())
    }

    fn finish(self) -> Result<(), PartError> {
        let foot = Foot {
            index_at: self.at,
            blocks: (self.index.len() as u64 / ENTRY_BYTES) as u32,
            index_crc: crc32c::crc32c_append(self.seed, &self.index),
        };
        self.output.write_all(&self.index).map_err(PartError::Write)?;
        self.output.write_all(&foot.encode(self.seed)).map_err(PartError::Write)?;
        self.output.flush().map_err(PartError::Write)
    }
}

//! Rendering a share of a picture into a part.

use std::io::Write;
use std::time::{Duration, Instant};

use super::block::Contents;
use super::error::PartError;
use super::fetch;
use super::header::{About, ENTRY_BYTES, Foot, Head, MOST_NOTE_BYTES, MOST_TEXT_BYTES};
use super::part::Part;
use super::same::Same;
use super::share::{MOST_BLOCKS, Share};
use crate::trace::costs::Costs;
use crate::trace::work::{LOOKAHEAD_TILE_PIXELS, Region};
use crate::trace::{RenderCounts, View};
use rayset_base::cancel::CancelToken;
use rayset_base::setters;

/// Pixels that are rendered together first where the time for that is limited.
const FIRST_PIXELS: u64 = 1 << 16;

/// Which part is rendered, and what is written into it besides pixels.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct PartOptions {
    /// The share of the picture.
    pub share: Share,
    /// Most pixels that are held in memory at a time, but always those of a square of 32×32; 16
    /// bytes each, and 64 with layers or ambient occlusion. 2²⁰ by default.
    pub held_pixels: u64,
    /// Whatever whoever joins the parts needs besides pixels, up to 64 MiB; the same in all parts.
    /// Empty by default.
    pub note: Vec<u8>,
    /// Which build of the program renders, if that is known; the same in all parts. Empty by
    /// default.
    pub build: String,
    /// An unfinished part of the same share: what it has is not rendered again. `None` by default.
    pub resumed: Option<Part>,
    /// About how long squares are rendered together, at most: no more than that is lost where a
    /// render is interrupted. `None` by default: as many as may be held.
    pub kept_every: Option<Duration>,
}

setters!(PartOptions {
    with_held_pixels => held_pixels: u64,
    with_note => note: Vec<u8>,
    with_build => build: String,
    with_resumed => resumed: Option<Part>,
    with_kept_every => kept_every: Option<Duration>,
});

impl PartOptions {
    /// A part of a picture, with nothing besides pixels.
    #[must_use]
    pub fn new(share: Share) -> Self {
        let (held_pixels, note, build) = (1 << 20, Vec::new(), String::new());
        Self { share, held_pixels, note, build, resumed: None, kept_every: None }
    }
}

impl View {
    /// Renders a share of a region of the picture, and writes it as a part. `progress` is told how
    /// many pixels of how many are finished.
    ///
    /// The bytes are a function of view, region and options, whatever session renders them, from
    /// whichever unfinished part it goes on.
    ///
    /// # Errors
    /// [`PartError`] as [`View::render`] and [`View::render_bands`], if the output refuses bytes,
    /// if the picture is too large, or if the part to go on with is of another render, or damaged.
    /// If the render fails or is cancelled, what is written is an unfinished part.
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
        let taken = options.resumed.as_ref().map_or(Ok(0), |part| writing.take_over(part, &about))?;
        let own = || blocks.of_share(options.share).map(|block| blocks.region(block));
        let pixels = |squares: usize| own().take(squares).map(|square| square.pixels()).sum::<u64>();
        let (before, total) = (pixels(taken), pixels(usize::MAX));
        let mut of_rest = |done| progress(before + done, total);
        let costs = self.costs(&about.rendered(), own().skip(taken));
        let mut squares = Squares { rest: own().skip(taken), pace: Pace::of(options), costs };
        let rendered = self.squares(&mut squares, about.contents, cancel, &mut of_rest, &mut writing);
        writing.finish()?;
        rendered
    }

    /// Renders squares, some of them together, and writes them in order.
    fn squares(
        &self,
        squares: &mut Squares<impl Iterator<Item = Region>>,
        contents: Contents,
        cancel: &CancelToken,
        progress: &mut dyn FnMut(u64),
        writing: &mut Writing<'_>,
    ) -> Result<RenderCounts, PartError> {
        let mut counts = RenderCounts::default();
        loop {
            let held = squares.next();
            if held.is_empty() {
                progress(squares.costs.pixels());
                return Ok(counts);
            }
            let begun = Instant::now();
            let told: (_, &mut dyn FnMut(u64)) = (&mut squares.costs, progress);
            let (bands, of_bands) = self.regions(&held, Vec::new(), cancel, told)?;
            squares.pace.took(begun.elapsed());
            counts += of_bands;
            for band in bands {
                writing.block(&contents.encode(&band.pixels, &band.layers))?;
            }
        }
    }

    fn about(&self, region: &Region, options: &PartOptions) -> About {
        let surroundings = self.surroundings();
        let contents = Contents::of(self.settings.layers, surroundings.is_some());
        let same = Same::of(self, self.prepared.engine.exec.simd, &options.build, &options.note);
        let size = (self.settings.width, self.settings.height);
        let note = (options.note.len() as u64, same);
        About::new(options.share, size, region, contents, surroundings.as_ref(), note)
    }
}

/// The squares that are still to be rendered, how many of them together, and what they cost.
struct Squares<I> {
    rest: I,
    pace: Pace,
    costs: Costs,
}

impl<I: Iterator<Item = Region>> Squares<I> {
    /// Those that are rendered next; none at the end.
    fn next(&mut self) -> Vec<Region> {
        let (mut held, mut pixels) = (Vec::new(), 0);
        while pixels < self.pace.pixels
            && let Some(square) = self.rest.next()
        {
            pixels += square.pixels();
            held.push(square);
        }
        held
    }
}

/// How many pixels are rendered together: as many as may be held, or as are rendered within a time.
struct Pace {
    pixels: u64,
    held_pixels: u64,
    kept_every: Option<Duration>,
}

impl Pace {
    fn of(options: &PartOptions) -> Self {
        let held_pixels = options.held_pixels.max(1);
        let first = if options.kept_every.is_some() { FIRST_PIXELS } else { held_pixels };
        Self { pixels: first.min(held_pixels), held_pixels, kept_every: options.kept_every }
    }

    /// Is told how long those took that were rendered last.
    fn took(&mut self, time: Duration) {
        let Some(most) = self.kept_every else { return };
        if time > most {
            self.pixels /= 2;
        } else if time < most / 4 {
            self.pixels *= 2;
        }
        self.pixels = self.pixels.clamp(1, self.held_pixels);
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

    /// Copies what an unfinished part of the same render has. Returns how many squares that are.
    fn take_over(&mut self, part: &Part, about: &About) -> Result<usize, PartError> {
        if let Some(what) = part.about.other_render(about) {
            return Err(PartError::OtherRender { part: part.source.name.clone(), what });
        }
        let (source, index) = (&part.source, part.index()?);
        let storage = source.open()?;
        for &stored in &index {
            let bytes = fetch::read(source, &*storage, stored)?;
            if crc32c::crc32c_append(source.seed, &bytes) != stored.crc {
                return Err(PartError::damaged(&source.name, stored.at, "the checksum of pixels is wrong"));
            }
            self.block(&bytes)?;
        }
        Ok(index.len())
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

//! Joining all parts of a picture.

use super::block::Contents;
use super::error::PartError;
use super::fetch::{AT_A_TIME, BlockPlace, Fetcher};
use super::header::About;
use super::part::{Part, Source, StoredBlock};
use super::share::{Blocks, Share};
use crate::image::{Band, LayerPixel};
use crate::scene::RenderSettings;
use crate::trace::ambient_occlusion::{AmbientOcclusion, ROWS_SENT, apron, with_apron};
use crate::trace::memory_plan::{PIXEL_BYTES, exr_bytes};
use crate::trace::work::{LOOKAHEAD_TILE_PIXELS, Region};
use crate::trace::{BandSink, Picture, RenderError};
use rayset_base::cancel::CancelToken;

/// Memory for each part besides its blocks: names, open files.
const PART_BYTES: u64 = 1024;
/// Memory for reading and unpacking blocks, and for the stack and the buffers of an encoder that is
/// a row of blocks behind.
const READING_BYTES: u64 = 5 << 19;
/// Memory for the stack of a thread that waits for a block.
const WAITING_BYTES: u64 = 64 << 10;
/// One part in this many of the rows' memory is set aside for gaps between them.
const GAPS_PART: u64 = 32;
/// Rows of the picture in an encoder, as a render counts them.
const ENCODER_ROWS: u64 = 8;

/// All parts of one picture, or those that are there.
pub struct Joined {
    /// In the order of their shares; `None` for those that are missing.
    sources: Vec<Option<Source>>,
    about: About,
    blocks: Blocks,
    /// Row after row.
    entries: Vec<BlockPlace>,
    note: Vec<u8>,
    memory_bytes: u64,
    /// Blocks that are read at a time.
    at_a_time: usize,
}

impl std::fmt::Debug for Joined {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Joined({} parts)", self.sources.len())
    }
}

impl Joined {
    /// Joins parts, in any order, in `memory_bytes` of memory: for the parts, for the rows of the
    /// picture on their way to a sink, and for those in an encoder. The iterator may open them one
    /// by one.
    ///
    /// # Errors
    /// [`PartError`] if one of them is an error, damaged, of another picture or there twice, if one
    /// is missing or unfinished, or if the memory is too small; then it says how much is needed.
    pub fn join(
        parts: impl IntoIterator<Item = Result<Part, PartError>>,
        memory_bytes: u64,
    ) -> Result<Self, PartError> {
        let parts = parts.into_iter().map(|part| part?.finished());
        let joined = Self::join_partly(parts, memory_bytes)?;
        let missing: Vec<u32> = (1..)
            .zip(&joined.sources)
            .filter(|(_, source)| source.is_none())
            .map(|(number, _)| number)
            .collect();
        if missing.is_empty() {
            return Ok(joined);
        }
        Err(PartError::Missing { missing, of: joined.sources.len() as u32 })
    }

    /// Joins the parts that are there, at least one, as [`join`](Self::join) does; any may be
    /// unfinished. Pixels that are missing are transparent, and ambient occlusion beside them is
    /// not what it will be.
    ///
    /// # Errors
    /// As [`join`](Self::join), but for missing and unfinished parts.
    pub fn join_partly(
        parts: impl IntoIterator<Item = Result<Part, PartError>>,
        memory_bytes: u64,
    ) -> Result<Self, PartError> {
        let mut parts = parts.into_iter();
        let first = parts.next().ok_or(PartError::None)??;
        let of = first.share().of();
        let blocks = first.about.blocks();
        let needed = Needs::of(&first).bytes();
        if needed > memory_bytes {
            return Err(PartError::Memory { given: memory_bytes, needed });
        }
        let mut gathered =
            Gathered { sources: vec![None; of as usize], indices: vec![Vec::new(); of as usize] };
        gathered.add(&first)?;
        for part in parts {
            let part = part?;
            check_same(&part, &first)?;
            gathered.add(&part)?;
        }
        let Gathered { sources, indices } = gathered;
        let mut entries = vec![BlockPlace::default(); blocks.count() as usize];
        let mut next: Vec<_> = indices.iter().map(|index| index.iter()).collect();
        for (number, block) in blocks.dealt(of) {
            let part = number - 1;
            let stored = next[part as usize].next().copied().unwrap_or_default();
            entries[blocks.number(block)] = BlockPlace { part, stored };
        }
        let note = first.note()?;
        let at_a_time = at_a_time(&first);
        Ok(Self { sources, about: first.about, blocks, entries, note, memory_bytes: needed, at_a_time })
    }

    /// An upper bound of the bytes that joining the only part of a picture takes, a file with a
    /// note of so many bytes.
    #[must_use]
    pub fn bytes_of_one(settings: &RenderSettings, region: &Region, note_bytes: u64) -> u64 {
        let occluded_rows = (settings.ambient_occlusion > 0.0).then_some(settings.height);
        let size = (settings.width, settings.height);
        let contents = Contents::of(settings.layers, occluded_rows.is_some());
        let rendered = occluded_rows.map_or_else(|| region.clone(), |_| with_apron(region, size));
        // The note is there packed, too, which takes a little more where it does not pack.
        let note_bytes = 2 * note_bytes + note_bytes / 128 + 64;
        Needs { rendered, contents, occluded_rows, parts: 1, note_bytes, at_a_time: 1 }.bytes()
    }

    /// What the picture shows of the whole.
    #[must_use]
    pub fn region(&self) -> Region {
        self.about.region()
    }

    /// What of the region is missing, with its part or from it: rectangles that do not overlap.
    #[must_use]
    pub fn missing(&self) -> Vec<Region> {
        let Region { columns, rows } = self.region();
        let places = (0..self.blocks.rows).flat_map(|j| (0..self.blocks.columns).map(move |i| (i, j)));
        let missing = places.filter(|&block| self.place(block).is_none());
        let clipped = move |block| {
            let block = self.blocks.region(block);
            Region {
                columns: block.columns.start.max(columns.start)..block.columns.end.min(columns.end),
                rows: block.rows.start.max(rows.start)..block.rows.end.min(rows.end),
            }
        };
        missing.map(clipped).filter(|region| region.pixels() > 0).collect()
    }

    /// Where the bytes of a block are, if they are there.
    fn place(&self, block: (u32, u32)) -> Option<(&Source, BlockPlace)> {
        let entry = self.entries[self.blocks.number(block)];
        let source = self.sources[entry.part as usize].as_ref()?;
        (!entry.stored.is_absent()).then_some((source, entry))
    }

    /// Width and height of the whole picture in pixels.
    #[must_use]
    pub fn size(&self) -> (u32, u32) {
        self.about.size()
    }

    /// Whether pixels have layers.
    #[must_use]
    pub fn has_layers(&self) -> bool {
        self.about.contents == Contents::Layers
    }

    /// The note that is in each of the parts.
    #[must_use]
    pub fn note(&self) -> &[u8] {
        &self.note
    }

    /// An upper bound of the bytes that [`bands`](Self::bands) and an encoder take.
    #[must_use]
    pub fn memory_bytes(&self) -> u64 {
        self.memory_bytes
    }

    /// Hands the picture to a sink, band by band from the top: bit for bit what a render of the
    /// region hands on. Bands may begin and end at other rows.
    ///
    /// # Errors
    /// [`PartError`] if a part cannot be read or is damaged, the sink refuses a band, or `cancel`
    /// is cancelled.
    pub fn bands(&self, cancel: &CancelToken, sink: &mut (impl BandSink + ?Sized)) -> Result<(), PartError> {
        match self.about.surroundings() {
            None => self.rendered(cancel, sink),
            Some(of) => self.rendered(cancel, &mut AmbientOcclusion::new(&of, &self.region(), sink)),
        }
    }

    /// The whole picture, in memory.
    ///
    /// # Errors
    /// As [`bands`](Self::bands).
    pub fn picture(&self) -> Result<Picture, PartError> {
        let mut picture = Picture::default();
        self.bands(&CancelToken::new(), &mut picture)?;
        Ok(picture)
    }

    /// What was rendered, a row of blocks at a time.
    fn rendered(&self, cancel: &CancelToken, sink: &mut (impl BandSink + ?Sized)) -> Result<(), PartError> {
        let rendered = self.about.rendered();
        let mut fetcher = Fetcher::of(self.sources.len());
        let mut done = 0;
        for j in 0..self.blocks.rows {
            if cancel.is_cancelled() {
                return Err(RenderError::Cancelled.into());
            }
            let rows = self.blocks.region((0, j)).rows;
            let has_layers = self.about.contents.has_layers();
            let width = rendered.columns.len() as u32;
            let mut band = Band::new(rows.start, width, rows.len() as u32, has_layers);
            let columns: Vec<u32> = (0..self.blocks.columns).collect();
            for together in columns.chunks(self.at_a_time) {
                self.read(&mut fetcher, together, j, &rendered, &mut band)?;
            }
            sink.band(&band).map_err(PartError::Sink)?;
            done += band.pixels.len() as u64;
            sink.progress(done, rendered.pixels());
        }
        Ok(())
    }

    /// Reads blocks of a row into their places in a band.
    fn read(
        &self,
        fetcher: &mut Fetcher,
        columns: &[u32],
        row: u32,
        rendered: &Region,
        band: &mut Band,
    ) -> Result<(), PartError> {
        let mut there = Vec::with_capacity(columns.len());
        for &column in columns {
            let Some((source, BlockPlace { part, stored })) = self.place((column, row)) else { continue };
            let region = self.blocks.region((column, row));
            let (length, pixels) = (stored.length as usize, region.pixels() as usize);
            if length > pixels * self.about.contents.pixel_bytes() {
                return Err(damaged(source, stored, &region, &format!("{length} bytes for {pixels} pixels")));
            }
            there.push((region, source, BlockPlace { part, stored }));
        }
        let blocks: Vec<(&Source, BlockPlace)> =
            there.iter().map(|&(_, source, entry)| (source, entry)).collect();
        let fetched = fetcher.fetch(&blocks)?;
        for ((region, source, BlockPlace { stored, .. }), bytes) in there.into_iter().zip(fetched) {
            self.unpack((source, stored), &bytes, &region, rendered, band)?;
        }
        Ok(())
    }

    /// Checks the bytes of a block, and unpacks them into their place in a band.
    fn unpack(
        &self,
        (source, stored): (&Source, StoredBlock),
        bytes: &[u8],
        region: &Region,
        rendered: &Region,
        band: &mut Band,
    ) -> Result<(), PartError> {
        let contents = self.about.contents;
        if crc32c::crc32c_append(source.seed, bytes) != stored.crc {
            return Err(damaged(source, stored, region, "the checksum is wrong"));
        }
        let count = region.pixels() as usize;
        let mut pixels = vec![[0.0; 4]; count];
        let mut layers = vec![LayerPixel::default(); if contents.has_layers() { count } else { 0 }];
        contents
            .decode(bytes, &mut pixels, &mut layers)
            .map_err(|what| damaged(source, stored, region, &what))?;
        let width = region.columns.len();
        let left = (region.columns.start - rendered.columns.start) as usize;
        for y in 0..region.rows.len() {
            let to = y * band.width as usize + left;
            band.pixels[to..to + width].copy_from_slice(&pixels[y * width..][..width]);
            if contents.has_layers() {
                band.layers[to..to + width].copy_from_slice(&layers[y * width..][..width]);
            }
        }
        Ok(())
    }
}

/// The error for a block that is damaged.
fn damaged(source: &Source, stored: StoredBlock, region: &Region, what: &str) -> PartError {
    let Region { columns, rows } = region;
    PartError::damaged(&source.name, stored.at, format!("columns {columns:?}, rows {rows:?}: {what}"))
}

/// Blocks that are read at a time: where the first part is remote, more than one.
fn at_a_time(part: &Part) -> usize {
    if part.source.is_remote() { AT_A_TIME } else { 1 }
}

/// What the memory for joining depends on.
struct Needs {
    rendered: Region,
    contents: Contents,
    /// The height of the whole picture, if it has ambient occlusion.
    occluded_rows: Option<u32>,
    parts: u32,
    note_bytes: u64,
    at_a_time: usize,
}

impl Needs {
    /// Of the parts of a picture, given one of them.
    fn of(part: &Part) -> Self {
        Self {
            rendered: part.about.rendered(),
            contents: part.about.contents,
            occluded_rows: part.about.surroundings().map(|of| of.size.1),
            parts: part.share().of(),
            note_bytes: part.note_bytes(),
            at_a_time: at_a_time(part),
        }
    }

    /// An upper bound of the bytes that joining takes.
    fn bytes(&self) -> u64 {
        let width = self.rendered.columns.len() as u64;
        let has_layers = self.contents.has_layers();
        let pixel = PIXEL_BYTES + if has_layers { size_of::<LayerPixel>() as u64 } else { 0 };
        let block_rows = u64::from(LOOKAHEAD_TILE_PIXELS);
        // Rows that come in, and those that ambient occlusion keeps and sends on.
        let kept = |height| 2 * u64::from(apron(height)) + 1 + block_rows;
        let shading = self.occluded_rows.map_or(0, |height| kept(height) + u64::from(ROWS_SENT));
        let rows = self.rendered.rows.len() as u32;
        let encoder = if self.contents == Contents::Layers { exr_bytes(rows) * width } else { 0 };
        // The index of a part, and of all.
        let index = Blocks::of(&self.rendered).count() * 2 * size_of::<BlockPlace>() as u64;
        let parts = u64::from(self.parts) * PART_BYTES;
        let rows = (block_rows + shading + ENCODER_ROWS) * width * pixel;
        let block_bytes = block_rows * block_rows * self.contents.pixel_bytes() as u64 + WAITING_BYTES;
        let together = block_bytes * (self.at_a_time as u64 - 1);
        rows + rows / GAPS_PART + encoder + index + parts + self.note_bytes + READING_BYTES + together
    }
}

/// Refuses a part of another picture than the first.
fn check_same(part: &Part, first: &Part) -> Result<(), PartError> {
    let (part, first) = ((&part.about, &part.source.name), (&first.about, &first.source.name));
    let foreign =
        |what, advice| Err(PartError::Foreign { part: part.1.clone(), first: first.1.clone(), what, advice });
    if let Some(difference) = part.0.same.difference(&first.0.same) {
        return foreign(difference.what, difference.advice);
    }
    match part.0.other_picture(first.0) {
        Some(what) => foreign(what, "render all parts with the same options, and as many parts"),
        None => Ok(()),
    }
}

/// Parts by their numbers, as they come.
struct Gathered {
    sources: Vec<Option<Source>>,
    indices: Vec<Vec<StoredBlock>>,
}

impl Gathered {
    fn add(&mut self, part: &Part) -> Result<(), PartError> {
        let share: Share = part.share();
        let place = share.number() as usize - 1;
        if let Some(known) = &self.sources[place] {
            let (first, second) = (known.name.clone(), part.source.name.clone());
            return Err(PartError::Double { first, second, share });
        }
        self.indices[place] = part.index()?;
        self.sources[place] = Some(part.source.clone());
        Ok(())
    }
}

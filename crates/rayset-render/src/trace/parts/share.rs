//! How a picture is divided into shares.
//!
//! The unit is the block: a look-ahead tile, 32×32 pixels of the picture's lattice, clipped to what
//! is rendered. Blocks are numbered along the curve that a render follows, and dealt out in
//! stretches, round and round. Stretches keep together what needs the same pages; and as every
//! share has stretches from all over the picture, and several of whatever is not small in it,
//! shares take about the same time.

use std::fmt;
use std::ops::Range;
use std::str::FromStr;

use crate::trace::work::{LOOKAHEAD_TILE_PIXELS, Region};
use rayset_base::geometry::curve::hilbert_cells;
use rayset_base::parse::ParseError;

/// Stretches of blocks that each share has at least, about.
const STRETCHES: u64 = 16;
/// Most blocks of a stretch.
const MOST_TOGETHER: u64 = 8;
/// Most blocks of a picture: an index of them fits in tens of megabytes.
pub(super) const MOST_BLOCKS: u64 = 1 << 22;
/// Most shares of a picture.
const MOST_SHARES: u32 = 1 << 16;
/// Bytes of a block in the index of a part, and twice that while the index grows.
const INDEX_BYTES: u64 = 24;

/// One of the equal shares of a picture, written `3/8`: the third of eight.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Share {
    number: u32,
    of: u32,
}

impl Share {
    /// All of a picture: `1/1`.
    pub const WHOLE: Self = Self { number: 1, of: 1 };

    /// Share `number`, counted from 1, of `of`, up to 65 536. `None` if there is no such share.
    #[must_use]
    pub fn new(number: u32, of: u32) -> Option<Self> {
        ((1..=MOST_SHARES).contains(&of) && (1..=of).contains(&number)).then_some(Self { number, of })
    }

    /// Its number, from 1.
    #[must_use]
    pub fn number(self) -> u32 {
        self.number
    }

    /// The number of shares.
    #[must_use]
    pub fn of(self) -> u32 {
        self.of
    }

    /// Every share of a picture in so many.
    pub fn all(of: u32) -> impl Iterator<Item = Self> {
        (1..=of).filter_map(move |number| Self::new(number, of))
    }

    /// The squares of 32×32 pixels, cut off where the region ends, that are this share of a region.
    pub fn squares(self, region: &Region) -> impl Iterator<Item = Region> + use<> {
        let blocks = Blocks::of(region);
        blocks.of_share(self).map(move |block| blocks.region(block))
    }

    /// An upper bound of the bytes that rendering this share of a region takes besides the render
    /// itself and the pixels that are held.
    #[must_use]
    pub fn index_bytes(self, region: &Region) -> u64 {
        let blocks = Blocks::of(region).count();
        INDEX_BYTES * (blocks / u64::from(self.of) + blocks / STRETCHES / u64::from(self.of) + 2)
    }
}

impl fmt::Display for Share {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.number, self.of)
    }
}

impl FromStr for Share {
    type Err = ParseError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let numbers = text.split_once('/').map(|(number, of)| (number.parse().ok(), of.parse().ok()));
        let share = numbers.and_then(|(number, of)| Self::new(number?, of?));
        share.ok_or_else(|| {
            ParseError::new(text, |given| {
                format!(
                    "`{given}` is no part: expected NUMBER/OF, as in 3/8, the third of eight; up to {MOST_SHARES}"
                )
            })
        })
    }
}

/// The blocks of what is rendered of a picture, on their lattice.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Blocks {
    rendered: Region,
    /// Column and row of the first block.
    first: (u32, u32),
    pub(super) columns: u32,
    pub(super) rows: u32,
}

impl Blocks {
    pub(super) fn of(rendered: &Region) -> Self {
        let edge = LOOKAHEAD_TILE_PIXELS;
        let first = (rendered.columns.start / edge, rendered.rows.start / edge);
        Self {
            rendered: rendered.clone(),
            first,
            columns: rendered.columns.end.div_ceil(edge) - first.0,
            rows: rendered.rows.end.div_ceil(edge) - first.1,
        }
    }

    pub(super) fn count(&self) -> u64 {
        u64::from(self.columns) * u64::from(self.rows)
    }

    /// The number of a block, row after row.
    pub(super) fn number(&self, (i, j): (u32, u32)) -> usize {
        j as usize * self.columns as usize + i as usize
    }

    /// The pixels of a block.
    pub(super) fn region(&self, (i, j): (u32, u32)) -> Region {
        let clipped = |at: u32, range: &Range<u32>| {
            let start = at * LOOKAHEAD_TILE_PIXELS;
            start.max(range.start)..(start + LOOKAHEAD_TILE_PIXELS).min(range.end)
        };
        Region {
            columns: clipped(self.first.0 + i, &self.rendered.columns),
            rows: clipped(self.first.1 + j, &self.rendered.rows),
        }
    }

    /// Blocks of a stretch, of so many shares.
    fn stretch(&self, of: u32) -> u64 {
        (self.count() / (STRETCHES * u64::from(of))).clamp(1, MOST_TOGETHER)
    }

    /// Every block, in order, each with the number of the share that it belongs to, of `of`.
    pub(super) fn dealt(&self, of: u32) -> impl Iterator<Item = (u32, (u32, u32))> + use<> {
        let stretch = self.stretch(of);
        let shares = (0_u64..).map(move |at| (at / stretch % u64::from(of)) as u32 + 1);
        shares.zip(hilbert_cells(self.columns, self.rows))
    }

    /// The blocks of a share, in order.
    pub(super) fn of_share(&self, share: Share) -> impl Iterator<Item = (u32, u32)> + use<> {
        self.dealt(share.of).filter(move |(number, _)| *number == share.number).map(|(_, block)| block)
    }

    /// The number of blocks of a share.
    pub(super) fn count_of(&self, share: Share) -> u64 {
        let (of, place) = (u64::from(share.of), u64::from(share.number - 1));
        let stretch = self.stretch(share.of);
        let whole = self.count() / (stretch * of);
        let rest = self.count() - whole * stretch * of;
        whole * stretch + rest.saturating_sub(place * stretch).min(stretch)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_block_belongs_to_one_share_and_shares_are_about_equal() {
        for (columns, rows) in [(0..1, 0..1), (5..700, 40..300), (0..1920, 0..1080), (33..97, 0..4000)] {
            let blocks = Blocks::of(&Region { columns, rows });
            for of in [1, 2, 7, 64, 1000] {
                let mut seen = vec![0; blocks.count() as usize];
                let mut counts = Vec::new();
                for share in Share::all(of) {
                    let own: Vec<_> = blocks.of_share(share).collect();
                    assert_eq!(own.len() as u64, blocks.count_of(share), "{share} of {blocks:?}");
                    own.iter().for_each(|&block| seen[blocks.number(block)] += 1);
                    counts.push(own.len());
                }
                assert!(seen.iter().all(|&times| times == 1), "{of} of {blocks:?}");
                let (least, most) =
                    (counts.iter().min().expect("shares"), counts.iter().max().expect("shares"));
                assert!(most - least <= 1 + most / 16, "{least} to {most} blocks, {of} of {blocks:?}");
            }
        }
    }

    #[test]
    fn blocks_cover_what_is_rendered_and_lie_on_the_lattice_of_the_picture() {
        let rendered = Region { columns: 30..100, rows: 64..65 };
        let blocks = Blocks::of(&rendered);
        let regions: Vec<Region> = blocks.dealt(1).map(|(_, block)| blocks.region(block)).collect();
        assert_eq!(regions.iter().map(Region::pixels).sum::<u64>(), rendered.pixels());
        assert!(regions.contains(&Region { columns: 30..32, rows: 64..65 }));
        assert!(regions.contains(&Region { columns: 96..100, rows: 64..65 }));
    }

    #[test]
    fn shares_are_written_as_people_write_them() {
        assert_eq!("3/8".parse::<Share>().ok(), Share::new(3, 8));
        assert_eq!(Share::new(3, 8).expect("a share").to_string(), "3/8");
        for wrong in ["", "3", "0/8", "9/8", "1/0", "1/65537", "-1/2", "a/b", "1/2/3"] {
            let said = wrong.parse::<Share>().expect_err(wrong).to_string();
            assert!(said.contains("as in 3/8"), "{said}");
        }
    }
}

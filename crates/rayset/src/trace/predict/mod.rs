//! Bringing pages in before rays need them. A prediction can be wrong without harm to the picture.

use std::sync::Arc;

mod lookahead;
mod probe;

pub use lookahead::Lookahead;
pub(super) use lookahead::LookaheadState;

/// Turns known rays, or past accesses, into hints.
pub trait Predictor: Send + Sync {
    /// Called by a thread that is about to trace a tile, by its place in the order of the work.
    fn ahead(&self, lookahead: Lookahead<'_>, tile: usize);

    /// Where a packet meets a page that is absent: how many of the slabs that come next it asks for the pages of, in one
    /// batch, before its tile is deferred until they are there. Where 0, it waits for each page as it comes to it.
    fn slabs_on_a_miss(&self) -> u64;

    /// Whether a packet asks, after each slab, for the first absent page that comes next on the line of its samples.
    fn follows_lines(&self) -> bool {
        false
    }

    /// What to call it in reports.
    fn name(&self) -> &'static str;
}

/// What brings pages in before rays need them. It changes no picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Prediction {
    /// Nothing: every page is read when it is needed.
    None,
    /// The paper's predictor (its Algorithms 1 and 2): what lies ahead on the line of a packet's samples.
    Line,
    /// The rays of the next tiles are known, and the octree is walked ahead of them.
    #[default]
    Packet,
}

impl Prediction {
    /// The name: `none`, `line`, `packet`.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.predictor().name()
    }

    pub(crate) fn predictor(self) -> Arc<dyn Predictor> {
        match self {
            Self::None => Arc::new(NoPredictor),
            Self::Line => Arc::new(LinePredictor),
            Self::Packet => Arc::new(PacketPredictor::default()),
        }
    }
}

/// Predicts nothing: every page is read when it is needed.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoPredictor;

impl Predictor for NoPredictor {
    fn ahead(&self, _: Lookahead<'_>, _: usize) {}

    fn slabs_on_a_miss(&self) -> u64 {
        0
    }

    fn name(&self) -> &'static str {
        "none"
    }
}

/// The paper's predictor (its Algorithms 1 and 2), for packets: past samples give a line; goes on along it through what is
/// in memory, and asks for the first page that is not. A packet's line is that of the ray in its middle.
#[derive(Clone, Copy, Debug, Default)]
pub struct LinePredictor;

impl Predictor for LinePredictor {
    fn ahead(&self, _: Lookahead<'_>, _: usize) {}

    fn slabs_on_a_miss(&self) -> u64 {
        0
    }

    fn follows_lines(&self) -> bool {
        true
    }

    fn name(&self) -> &'static str {
        "line"
    }
}

/// The rays of the next tiles are known: walks the octree ahead of them, a block of tiles at a time, and hints at the
/// pages that they will meet before they end. Where that falls short, the packet that misses a page asks for what its
/// own next slabs need, and its tile is deferred until that is there.
#[derive(Clone, Copy, Debug)]
pub struct PacketPredictor {
    /// Blocks of 32×32 pixels looked at ahead of the one that is traced; 0 for that one alone.
    pub tiles_ahead: u32,
    /// Slabs whose pages a packet asks for at once where it misses one; 0 to wait for each page as it comes.
    pub slabs_on_a_miss: u64,
}

impl Default for PacketPredictor {
    fn default() -> Self {
        Self { tiles_ahead: 16, slabs_on_a_miss: 2 }
    }
}

impl Predictor for PacketPredictor {
    fn ahead(&self, lookahead: Lookahead<'_>, tile: usize) {
        lookahead.scout(tile, self.tiles_ahead);
    }

    fn slabs_on_a_miss(&self) -> u64 {
        self.slabs_on_a_miss
    }

    fn name(&self) -> &'static str {
        "packet"
    }
}

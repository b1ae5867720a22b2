//! Prediction of the pages that rays will need. A wrong prediction does not change the picture.

use std::sync::Arc;

mod deferral;
mod foresight;
mod found;
mod lookahead;
mod order;
mod pace;
pub(super) mod policy;
mod probe;
mod window;

pub(super) use deferral::Deferral;
pub(super) use foresight::Foresight;
pub use lookahead::Lookahead;
pub(super) use lookahead::LookaheadState;

/// Turns known rays or past accesses into hints at pages.
pub trait Predictor: Send + Sync {
    /// Called by a thread that is about to trace the tile with index `tile` in the order of the
    /// work.
    fn ahead(&self, lookahead: Lookahead<'_>, tile: usize);

    /// When a packet needs a page that is absent: the number of following slabs whose pages are
    /// requested in the same batch, before the packet's tile is deferred until the missing page has
    /// been read. If 0, the packet waits for each page when it needs it.
    fn slabs_on_a_miss(&self) -> u64;

    /// Whether a packet requests, after each slab, the first absent page ahead on the line of its
    /// samples.
    fn follows_lines(&self) -> bool {
        false
    }

    /// The name used in reports.
    fn name(&self) -> &'static str;
}

/// How pages are brought in before rays need them. The choice does not change the picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Prediction {
    /// No prediction: every page is read when it is needed.
    None,
    /// The paper's predictor (its Algorithms 1 and 2), which looks ahead on the line of a packet's
    /// samples.
    Line,
    /// Walks the octree ahead of the rays of the next tiles, which are known.
    #[default]
    Packet,
}

impl Prediction {
    /// The name: `none`, `line` or `packet`.
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

/// No prediction: every page is read when it is needed.
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

/// The paper's predictor (its Algorithms 1 and 2), applied to packets: past samples define a line,
/// which is followed through the nodes in memory; the first absent page on it is requested. The
/// line of a packet is that of its middle ray.
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

/// The rays of the next tiles are known: walks the octree ahead of them, one look-ahead tile at a
/// time, and hints at the pages they are expected to need before they end. If a page is still
/// absent, the packet that misses it requests the pages of its own next slabs, and its tile is
/// deferred until the missing page has been read.
#[derive(Clone, Copy, Debug)]
pub struct PacketPredictor {
    /// Look-ahead tiles of 32×32 pixels examined at least ahead of the current one; 0 for the
    /// current one only.
    pub tiles_ahead: u32,
    /// Following slabs whose pages a packet requests with one it misses; 0 to wait for each page
    /// when it is needed.
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

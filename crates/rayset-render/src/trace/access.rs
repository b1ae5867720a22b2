//! How one attempt at a tile obtains its pages: it either waits for absent pages, or is deferred
//! until they are resident.

use std::cell::{Cell, RefCell};
use std::collections::HashMap;
use std::sync::Arc;

use super::RenderError;
use crate::field::Sight;
use rayset_store::working_set::{Object, PageClient, PageGuard, Reuse};

/// A page that a tile waits for.
#[derive(Clone)]
pub(super) struct Lacking {
    pub(super) object: Arc<Object>,
    pub(super) page: u32,
}

/// Why an attempt ended early.
pub(super) enum Halt {
    /// A page is absent. It has been hinted if there was room; the tile is to be traced again from
    /// its beginning.
    Deferred(Lacking),
    Failed(RenderError),
}

impl<E: Into<RenderError>> From<E> for Halt {
    fn from(error: E) -> Self {
        Self::Failed(error.into())
    }
}

/// What an attempt has found out about pages that rays are expected to need.
#[derive(Default)]
pub(super) struct Foreseen {
    /// A page that the attempt is known to lack: it goes on only to find out what else it lacks,
    /// and is then deferred.
    lacking: RefCell<Option<Lacking>>,
    /// The tile that is being traced.
    tile: Cell<usize>,
    /// Pages that have been asked for, and that nobody else had asked for, by tile.
    asked: RefCell<HashMap<usize, Vec<Lacking>>>,
}

impl Foreseen {
    /// An attempt at a tile begins.
    pub(super) fn begin(&self, tile: usize) {
        self.lacking.take();
        self.tile.set(tile);
    }

    /// Records pages of an object as asked for.
    pub(super) fn asks(&self, object: &Arc<Object>, pages: impl Iterator<Item = u32>) {
        let mut asked = self.asked.borrow_mut();
        let of_tile = asked.entry(self.tile.get()).or_default();
        of_tile.extend(pages.map(|page| Lacking { object: object.clone(), page }));
    }

    /// Forgets what has been asked for.
    pub(super) fn forget(&self) {
        self.asked.borrow_mut().clear();
    }

    /// A tile is finished: what its rays have not needed must not count as what is still to be
    /// used.
    pub(super) fn finished(&self, tile: usize, pages: &PageClient) {
        for Lacking { object, page } in self.asked.borrow_mut().remove(&tile).unwrap_or_default() {
            pages.retire_unused(&object, &[page]);
        }
    }
}

/// Access to the pages of a render, for one attempt at a tile.
#[derive(Clone, Copy)]
pub(super) struct Access<'a> {
    pub(super) pages: &'a PageClient,
    /// Whether the attempt waits for absent pages.
    pub(super) waits: bool,
    /// If it does not wait: for how many slabs ahead pages are requested together with an absent
    /// one.
    pub(super) slabs_on_a_miss: u64,
    /// Whether it requests the pages that come next along the line of a packet.
    pub(super) follows_lines: bool,
    /// How far it looks along rays that it is about to trace, to ask for all pages that they are
    /// expected to need: a factor on the optical depth with which they are expected to have ended.
    /// `None` if it does not ask.
    pub(super) foresees: Option<f32>,
    /// What it has found out by that.
    pub(super) foreseen: &'a Foreseen,
    /// Threads that share the memory.
    pub(super) threads: usize,
    /// Bytes of the pages requested so far.
    pub(super) asked_bytes: &'a Cell<u64>,
    /// How the picture, or what keeps a light away, is seen, world space. `None` if nothing is seen
    /// from afar, nor shown.
    pub(super) sight: Option<Sight>,
    /// What this thread knows about when pages are used again.
    pub(super) reuse: &'a RefCell<Reuse>,
}

impl Access<'_> {
    /// The same for other rays.
    pub(super) fn seen(self, sight: Option<Sight>) -> Self {
        Self { sight, ..self }
    }

    /// Ends the attempt if the render is cancelled.
    pub(super) fn check(&self) -> Result<(), Halt> {
        if self.pages.cancel_token().is_cancelled() {
            return Err(Halt::Failed(RenderError::Cancelled));
        }
        Ok(())
    }

    /// Records that the attempt lacks a page.
    pub(super) fn lack(&self, lacking: Lacking) {
        *self.foreseen.lacking.borrow_mut() = Some(lacking);
    }

    /// Whether the attempt is to be deferred, whatever it finds from here on.
    pub(super) fn is_lacking(&self) -> bool {
        self.foreseen.lacking.borrow().is_some()
    }

    /// Ends an attempt that lacks a page.
    pub(super) fn end_if_lacking(&self) -> Result<(), Halt> {
        self.foreseen.lacking.take().map_or(Ok(()), |lacking| Err(Halt::Deferred(lacking)))
    }

    pub(super) fn retain_page(&self, object: &Arc<Object>, page: u32) -> Result<PageGuard, Halt> {
        self.check()?;
        self.asked_bytes.set(self.asked_bytes.get() + object.bytes());
        if self.waits {
            return Ok(self.pages.retain_knowing(object, page, Some(self.reuse))?);
        }
        match self.pages.retain_resident(object, page) {
            Some(outcome) => Ok(outcome?),
            None => {
                self.pages.hint(object, &[page], u64::MAX);
                Err(Halt::Deferred(Lacking { object: object.clone(), page }))
            }
        }
    }

    /// Retains one of the pages that a slab goes through in turn; `sample` is the slab's first,
    /// `again` whether the slabs after it need the page, too.
    pub(super) fn retain_in_turn(
        &self,
        object: &Arc<Object>,
        page: u32,
        sample: u64,
        again: bool,
    ) -> Result<PageGuard, Halt> {
        self.pages.come_to(sample, &mut self.reuse.borrow_mut());
        let guard = self.retain_page(object, page)?;
        self.pages.used_in_turn(object, page, &guard, again, &mut self.reuse.borrow_mut());
        Ok(guard)
    }
}

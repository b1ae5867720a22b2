//! Looking ahead in files that are remote: pages are asked for as early as there is room for
//! them, and stay until rays have passed.
//!
//! The window reaches from the first tile that is not finished to the last one whose pages have
//! been asked for. All pages that its tiles want stay in memory together, so that each is read once
//! for all of them; its length is limited by their number, and by what rays use up while a page is
//! on its way. Where there is little room, it goes on in smaller squares.

use std::sync::atomic::Ordering;
use std::time::Duration;

use super::found::{Found, Looked, PageId};
use super::lookahead::Lookahead;
use crate::trace::cloud::FarAhead;

/// So many pages are left to what nobody expected: measured, with fewer they evict each other
/// before their tiles are traced again.
const LEAST_RESERVE: u64 = 28;
/// At least one part in this many of the budget.
const RESERVE: u64 = 8;
/// And at most one part in this many.
const MOST_RESERVE: u64 = 4;
/// It is filled in bursts of one part in this many: of few pages at a time, few would be neighbours
/// that a request can join.
const BURSTS: u64 = 4;
/// Node pages are read at once, before anything else, if they take at most one part in this many of
/// the budget.
const NODES: u64 = 3;
/// So may those of records of what is seen from afar, at most one part in this many.
const RECORDS: u64 = 4;
/// So many squares behind one that cannot be looked at yet are asked what they lack.
const SQUARES_BEHIND: u32 = 16;
/// A square may add at most one part in this many to what the window may take; otherwise smaller
/// ones are examined.
const PARTS: u64 = 4;
/// If it adds less than one part in this many, larger ones are examined.
const SMALL_PARTS: u64 = 32;
/// Latencies vary, and so does what rays use up.
const MARGIN: u64 = 2;
/// The least that the window reaches ahead, in pages that are not in memory yet.
const LEAST_AHEAD: u64 = 64;

impl Lookahead<'_> {
    /// Examines further look-ahead tiles as far as there is room for their pages, and hints at
    /// them.
    pub(super) fn fill_window(&self, found: &mut Found, here: u32) {
        let state = self.state;
        if !found.begun {
            found.begun = true;
            self.bring_nodes(found);
        }
        // Forgets what squares wanted that have been traced.
        self.spare(found, here);
        let examined = found.next.max(1);
        state.pace.needed(found.fresh * u64::from((here + 1).min(examined)) / u64::from(examined));
        let room = self.room(found);
        let ahead = (MARGIN * self.pages_under_way()).max(LEAST_AHEAD);
        // Records that no ray comes to may stay unused.
        let unused = self.pages.hinted_bytes() / state.page_bytes;
        let unused = unused.saturating_sub(found.records_to_let_go.len() as u64);
        let is_full = |part: u64, found: &Found| {
            found.wanted >= room - room / part || unused + found.waiting.len() as u64 >= ahead - ahead / part
        };
        if (!is_full(BURSTS, found) && !state.is_stuck()) || found.next <= here {
            while found.next < state.order.len()
                && (!(is_full(u64::MAX, found) || state.is_stuck()) || found.next <= here)
                && self.widen(found, here, room)
            {}
        }
        self.hint_to_stay(found);
        state.examined.store(found.next, Ordering::Relaxed);
    }

    /// Pages that the window may take.
    fn room(&self, found: &Found) -> u64 {
        let pages = self.pages.share_bytes() / self.state.page_bytes;
        let stay = found.nodes_to_let_go.len() + found.records_to_let_go.len();
        let pages = pages.saturating_sub(stay as u64);
        pages - LEAST_RESERVE.max(pages / RESERVE).min(pages / MOST_RESERVE)
    }

    /// Examines one more square; returns whether the window has room for it, and now reaches to its
    /// end. The tiles that are about to be traced are taken in without room, as far as rays reach
    /// with what there is.
    fn widen(&self, found: &mut Found, here: u32, room: u64) -> bool {
        let looked = loop {
            let put_off = found.put_off.take().filter(|looked| looked.places.start == found.next);
            let Some(looked) = put_off.or_else(|| self.look_once(found)) else { return false };
            match found.edge.halved() {
                Some(smaller) if found.more_for(&looked) > room / PARTS => found.edge = smaller,
                _ => break looked,
            }
        };
        let more = found.more_for(&looked);
        let fits = found.wanted + more <= room;
        if !fits && found.next > here {
            found.put_off = Some(looked);
            return false;
        }
        if more < room / SMALL_PARTS {
            found.edge = found.edge.doubled();
        }
        let left = room.saturating_sub(found.wanted).max(room / PARTS);
        found.take_in_at_most(looked, left);
        true
    }

    /// Looks at the next square, unless what it lacked the last time is still on its way. If it
    /// lacks what nobody has asked for, squares behind it most likely do, too: that is asked for
    /// together, if there is room.
    fn look_once(&self, found: &mut Found) -> Option<Looked> {
        let is_under_way = |id: &PageId| self.object(id.file).is_some_and(|file| file.is_under_way(id.page));
        if found.lacking.iter().any(is_under_way) {
            return None;
        }
        let known = found.nodes_hinted.len();
        let looked = self.look(found.next, found.edge, found);
        let is_fresh = found.nodes_hinted.len() > known;
        if looked.is_none() && is_fresh && found.wanted + LEAST_AHEAD < self.room(found) {
            let (lacking, gone) = (std::mem::take(&mut found.lacking), found.nodes_do_not_fit);
            let order = &self.state.order;
            let mut place = found.next;
            for _ in 0..SQUARES_BEHIND {
                place = order.rest_of_square(place, found.edge).end;
                if place >= order.len() {
                    break;
                }
                let _ = self.look(place, found.edge, found);
            }
            (found.lacking, found.nodes_do_not_fit) = (lacking, gone);
        }
        looked
    }

    /// Pages that rays use up while one is on its way.
    fn pages_under_way(&self) -> u64 {
        self.state.pace.pages_in(self.latency(), self.state.threads)
    }

    /// The time that a page takes.
    pub(super) fn latency(&self) -> Duration {
        self.world.program.files().map(|pages| pages.latency()).max().unwrap_or_default()
    }

    fn hint_to_stay(&self, found: &mut Found) {
        let pages: Vec<PageId> = found.waiting.iter().map(|&(_, _, page)| page).collect();
        for same_file in pages.chunk_by(|a, b| a.file == b.file) {
            let numbers: Vec<u32> = same_file.iter().map(|id| id.page).collect();
            let Some(object) = self.object(same_file[0].file) else { continue };
            let dealt_with = self.pages.hint_to_stay(object, &numbers, self.reuse);
            found.dealt_with(dealt_with);
            if dealt_with < numbers.len() {
                break;
            }
        }
    }

    /// Lets a page go that was to stay; returns whether it is to be let go once more.
    pub(super) fn let_go(&self, PageId { file, page }: PageId) -> bool {
        self.object(file).is_some_and(|object| self.pages.let_go(object, page))
    }

    /// Asks for all node pages of remote clouds, if they are few, and for all ranges of bricks of
    /// remote grids likewise. First come the first records of what is seen from afar. All are kept
    /// as long as the picture is made: walking down the octree page by page would take a round trip
    /// for each level.
    fn bring_nodes(&self, found: &mut Found) {
        let (foresight, program) = (&self.world.foresight, &self.world.program);
        self.bring_records(found);
        let clouds = foresight.clouds(program).map(|(volume, file, _)| {
            let cloud = &volume.placement;
            let first = cloud.first_node_page;
            (file, first, first + cloud.header().node_pages)
        });
        let grids =
            foresight.grids(program).map(|(grid, file, _)| (file, grid.first_ranges_page(), u32::MAX));
        for (file, first, end) in clouds.chain(grids) {
            let Some(object) = self.object(file).filter(|object| foresight.policy.asks_together(object))
            else {
                continue;
            };
            let nodes: Vec<u32> = (first..end.min(object.pages())).rev().collect();
            let most = self.pages.share_bytes() / NODES;
            let is_known = found.nodes_to_let_go.iter().any(|page| page.file == file);
            if !is_known && nodes.len() as u64 * self.state.page_bytes <= most {
                self.pages.hint_to_stay(object, &nodes, self.reuse);
                found.nodes_to_let_go.extend(nodes.iter().map(|&page| PageId { file, page }));
            }
        }
    }

    fn bring_records(&self, found: &mut Found) {
        let (foresight, sight) = (&self.world.foresight, self.rays.sight());
        for (volume, file, _) in foresight.clouds(&self.world.program) {
            let object = &volume.placement.pages;
            let far = FarAhead::new(self.pages, volume, Some(&sight));
            let Some(far) = far.filter(|_| foresight.policy.asks_together(object)) else { continue };
            let most = (self.pages.share_bytes() / RECORDS / self.state.page_bytes) as usize;
            let left = most.saturating_sub(found.records_to_let_go.len());
            let is_new = |&page: &u32| !found.records_to_let_go.contains(&PageId { file, page });
            let pages: Vec<u32> = far.coarse_pages().filter(is_new).take(left).collect();
            self.pages.hint_to_stay(object, &pages, self.reuse);
            found.records_to_let_go.extend(pages.iter().map(|&page| PageId { file, page }));
        }
    }
}

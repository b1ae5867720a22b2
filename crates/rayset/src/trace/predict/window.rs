//! Looking ahead in files that are far away: pages are asked for as early as there is room for them, and stay until rays have passed.
//!
//! The window reaches from the first tile that is not finished to the last look-ahead tile whose pages have been asked for. All pages
//! that its tiles want stay in memory together, so that each is read once for all of them; its length is limited by their
//! number, and by what rays use up while a page is on its way.

use std::sync::atomic::Ordering;

use super::found::{Found, PageId};
use super::lookahead::Lookahead;

/// The window takes at most this share of the budget; the rest is for pages that nobody expected.
const SHARE: (u64, u64) = (3, 4);
/// It is filled in bursts of one part in this many: of few pages at a time, few would be neighbours that a request can join.
const BURSTS: u64 = 4;
/// Node pages are read at once, before anything else, if they take at most one part in this many of the budget.
const NODES: u64 = 8;
/// Latencies vary, and so does what rays use up.
const MARGIN: u64 = 2;
/// The least that the window reaches ahead, in pages that are not in memory yet.
const LEAST_AHEAD: u64 = 64;

impl Lookahead<'_> {
    /// Examines further look-ahead tiles as far as there is room for their pages, and hints at them.
    pub(super) fn fill_window(&self, found: &mut Found, here: u32) {
        let state = self.state;
        if !found.begun {
            found.begun = true;
            self.bring_nodes(found);
        }
        // Kept up to date for what tells how much is spare.
        self.spare(found, here);
        let examined = u64::from(found.next.max(1));
        state.pace.needed(found.fresh * (u64::from(here) + 1).min(examined) / examined);
        let room = self.pages.share_bytes() / state.page_bytes * SHARE.0 / SHARE.1;
        let ahead = (MARGIN * self.pages_under_way()).max(LEAST_AHEAD);
        let unused = self.pages.hinted_bytes() / state.page_bytes;
        let is_full = |part: u64, found: &Found| {
            found.wanted >= room - room / part || unused + found.waiting.len() as u64 >= ahead - ahead / part
        };
        let end = state.order.len() as u32;
        // At its end nothing is left to do meanwhile, and any page is better than none.
        if !is_full(BURSTS, found) || found.next <= here + 2 {
            while found.next < end
                && (!is_full(u64::MAX, found) || found.next <= here + 1)
                && self.look(found.next, found)
            {
                found.next += 1;
            }
        }
        self.hint_to_stay(found);
        state.examined.store(found.next, Ordering::Relaxed);
    }

    /// Pages that rays use up while one is on its way.
    fn pages_under_way(&self) -> u64 {
        let files = self.world.program.files();
        let latency = files.map(|pages| pages.latency()).max().unwrap_or_default();
        self.state.pace.pages_in(latency, self.state.threads)
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

    /// Asks for all node pages of far clouds, if they are few, and keeps them as long as the picture is made: walking down the octree page by page would take a round trip for
    /// each level.
    fn bring_nodes(&self, found: &mut Found) {
        for (cloud, _) in self.clouds().filter(|(cloud, _)| cloud.pages.is_far()) {
            let nodes: Vec<u32> = (cloud.first_node_page..cloud.pages.pages()).rev().collect();
            if nodes.len() as u64 * self.state.page_bytes <= self.pages.share_bytes() / NODES {
                self.pages.hint_to_stay(&cloud.pages, &nodes, self.reuse);
                found.nodes_to_let_go.extend(nodes.iter().map(|&page| PageId { file: cloud.file, page }));
            }
        }
    }
}

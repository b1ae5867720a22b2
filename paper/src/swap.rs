//! Memory under an operating system that swaps: pages least recently used go to disk, those that
//! were written to before they go. Time is counted, on the disk of the paper's day: that of reads
//! alone.

use crate::simulated::{Arm, Clock};

/// Bytes of a page of the operating system.
pub const OS_PAGE_BYTES: usize = 4096;

/// No page.
const NONE: u32 = u32::MAX;

#[derive(Clone, Copy)]
struct Page {
    /// Neighbours in the order of use, where it is in memory.
    older: u32,
    newer: u32,
    is_resident: bool,
    is_dirty: bool,
    is_on_disk: bool,
}

/// The program has never used it.
const NEW: Page = Page { older: NONE, newer: NONE, is_resident: false, is_dirty: false, is_on_disk: false };

/// Which pages of a program are in memory, and the counted time that it takes to have them there.
pub struct Swap {
    arm: Arm,
    clock: Clock,
    most: usize,
    /// Pages that are read together.
    together: usize,
    pages: Vec<Page>,
    oldest: u32,
    newest: u32,
    resident: usize,
    evictions: u64,
}

impl Swap {
    /// A program without any memory yet, of which so many bytes may be there.
    #[must_use]
    pub fn new(memory_bytes: u64, clock: Clock) -> Self {
        let most = (memory_bytes as usize / OS_PAGE_BYTES).max(1);
        Self {
            arm: Arm::default(),
            clock,
            most,
            together: 1,
            pages: Vec::new(),
            oldest: NONE,
            newest: NONE,
            resident: 0,
            evictions: 0,
        }
    }

    /// Reads with a page those around it that are on disk, in aligned groups of so many bytes:
    /// systems do so.
    #[must_use]
    pub fn reading_around(mut self, bytes: u64) -> Self {
        self.together = (bytes as usize / OS_PAGE_BYTES).clamp(1, self.most);
        self
    }

    /// The program has `bytes` of memory, and all of it is on disk.
    #[must_use]
    pub fn swapped_out(mut self, bytes: u64) -> Self {
        let pages = bytes.div_ceil(OS_PAGE_BYTES as u64) as usize;
        self.pages = vec![Page { is_on_disk: true, ..NEW }; pages];
        (self.oldest, self.newest, self.resident) = (NONE, NONE, 0);
        self
    }

    /// The same, but for the pages that a program used last, which are there, and on disk as well.
    #[must_use]
    pub fn left_by(self, uses: &LastUses) -> Self {
        let mut swap = self.swapped_out((uses.pages.len() * OS_PAGE_BYTES) as u64);
        for number in uses.last(swap.most) {
            swap.bring_in(number);
        }
        swap
    }

    /// Pages that had to go.
    #[must_use]
    pub fn evictions(&self) -> u64 {
        self.evictions
    }

    /// The program reads or writes bytes at an address.
    pub fn touch(&mut self, at: u64, bytes: usize, writes: bool) {
        for number in pages_of(at, bytes) {
            if self.pages.len() <= number {
                self.pages.resize(number + 1, NEW);
            }
            if self.pages[number].is_resident {
                self.unlink(number);
                self.link_newest(number);
            } else {
                self.fault(number);
            }
            self.pages[number].is_dirty |= writes;
        }
    }

    fn fault(&mut self, number: usize) {
        // A page that the program has never written to disk is new, and empty.
        if !self.pages[number].is_on_disk {
            self.bring_in(number);
            return;
        }
        let around = self.absent_around(number);
        let (first, count) = (around.start, around.len());
        // What is needed is used last, so that what comes with it cannot drive it out.
        around.filter(|&page| page != number).chain([number]).for_each(|page| self.bring_in(page));
        let place = (first * OS_PAGE_BYTES) as u64;
        let job = self.arm.submit(place, count * OS_PAGE_BYTES, self.clock.now());
        let ends = self.arm.end_of(job);
        self.clock.advance(ends.saturating_sub(self.clock.now()));
        self.arm.run_until(self.clock.now());
    }

    /// The pages of its group that stand side by side with a page on disk, and are not there.
    fn absent_around(&self, number: usize) -> std::ops::Range<usize> {
        let group = number / self.together * self.together;
        let end = (group + self.together).min(self.pages.len());
        let is_absent = |page: &usize| !self.pages[*page].is_resident && self.pages[*page].is_on_disk;
        let before = (group..number).rev().take_while(is_absent).count();
        let behind = (number..end).take_while(is_absent).count();
        number - before..number + behind
    }

    /// Makes room, and the page resident.
    fn bring_in(&mut self, number: usize) {
        while self.resident >= self.most && self.oldest != NONE {
            self.drive_out(self.oldest as usize);
        }
        self.resident += 1;
        self.pages[number].is_resident = true;
        self.link_newest(number);
    }

    fn drive_out(&mut self, number: usize) {
        self.unlink(number);
        self.resident -= 1;
        self.evictions += 1;
        let page = &mut self.pages[number];
        page.is_resident = false;
        // Systems gather what they write, and put it side by side: in favour of paging, it takes no
        // time here.
        page.is_on_disk |= std::mem::take(&mut page.is_dirty);
    }

    fn link_newest(&mut self, number: usize) {
        let page = &mut self.pages[number];
        (page.older, page.newer) = (self.newest, NONE);
        match self.newest {
            NONE => self.oldest = number as u32,
            newest => self.pages[newest as usize].newer = number as u32,
        }
        self.newest = number as u32;
    }

    fn unlink(&mut self, number: usize) {
        let Page { older, newer, .. } = self.pages[number];
        match older {
            NONE => self.oldest = newer,
            older => self.pages[older as usize].newer = newer,
        }
        match newer {
            NONE => self.newest = older,
            newer => self.pages[newer as usize].older = older,
        }
    }
}

/// When a program last used each page: with pages least recently used out first, the latest are
/// those in memory, whatever came before and however long it took.
#[derive(Default)]
pub struct LastUses {
    pages: Vec<u64>,
    uses: u64,
}

impl LastUses {
    /// The program reads or writes bytes at an address.
    pub fn touch(&mut self, at: u64, bytes: usize) {
        for number in pages_of(at, bytes) {
            if self.pages.len() <= number {
                self.pages.resize(number + 1, 0);
            }
            self.uses += 1;
            self.pages[number] = self.uses;
        }
    }

    /// The `most` pages that were used last, the least recently used of them first.
    fn last(&self, most: usize) -> Vec<usize> {
        let mut used: Vec<usize> = (0..self.pages.len()).filter(|&number| self.pages[number] > 0).collect();
        used.sort_unstable_by_key(|&number| self.pages[number]);
        used.split_off(used.len().saturating_sub(most))
    }
}

fn pages_of(at: u64, bytes: usize) -> std::ops::Range<usize> {
    let width = OS_PAGE_BYTES as u64;
    (at / width) as usize..(at + bytes as u64).div_ceil(width) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    const SEEK: u64 = 8_000_000;
    const PAGE: u64 = OS_PAGE_BYTES as u64;

    fn far(n: u64) -> u64 {
        n * (1 << 20)
    }

    #[test]
    fn new_pages_cost_nothing_and_pages_that_come_back_cost_a_read() {
        let clock = Clock::default();
        let mut swap = Swap::new(2 * PAGE, clock.clone());
        for n in 1..4 {
            swap.touch(far(n), 10, true);
        }
        assert_eq!(clock.now(), 0, "the first goes behind the program's back");
        swap.touch(far(3), 10, false);
        assert_eq!(clock.now(), 0, "it is there");
        swap.touch(far(1), 10, false);
        assert!(clock.now() > SEEK, "it was written, and comes back");
        assert_eq!(swap.evictions(), 2);
    }

    #[test]
    fn what_stands_around_a_page_comes_with_it_and_only_that() {
        let clock = Clock::default();
        let mut swap = Swap::new(8 * PAGE, clock.clone()).reading_around(4 * PAGE).swapped_out(16 * PAGE);
        let mut cost = |page: u64| {
            let before = clock.now();
            swap.touch(page * PAGE, 1, false);
            clock.now() - before
        };
        assert_eq!(cost(5), SEEK.min(4 * PAGE * 20) + 4 * PAGE * 20, "pages 4 to 7, at 50 MB/s");
        assert_eq!([cost(4), cost(6), cost(7)], [0; 3]);
        assert!(cost(8) > 0, "of the next group");
        assert!(cost(3) > SEEK, "of the group before");
        assert_eq!([cost(9), cost(10), cost(0)], [0; 3]);
        assert!(cost(5) > 0, "only two groups fit");
        assert!(cost(8) > 0, "used before the others");
    }

    #[test]
    fn a_program_leaves_in_memory_what_it_used_last() {
        let clock = Clock::default();
        let (mut whole, mut uses) = (Swap::new(3 * PAGE, clock.clone()), LastUses::default());
        for page in [0, 1, 2, 3, 4, 1, 5, 4, 4, 0] {
            whole.touch(page * PAGE, 1, true);
            uses.touch(page * PAGE, 1);
        }
        let mut left = Swap::new(3 * PAGE, clock.clone()).left_by(&uses);
        let is_there = |swap: &Swap| swap.pages.iter().map(|p| p.is_resident).collect::<Vec<_>>();
        assert_eq!(is_there(&left), is_there(&whole));
        assert_eq!(is_there(&left), [true, false, false, false, true, true]);
        let before = clock.now();
        [4, 0, 5].into_iter().for_each(|page| left.touch(page * PAGE, 1, false));
        assert_eq!(clock.now(), before);
    }
}

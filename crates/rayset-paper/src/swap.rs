//! Memory of a program that writes to it, under an operating system that swaps: pages least recently used go to disk, those
//! that were written to before they go.

use std::collections::{BTreeMap, HashMap, HashSet};

use crate::memory::OS_PAGE_BYTES;
use crate::records::Work;
use crate::simulated::{Arm, Clock};

struct Page {
    used: u64,
    is_dirty: bool,
}

/// Which pages of a program are in memory, and the counted time that it takes to have them there.
pub struct Swap {
    arm: Arm,
    clock: Clock,
    most: usize,
    pages: HashMap<u64, Page>,
    by_use: BTreeMap<u64, u64>,
    /// Pages that have been written to disk.
    swapped: HashSet<u64>,
    uses: u64,
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
            pages: HashMap::new(),
            by_use: BTreeMap::new(),
            swapped: HashSet::new(),
            uses: 0,
        }
    }

    /// The program reads or writes bytes at an address.
    pub fn touch(&mut self, at: u64, bytes: usize, writes: bool) {
        self.clock.advance(Work::Step.nanoseconds());
        let width = OS_PAGE_BYTES as u64;
        for number in at / width..(at + bytes as u64).div_ceil(width) {
            if !self.pages.contains_key(&number) {
                self.fault(number);
            }
            self.uses += 1;
            let Some(page) = self.pages.get_mut(&number) else { continue };
            self.by_use.remove(&page.used);
            page.used = self.uses;
            page.is_dirty |= writes;
            self.by_use.insert(self.uses, number);
        }
    }

    fn fault(&mut self, number: u64) {
        let place = |number: u64| number * OS_PAGE_BYTES as u64;
        while self.pages.len() >= self.most
            && let Some((_, oldest)) = self.by_use.pop_first()
        {
            if self.pages.remove(&oldest).is_some_and(|page| page.is_dirty) {
                // The system writes it while the program goes on, as far as the arm is free.
                self.arm.submit(place(oldest), OS_PAGE_BYTES, self.clock.now());
                self.swapped.insert(oldest);
            }
        }
        // A page that the program has never written to disk is new, and empty.
        if self.swapped.contains(&number) {
            let job = self.arm.submit(place(number), OS_PAGE_BYTES, self.clock.now());
            let ends = self.arm.end_of(job);
            self.clock.advance(ends.saturating_sub(self.clock.now()));
            self.arm.run_until(self.clock.now());
        }
        self.uses += 1;
        self.pages.insert(number, Page { used: self.uses, is_dirty: false });
        self.by_use.insert(self.uses, number);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn new_pages_cost_nothing_and_pages_that_come_back_cost_a_write_and_a_read() {
        let clock = Clock::default();
        let mut swap = Swap::new(2 * OS_PAGE_BYTES as u64, clock.clone());
        let page = |n: u64| n * (1 << 20);
        let seek = 8_000_000;
        for n in 1..4 {
            swap.touch(page(n), 10, true);
        }
        assert!(clock.now() < seek, "the first is written behind the program's back");
        swap.touch(page(3), 10, false);
        assert!(clock.now() < seek, "it is there");
        swap.touch(page(1), 10, false);
        assert!(clock.now() > seek, "it was written, and comes back");
    }
}

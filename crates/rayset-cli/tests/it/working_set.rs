//! The working set by itself: budgets, eviction, single flight, faults.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use rayset::working_set::read::{Pool, Storage};
use rayset::working_set::{Kind, Limits, Object, PageSource, WorkingSet};

use crate::common::Random;

const PAGE: usize = 4096;

/// Pages that hold their own number; reads can be slow, and can fail.
struct Numbers {
    pages: u32,
    reads: AtomicU64,
    delay: Duration,
    broken_page: Option<u32>,
    in_flight: Vec<AtomicUsize>,
}

impl Numbers {
    fn new(pages: u32) -> Self {
        Self {
            pages,
            reads: AtomicU64::new(0),
            delay: Duration::ZERO,
            broken_page: None,
            in_flight: (0..pages).map(|_| AtomicUsize::new(0)).collect(),
        }
    }
}

impl Storage for Numbers {
    fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        let page = offset as usize / PAGE;
        assert_eq!(
            self.in_flight[page].fetch_add(1, Ordering::SeqCst),
            0,
            "page {page} is read twice at a time"
        );
        self.reads.fetch_add(1, Ordering::SeqCst);
        std::thread::sleep(self.delay);
        self.in_flight[page].fetch_sub(1, Ordering::SeqCst);
        if self.broken_page == Some(page as u32) {
            return Err(io::Error::other("the disk is on fire"));
        }
        buffer.fill(page as u8);
        Ok(())
    }
}

struct Source(Arc<Numbers>);

#[test]
fn a_working_set_that_goes_takes_its_pages_with_it() {
    let numbers = Arc::new(Numbers::new(40));
    let pages = WorkingSet::new(Limits::total(64 * PAGE as u64), Arc::new(Pool::new(2)));
    let object = pages.add(Arc::new(Source(numbers.clone())));
    for page in 0..40 {
        drop(pages.retain(&object, page, 100).expect("a page"));
    }
    drop((pages, object));
    // The thread that read the last page may be about to let go of what it read for.
    let patience = Instant::now() + Duration::from_secs(20);
    while Arc::strong_count(&numbers) > 1 && Instant::now() < patience {
        std::thread::sleep(Duration::from_millis(1));
    }
    assert_eq!(Arc::strong_count(&numbers), 1, "something still holds the pages' source, and so the pages");
}

impl PageSource for Source {
    fn pages(&self) -> u32 {
        self.0.pages
    }
    fn page_bytes(&self) -> usize {
        PAGE
    }
    fn kind(&self, page: u32) -> Kind {
        if page.is_multiple_of(4) { Kind::Octree } else { Kind::Points }
    }
    fn offset(&self, page: u32) -> u64 {
        u64::from(page) * PAGE as u64
    }
    fn storage(&self) -> Arc<dyn Storage> {
        self.0.clone()
    }
    fn check(&self, page: u32, bytes: &[u8]) -> Result<(), String> {
        if bytes.iter().all(|&b| b == page as u8) { Ok(()) } else { Err("a wrong number".into()) }
    }
    fn name(&self) -> String {
        "numbers".into()
    }
}

fn set(numbers: Numbers, limits: Limits) -> (WorkingSet, Arc<Object>, Arc<Numbers>) {
    let numbers = Arc::new(numbers);
    let set = WorkingSet::new(limits, Arc::new(Pool::new(4)));
    let object = set.add(Arc::new(Source(numbers.clone())));
    (set, object, numbers)
}

fn pages(n: u64) -> Limits {
    Limits::total(n * PAGE as u64)
}

#[test]
fn the_lowest_priority_goes_first_and_the_least_recently_used_among_equals() {
    let (set, object, _) = set(Numbers::new(20), pages(4));
    let touch = |page, priority| drop(set.retain(&object, page, priority).expect("a page"));
    touch(1, 100);
    touch(2, 40);
    touch(3, 100);
    touch(5, 100);
    touch(1, 100);
    let resident = || (0..20).filter(|&p| set.is_resident(&object, p)).collect::<Vec<_>>();
    assert_eq!(resident(), [1, 2, 3, 5]);
    touch(6, 100);
    assert_eq!(resident(), [1, 3, 5, 6], "the lowest priority went");
    touch(7, 100);
    assert_eq!(resident(), [1, 5, 6, 7], "the least recently used went");
    let held = set.retain(&object, 5, 100).expect("a page");
    set.retire(&object, &[6, 5]);
    touch(9, 100);
    assert_eq!(resident(), [1, 5, 7, 9], "the retired page went, the retained one stayed");
    assert!(held.iter().all(|&b| b == 5));
}

#[test]
fn budgets_in_all_by_kind_and_by_object_hold_at_every_moment() {
    let limits = pages(12).with_kind(Kind::Octree, 3 * PAGE as u64).with_object(1, 5 * PAGE as u64);
    let (set, first, _) = set(Numbers::new(60), limits);
    let second = set.add(Arc::new(Source(Arc::new(Numbers::new(60)))));
    std::thread::scope(|scope| {
        for seed in 0..4 {
            let (set, first, second) = (&set, &first, &second);
            scope.spawn(move || {
                let mut random = Random(seed);
                for _ in 0..3000 {
                    let object = if random.unit() < 0.5 { first } else { second };
                    let page = (random.unit() * 60.0) as u32;
                    let priority = (random.unit() * 255.0) as u8;
                    if random.unit() < 0.3 {
                        set.hint(object, &[page, (page + 1) % 60], priority, u64::MAX);
                    } else {
                        let guard = set.retain(object, page, priority).expect("a page");
                        assert!(guard.iter().all(|&b| b == page as u8));
                    }
                }
            });
        }
    });
    let found = set.statistics();
    assert!(found.peak_bytes <= 12 * PAGE as u64, "{found:?}");
    assert!(found.kind(Kind::Octree).peak_bytes <= 3 * PAGE as u64, "{found:?}");
    let of_second = (0..60).filter(|&p| set.is_resident(&second, p)).count();
    assert!(of_second <= 5);
    assert!(found.total(|k| k.evictions) > 100);
}

#[test]
fn a_page_that_many_threads_want_is_read_once() {
    let numbers = Numbers { delay: Duration::from_millis(30), ..Numbers::new(8) };
    let (set, object, numbers) = set(numbers, pages(8));
    std::thread::scope(|scope| {
        for _ in 0..8 {
            scope.spawn(|| drop(set.retain(&object, 3, 100).expect("a page")));
        }
    });
    assert_eq!(numbers.reads.load(Ordering::SeqCst), 1);
    let found = set.statistics();
    assert_eq!(found.total(|k| k.misses), 1);
    assert_eq!(found.total(|k| k.late + k.hits), 7);
    assert!(found.total(|k| k.stall_nanoseconds) > 20_000_000);
}

#[test]
fn a_hint_brings_a_page_in_before_it_is_asked_for() {
    let (set, object, numbers) = set(Numbers::new(64), pages(64));
    assert_eq!(set.hint(&object, &[5, 6, 7], 100, 9 * PAGE as u64), 3);
    while !(5..8).all(|p| set.is_resident(&object, p)) {
        std::thread::yield_now();
    }
    drop(set.retain(&object, 6, 100).expect("a page"));
    let found = set.statistics();
    assert_eq!((found.total(|k| k.hits), found.total(|k| k.misses)), (1, 0));
    assert_eq!((found.total(|k| k.hinted), found.total(|k| k.hinted_in_time)), (3, 1));
    assert_eq!(numbers.reads.load(Ordering::SeqCst), 3);
    // Hints that nobody takes up may fill as much as was said and no more: two are unused already.
    assert_eq!(set.hint(&object, &(10..40).collect::<Vec<_>>(), 100, 9 * PAGE as u64), 7);
}

#[test]
fn hints_never_evict_a_page_of_the_same_or_a_higher_priority() {
    let (set, object, _) = set(Numbers::new(64), pages(8));
    let held: Vec<_> = (0..8).map(|p| set.retain(&object, p, 200).expect("a page")).collect();
    assert_eq!(set.hint(&object, &[20], 250, u64::MAX), 0, "all are retained");
    drop(held);
    assert_eq!(set.hint(&object, &[20], 100, u64::MAX), 0, "released pages keep half of their priority");
    assert_eq!(set.hint(&object, &[20], 101, u64::MAX), 1);
}

#[test]
fn what_a_hint_brought_in_and_nobody_uses_goes_before_what_was_used_since() {
    let (set, object, _) = set(Numbers::new(64), pages(4));
    assert_eq!(set.hint(&object, &[20], 200, u64::MAX), 1);
    while !set.is_resident(&object, 20) {
        std::thread::yield_now();
    }
    (0..4).for_each(|page| drop(set.retain(&object, page, 200).expect("a page")));
    let resident: Vec<u32> = (0..64).filter(|&page| set.is_resident(&object, page)).collect();
    assert_eq!(resident, [0, 1, 2, 3]);
}

#[test]
fn failed_reads_and_wrong_bytes_are_errors_with_their_place() {
    let (set, object, _) = set(Numbers { broken_page: Some(2), ..Numbers::new(8) }, pages(4));
    let Err(fault) = set.retain(&object, 2, 100) else { panic!("page 2 is broken") };
    let text = fault.to_string();
    assert!(text.contains("numbers") && text.contains("byte 8192") && text.contains("on fire"), "{text}");
    drop(set.retain(&object, 3, 100).expect("other pages are fine"));
}

#[test]
fn a_budget_below_one_page_is_an_error_that_names_what_is_needed() {
    let (set, object, _) = set(Numbers::new(8), pages(1));
    let small = WorkingSet::new(Limits::total(PAGE as u64 - 1), Arc::new(Pool::new(1)));
    let alone = small.add(Arc::new(Source(Arc::new(Numbers::new(2)))));
    let Err(fault) = small.retain(&alone, 0, 1) else { panic!("a page cannot fit") };
    assert!(fault.to_string().contains("4096"), "{fault}");
    drop(set.retain(&object, 1, 1).expect("one page fits"));
}

#[test]
fn a_smaller_budget_takes_effect_at_once() {
    let (set, object, _) = set(Numbers::new(32), pages(32));
    (0..32).for_each(|p| drop(set.retain(&object, p, 100).expect("a page")));
    let held = set.retain(&object, 9, 100).expect("a page");
    set.set_limits(pages(5));
    let resident: Vec<u32> = (0..32).filter(|&p| set.is_resident(&object, p)).collect();
    assert_eq!(resident.len(), 5);
    assert!(resident.contains(&9));
    drop(held);
}

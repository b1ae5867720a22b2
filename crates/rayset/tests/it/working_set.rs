//! The working set by itself: budgets, eviction, single flight, faults.

use std::cell::RefCell;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use rayset::cancel::CancelToken;
use rayset::working_set::read::{MemoryStorage, Pool, Storage};
use rayset::working_set::{Kind, Limits, Object, PageClient, PageSource, Reuse, WorkingSet};

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
    fn length(&self) -> io::Result<u64> {
        Ok(u64::from(self.pages) * PAGE as u64)
    }

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
    let client = pages.client(&CancelToken::new());
    let object = pages.add(Arc::new(Source(numbers.clone())));
    for page in 0..40 {
        drop(client.retain(&object, page).expect("a page"));
    }
    drop((pages, client, object));
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

fn set(numbers: Numbers, limits: Limits) -> (WorkingSet, PageClient, Arc<Object>, Arc<Numbers>) {
    let numbers = Arc::new(numbers);
    let set = WorkingSet::new(limits, Arc::new(Pool::new(4)));
    let client = set.client(&CancelToken::new());
    let object = set.add(Arc::new(Source(numbers.clone())));
    (set, client, object, numbers)
}

/// Those of the first pages that are in memory.
fn resident(object: &Object, pages: u32) -> Vec<u32> {
    (0..pages).filter(|&page| object.is_resident(page)).collect()
}

fn pages(n: u64) -> Limits {
    Limits::total(n * PAGE as u64)
}

#[test]
fn what_is_retired_goes_first_and_then_the_least_recently_used() {
    let (_set, client, object, _) = set(Numbers::new(20), pages(4));
    let touch = |page| drop(client.retain(&object, page).expect("a page"));
    [1, 2, 3, 5, 1].into_iter().for_each(touch);
    assert_eq!(resident(&object, 20), [1, 2, 3, 5]);
    touch(6);
    assert_eq!(resident(&object, 20), [1, 3, 5, 6], "the least recently used went");
    touch(7);
    assert_eq!(resident(&object, 20), [1, 5, 6, 7], "the least recently used went");
    let held = client.retain(&object, 5).expect("a page");
    client.retire(&object, &[6, 5]);
    touch(9);
    assert_eq!(resident(&object, 20), [1, 5, 7, 9], "the retired page went, the retained one stayed");
    assert!(held.iter().all(|&b| b == 5));
    drop(held);
    client.retire(&object, &[7]);
    touch(7);
    touch(10);
    assert_eq!(resident(&object, 20), [5, 7, 9, 10], "a page that is used again is retired no more");
}

/// Which page goes is what a list in the order of uses says, whatever was asked for in whatever
/// order.
#[test]
fn eviction_follows_the_order_of_uses_exactly_where_pages_are_few() {
    let (_set, client, object, _) = set(Numbers::new(40), pages(12));
    let mut random = Random(5);
    let mut by_use: Vec<u32> = Vec::new();
    for _ in 0..2000 {
        // Some pages much more often than others.
        let page = (random.unit() * random.unit() * 40.0) as u32;
        drop(client.retain(&object, page).expect("a page"));
        by_use.retain(|&p| p != page);
        by_use.push(page);
        if by_use.len() > 12 {
            by_use.remove(0);
        }
        let mut expected = by_use.clone();
        expected.sort_unstable();
        assert_eq!(resident(&object, 40), expected);
    }
}

/// Rounds of slabs that go through five pages each, of which the next slab needs the last two
/// again.
#[test]
fn rounds_that_need_more_pages_than_fit_keep_pages_from_round_to_round() {
    for (all, fit) in [(32, 16), (400, 200)] {
        let (set, client, object, _) = set(Numbers::new(all), pages(fit));
        let mut reuse = RefCell::new(Reuse::default());
        let reads_of_round = || {
            set.reset_statistics();
            client.begin_round(reuse.get_mut());
            for first in (0..all - 4).step_by(3) {
                for page in first..first + 5 {
                    client.come_to(u64::from(first), reuse.get_mut());
                    let guard = client.retain_knowing(&object, page, Some(&reuse)).expect("a page");
                    client.used_in_turn(&object, page, &guard, page >= first + 3, reuse.get_mut());
                }
            }
            client.end_round(reuse.get_mut());
            set.statistics().total(|kind| kind.reads)
        };
        let reads: Vec<u64> = std::iter::repeat_with(reads_of_round).take(8).collect();
        // The first rounds show what a round needs. Then those that do not fit are read, and a few
        // that gave way to them.
        let most = u64::from(all) - fit + 8;
        assert!(reads[3..].iter().all(|&reads| reads <= most), "{fit} of {all}: {reads:?}, at most {most}");
    }
}

#[test]
fn of_many_pages_used_since_the_last_eviction_an_old_one_goes() {
    let (_set, client, object, _) = set(Numbers::new(1200), pages(1000));
    (0..1000).for_each(|page| drop(client.retain(&object, page).expect("a page")));
    // All are younger than when they came, and in another order.
    (0..1000).for_each(|k| drop(client.retain(&object, k * 7 % 1000).expect("a page")));
    drop(client.retain(&object, 1100).expect("a page"));
    let gone: Vec<u32> = (0..1000).filter(|&page| !object.is_resident(page)).collect();
    let [gone] = gone[..] else { panic!("{gone:?}") };
    let age = (0..1000).position(|k| k * 7 % 1000 == gone).expect("one of them");
    assert!(age < 900, "of all uses, the one of the page that went is number {age}");
}

#[test]
fn clients_hints_and_retirements_do_not_touch_each_others_pages() {
    let (set, first, object, _) = set(Numbers::new(64), pages(8));
    let second = set.client(&CancelToken::new());
    assert_eq!(first.share_bytes(), 4 * PAGE as u64);
    drop(first.retain(&object, 1).expect("a page"));
    drop(second.retain(&object, 2).expect("a page"));
    let wait_for = |page| {
        while !object.is_resident(page) {
            std::thread::yield_now();
        }
    };
    assert_eq!(first.hint(&object, &[3], PAGE as u64), 1);
    assert_eq!(first.hint(&object, &[4], PAGE as u64), 0, "its own unused hints fill what it may");
    assert_eq!(second.hint(&object, &[4], PAGE as u64), 1, "not those of others");
    wait_for(3);
    wait_for(4);
    // Neither may retire what the other has used or hinted at last.
    first.retire(&object, &[2, 4]);
    first.retire_unused(&object, &[4]);
    drop(second);
    assert_eq!(first.share_bytes(), 8 * PAGE as u64);
    // The hint of the one that is gone is the first to go; what it used is not.
    (10..15).for_each(|page| drop(first.retain(&object, page).expect("a page")));
    assert_eq!(resident(&object, 64), [1, 2, 3, 10, 11, 12, 13, 14]);
}

#[test]
fn a_wait_ends_when_its_client_is_cancelled_and_the_set_serves_others() {
    let numbers = Numbers { delay: Duration::from_millis(1500), ..Numbers::new(8) };
    let (set, other, object, _) = set(numbers, pages(1));
    let cancel = CancelToken::new();
    let client = set.client(&cancel);
    let waits = |page| {
        let started = Instant::now();
        let fault = client.retain(&object, page).err().expect("a fault");
        assert_eq!(fault.to_string(), "cancelled");
        started.elapsed()
    };
    std::thread::scope(|scope| {
        // One waits for its read, which takes over a second more, the other for the room of the
        // page that is being read.
        let threads = [0, 1].map(|page| scope.spawn(move || waits(page)));
        std::thread::sleep(Duration::from_millis(200));
        cancel.cancel();
        let cancelled = Instant::now();
        assert!(threads.into_iter().all(|thread| thread.join().is_ok()));
        assert!(cancelled.elapsed() < Duration::from_millis(700), "{:?}", cancelled.elapsed());
    });
    drop(other.retain(&object, 5).expect("the set goes on"));
}

/// Pages in memory that hold their own number.
struct InMemory(MemoryStorage, u32);

impl PageSource for InMemory {
    fn pages(&self) -> u32 {
        self.1
    }
    fn page_bytes(&self) -> usize {
        PAGE
    }
    fn kind(&self, _: u32) -> Kind {
        Kind::Points
    }
    fn offset(&self, page: u32) -> u64 {
        u64::from(page) * PAGE as u64
    }
    fn storage(&self) -> Arc<dyn Storage> {
        Arc::new(self.0.clone())
    }
    fn check(&self, page: u32, bytes: &[u8]) -> Result<(), String> {
        if bytes.iter().all(|&b| b == page as u8) { Ok(()) } else { Err("a wrong number".into()) }
    }
    fn name(&self) -> String {
        "memory".into()
    }
}

#[test]
fn pages_that_lie_in_memory_are_used_where_they_are_checked_and_count_in_no_budget() {
    let mut bytes: Vec<u8> = (0..10 * PAGE).map(|at| (at / PAGE) as u8).collect();
    bytes[3 * PAGE + 7] = 99;
    let bytes = Arc::new(bytes);
    let set = WorkingSet::new(pages(1), Arc::new(Pool::new(1)));
    let client = set.client(&CancelToken::new());
    // The last page is not all there.
    let source = InMemory(MemoryStorage::new(bytes.clone()), 11);
    let object = set.add(Arc::new(source));
    let held: Vec<_> = [0, 1, 9].map(|page| client.retain(&object, page).expect("a page")).into();
    assert!(held.iter().zip([0, 1, 9]).all(|(guard, page)| guard.as_ptr() == bytes[page * PAGE..].as_ptr()));
    assert_eq!(client.hint(&object, &[1, 2], 0), 2);
    let wrong = client.retain(&object, 3).err().expect("it is damaged").to_string();
    assert!(wrong.contains("memory") && wrong.contains("byte 12288") && wrong.contains("wrong"), "{wrong}");
    assert!(client.retain(&object, 10).is_err() && client.peek(&object, 3).is_none());
    assert_eq!(set.statistics().peak_bytes, 0);
}

#[test]
fn budgets_in_all_and_by_kind_hold_at_every_moment() {
    let limits = pages(12).with_kind(Kind::Octree, 3 * PAGE as u64);
    let (set, _, first, _) = set(Numbers::new(60), limits);
    let second = set.add(Arc::new(Source(Arc::new(Numbers::new(60)))));
    std::thread::scope(|scope| {
        for seed in 0..4 {
            let (set, first, second) = (&set, &first, &second);
            scope.spawn(move || {
                let client = set.client(&CancelToken::new());
                let mut random = Random(seed);
                for _ in 0..3000 {
                    let object = if random.unit() < 0.5 { first } else { second };
                    let page = (random.unit() * 60.0) as u32;
                    if random.unit() < 0.3 {
                        client.hint(object, &[page, (page + 1) % 60], u64::MAX);
                    } else {
                        let guard = client.retain(object, page).expect("a page");
                        assert!(guard.iter().all(|&b| b == page as u8));
                    }
                }
            });
        }
    });
    let found = set.statistics();
    assert!(found.peak_bytes <= 12 * PAGE as u64, "{found:?}");
    assert!(found.kind(Kind::Octree).peak_bytes <= 3 * PAGE as u64, "{found:?}");
    assert!(found.total(|k| k.evictions) > 100);
}

#[test]
fn a_page_that_many_threads_want_is_read_once() {
    let numbers = Numbers { delay: Duration::from_millis(30), ..Numbers::new(8) };
    let (set, client, object, numbers) = set(numbers, pages(8));
    std::thread::scope(|scope| {
        for _ in 0..8 {
            scope.spawn(|| drop(client.retain(&object, 3).expect("a page")));
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
    let (set, client, object, numbers) = set(Numbers::new(64), pages(64));
    assert_eq!(client.hint(&object, &[5, 6, 7], 9 * PAGE as u64), 3);
    while !(5..8).all(|p| object.is_resident(p)) {
        std::thread::yield_now();
    }
    drop(client.retain(&object, 6).expect("a page"));
    let found = set.statistics();
    assert_eq!((found.total(|k| k.hits), found.total(|k| k.misses)), (1, 0));
    assert_eq!((found.total(|k| k.hinted), found.total(|k| k.hinted_in_time)), (3, 1));
    assert_eq!(numbers.reads.load(Ordering::SeqCst), 3);
    // Hints that nobody takes up may fill as much as was said and no more: two are unused already.
    assert_eq!(client.hint(&object, &(10..40).collect::<Vec<_>>(), 9 * PAGE as u64), 7);
}

#[test]
fn hints_never_evict_a_page_that_is_retained() {
    let (_, client, object, _) = set(Numbers::new(64), pages(8));
    let held: Vec<_> = (0..8).map(|p| client.retain(&object, p).expect("a page")).collect();
    assert_eq!(client.hint(&object, &[20], u64::MAX), 0, "all are retained");
    drop(held);
    assert_eq!(client.hint(&object, &[20], u64::MAX), 1);
}

#[test]
fn what_a_hint_brought_in_and_nobody_uses_goes_before_what_was_used_since() {
    let (_set, client, object, _) = set(Numbers::new(64), pages(4));
    assert_eq!(client.hint(&object, &[20], u64::MAX), 1);
    while !object.is_resident(20) {
        std::thread::yield_now();
    }
    (0..4).for_each(|page| drop(client.retain(&object, page).expect("a page")));
    assert_eq!(resident(&object, 64), [0, 1, 2, 3]);
}

#[test]
fn failed_reads_and_wrong_bytes_are_errors_with_their_place() {
    let (_set, client, object, _) = set(Numbers { broken_page: Some(2), ..Numbers::new(8) }, pages(4));
    let Err(fault) = client.retain(&object, 2) else { panic!("page 2 is broken") };
    let text = fault.to_string();
    assert!(text.contains("numbers") && text.contains("byte 8192") && text.contains("on fire"), "{text}");
    drop(client.retain(&object, 3).expect("other pages are fine"));
}

#[test]
fn a_budget_below_one_page_is_an_error_that_names_what_is_needed() {
    let (_set, client, object, _) = set(Numbers::new(8), pages(1));
    let small = WorkingSet::new(Limits::total(PAGE as u64 - 1), Arc::new(Pool::new(1)));
    let alone = small.add(Arc::new(Source(Arc::new(Numbers::new(2)))));
    let Err(fault) = small.client(&CancelToken::new()).retain(&alone, 0) else { panic!("a page cannot fit") };
    assert!(fault.to_string().contains("4096"), "{fault}");
    drop(client.retain(&object, 1).expect("one page fits"));
}

#[test]
fn a_smaller_budget_takes_effect_at_once() {
    let (set, client, object, _) = set(Numbers::new(32), pages(32));
    (0..32).for_each(|p| drop(client.retain(&object, p).expect("a page")));
    let held = client.retain(&object, 9).expect("a page");
    set.set_limits(pages(5));
    let resident = resident(&object, 32);
    assert_eq!(resident.len(), 5);
    assert!(resident.contains(&9));
    drop(held);
}

#[test]
fn a_kind_that_may_have_no_page_is_an_error_at_once() {
    let (_, client, object, _) = set(Numbers::new(8), pages(8).with_kind(Kind::Octree, 0));
    let started = Instant::now();
    assert!(client.retain(&object, 4).is_err(), "an octree page");
    assert!(started.elapsed() < Duration::from_secs(5), "{:?}", started.elapsed());
    drop(client.retain(&object, 5).expect("a page of points"));
}

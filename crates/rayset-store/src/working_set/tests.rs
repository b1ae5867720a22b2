//! Tests that need the inside of a working set: waits that end, pages whose computation fails,
//! hints that are settled.

use std::cell::RefCell;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc;
use std::time::{Duration, Instant};

use super::object::HintMark;
use super::read::{Pool, Storage};
use super::*;

const PAGE: u64 = 4096;

/// Pages of zeros; reads take a while.
struct Zeros {
    pages: u32,
    page_bytes: u64,
    delay_milliseconds: AtomicU64,
    unreadable_offset: AtomicU64,
}

struct Source(Arc<Zeros>);

impl Storage for Zeros {
    fn length(&self) -> io::Result<u64> {
        Ok(u64::from(self.pages) * self.page_bytes)
    }

    fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        if offset == self.unreadable_offset.load(Ordering::SeqCst) {
            return Err(io::ErrorKind::InvalidData.into());
        }
        std::thread::sleep(Duration::from_millis(self.delay_milliseconds.load(Ordering::SeqCst)));
        buffer.fill(0);
        Ok(())
    }
}

impl PageSource for Source {
    fn pages(&self) -> u32 {
        self.0.pages
    }
    fn page_bytes(&self) -> usize {
        self.0.page_bytes as usize
    }
    fn kind(&self, _page: u32) -> Kind {
        Kind::Points
    }
    fn offset(&self, page: u32) -> u64 {
        u64::from(page) * self.0.page_bytes
    }
    fn storage(&self) -> Arc<dyn Storage> {
        self.0.clone()
    }
    fn check(&self, _page: u32, _bytes: &[u8]) -> Result<(), String> {
        Ok(())
    }
    fn name(&self) -> String {
        "zeros".into()
    }
}

fn zeros(pages: u32, page_bytes: u64, delay_milliseconds: u64) -> Arc<Zeros> {
    let unreadable_offset = u64::MAX.into();
    Arc::new(Zeros { pages, page_bytes, delay_milliseconds: delay_milliseconds.into(), unreadable_offset })
}

/// A set with room for `room` pages, whose threads have the given patience, and an object whose
/// reads take the given delay.
fn set(
    room: u64,
    patience_milliseconds: u64,
    delay_milliseconds: u64,
) -> (WorkingSet, Arc<PageClient>, Arc<Object>, Arc<Zeros>) {
    let patience = Duration::from_millis(patience_milliseconds);
    let set = WorkingSet::with_patience(Limits::total(room * PAGE), Arc::new(Pool::new(2)), patience);
    let zeros = zeros(64, PAGE, delay_milliseconds);
    let object = set.add(Arc::new(Source(zeros.clone())));
    let client = Arc::new(set.client(&CancelToken::new()));
    (set, client, object, zeros)
}

/// Runs `work` on a thread of its own, which must end in time; returns its result.
fn in_time<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> T {
    let (send, receive) = mpsc::channel();
    std::thread::spawn(move || send.send(work()));
    receive.recv_timeout(Duration::from_secs(20)).expect("a wait that lasts for ever")
}

#[test]
fn a_page_that_is_computed_where_its_own_page_is_the_whole_budget_is_an_error_and_no_hang() {
    let (_set, client, object, _) = set(1, 50, 0);
    let outcome = in_time(move || {
        client.retain_computed(&object, 0, |_| client.retain(&object, 1).map(drop)).map(drop)
    });
    assert!(matches!(outcome, Err(PageFault::Full { .. })), "{outcome:?}");
}

#[test]
fn threads_that_compute_pages_and_wait_for_each_others_room_do_not_wait_for_ever() {
    let (_set, client, object, _) = set(4, 50, 0);
    let threads: Vec<_> = (0..4)
        .map(|thread| {
            let (client, object) = (client.clone(), object.clone());
            std::thread::spawn(move || {
                client
                    .retain_computed(&object, thread, |_| {
                        // Waits until all four have their room.
                        while client.shared.pool.peaks().0 < 4 * PAGE {
                            std::thread::yield_now();
                        }
                        client.retain(&object, 10 + thread).map(drop)
                    })
                    .map(drop)
            })
        })
        .collect();
    let outcomes =
        in_time(move || threads.into_iter().map(|t| t.join().expect("no panic")).collect::<Vec<_>>());
    assert!(outcomes.iter().any(|o| matches!(o, Err(PageFault::Full { .. }))), "{outcomes:?}");
}

#[test]
fn pages_that_are_computed_from_each_other_are_an_error_and_no_hang() {
    let (_set, client, object, _) = set(8, 50, 0);
    let outcome = in_time(move || {
        client
            .retain_computed(&object, 0, |_| {
                client.retain_computed(&object, 0, |_| Ok::<(), PageFault>(())).map(drop)
            })
            .map(drop)
    });
    assert!(matches!(outcome, Err(PageFault::Stuck { page: 0, .. })), "{outcome:?}");
}

#[test]
fn a_page_that_is_computed_for_long_is_waited_for() {
    let (_set, client, object, _) = set(1, 50, 0);
    let begun = Arc::new(std::sync::Barrier::new(2));
    let maker = {
        let (client, object, begun) = (client.clone(), object.clone(), begun.clone());
        std::thread::spawn(move || {
            client
                .retain_computed(&object, 0, |_| {
                    begun.wait();
                    std::thread::sleep(Duration::from_millis(300));
                    Ok::<(), PageFault>(())
                })
                .map(drop)
        })
    };
    begun.wait();
    // One thread waits for the page, another for its room: both wait six times as long as their
    // patience.
    let (of_client, of_object) = (client.clone(), object.clone());
    let same = std::thread::spawn(move || {
        of_client.retain_computed(&of_object, 0, |_| Ok::<(), PageFault>(())).map(drop)
    });
    let outcome = in_time(move || client.retain(&object, 1).map(drop));
    assert!(outcome.is_ok(), "{outcome:?}");
    assert!(same.join().expect("no panic").is_ok());
    assert!(maker.join().expect("no panic").is_ok());
}

#[test]
fn a_slow_read_extends_the_patience_of_those_who_wait_for_its_room() {
    let (_set, client, object, _) = set(1, 60, 400);
    assert_eq!(client.hint(&object, &[0], u64::MAX), 1);
    let outcome = in_time(move || client.retain(&object, 1).map(drop));
    assert!(outcome.is_ok(), "a page on its way can be evicted when it is there: {outcome:?}");
}

#[test]
fn a_panic_while_a_page_is_computed_reaches_the_caller_and_fails_the_page_for_all_who_wait() {
    let (set, client, object, _) = set(4, 10_000, 0);
    let begun = Arc::new(std::sync::Barrier::new(2));
    let waiter = {
        let (client, object, begun) = (client.clone(), object.clone(), begun.clone());
        std::thread::spawn(move || {
            begun.wait();
            client.retain_computed(&object, 7, |_| Ok::<(), PageFault>(())).map(drop)
        })
    };
    let compute = || {
        client
            .retain_computed(&object, 7, |_| -> Result<(), PageFault> {
                begun.wait();
                while set.statistics().total(|k| k.late) == 0 {
                    std::thread::yield_now();
                }
                panic!("a bug in somebody's compute")
            })
            .map(drop)
    };
    let panic = catch_unwind(AssertUnwindSafe(compute)).expect_err("the panic goes on");
    assert_eq!(panic.downcast_ref::<&str>(), Some(&"a bug in somebody's compute"));
    let waited = in_time(move || waiter.join().expect("no panic"));
    assert!(matches!(waited, Err(PageFault::Panicked { page: 7, .. })), "{waited:?}");
    let later = client.retain(&object, 7).map(drop);
    assert!(matches!(later, Err(PageFault::Panicked { page: 7, .. })), "{later:?}");
    // Its room is free again, and the set keeps serving other requests.
    let all: Vec<_> = (0..4).map(|page| client.retain(&object, page).expect("there is room")).collect();
    assert_eq!(all.len(), 4);
}

#[test]
fn a_budget_full_of_retained_pages_is_an_error_that_names_what_is_needed() {
    let (_set, client, object, _) = set(3, 50, 0);
    let held: Vec<_> = (0..3).map(|page| client.retain(&object, page).expect("there is room")).collect();
    let started = Instant::now();
    let Err(fault) = client.retain(&object, 3) else { panic!("there is no room") };
    assert!(started.elapsed() >= Duration::from_millis(50), "it waits for a release first");
    let PageFault::Full { budget, needed } = fault else { panic!("{fault}") };
    assert_eq!((budget, needed), (3 * PAGE, 4 * PAGE), "{fault}");
    drop(held);
    drop(client.retain(&object, 3).expect("released pages give way"));
}

/// How many of 40 hinted pages are accepted if unused ones may take eight pages.
#[test]
fn what_is_lent_counts_as_pages_do_is_a_small_part_and_is_due_where_the_budget_falls() {
    let (set, client, object, _) = set(64, 50, 0);
    let in_memory = |set: &WorkingSet| set.shared.pool.used().iter().sum::<u64>();
    (0..64).for_each(|page| drop(client.retain(&object, page).expect("room")));
    assert_eq!(in_memory(&set), 64 * PAGE);
    // A part in 32: two pages, and no third.
    let loans = [client.lend(PAGE, 32).expect("a loan"), client.lend(PAGE, 32).expect("another")];
    assert_eq!(in_memory(&set), 62 * PAGE, "pages make room for what is lent");
    assert!(client.lend(1, 32).is_none());
    // Of another part there is as much as if nothing were lent.
    assert!(client.lend(8 * PAGE, 8).is_some() && client.lend(8 * PAGE + 1, 8).is_none());
    (0..64).for_each(|page| drop(client.retain(&object, page).expect("room")));
    assert_eq!(in_memory(&set), 62 * PAGE);
    // What is given back is room for pages, and may be lent again.
    let [first, second] = loans;
    drop(first);
    (0..64).for_each(|page| drop(client.retain(&object, page).expect("room")));
    assert_eq!(in_memory(&set), 63 * PAGE);
    // A budget that falls a little leaves a loan; one that it is no small part of does not.
    set.set_limits(Limits::total(32 * PAGE));
    assert!(!second.is_due());
    assert_eq!(in_memory(&set), 31 * PAGE);
    set.set_limits(Limits::total(31 * PAGE));
    assert!(second.is_due());
    drop(second);
    set.set_limits(Limits::total(64 * PAGE));
    assert!(client.lend(2 * PAGE, 32).is_some() && client.lend(2 * PAGE + 1, 32).is_none());
    // Retained pages make no room.
    let mut retained: Vec<_> = (0..64).map(|page| client.retain(&object, page).expect("room")).collect();
    assert!(client.lend(PAGE, 32).is_none());
    retained.pop();
    assert!(client.lend(PAGE, 32).is_some());
}

/// Pages that are computed.
struct Computed(Source);

impl PageSource for Computed {
    fn pages(&self) -> u32 {
        self.0.pages()
    }
    fn page_bytes(&self) -> usize {
        self.0.page_bytes()
    }
    fn kind(&self, _page: u32) -> Kind {
        Kind::Shadows
    }
    fn offset(&self, _page: u32) -> u64 {
        0
    }
    fn storage(&self) -> Arc<dyn Storage> {
        self.0.storage()
    }
    fn check(&self, _page: u32, _bytes: &[u8]) -> Result<(), String> {
        Ok(())
    }
    fn name(&self) -> String {
        "computed".into()
    }
}

/// With few pages, and with many, of which the oldest are found in another way.
#[test]
fn pages_that_are_computed_stay_while_others_are_read_once() {
    for room in [64_u64, 150] {
        let (set, client, _, _) = set(room, 10_000, 0);
        let read = set.add(Arc::new(Source(zeros(1 << 16, PAGE, 0))));
        let made = set.add(Arc::new(Computed(Source(zeros(8, PAGE, 0)))));
        let mut left = 0..read.pages();
        let mut read_some = |count: u64| {
            for page in left.by_ref().take(count as usize) {
                drop(client.retain(&read, page).expect("room"));
            }
            (0..8).filter(|&page| made.is_resident(page)).count()
        };
        for page in 0..8 {
            let fill = |_: &mut [u8]| Ok::<(), PageFault>(());
            drop(client.retain_computed(&made, page, fill).expect("room"));
        }
        assert_eq!(read_some(64 * room), 8, "{room}");
        // But not for ever.
        assert_eq!(read_some(256 * room), 0, "{room}");
    }
}

/// Rays come last to what was used last.
#[test]
fn of_pages_that_stay_the_one_goes_that_was_used_last() {
    let (_set, client, object, _) = set(8, 10_000, 0);
    let reuse = RefCell::new(Reuse::default());
    assert_eq!(client.hint_to_stay(&object, &(0..8).collect::<Vec<_>>(), &reuse), 8);
    until_resident(&object, 0..8);
    (0..8).for_each(|page| drop(client.retain(&object, page).expect("room")));
    drop(client.retain(&object, 20).expect("room"));
    assert!(object.is_resident(0) && !object.is_resident(7));
}

fn hints_taken(client: &PageClient, object: &Arc<Object>) -> usize {
    client.hint(object, &(20..60).collect::<Vec<_>>(), 8 * PAGE)
}

fn until_resident(object: &Object, pages: std::ops::Range<u32>) {
    let started = Instant::now();
    while !pages.clone().all(|page| object.is_resident(page)) {
        assert!(started.elapsed() < Duration::from_secs(20), "reads that do not end");
        std::thread::yield_now();
    }
}

#[test]
fn hints_that_are_forgotten_retired_or_evicted_no_longer_count_as_unused() {
    type Settle = fn(&WorkingSet, &PageClient, &Arc<Object>);
    let ways: [(&str, Settle, usize); 5] = [
        ("kept", |_, _, _| {}, 3),
        ("forgotten", |_, client, _| client.forget_hints(), 8),
        ("retired", |_, client, object| client.retire(object, &[0, 1, 2, 3, 4]), 8),
        ("retired, unused", |_, client, object| client.retire_unused(object, &[0, 1, 2, 3, 4]), 8),
        ("evicted", |set, _, _| set.clear(), 8),
    ];
    for (name, settle, expected) in ways {
        let (set, client, object, _) = set(64, 10_000, 0);
        assert_eq!(client.hint(&object, &[0, 1, 2, 3, 4], 8 * PAGE), 5);
        until_resident(&object, 0..5);
        settle(&set, &client, &object);
        assert_eq!(hints_taken(&client, &object), expected, "{name}");
    }
}

#[test]
fn hints_that_are_forgotten_while_they_are_read_no_longer_count_as_unused() {
    let (_set, client, object, zeros) = set(64, 10_000, 150);
    assert_eq!(client.hint(&object, &[0, 1, 2, 3, 4], 8 * PAGE), 5);
    client.forget_hints();
    zeros.delay_milliseconds.store(0, Ordering::SeqCst);
    until_resident(&object, 0..5);
    assert_eq!(hints_taken(&client, &object), 8);
}

/// A billion points are some 200 000 pages; what the set stores for them must be small compared to
/// any budget.
#[test]
fn a_page_takes_at_most_32_bytes_outside_the_budget() {
    assert!(WorkingSet::overhead_bytes(1) <= 32, "{} bytes", WorkingSet::overhead_bytes(1));
    assert_eq!(WorkingSet::overhead_bytes(200_000), 200_000 * WorkingSet::overhead_bytes(1));
    let object = Object::new(Arc::new(Source(zeros(1000, PAGE, 0))), Arc::default());
    assert!(object.bytes_kept() <= WorkingSet::overhead_bytes(1000) as usize + 64, "{}", object.bytes_kept());
}

#[test]
fn pages_of_every_size_have_memory_of_their_own_size() {
    let (set, client, small, _) = set(4, 10_000, 0);
    let large = set.add(Arc::new(Source(zeros(64, 2 * PAGE, 0))));
    for round in 0..8 {
        // Two small pages give way to a large one, and a large one to two small ones.
        for page in 4 * round..4 * round + 4 {
            assert_eq!(client.retain(&small, page).expect("a page").len() as u64, PAGE);
        }
        for page in 2 * round..2 * round + 2 {
            assert_eq!(client.retain(&large, page).expect("a page").len() as u64, 2 * PAGE);
        }
    }
    assert!(set.statistics().peak_bytes <= 4 * PAGE);
}

/// Retired pages are evicted by another way than the queue of pages by age.
#[test]
fn what_is_kept_of_pages_that_have_gone_does_not_grow_with_their_number() {
    let (_set, client, object, _) = set(4, 10_000, 0);
    for round in 0..40 {
        for page in 0..64 {
            drop(client.retain(&object, page).expect("a page"));
            if (page + round) % 5 > 0 {
                client.retire(&object, &[page]);
            }
        }
    }
    let entries = client.shared.pool.entries();
    assert!(entries <= 2 * (2 * 4 + 65), "{entries} entries of 4 pages");
}

/// All pages have been used since they were loaded, the first of them last.
#[test]
fn of_many_pages_that_are_all_younger_than_they_seem_an_old_one_goes() {
    let pages = 300;
    let (set, client, _, _) = set(u64::from(pages), 10_000, 0);
    let object = set.add(Arc::new(Source(zeros(pages + 1, PAGE, 0))));
    (0..pages).for_each(|page| drop(client.retain(&object, page).expect("a page")));
    (0..pages).rev().for_each(|page| drop(client.retain(&object, page).expect("a page")));
    drop(client.retain(&object, pages).expect("a page"));
    let gone: Vec<u32> = (0..pages).filter(|&page| !object.is_resident(page)).collect();
    assert!(gone.len() == 1 && gone[0] >= 32, "{gone:?}, which was used as one of the last");
}

#[test]
fn pages_that_were_there_when_they_were_hinted_at_never_count_as_read_for_a_hint() {
    let (_set, client, object, _) = set(64, 10_000, 0);
    (0..5).for_each(|page| drop(client.retain(&object, page).expect("a page")));
    assert_eq!(client.hint(&object, &[0, 1, 2, 3, 4], 8 * PAGE), 5);
    (0..5).for_each(|page| drop(client.retain(&object, page).expect("a page")));
    assert_eq!(hints_taken(&client, &object), 8);
    for mark in [HintMark::None, HintMark::Kept(1), HintMark::Read(1), HintMark::Kept(7), HintMark::Requested]
    {
        assert_eq!(HintMark::of(mark.word()), mark);
    }
}

/// A page that was read for a request has been used once, when it came: nobody used it a second
/// time.
#[test]
fn pages_that_were_used_once_go_in_the_order_in_which_they_came() {
    let pages = 300;
    let (set, client, _, _) = set(u64::from(pages), 10_000, 0);
    let object = set.add(Arc::new(Source(zeros(2 * pages, PAGE, 0))));
    for page in 0..2 * pages {
        drop(client.retain(&object, page).expect("a page"));
        let first = (page + 1).saturating_sub(pages);
        assert!(first == 0 || !object.is_resident(first - 1), "page {} outlived its turn", first - 1);
        assert!(object.is_resident(first), "page {first} went too early");
    }
}

/// A page that could not be read is not on its way any more.
#[test]
fn after_a_read_that_failed_nobody_waits_for_it() {
    let (_set, client, object, zeros) = set(2, 50, 0);
    zeros.unreadable_offset.store(5 * PAGE, Ordering::SeqCst);
    assert!(matches!(client.retain(&object, 5).map(drop), Err(PageFault::Read { page: 5, .. })));
    let held: Vec<_> = (0..2).map(|page| client.retain(&object, page).expect("there is room")).collect();
    let outcome = in_time({
        let (client, object) = (client.clone(), object.clone());
        move || client.retain(&object, 2).map(drop)
    });
    assert!(matches!(outcome, Err(PageFault::Full { .. })), "{outcome:?}");
    drop(held);
}

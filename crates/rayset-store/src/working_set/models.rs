//! Models of the page pool: every test runs a few threads under a scheduler that tries one order of
//! their steps after another (`shuttle`), and fails if any order breaks a promise or leaves all
//! threads waiting.
//!
//! `cargo test -p rayset --features model --lib models`. There is no time in a model: a wait only
//! ends by a notification, so that a lost notification shows as a deadlock. A patience of zero
//! stands for one that has run out.

use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Duration;

use shuttle::thread;

use super::read::{Read, Storage};
use super::*;
use rayset_base::sync::atomic::{AtomicBool, AtomicUsize};
use rayset_base::sync::{Mutex, lock};

const PAGE: usize = 512;
/// Number of orders tried for each model.
const ORDERS: usize = 4000;
const RUN_OUT: Duration = Duration::ZERO;
const ENDLESS: Duration = Duration::from_secs(3600);

/// Pages that hold their own number. One cannot be read, one is damaged, and the check of one
/// panics.
struct Numbers {
    /// Number of reads in flight, page by page.
    in_flight: Vec<AtomicUsize>,
}

const UNREADABLE: u32 = 13;
const DAMAGED: u32 = 14;
const PANICS: u32 = 15;

impl Storage for Numbers {
    fn length(&self) -> io::Result<u64> {
        Ok((self.in_flight.len() * PAGE) as u64)
    }

    fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        let page = offset as usize / PAGE;
        assert_eq!(
            self.in_flight[page].fetch_add(1, Ordering::SeqCst),
            0,
            "page {page} is read twice at a time"
        );
        thread::yield_now();
        buffer.fill(page as u8);
        self.in_flight[page].fetch_sub(1, Ordering::SeqCst);
        if page == UNREADABLE as usize { Err(io::Error::other("unreadable")) } else { Ok(()) }
    }
}

struct Source(Arc<Numbers>);

impl PageSource for Source {
    fn pages(&self) -> u32 {
        16
    }
    fn page_bytes(&self) -> usize {
        PAGE
    }
    fn kind(&self, page: u32) -> Kind {
        if page >= 8 { Kind::Shadows } else { Kind::Points }
    }
    fn offset(&self, page: u32) -> u64 {
        u64::from(page) * PAGE as u64
    }
    fn storage(&self) -> Arc<dyn Storage> {
        self.0.clone()
    }
    fn check(&self, page: u32, bytes: &[u8]) -> Result<(), String> {
        assert!(page != PANICS, "a check that panics");
        if page == DAMAGED || bytes.iter().any(|&b| b != page as u8) { Err("damaged".into()) } else { Ok(()) }
    }
    fn name(&self) -> String {
        "numbers".into()
    }
}

/// A backend with a thread for each read, or with reads that are held back until they are let go.
#[derive(Default)]
struct Backend {
    held: AtomicBool,
    waiting: Mutex<Vec<Read>>,
}

impl Transport for Backend {
    fn submit(&self, batch: Vec<Read>) {
        for read in batch {
            if self.held.load(Ordering::SeqCst) {
                lock(&self.waiting).push(read);
            } else {
                thread::spawn(move || read.run());
            }
        }
    }

    fn name(&self) -> String {
        "model".into()
    }
}

impl Backend {
    fn let_go(&self) {
        self.held.store(false, Ordering::SeqCst);
        let reads = std::mem::take(&mut *lock(&self.waiting));
        reads.into_iter().for_each(Read::run);
    }
}

/// A set with room for `room` pages.
fn set(room: usize, patience: Duration) -> (WorkingSet, Arc<Object>, Arc<Backend>) {
    let backend = Arc::new(Backend::default());
    let limits = Limits::total((room * PAGE) as u64);
    let set = WorkingSet::with_patience(limits, backend.clone(), patience);
    let numbers = Numbers { in_flight: (0..16).map(|_| AtomicUsize::new(0)).collect() };
    let object = set.add(Arc::new(Source(Arc::new(numbers))));
    (set, object, backend)
}

/// Tries many orders of the steps of a model.
fn model(run: impl Fn() + Send + Sync + 'static) {
    shuttle::check_random(run, ORDERS);
}

/// Runs threads, each with a client of its own, and waits for them all.
fn threads(
    set: &WorkingSet,
    object: &Arc<Object>,
    work: Vec<Box<dyn FnOnce(&PageClient, &Arc<Object>) + Send>>,
) {
    let threads: Vec<_> = work
        .into_iter()
        .map(|work| {
            let (client, object) = (set.client(&CancelToken::new()), object.clone());
            thread::spawn(move || work(&client, &object))
        })
        .collect();
    threads.into_iter().for_each(|thread| thread.join().expect("no panic"));
}

/// Retains a page, checks its bytes, and releases it.
fn look(client: &PageClient, object: &Arc<Object>, page: u32) {
    let guard = client.retain(object, page).expect("a page");
    assert!(guard.iter().all(|&b| b == page as u8), "another page's bytes");
    thread::yield_now();
    assert!(guard.iter().all(|&b| b == page as u8), "evicted while it was retained");
}

/// Checks that nothing is left behind: nothing is retained, every page can be retained again, and
/// the whole budget can be released.
fn check_end(set: &WorkingSet, object: &Arc<Object>) {
    assert_eq!(set.retained_bytes(), 0);
    assert!(set.statistics().peak_bytes <= set.budget_bytes());
    let client = set.client(&CancelToken::new());
    look(&client, object, 0);
    look(&client, object, 1);
    set.clear();
    assert!((0..16).all(|page| !object.is_resident(page)));
    set.reset_statistics();
    assert_eq!(set.statistics().peak_bytes, 0, "room that nobody has any more");
}

#[test]
fn pages_are_read_once_evicted_and_never_seen_with_anothers_bytes() {
    model(|| {
        let (set, object, _) = set(2, ENDLESS);
        threads(
            &set,
            &object,
            vec![
                Box::new(|client, object| [0, 1, 0].into_iter().for_each(|page| look(client, object, page))),
                Box::new(|client, object| [1, 2].into_iter().for_each(|page| look(client, object, page))),
                Box::new(|client, object| look(client, object, 0)),
            ],
        );
        check_end(&set, &object);
    });
}

#[test]
fn whoever_waits_for_room_is_woken_by_a_release() {
    model(|| {
        let (set, object, _) = set(1, ENDLESS);
        threads(
            &set,
            &object,
            (0..3)
                .map(|page| Box::new(move |client: &_, object: &_| look(client, object, page)) as Box<_>)
                .collect(),
        );
        check_end(&set, &object);
    });
}

#[test]
fn a_hint_that_finds_no_room_leaves_its_page_to_whoever_waits_for_it() {
    model(|| {
        let (set, object, _) = set(1, ENDLESS);
        threads(
            &set,
            &object,
            vec![
                Box::new(|client, object| look(client, object, 0)),
                Box::new(|client, object| {
                    client.hint(object, &[1], u64::MAX);
                }),
                Box::new(|client, object| look(client, object, 1)),
            ],
        );
        check_end(&set, &object);
    });
}

#[test]
fn a_page_that_fails_fails_for_all_who_wait_and_its_room_is_free() {
    for page in [UNREADABLE, DAMAGED, PANICS] {
        model(move || {
            let (set, object, _) = set(1, ENDLESS);
            let fails = move |client: &PageClient, object: &Arc<Object>| {
                assert!(client.retain(object, page).is_err(), "page {page}");
            };
            threads(
                &set,
                &object,
                vec![
                    Box::new(fails),
                    Box::new(fails),
                    Box::new(|client, object| look(client, object, 0)),
                    Box::new(move |client, object| {
                        client.hint(object, &[page, 1], u64::MAX);
                    }),
                ],
            );
            check_end(&set, &object);
        });
    }
}

#[test]
fn a_page_whose_making_panics_fails_for_all_who_wait() {
    model(|| {
        let (set, object, _) = set(2, ENDLESS);
        let made = Arc::new(AtomicUsize::new(0));
        let of_thread = || {
            let made = made.clone();
            Box::new(move |client: &PageClient, object: &Arc<Object>| {
                let compute = |_: &mut [u8]| -> Result<(), PageFault> {
                    made.fetch_add(1, Ordering::SeqCst);
                    std::panic::resume_unwind(Box::new("a bug in somebody's compute"))
                };
                match catch_unwind(AssertUnwindSafe(|| client.retain_computed(object, 9, compute).map(drop)))
                {
                    Err(_) => {}
                    Ok(outcome) => assert!(matches!(outcome, Err(PageFault::Panicked { .. })), "{outcome:?}"),
                }
            }) as Box<dyn FnOnce(&PageClient, &Arc<Object>) + Send>
        };
        threads(&set, &object, vec![of_thread(), of_thread(), of_thread()]);
        assert_eq!(made.load(Ordering::SeqCst), 1, "it was made again");
        check_end(&set, &object);
    });
}

#[test]
fn a_page_whose_making_fails_is_made_by_the_next_who_wants_it() {
    model(|| {
        let (set, object, _) = set(2, ENDLESS);
        let failures = Arc::new(AtomicUsize::new(1));
        let of_thread = || {
            let failures = failures.clone();
            Box::new(move |client: &PageClient, object: &Arc<Object>| {
                let compute = |bytes: &mut [u8]| {
                    bytes.fill(9);
                    if failures.swap(0, Ordering::SeqCst) > 0 { Err(PageFault::Cancelled) } else { Ok(()) }
                };
                if let Ok(guard) = client.retain_computed(object, 9, compute) {
                    assert!(guard.iter().all(|&b| b == 9));
                }
            }) as Box<dyn FnOnce(&PageClient, &Arc<Object>) + Send>
        };
        threads(&set, &object, vec![of_thread(), of_thread(), of_thread()]);
        assert_eq!(set.statistics().kind(Kind::Shadows).computed, 1);
        check_end(&set, &object);
    });
}

#[test]
fn threads_that_make_pages_and_wait_for_each_others_room_do_not_wait_for_ever() {
    model(|| {
        let (set, object, _) = set(2, RUN_OUT);
        let of_thread = |own: u32, other: u32| {
            Box::new(move |client: &PageClient, object: &Arc<Object>| {
                // An error if both have taken all the room; a page if one was first.
                let outcome = client.retain_computed(object, own, |bytes| {
                    bytes.fill(own as u8);
                    client.retain(object, other).map(drop)
                });
                let outcome = outcome.map(drop);
                assert!(matches!(outcome, Ok(()) | Err(PageFault::Full { .. })), "{outcome:?}");
            }) as Box<dyn FnOnce(&PageClient, &Arc<Object>) + Send>
        };
        threads(&set, &object, vec![of_thread(8, 0), of_thread(9, 1)]);
        check_end(&set, &object);
    });
}

#[test]
fn pages_that_are_made_of_each_other_are_an_error_and_no_wait_for_ever() {
    model(|| {
        let (set, object, _) = set(4, RUN_OUT);
        let of_thread = |own: u32, other: u32| {
            Box::new(move |client: &PageClient, object: &Arc<Object>| {
                let fill = |bytes: &mut [u8]| {
                    bytes.fill(0);
                    Ok::<(), PageFault>(())
                };
                let outcome = client.retain_computed(object, own, |bytes| {
                    bytes.fill(own as u8);
                    client.retain_computed(object, other, fill).map(drop)
                });
                let outcome = outcome.map(drop);
                assert!(matches!(outcome, Ok(()) | Err(PageFault::Stuck { .. })), "{outcome:?}");
            }) as Box<dyn FnOnce(&PageClient, &Arc<Object>) + Send>
        };
        threads(&set, &object, vec![of_thread(8, 9), of_thread(9, 8)]);
        check_end(&set, &object);
    });
}

#[test]
fn a_cancelled_client_stops_waiting_whatever_becomes_of_its_page() {
    model(|| {
        let (set, object, backend) = set(1, ENDLESS);
        backend.held.store(true, Ordering::SeqCst);
        let cancel = CancelToken::new();
        // One waits for its read, the others for that page or for room; none of them arrives.
        let waiting: Vec<_> = [0, 0, 1]
            .into_iter()
            .map(|page| {
                let (client, object) = (set.client(&cancel), object.clone());
                thread::spawn(move || match client.retain(&object, page) {
                    Err(PageFault::Cancelled) => {}
                    other => panic!("{:?}", other.map(drop)),
                })
            })
            .collect();
        let canceller = {
            let cancel = cancel.clone();
            thread::spawn(move || cancel.cancel())
        };
        waiting.into_iter().chain([canceller]).for_each(|thread| thread.join().expect("no panic"));
        // The reads end after them, and the set keeps working.
        backend.let_go();
        check_end(&set, &object);
    });
}

#[test]
fn hints_retirements_and_forgetting_leave_every_count_at_zero() {
    model(|| {
        let (set, object, _) = set(3, ENDLESS);
        let hinting = set.client(&CancelToken::new());
        let threads: Vec<_> = [
            Box::new({
                let object = object.clone();
                move || {
                    hinting.hint(&object, &[0, 1, 2, 3], 3 * PAGE as u64);
                    hinting.retire(&object, &[0, 1]);
                    hinting.forget_hints();
                    hinting.hint(&object, &[2, 3], 2 * PAGE as u64);
                    hinting.retire_unused(&object, &[2]);
                }
            }) as Box<dyn FnOnce() + Send>,
            Box::new({
                let (client, object) = (set.client(&CancelToken::new()), object.clone());
                move || [1, 2].into_iter().for_each(|page| look(&client, &object, page))
            }),
            Box::new({
                let (set, object) = (set.clone(), object.clone());
                move || set.forget(&object)
            }),
        ]
        .map(thread::spawn)
        .into();
        threads.into_iter().for_each(|thread| thread.join().expect("no panic"));
        // As many hints as before are accepted again, once those that are still being read are
        // resident.
        let client = set.client(&CancelToken::new());
        [0, 1, 2, 3].into_iter().for_each(|page| look(&client, &object, page));
        set.clear();
        assert_eq!(client.hint(&object, &[4, 5, 6], 3 * PAGE as u64), 3);
        [4, 5, 6].into_iter().for_each(|page| look(&client, &object, page));
        drop(client);
        check_end(&set, &object);
    });
}

#[test]
fn limits_may_change_while_pages_come_and_go() {
    model(|| {
        let (set, object, _) = set(3, ENDLESS);
        let changing = set.clone();
        threads(
            &set,
            &object,
            vec![
                Box::new(|client, object| [0, 1].into_iter().for_each(|page| look(client, object, page))),
                Box::new(|client, object| [2, 0].into_iter().for_each(|page| look(client, object, page))),
                Box::new(move |_, _| changing.set_limits(Limits::total(PAGE as u64))),
            ],
        );
        set.set_limits(Limits::total(3 * PAGE as u64));
        check_end(&set, &object);
    });
}

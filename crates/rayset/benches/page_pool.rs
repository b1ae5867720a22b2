//! What a request for a page costs, by the number of pages and of threads:
//! `cargo bench -p rayset --bench page_pool`.
//!
//! Pages are small and their reads cost nothing, so that what is measured is the pool itself.
//! `hits`: all pages fit. `half`: half of them do. `walk`: requests are for 32 neighbours at a
//! time, as those of a tile are; `random`: for any page, which costs what the processor's caches do
//! not hold. With `RAYSET_POOL_ONCE=PAGES,FIT,NEIGHBOURS,REQUESTS` it makes so many requests once,
//! for counting instructions (`valgrind --tool=callgrind`).

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group};
use rayset::cancel::CancelToken;
use rayset::storage::Storage;
use rayset::working_set::read::{Read, Transport};
use rayset::working_set::{Kind, Limits, Object, PageSource, WorkingSet};

const PAGE: usize = 512;

struct Pages(u32);

impl Storage for Pages {
    fn length(&self) -> io::Result<u64> {
        Ok(u64::from(self.0) * PAGE as u64)
    }

    fn read_exact_at(&self, buffer: &mut [u8], _offset: u64) -> io::Result<()> {
        buffer[0] = 1;
        Ok(())
    }
}

impl PageSource for Pages {
    fn pages(&self) -> u32 {
        self.0
    }
    fn page_bytes(&self) -> usize {
        PAGE
    }
    fn kind(&self, page: u32) -> Kind {
        if page.is_multiple_of(16) { Kind::Octree } else { Kind::Points }
    }
    fn offset(&self, page: u32) -> u64 {
        u64::from(page) * PAGE as u64
    }
    fn storage(&self) -> Arc<dyn Storage> {
        Arc::new(Self(self.0))
    }
    fn check(&self, _page: u32, _bytes: &[u8]) -> Result<(), String> {
        Ok(())
    }
    fn name(&self) -> String {
        "pages".into()
    }
}

/// Reads on the thread that asks.
struct AtOnce;

impl Transport for AtOnce {
    fn submit(&self, batch: Vec<Read>) {
        batch.into_iter().for_each(Read::run);
    }
    fn name(&self) -> String {
        "at once".into()
    }
}

/// A set of which `fit` of `pages` pages fit, with as many of them in memory.
fn set(pages: u32, fit: u32) -> (WorkingSet, Arc<Object>) {
    let set = WorkingSet::new(Limits::total(u64::from(fit) * PAGE as u64), Arc::new(AtOnce));
    let object = set.add(Arc::new(Pages(pages)));
    let client = set.client(&CancelToken::new());
    (0..pages).for_each(|page| drop(client.retain(&object, page).expect("a page")));
    (set, object)
}

/// Makes requests for pages: at random among so many neighbours (a power of two), for four times as
/// long as there are of them, and then elsewhere. All pages are their neighbours where there are
/// more than pages.
fn requests(set: &WorkingSet, object: &Arc<Object>, pages: u32, neighbours: u32, count: u64, seed: u64) {
    let client = set.client(&CancelToken::new());
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut place = 0;
    for number in 0..count {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        let anywhere = (((state >> 32) * u64::from(pages)) >> 32) as u32;
        if number % (4 * u64::from(neighbours)) == 0 {
            place = anywhere;
        }
        let near = (place + (state as u32 & (neighbours - 1))) % pages;
        let page = if neighbours > pages { anywhere } else { near };
        drop(client.retain(object, page).expect("a page"));
    }
}

/// No two sequences of requests begin alike: of one that is repeated all pages would soon be in
/// memory.
static SEED: AtomicU64 = AtomicU64::new(1);

/// The time of `count` requests, divided among threads.
fn time(
    set: &WorkingSet,
    object: &Arc<Object>,
    (pages, neighbours): (u32, u32),
    threads: u64,
    count: u64,
) -> Duration {
    let started = Instant::now();
    std::thread::scope(|scope| {
        for _ in 0..threads {
            let seed = SEED.fetch_add(1, Ordering::Relaxed);
            scope.spawn(move || requests(set, object, pages, neighbours, count.div_ceil(threads), seed));
        }
    });
    started.elapsed()
}

/// Every page is a neighbour.
const ANYWHERE: u32 = 1 << 30;

fn pool(criterion: &mut Criterion) {
    for (name, part, neighbours) in [
        ("walk, hits", 1, 32),
        ("walk, half", 2, 32),
        ("random, hits", 1, ANYWHERE),
        ("random, half", 2, ANYWHERE),
    ] {
        let mut group = criterion.benchmark_group(name);
        group.throughput(Throughput::Elements(1)).measurement_time(Duration::from_secs(3));
        for threads in [1, 2, 16] {
            for pages in [1000, 200_000] {
                let (set, object) = set(pages, pages / part);
                group.bench_function(BenchmarkId::new(format!("{threads} threads"), pages), |bencher| {
                    bencher.iter_custom(|count| time(&set, &object, (pages, neighbours), threads, count));
                });
            }
        }
    }
}

criterion_group!(benches, pool);

#[expect(clippy::print_stdout, reason = "what it counts is its output")]
fn main() {
    if let Ok(once) = std::env::var("RAYSET_POOL_ONCE") {
        let numbers: Vec<u32> = once.split(',').map(|n| n.parse().expect("a number")).collect();
        let [pages, fit, neighbours, count] = numbers[..] else { panic!("four numbers") };
        let (set, object) = set(pages, fit);
        set.reset_statistics();
        requests(&set, &object, pages, neighbours, count.into(), 1);
        let statistics = set.statistics();
        println!("{} misses", statistics.total(|kind| kind.misses));
        return;
    }
    benches();
    Criterion::default().configure_from_args().final_summary();
}

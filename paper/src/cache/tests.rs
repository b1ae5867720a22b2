use std::io::Write as _;

use proptest::prelude::*;

use super::*;
use crate::simulated::{Clock, SimulatedDisk};

const WIDTH: usize = 16;
const RECORDS: u64 = 96;

fn record_bytes(record: u64) -> Vec<u8> {
    (0..WIDTH as u64).map(|i| (record * 31 + i * 7 + record / 8) as u8).collect()
}

fn disk() -> SimulatedDisk {
    let mut file = tempfile::NamedTempFile::new().expect("a file");
    (0..RECORDS).for_each(|record| file.write_all(&record_bytes(record)).expect("a write"));
    SimulatedDisk::open(&[file.path().to_owned()], Clock::default()).expect("it opens")
}

fn use_once(cache: &mut RecordCache, disk: &mut SimulatedDisk, record: u64, priority: u8) {
    let slot = cache.retain(disk, record, priority).expect("a record");
    cache.release(slot);
}

#[test]
fn the_least_priority_goes_first_and_among_equals_what_was_used_longest_ago() {
    let (mut disk, mut cache) = (disk(), RecordCache::new(0, WIDTH, 1, 3));
    for (record, priority) in [(0, 200), (1, 100), (2, 200)] {
        use_once(&mut cache, &mut disk, record, priority);
    }
    let known = |cache: &RecordCache| (0..6).filter(|&record| cache.is_known(record)).collect::<Vec<_>>();
    use_once(&mut cache, &mut disk, 3, 200);
    assert_eq!(known(&cache), [0, 2, 3], "half of 100 is the least");
    use_once(&mut cache, &mut disk, 4, 200);
    assert_eq!(known(&cache), [2, 3, 4], "used longest ago");
    cache.prefetch(&mut disk, &[5], 99, 16).expect("a prefetch");
    assert_eq!(known(&cache), [2, 3, 4], "nothing goes for what matters less");
    let held = [2, 3, 4].map(|record| cache.retain(&mut disk, record, 1).expect("it is there"));
    assert!(matches!(cache.retain(&mut disk, 5, 255), Err(CacheError::Full { records: 3 })));
    held.into_iter().for_each(|slot| cache.release(slot));
    use_once(&mut cache, &mut disk, 5, 1);
    assert_eq!(known(&cache), [3, 4, 5]);
}

#[test]
fn records_that_stand_together_come_with_one_read() {
    let (mut disk, mut cache) = (disk(), RecordCache::new(0, WIDTH, 8, 16));
    use_once(&mut cache, &mut disk, 13, 9);
    assert!((8..16).all(|record| cache.is_known(record)));
    (8..16).for_each(|record| use_once(&mut cache, &mut disk, record, 9));
    let CacheCounts { reads, bytes, misses, hits, prefetched, prefetched_used, .. } = cache.counts();
    assert_eq!((reads, bytes, misses, hits), (1, 8 * WIDTH as u64, 1, 8));
    assert_eq!((prefetched, prefetched_used), (7, 7));
}

#[test]
fn a_record_beyond_the_end_is_an_error() {
    let (mut disk, mut cache) = (disk(), RecordCache::new(0, WIDTH, 8, 16));
    for record in [RECORDS, u64::MAX] {
        assert!(matches!(cache.retain(&mut disk, record, 9), Err(CacheError::Beyond { .. })));
    }
}

#[derive(Clone, Debug)]
enum Step {
    Retain(u64, u8),
    Release(usize),
    Prefetch(Vec<u64>, u8),
    Resize(usize),
}

fn step() -> impl Strategy<Value = Step> {
    let record = 0..RECORDS;
    prop_oneof![
        4 => (record.clone(), any::<u8>()).prop_map(|(record, priority)| Step::Retain(record, priority)),
        3 => any::<usize>().prop_map(Step::Release),
        2 => (prop::collection::vec(record, 1..6), any::<u8>()).prop_map(|(r, p)| Step::Prefetch(r, p)),
        1 => (1..40_usize).prop_map(Step::Resize),
    ]
}

proptest! {
    #[test]
    fn what_is_held_stays_as_it_is_whatever_else_happens_and_what_is_not_fits_the_limit(
        group in prop::sample::select(vec![1_u64, 3, 8]),
        steps in prop::collection::vec(step(), 1..120),
    ) {
        let (mut disk, mut cache) = (disk(), RecordCache::new(0, WIDTH, group, 12));
        let mut held: Vec<(u64, Slot)> = Vec::new();
        for step in steps {
            match step {
                Step::Retain(record, priority) => match cache.retain(&mut disk, record, priority) {
                    Ok(slot) => held.push((record, slot)),
                    Err(CacheError::Full { records }) => {
                        let mut distinct: Vec<u64> = held.iter().map(|(record, _)| *record).collect();
                        distinct.sort_unstable();
                        distinct.dedup();
                        prop_assert!(distinct.len() >= records, "{} of {records} are held", distinct.len());
                    }
                    Err(other) => return Err(TestCaseError::fail(other.to_string())),
                },
                Step::Release(which) if !held.is_empty() => {
                    let (_, slot) = held.swap_remove(which % held.len());
                    cache.release(slot);
                }
                Step::Release(_) => {}
                Step::Prefetch(records, priority) => {
                    cache.prefetch(&mut disk, &records, priority, 4).expect("a prefetch");
                }
                Step::Resize(capacity) => cache.set_capacity(capacity),
            }
            for &(record, slot) in &held {
                prop_assert_eq!(cache.bytes(slot), record_bytes(record));
            }
        }
        held.drain(..).for_each(|(_, slot)| cache.release(slot));
        (0..RECORDS).for_each(|record| use_once(&mut cache, &mut disk, record, 255));
        prop_assert!(cache.resident() <= cache.capacity(), "{} of {}", cache.resident(), cache.capacity());
    }
}

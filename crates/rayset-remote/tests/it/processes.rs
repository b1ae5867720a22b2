//! One folder of the cache, used by several processes at a time, of which some are killed.

use std::fs::File;
use std::path::Path;
use std::time::{Duration, Instant};

use xxhash_rust::xxh3::xxh3_64;

use crate::child::{Child, files, heard};
use crate::common::{Random, server};

/// Most bytes of the folder: the least that it may have.
const MOST: u64 = 16 << 20;
/// Objects and their bytes: together more than twice what may be kept.
const OBJECTS: [&str; 4] = ["a", "b", "c", "d"];
const OBJECT_BYTES: usize = 9 << 20;

/// What all files of the folder take on disk, those that are unfinished too, while nobody writes;
/// and what the folder says of it.
fn size(folder: &Path) -> Option<(u64, u64)> {
    let own = folder.join("rayset-remote-1");
    let lock = File::options().read(true).write(true).open(own.join("bytes")).ok()?;
    lock.lock().expect("a lock");
    let said = std::fs::read_to_string(own.join("bytes")).expect("the sum");
    let kept = files(&own).into_iter().filter(|path| path.file_name().is_some_and(|name| name != "bytes"));
    let bytes = kept.map(|path| path.metadata().expect("a file").len().next_multiple_of(4096)).sum();
    Some((bytes, said.trim().parse().unwrap_or(0)))
}

#[test]
fn the_folder_of_the_cache_never_exceeds_its_size_whoever_uses_it_and_is_killed() {
    let server = server();
    let mut random = Random(3);
    let contents = OBJECTS.map(|name| {
        let content: Vec<u8> = (0..OBJECT_BYTES / 8).flat_map(|_| random.unit().to_le_bytes()).collect();
        server.put(name, content.clone());
        (server.address_of(name), format!("{:016x}", xxh3_64(&content)))
    });
    let folder = tempfile::tempdir().expect("a folder");
    let reader = |object: usize| {
        Child::new(&["read", &contents[object % OBJECTS.len()].0]).keeping(folder.path(), MOST)
    };
    let largest = std::cell::Cell::new(0);
    let look = || {
        let Some((bytes, said)) = size(folder.path()) else { return };
        assert!(bytes <= MOST, "{bytes} bytes");
        assert!(bytes <= said, "{bytes} bytes, and {said} are said");
        largest.set(bytes.max(largest.get()));
    };
    // Most of what they read is kept, but not what they would still keep when they end: until
    // enough is there.
    let mut round = 0;
    while round < 4 || (largest.get() <= MOST / 2 && round < 50) {
        let mut children: Vec<Child> = (0..4).map(|number| reader(round + number)).collect();
        let mut running: Vec<_> = children.iter_mut().map(Child::spawn).collect();
        // The first is killed while it keeps something, as far as that can be seen from here; at
        // the latest a moment later.
        let started = Instant::now();
        let unfinished = folder.path().join("rayset-remote-1/unfinished");
        while files(&unfinished).is_empty()
            && started.elapsed() < Duration::from_millis(500 + 100 * (round % 4) as u64)
        {
            std::thread::sleep(Duration::from_micros(100));
        }
        running[0].kill().expect("it runs, or has ended");
        while running.iter_mut().any(|child| child.try_wait().expect("a process").is_none()) {
            look();
            std::thread::sleep(Duration::from_millis(5));
        }
        look();
        for (number, child) in running.into_iter().enumerate().skip(1) {
            let said = heard(&child.wait_with_output().expect("a process"));
            assert_eq!(said.as_ref(), Ok(&contents[(round + number) % OBJECTS.len()].1));
        }
        round += 1;
    }
    assert!(largest.get() > MOST / 2, "hardly anything was kept: {}", largest.get());
    // What one that was killed may have left: half a block, and a sum that is too high.
    let own = folder.path().join("rayset-remote-1");
    std::fs::write(own.join("unfinished/1-1"), [0; 5000]).expect("a write");
    assert_eq!(reader(0).run().as_ref(), Ok(&contents[0].1));
    assert!(!own.join("unfinished/1-1").exists(), "what was left is there");
    // That run may have ended while it kept something, too.
    rayset_remote::Cache::open(folder.path(), MOST).expect("a cache");
    assert_eq!(files(&own.join("unfinished")).len(), 0);
    let (bytes, said) = size(folder.path()).expect("it was used");
    assert_eq!(bytes, said, "what is there, and what is said to be");
}

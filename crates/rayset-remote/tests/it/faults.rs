//! What goes wrong once something has been opened: clouds and grids that are rendered, points and
//! volumes that are built. The outcome is the one of local files or a clear error, in bounded time,
//! and nothing is left behind.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use rayset::Grid;

use crate::child::{Child, digest, files};
use crate::common::{built, built_grid, cloud, near, odd, render_grid, server};
use crate::range_server::{Behaviour, Event, Objects, RangeServer};

/// Times of attempts, in milliseconds: one, and all.
const TIMES: (u64, u64) = (6_000, 12_000);
/// What a test allows for them, on a machine that does other things beside.
const SOON: Duration = Duration::from_secs(60);
/// Places for pages: few, so that many are read again.
const BUDGET: &str = "262144";

/// Something remote, and what becomes of it.
struct Remote {
    server: RangeServer,
    name: &'static str,
    file: Vec<u8>,
    /// What is done with it, as [`Child`] does it.
    word: &'static str,
    /// What becomes of it nearby: the digest of a picture, or a file.
    expected: Vec<u8>,
    /// Requests that it takes if nothing is wrong.
    requests: u64,
    /// Bytes for pages.
    budget: &'static str,
}

/// What became of it.
struct Outcome {
    /// The expected, or a complaint.
    result: Result<(), String>,
    took: Duration,
}

impl Remote {
    fn new(name: &'static str, word: &'static str, file: Vec<u8>, expected: Vec<u8>) -> Self {
        let mut remote = Self { server: server(), name, file, word, expected, requests: 0, budget: BUDGET };
        let before = remote.count(|objects| &objects.requests);
        remote.run(Behaviour::default(), true).result.expect("nothing is wrong");
        remote.requests = remote.count(|objects| &objects.requests) - before;
        remote
    }

    /// A cloud whose picture takes many requests.
    fn cloud() -> Self {
        let file = cloud("sphere-100k");
        let expected = digest(&near(&file)).into();
        Self::new("sphere.rset", "cloud", file, expected)
    }

    /// A grid, likewise.
    fn grid() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("volume.nrrd");
        std::fs::write(&path, crate::inputs::nrrd(160)).expect("a write");
        let file = built_grid(&path).expect("a grid");
        let path = folder.path().join("grid.rset");
        std::fs::write(&path, &file).expect("a write");
        let grid = Arc::new(Grid::open(&path).expect("a grid"));
        let picture = render_grid(&grid, 1 << 30).expect("a picture");
        assert!(picture.iter().any(|pixel| pixel[3] > 0.5), "nothing is seen of the grid");
        Self::new("grid.rset", "grid", file, digest(&picture).into())
    }

    fn input(name: &'static str, file: Vec<u8>) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join(name);
        std::fs::write(&path, &file).expect("a write");
        let expected = built(&path).expect("a cloud");
        Self::new(name, "points", file, expected)
    }

    fn laz() -> Self {
        Self::input("points.laz", crate::inputs::laz(150_000))
    }

    fn npy() -> Self {
        Self::input("points.npy", crate::inputs::npy(400_000))
    }

    fn count(&self, of: impl Fn(&Objects) -> &AtomicU64) -> u64 {
        of(&self.server.objects).load(Ordering::Relaxed)
    }

    /// Does it, with a cache on disk or without.
    fn run(&self, behaviour: Behaviour, keeping: bool) -> Outcome {
        self.server.behave(behaviour);
        self.server.put(self.name, self.file.clone());
        let folder = tempfile::tempdir().expect("a folder");
        let (out, cache) = (folder.path().join("out"), folder.path().join("cache"));
        std::fs::create_dir(&out).expect("a folder");
        let (address, output) = (self.server.address_of(self.name), out.join("out.rset"));
        let renders = matches!(self.word, "cloud" | "grid");
        let last = if renders { self.budget.to_owned() } else { output.display().to_string() };
        let child = Child::new(&[self.word, &address, &last]).within(TIMES.0, TIMES.1);
        // What is kept of one run would spare the next one its requests: each has a folder of its
        // own.
        let mut child = if keeping { child.keeping(&cache, 64 << 20) } else { child };
        let started = Instant::now();
        let said = child.run();
        let took = started.elapsed();
        let result = said.map(|said| {
            let found = if renders { said.into_bytes() } else { std::fs::read(&output).expect("the output") };
            assert!(found == self.expected, "{}: another {}", self.name, self.word);
        });
        if result.is_ok() && !renders {
            std::fs::remove_file(&output).expect("it is there");
        }
        assert_eq!(files(&out), Vec::<PathBuf>::new(), "{}", self.name);
        assert_eq!(child.left(), Vec::<PathBuf>::new(), "{}", self.name);
        if keeping {
            nothing_is_unfinished(&cache);
        }
        Outcome { result, took }
    }

    /// It ends as it does without faults, of which there is at least one: it is done until one has
    /// been counted.
    fn is_right(&self, behaviour: &Behaviour, faults: impl Fn(&Objects) -> &AtomicU64) {
        let before = self.count(&faults);
        for round in 0..100 {
            // The cache spares it requests; the first time there is none.
            let outcome = self.run(behaviour.clone(), round % 2 == 1);
            assert_eq!(outcome.result, Ok(()), "{}: {behaviour:?}", self.name);
            assert!(outcome.took < SOON, "{}: {behaviour:?}: {:?}", self.name, outcome.took);
            if self.count(&faults) > before {
                return;
            }
        }
        panic!("{}: {behaviour:?}: nothing went wrong", self.name);
    }

    /// From about the middle on it goes wrong, and this is said of it.
    fn goes_wrong(&self, event: &Event, word: &str) {
        // The first requests open it. A busy machine joins more of the others: then fewer of them
        // are half of all.
        let parts = [2, 3, 4, 6, 8, 16].map(|part| (self.requests / part).max(2));
        let found = parts.into_iter().find_map(|requests| {
            self.server.after(requests, event.clone());
            let Outcome { result, took } = self.run(Behaviour::default(), true);
            result.err().map(|complaint| (complaint, took))
        });
        let (complaint, took) = found.expect("it goes wrong");
        assert!(complaint.contains(self.name), "{complaint}");
        assert!(complaint.contains(word), "{}: {word}: {complaint}", self.name);
        assert!(took < SOON, "{}: {word}: {took:?}", self.name);
    }

    /// Lengths that are lies are found out, or made up for by other answers.
    fn lies_are_not_believed(&self, lie: &'static str) {
        self.server.after((self.requests / 2).max(2), Event::Behave(odd(lie)));
        let outcome = self.run(Behaviour::default(), true);
        if let Err(complaint) = outcome.result {
            assert!(complaint.contains(self.name), "{lie}: {complaint}");
        }
        assert!(outcome.took < SOON, "{}: {lie}: {:?}", self.name, outcome.took);
    }

    /// The same on a server of its own.
    fn beside(&self) -> Self {
        Self { server: server(), file: self.file.clone(), expected: self.expected.clone(), ..*self }
    }

    /// Everything that is wrong for good. Most of it is waited for, so all goes on at once.
    fn everything_goes_wrong(&self) {
        let refused = |code| Event::Behave(Behaviour { refuses: Some(code), ..Behaviour::default() });
        // As long as the first, so that its length tells nothing.
        let other = Event::Put(self.name.to_owned(), self.file.clone());
        let errors = [
            (refused(403), "access is denied"),
            (refused(404), "there is no such object"),
            (Event::Behave(odd("silent")), "no answer within"),
            (other, "another object has taken its place"),
        ];
        std::thread::scope(|scope| {
            for (event, word) in errors {
                scope.spawn(move || self.beside().goes_wrong(&event, word));
            }
            for lie in ["short", "long", "too-few", "other-range"] {
                scope.spawn(|| self.beside().lies_are_not_believed(lie));
            }
        });
    }
}

/// Opens the cache, as the next run does, which removes what a process that has ended was about to
/// keep.
fn nothing_is_unfinished(cache: &Path) {
    rayset_remote::Cache::open(cache, 64 << 20).expect("a cache");
    assert_eq!(files(&cache.join("rayset-remote-1/unfinished")), Vec::<PathBuf>::new());
}

fn failing(share: f64) -> Behaviour {
    Behaviour { failing: share, ..Behaviour::default() }
}

fn cut(share: f64) -> Behaviour {
    Behaviour { cut: share, ..Behaviour::default() }
}

fn slow(share: f64, milliseconds: u64) -> Behaviour {
    Behaviour { slow: (share, Duration::from_millis(milliseconds)), ..Behaviour::default() }
}

#[test]
fn clouds_are_rendered_right_whatever_passes() {
    let remote = Remote::cloud();
    remote.is_right(&failing(0.01), |objects| &objects.failed);
    remote.is_right(&cut(0.05), |objects| &objects.cut);
}

#[test]
fn clouds_are_rendered_right_if_one_answer_of_twenty_takes_two_seconds() {
    Remote::cloud().is_right(&slow(0.05, 2000), |objects| &objects.slowed);
}

#[test]
fn many_processes_share_a_server_that_refuses_what_is_too_much() {
    let remote = Remote::cloud();
    let address = remote.server.address_of(remote.name);
    // Each of them alone asks for as much at a time as is answered in a second.
    remote.server.behave(Behaviour { rate: 64.0, ..Behaviour::default() });
    let begun = remote.count(|objects| &objects.requests);
    std::thread::scope(|scope| {
        let renders: Vec<_> = (0..4)
            .map(|_| {
                scope.spawn(|| Child::new(&["cloud", &address, remote.budget]).within(6_000, 60_000).run())
            })
            .collect();
        for render in renders {
            let said = render.join().expect("no panic");
            assert!(said.as_ref().is_ok_and(|said| said.as_bytes() == remote.expected), "{said:?}");
        }
    });
    let refused = remote.count(|objects| &objects.refused);
    let requests = remote.count(|objects| &objects.requests) - begun;
    assert!(refused > 0 && refused < requests / 2, "{refused} of {requests} requests were refused");
}

#[test]
fn grids_are_rendered_right_whatever_passes() {
    let remote = Remote::grid();
    // With room for a few pages alone, whatever is slow is waited for before anything else is asked
    // for.
    let narrow = Remote { budget: "4000000", ..remote.beside() };
    std::thread::scope(|scope| {
        scope.spawn(|| narrow.is_right(&slow(0.05, 2000), |objects| &objects.slowed));
        remote.is_right(&failing(0.01), |objects| &objects.failed);
        remote.is_right(&cut(0.05), |objects| &objects.cut);
    });
}

#[test]
fn points_are_built_right_whatever_passes() {
    for remote in [Remote::laz(), Remote::npy()] {
        let waiting = remote.beside();
        std::thread::scope(|scope| {
            scope.spawn(|| waiting.is_right(&slow(0.05, 2000), |objects| &objects.slowed));
            // They are read in few large requests: of those, more have to fail for one to do.
            remote.is_right(&failing(0.1), |objects| &objects.failed);
            remote.is_right(&cut(0.1), |objects| &objects.cut);
        });
    }
}

#[test]
fn pictures_of_clouds_that_go_wrong_half_way_are_errors() {
    Remote::cloud().everything_goes_wrong();
}

#[test]
fn pictures_of_grids_that_go_wrong_half_way_are_errors() {
    Remote::grid().everything_goes_wrong();
}

#[test]
fn builds_of_points_that_go_wrong_half_way_are_errors() {
    for remote in [Remote::laz(), Remote::npy()] {
        remote.everything_goes_wrong();
    }
}

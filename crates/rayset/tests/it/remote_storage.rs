//! Remote objects: faults, time-outs, joined requests, and pictures that do not notice.

use std::io;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use proptest::prelude::*;
use rayset::build::{self, BuildControl, BuildOptions};
use rayset::points::Workload;
use rayset::scene::{Camera, CloudObject, RenderSettings, Scene};
use rayset::storage::{
    MemoryStorage, RangeError, RangeReader, RangeSink, RemoteOptions, RemoteStorage, RequestLimit, Storage,
};
use rayset::working_set::Limits;
use rayset::{Cloud, Prediction, Session};
use rayset_lab::simulated::{Behaviour, SimulatedObject};

fn bytes(count: usize) -> Vec<u8> {
    (0..count).map(|i| (i * 7 + i / 251) as u8).collect()
}

pub(crate) fn quick() -> RemoteOptions {
    let mut options = RemoteOptions::default();
    (options.first_pause, options.longest_pause) = (Duration::from_millis(1), Duration::from_millis(4));
    options.timeout = Duration::from_millis(300);
    options.attempts = 20;
    options
}

pub(crate) fn remote(
    content: &[u8],
    behaviour: Behaviour,
    options: RemoteOptions,
) -> (Arc<SimulatedObject>, RemoteStorage) {
    let near = MemoryStorage::new(Arc::new(content.to_vec()));
    let object = Arc::new(SimulatedObject::new(Arc::new(near), behaviour, 42).expect("a thread"));
    let storage = RemoteStorage::new(object.clone(), content.len() as u64, options).expect("a thread");
    (object, storage)
}

#[test]
fn every_byte_is_right_though_requests_fail_are_cut_are_slow_and_are_never_answered() {
    let content = bytes(3_000_000);
    let behaviour = Behaviour {
        latency: Duration::from_millis(1),
        jitter: 0.5,
        failing: 0.1,
        cut: 0.1,
        slow: (0.05, Duration::from_millis(20)),
        silent: 0.02,
        ..Behaviour::default()
    };
    let mut options = quick();
    options.most_bytes = 50_000;
    let (object, storage) = remote(&content, behaviour, options);
    let mut found = vec![0; content.len()];
    storage.read_exact_at(&mut found, 0).expect("it is read in the end");
    assert!(found == content);
    assert!(object.counts().faults > 5, "{:?}", object.counts());
    assert!(storage.counts().retries >= 5, "{:?}", storage.counts());
}

#[test]
fn a_read_beyond_the_end_is_an_error_without_a_request() {
    let (object, storage) = remote(&bytes(1000), Behaviour::default(), quick());
    let error = storage.read_exact_at(&mut [0; 10], 995).expect_err("5 bytes are missing");
    assert_eq!(error.kind(), io::ErrorKind::UnexpectedEof);
    assert_eq!(object.counts().requests, 0);
}

#[test]
fn a_storage_that_always_fails_gives_up_with_the_reason_and_the_number_of_attempts() {
    let behaviour = Behaviour { failing: 1.0, ..Behaviour::default() };
    let mut options = quick();
    options.attempts = 3;
    let (object, storage) = remote(&bytes(1000), behaviour, options);
    let error = storage.read_exact_at(&mut [0; 10], 0).expect_err("it fails").to_string();
    assert!(error.contains("503") && error.contains("tried 3 times"), "{error}");
    assert_eq!(object.counts().requests, 3);
}

/// Reads an object that answers at a rate, from so many storages at a time as of so many processes.
/// Returns the requests and the refusals, and how long it took.
fn read_at_a_rate(storages: usize, rate: f64) -> (u64, u64, Duration) {
    let content = bytes(300_000);
    let behaviour = Behaviour { latency: Duration::from_millis(5), rate, ..Behaviour::default() };
    let mut options = RemoteOptions::default();
    (options.most_bytes, options.attempts) = (1000, 1);
    let near = MemoryStorage::new(Arc::new(content.clone()));
    let object = Arc::new(SimulatedObject::new(Arc::new(near), behaviour, 42).expect("a thread"));
    let started = Instant::now();
    std::thread::scope(|scope| {
        for _ in 0..storages {
            scope.spawn(|| {
                let storage = RemoteStorage::new(object.clone(), content.len() as u64, options);
                let mut found = vec![0; content.len()];
                storage.expect("a thread").read_exact_at(&mut found, 0).expect("nothing has failed");
                assert!(found == content);
            });
        }
    });
    let counts = object.counts();
    (counts.requests, counts.faults, started.elapsed())
}

#[test]
fn an_object_that_refuses_what_is_too_much_is_asked_for_less_and_nothing_fails() {
    let (requests, refused, took) = read_at_a_rate(1, 200.0);
    assert!(refused > 0 && requests == 300 + refused, "{requests} requests, {refused} refused");
    assert!(refused < 300, "{refused} refused");
    assert!(took < Duration::from_secs(15), "300 requests at 200 a second took {took:?}");
    let (requests, refused, _) = read_at_a_rate(8, 800.0);
    assert!(refused > 0 && requests == 2400 + refused, "{requests} requests, {refused} refused");
    assert!(refused < 2400, "{refused} refused");
}

#[test]
fn an_object_that_refuses_everything_is_given_up_in_bounded_time() {
    let behaviour = Behaviour { rate: 1e-9, ..Behaviour::default() };
    let mut options = quick();
    options.give_up_after = Duration::from_millis(500);
    let (_, storage) = remote(&bytes(1000), behaviour, options);
    storage.read_exact_at(&mut [0; 10], 0).expect("the first is answered");
    let started = Instant::now();
    let error = storage.read_exact_at(&mut [0; 10], 0).expect_err("nothing else is").to_string();
    assert!(error.contains("429") && error.contains("tried"), "{error}");
    assert!(started.elapsed() < Duration::from_secs(5), "{:?}", started.elapsed());
}

#[test]
fn a_storage_that_never_answers_is_given_up_in_bounded_time() {
    let behaviour = Behaviour { silent: 1.0, ..Behaviour::default() };
    let mut options = quick();
    (options.attempts, options.timeout) = (2, Duration::from_millis(100));
    let (_, storage) = remote(&bytes(1000), behaviour, options);
    let started = Instant::now();
    let error = storage.read_exact_at(&mut [0; 10], 0).expect_err("nobody answers");
    assert_eq!(error.kind(), io::ErrorKind::TimedOut, "{error}");
    assert!(started.elapsed() < Duration::from_secs(5), "{:?}", started.elapsed());
}

/// Refuses everything, for good.
#[derive(Default)]
struct Denied(AtomicU64);

impl RangeReader for Denied {
    fn start(&self, _: std::ops::Range<u64>, sink: RangeSink) {
        self.0.fetch_add(1, Ordering::Relaxed);
        let reason =
            io::Error::new(io::ErrorKind::PermissionDenied, "403: no permission to read this object");
        sink.end(Err(RangeError::lasting(reason)));
    }

    fn name(&self) -> String {
        "a locked door".into()
    }
}

#[test]
fn what_another_attempt_would_meet_again_is_not_tried_again() {
    let reader = Arc::new(Denied::default());
    let storage = RemoteStorage::new(reader.clone(), 1000, quick()).expect("a thread");
    let error = storage.read_exact_at(&mut [0; 10], 0).expect_err("no permission");
    assert_eq!(error.kind(), io::ErrorKind::PermissionDenied);
    assert!(error.to_string().contains("403"), "{error}");
    assert_eq!(reader.0.load(Ordering::Relaxed), 1);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn any_range_is_read_whatever_the_limits_of_requests(
        start in 0_usize..5000, length in 0_usize..5000, most in 1_u64..3000, in_flight in 0_usize..5,
    ) {
        let content = bytes(10_000);
        let mut options = quick();
        (options.most_bytes, options.in_flight) = (most, in_flight);
        let (_, storage) = remote(&content, Behaviour::default(), options);
        let mut found = vec![0; length];
        storage.read_exact_at(&mut found, start as u64).expect("it is there");
        prop_assert!(found == content[start..start + length]);
    }
}

/// Hands out a remote object's bytes late, and counts what is in flight together with other
/// readers.
struct Counting {
    content: Vec<u8>,
    flying: Arc<Mutex<(usize, u64)>>,
    most: Arc<Mutex<(usize, u64)>>,
    fails: bool,
}

impl RangeReader for Counting {
    fn start(&self, range: Range<u64>, mut sink: RangeSink) {
        let length = range.end - range.start;
        {
            let (mut flying, mut most) =
                (self.flying.lock().expect("no panic"), self.most.lock().expect("no panic"));
            *flying = (flying.0 + 1, flying.1 + length);
            *most = (most.0.max(flying.0), most.1.max(flying.1));
        }
        let bytes = self.content[range.start as usize..range.end as usize].to_vec();
        let (flying, fails) = (self.flying.clone(), self.fails);
        std::thread::spawn(move || {
            std::thread::sleep(Duration::from_millis(2));
            {
                let mut flying = flying.lock().expect("no panic");
                *flying = (flying.0 - 1, flying.1 - length);
            }
            if fails {
                return sink.end(Err(RangeError::lasting(io::Error::other("never"))));
            }
            sink.put(&bytes);
            sink.end(Ok(()));
        });
    }

    fn name(&self) -> String {
        "counted".into()
    }
}

#[test]
fn storages_that_share_a_limit_have_no_more_in_flight_together_and_all_are_served() {
    let limit = RequestLimit::new(3, 5000, 7);
    let (flying, most) = (Arc::default(), Arc::<Mutex<(usize, u64)>>::default());
    let mut options = quick();
    // Requests of 2 000 bytes: of three at a time, the third would be too many bytes. One of 9 000
    // goes alone.
    options.most_bytes = 2000;
    let storages: Vec<RemoteStorage> = (0..4)
        .map(|i| {
            let content = bytes(30_000);
            let reader = Counting { content, flying: Arc::clone(&flying), most: most.clone(), fails: i == 3 };
            options.most_bytes = if i == 2 { 9000 } else { 2000 };
            RemoteStorage::within(&limit, Arc::new(reader), 30_000, options).expect("a thread")
        })
        .collect();
    std::thread::scope(|scope| {
        for (i, storage) in storages.iter().enumerate() {
            scope.spawn(move || {
                let mut found = vec![0; 30_000];
                match storage.read_exact_at(&mut found, 0) {
                    Ok(()) => assert!(i < 3 && found == bytes(30_000), "{i}"),
                    Err(error) => assert!(i == 3 && error.to_string().contains("never"), "{i}: {error}"),
                }
            });
        }
    });
    let (requests, length) = *most.lock().expect("no panic");
    assert!(requests <= 3 && length <= 9000, "{requests} requests, {length} bytes");
    assert_eq!(storages[0].transport().expect("remote").memory_bytes(), 7);
}

#[test]
fn a_storage_that_is_dropped_gives_back_what_it_had_in_flight() {
    let limit = RequestLimit::new(2, 5000, 0);
    let near = |content: &[u8]| Arc::new(MemoryStorage::new(Arc::new(content.to_vec())));
    let object = |silent: f64| {
        let behaviour = Behaviour { silent, ..Behaviour::default() };
        Arc::new(SimulatedObject::new(near(&bytes(1000)), behaviour, 1).expect("a thread"))
    };
    let mut options = quick();
    options.timeout = Duration::from_secs(600);
    let silent = RemoteStorage::within(&limit, object(1.0), 1000, options).expect("a thread");
    let heard = RemoteStorage::within(&limit, object(0.0), 1000, options).expect("a thread");
    std::thread::scope(|scope| {
        let waiting: Vec<_> =
            (0..2).map(|_| scope.spawn(|| heard.read_exact_at(&mut [0; 10], 500))).collect();
        waiting.into_iter().for_each(|thread| assert!(thread.join().expect("no panic").is_ok()));
    });
    let transport = silent.transport().expect("remote");
    let (send, receive) = std::sync::mpsc::channel();
    for offset in [0, 900] {
        let send = send.clone();
        let done = Box::new(move |_, outcome: io::Result<()>| send.send(outcome).expect("somebody listens"));
        let buffer = rayset::storage::PageBuffer::new(10);
        let storage = near(&bytes(1000));
        transport.submit(vec![rayset::storage::transport::Read { storage, offset, buffer, done }]);
    }
    let waits = std::thread::spawn(move || {
        let mut found = [0; 10];
        heard.read_exact_at(&mut found, 500).map(|()| found.to_vec())
    });
    drop(silent);
    assert!(receive.recv().expect("it is told").is_err());
    assert_eq!(waits.join().expect("no panic").expect("its turn"), bytes(1000)[500..510]);
}

/// A cloud's file, and a picture of it with all of it at hand.
fn cloud() -> (Vec<u8>, Vec<[f32; 4]>) {
    let workload: Workload = "sphere-100k".parse().expect("a workload");
    let radius = workload.radius().map(build::Rule::Number);
    let options = BuildOptions::default().with_radius(radius).with_page_bytes(Some(16384));
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("sphere.rset");
    rayset::octree::build::run(vec![workload.source()], &path, &options, &BuildControl::default())
        .expect("a build");
    let file = std::fs::read(&path).expect("the file");
    let near = Arc::new(Cloud::open(&path).expect("a cloud"));
    let session = Session::builder().threads(2).build().expect("a session");
    let picture = render(&session, near);
    (file, picture)
}

fn render(session: &Session, cloud: Arc<Cloud>) -> Vec<[f32; 4]> {
    let scene = Scene::of_cloud(CloudObject::plain(cloud));
    let bounds = scene.root.bounds();
    let camera = Camera::framing(&bounds, [0.2, -0.3, -1.0].into(), [0.0, 1.0, 0.0].into(), 0.8, 1.0, false);
    let settings = RenderSettings::default().with_size(64, 64);
    let prepared = session.prepare(&scene, &settings).expect("a scene");
    prepared.view(&camera).expect("a view").picture().expect("a picture").pixels
}

#[test]
fn a_picture_of_a_remote_cloud_is_the_same_for_every_budget_predictor_thread_count_and_fault() {
    let (file, expected) = cloud();
    let behaviour = Behaviour {
        latency: Duration::from_millis(2),
        jitter: 0.2,
        failing: 0.02,
        cut: 0.02,
        ..Behaviour::default()
    };
    let small = 12 * 16384;
    for (predictor, threads, budget) in [
        (Prediction::Packet, 1, 1 << 30),
        (Prediction::Packet, 3, small),
        (Prediction::Packet, 1, small),
        (Prediction::Line, 2, 2 * small),
        (Prediction::None, 2, 1 << 30),
    ] {
        let (object, storage) = remote(&file, behaviour, quick());
        let cloud = Arc::new(Cloud::from_storage("remote", Arc::new(storage)).expect("a cloud"));
        let session = Session::builder()
            .page_limits(Limits::total(budget))
            .threads(threads)
            .prediction(predictor)
            .build()
            .expect("a session");
        let case = format!("{}, {threads} threads, {budget} bytes", predictor.name());
        assert!(render(&session, cloud.clone()) == expected, "{case}");
        assert!(session.statistics().peak_bytes <= budget, "{case}");
        // A second picture, with what the first has left in memory.
        assert!(render(&session, cloud) == expected, "{case}, again");
        assert!(object.counts().requests > 0, "{case}");
    }
}

#[test]
fn with_room_for_all_pages_remote_ones_are_joined_to_few_requests() {
    let (file, _) = cloud();
    let behaviour = Behaviour { latency: Duration::from_millis(5), ..Behaviour::default() };
    let (object, storage) = remote(&file, behaviour, quick());
    let cloud = Arc::new(Cloud::from_storage("remote", Arc::new(storage)).expect("a cloud"));
    let session = Session::builder().threads(1).build().expect("a session");
    object.reset_counts();
    render(&session, cloud);
    let (requests, pages) = (object.counts().requests, session.statistics().total(|kind| kind.reads));
    assert!(requests as f64 <= 0.6 * pages as f64, "{requests} requests for {pages} pages");
}

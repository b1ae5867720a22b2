//! What sessions promise, measured: how soon cancelled calls return, and what two renders at a time
//! cost beside one after the other: `cargo bench -p rayset --bench sessions`. Not statistics of one
//! number, but 200 moments each; so it prints a table of its own.
#![allow(clippy::print_stdout, reason = "it prints what it measured")]

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use rayset::build::{BuildControl, BuildError, BuildOptions, Rule};
use rayset::memory::Limits;
use rayset::points::Workload;
use rayset::scene::{Camera, CloudObject, OpacityRule, RenderSettings, Scene};
use rayset::{CancelToken, Cloud, FinishedTile, RenderError, Session, SinkError, View, Work};

/// Moments of each kind.
const MOMENTS: u32 = 200;

fn main() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("sessions");
    std::fs::create_dir_all(&folder).expect("a folder");
    println!(
        "| call | took | cancelled: median | 99 of 100 | longest |\n| --- | ---: | ---: | ---: | ---: |"
    );
    in_core(&folder);
    waiting(&folder);
    building(&folder);
    println!();
    side_by_side(&folder);
}

fn cloud(folder: &Path, name: &str) -> Arc<Cloud> {
    let path = folder.join(format!("{name}.rset"));
    if !path.exists() {
        let workload: Workload = name.parse().expect("a workload");
        let options = BuildOptions { radius: workload.radius().map(Rule::Number), ..BuildOptions::default() };
        rayset::octree::build::run(vec![workload.source()], &path, &options, &BuildControl::default())
            .expect("a cloud");
    }
    Arc::new(Cloud::open(&path).expect("it opens"))
}

fn scene(cloud: &Arc<Cloud>) -> Scene {
    let mut object = CloudObject::plain(cloud.clone());
    object.transfer.opacity = OpacityRule::Extinction(0.2 / cloud.header().radius_mean);
    Scene::of_cloud(object)
}

fn camera(scene: &Scene) -> Camera {
    Camera::framing(&scene.root.bounds(), [0.3, -0.2, -1.0].into(), [0.0, 1.0, 0.0].into(), 0.7, 1.0, false)
}

fn view(session: &Session, scene: &Scene, side: u32) -> View {
    let settings = RenderSettings { width: side, height: side, ..RenderSettings::default() };
    session.prepare(scene, &settings).expect("a scene").view(&camera(scene)).expect("a view")
}

/// Prints how late calls returned.
fn row(name: &str, took: Duration, mut late: Vec<Duration>) {
    late.sort_unstable();
    let at = |part: usize| late[(late.len() * part / 100).min(late.len() - 1)];
    println!("| {name} | {took:.1?} | {:.2?} | {:.2?} | {:.2?} |", at(50), at(99), at(100));
}

/// Runs `call` with a token that is cancelled at a moment, and returns how late it returned after
/// that.
fn cancelled_at(moment: Duration, call: impl FnOnce(&CancelToken)) -> Duration {
    let cancel = CancelToken::new();
    let canceller = {
        let cancel = cancel.clone();
        std::thread::spawn(move || {
            std::thread::sleep(moment);
            cancel.cancel();
            Instant::now()
        })
    };
    call(&cancel);
    let returned = Instant::now();
    returned.saturating_duration_since(canceller.join().expect("it cancels"))
}

/// Moments spread over a time, in no order.
fn moments(longest: Duration) -> impl Iterator<Item = Duration> {
    (0..MOMENTS).map(move |i| longest.mul_f64(f64::from(i * 73 % MOMENTS) / f64::from(MOMENTS)))
}

fn nothing(_: &FinishedTile<'_>) -> Result<(), SinkError> {
    Ok(())
}

fn cancel_render(view: &View, longest: Duration) -> Vec<Duration> {
    let work = Work::tiles(view.tiles(&view.region()));
    let late = moments(longest).map(|moment| {
        cancelled_at(moment, |cancel| {
            let outcome = view.render(&work, cancel, &mut nothing);
            assert!(matches!(outcome, Ok(_) | Err(RenderError::Cancelled)), "{outcome:?}");
        })
    });
    late.collect()
}

fn in_core(folder: &Path) {
    let scene = scene(&cloud(folder, "knot-200k"));
    let session = Session::builder().build().expect("a session");
    let view = view(&session, &scene, 256);
    let expected = view.picture().expect("a picture");
    let started = Instant::now();
    view.picture().expect("a picture");
    let took = started.elapsed();
    row("render, in core", took, cancel_render(&view, took));
    assert_eq!(session.pages().retained_bytes(), 0);
    assert!(view.picture().expect("a picture") == expected, "the session goes on");
}

fn waiting(folder: &Path) {
    let scene = scene(&cloud(folder, "sphere-1m"));
    let slow = Session::builder().page_limits(Limits::total(1 << 20)).read_delay(Duration::from_secs(2));
    let session = slow.build().expect("a session");
    let view = view(&session, &scene, 128);
    let late = cancel_render(&view, Duration::from_millis(100));
    row("render, waiting for reads of 2 s", Duration::from_secs(2), late);
    assert_eq!(session.pages().retained_bytes(), 0);
}

fn building(folder: &Path) {
    let workload: Workload = "sphere-1m".parse().expect("a workload");
    let place = folder.join("built");
    std::fs::create_dir_all(&place).expect("a folder");
    let path = place.join("c.rset");
    let options = BuildOptions { threads: 2, ..BuildOptions::default() };
    let build = |cancel: &CancelToken| {
        let control = BuildControl { cancel: cancel.clone(), ..BuildControl::default() };
        let outcome = rayset::octree::build::run(vec![workload.source()], &path, &options, &control);
        let cancelled = matches!(outcome, Err(BuildError::Cancelled));
        assert!(cancelled || outcome.is_ok());
        let left = std::fs::read_dir(&place).expect("the folder").count();
        assert_eq!(left, usize::from(!cancelled), "a file is left");
        let _ = std::fs::remove_file(&path);
    };
    let started = Instant::now();
    build(&CancelToken::new());
    let took = started.elapsed();
    row(
        "build of sphere-1m, spacing measured",
        took,
        moments(took).map(|m| cancelled_at(m, build)).collect(),
    );
}

fn side_by_side(folder: &Path) {
    let clouds = ["sphere-1m", "knot-1m"].map(|name| cloud(folder, name));
    let scenes = clouds.each_ref().map(scene);
    let bytes: u64 = clouds.iter().map(|cloud| cloud.header().file_bytes / 10).sum();
    let session = Session::builder().page_limits(Limits::total(bytes)).build().expect("a session");
    let views = scenes.each_ref().map(|scene| view(&session, scene, 384));
    let alone = views.each_ref().map(|view| view.picture().expect("a picture"));
    let mut ratios: Vec<f64> = (0..7)
        .map(|_| {
            session.evict_all();
            let started = Instant::now();
            views.iter().for_each(|view| drop(view.picture().expect("a picture")));
            let in_turn = started.elapsed();
            session.evict_all();
            let started = Instant::now();
            std::thread::scope(|scope| {
                for (view, alone) in views.iter().zip(&alone) {
                    scope.spawn(move || assert!(view.picture().expect("a picture") == *alone, "other bits"));
                }
            });
            started.elapsed().as_secs_f64() / in_turn.as_secs_f64()
        })
        .collect();
    ratios.sort_unstable_by(f64::total_cmp);
    println!(
        "two renders at a time, a tenth of their pages each: {:.2} (median of 7; {:.2} to {:.2}) of one after the other",
        ratios[3], ratios[0], ratios[6]
    );
}

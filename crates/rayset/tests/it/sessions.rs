//! Sessions: scenes that are prepared once and looked at often, tiles in any order, passes, renders
//! side by side, cancellation.

use std::sync::Arc;
use std::time::{Duration, Instant};

use rayset::cancel::CancelToken;
use rayset::field::Kernel;
use rayset::geometry::DVec3;
use rayset::image::LayerPixel;
use rayset::scene::{Camera, Light, LightKind, Lighting, RenderSettings, Samples, Scene, Shadows};
use rayset::scene_file::SceneFile;
use rayset::trace::{
    ExecSettings, FinishedTile, Region, RenderError, Session, SettingError, SinkError, Tile, View, Work,
    render_once,
};
use rayset::working_set::Kind;
use rayset::working_set::read::{self, BackendKind, Delayed};

use crate::common::{
    Random, bits, camera, clouds_of, folder, paged, paged_with, scene, settings, workload_cloud,
};

fn exec(threads: usize) -> ExecSettings {
    ExecSettings { threads, ..ExecSettings::default() }
}

/// A sun and a lamp that throw shadows, in tables.
fn shaded(folder: &std::path::Path) -> (Scene, RenderSettings) {
    let cloud = workload_cloud("knot-20k", folder);
    let light = |kind| Light { kind, color: [0.7; 3], shadow: true };
    let lights = vec![
        light(LightKind::Directional { direction: DVec3::new(0.3, -1.0, -0.4) }),
        light(LightKind::Point { position: DVec3::new(2.0, 3.0, 2.0), decays: false }),
    ];
    let scene = Scene { lighting: Lighting::Lit(lights), ..scene(&cloud, Kernel::Wyvill, true) };
    (scene, RenderSettings { shadows: Shadows::Cached { resolution: 96 }, ..settings(40, 40) })
}

fn turned(frame: u32, frames: u32) -> Camera {
    let angle = f64::from(frame) / f64::from(frames) * std::f64::consts::TAU;
    let eye = 3.0 * DVec3::new(angle.sin(), 0.2, angle.cos());
    Camera::look_at(eye, DVec3::ZERO, DVec3::Y, 45_f64.to_radians())
}

#[test]
fn a_turntable_makes_no_block_of_a_shadow_table_twice_and_each_picture_is_as_if_alone() {
    let folder = folder();
    let (scene, settings) = shaded(folder.path());
    let page = u64::from(clouds_of(&scene)[0].header().page_bytes);
    for (budget, all_fit) in [(1 << 30, true), (40 * page, false)] {
        let session = Session::over(paged(&scene, budget), exec(2)).expect("a session");
        let prepared = session.prepare(&scene, &settings).expect("a scene");
        for frame in 0..6 {
            let camera = turned(frame, 6);
            let found = prepared.view(&camera).expect("a view").picture().expect("a picture");
            let alone = render_once(&scene, &camera, &settings, &exec(1), &paged(&scene, 1 << 30));
            assert!(bits(&found.pixels) == bits(&alone.expect("a picture").0.pixels), "frame {frame}");
        }
        let made = *session.pages().statistics().kind(Kind::Shadows);
        assert!(made.computed_unique > 50, "{made:?}");
        assert_eq!(made.computed == made.computed_unique, all_fit, "{made:?}");
        drop(prepared);
        let left = session.pages().statistics().kind(Kind::Shadows).evictions;
        assert_eq!(left, made.computed, "tables go with their scene");
    }
}

/// The pixels of a view as tiles bring them, and how often each tile came.
struct Gathered {
    width: u32,
    pixels: Vec<[f32; 4]>,
    layers: Vec<LayerPixel>,
    final_tiles: usize,
    tiles: usize,
}

fn gather(view: &View, work: &Work) -> Result<Gathered, RenderError> {
    let region = view.region();
    let count = region.pixels() as usize;
    let mut found = Gathered {
        width: region.columns.end,
        pixels: vec![[-1.0; 4]; count],
        layers: vec![LayerPixel::default(); count],
        final_tiles: 0,
        tiles: 0,
    };
    view.render(work, &CancelToken::new(), &mut |tile: &FinishedTile<'_>| found.take(tile))?;
    Ok(found)
}

impl Gathered {
    fn take(&mut self, finished: &FinishedTile<'_>) -> Result<(), SinkError> {
        self.tiles += 1;
        self.final_tiles += usize::from(finished.is_final());
        let Tile { x, y, width, height } = finished.tile;
        assert_eq!(finished.pixels.len(), finished.tile.pixels());
        for (at, pixel) in finished.pixels.iter().enumerate() {
            let (column, row) = (x + at as u32 % width, y + at as u32 / width);
            assert!(row < y + height);
            let place = (row * self.width + column) as usize;
            self.pixels[place] = *pixel;
            if let Some(layer) = finished.layers.get(at) {
                self.layers[place] = *layer;
            }
        }
        Ok(())
    }
}

fn shuffled(mut tiles: Vec<Tile>, seed: u64) -> Vec<Tile> {
    let mut random = Random(seed);
    for at in (1..tiles.len()).rev() {
        tiles.swap(at, (random.unit() * (at + 1) as f64) as usize);
    }
    tiles
}

#[test]
fn tiles_in_any_order_and_passes_of_any_size_come_to_the_picture_of_one_pass() {
    let folder = folder();
    let cloud = workload_cloud("knot-20k", folder.path());
    let scene = scene(&cloud, Kernel::Wyvill, true);
    let settings = RenderSettings { samples: Samples::Fixed(3), layers: true, ..settings(44, 29) };
    let page = u64::from(cloud.header().page_bytes);
    let layers = |all: &[LayerPixel]| -> Vec<LayerPixel> {
        all.iter().map(|pixel| LayerPixel { bytes: 0.0, ..*pixel }).collect()
    };
    let expected = render_once(&scene, &camera(), &settings, &exec(1), &paged(&scene, 1 << 30));
    let expected = expected.expect("a picture").0;
    for (threads, budget) in [(1, 12 * page), (3, 1 << 30)] {
        let session = Session::over(paged(&scene, budget), exec(threads)).expect("a session");
        let view = session.prepare(&scene, &settings).expect("a scene").view(&camera()).expect("a view");
        let tiles = view.tiles(&view.region());
        let works = [
            Work::tiles(tiles.clone()),
            Work::tiles(shuffled(tiles.clone(), 1)),
            Work::tiles(shuffled(tiles.clone(), 2)).progressive(),
            Work::tiles(tiles.clone()).in_passes(&[1, 3]),
            Work::tiles(tiles.clone()).in_passes(&[0, 100]),
        ];
        for (work, passes) in works.iter().zip([1, 1, 5, 3, 2]) {
            let found = gather(&view, work).expect("a picture");
            assert_eq!((found.tiles, found.final_tiles), (passes * tiles.len(), tiles.len()), "{work:?}");
            assert!(bits(&found.pixels) == bits(&expected.pixels), "{threads} threads, {passes} passes");
            assert!(layers(&found.layers) == layers(&expected.layers), "{threads} threads, {passes} passes");
        }
    }
}

#[test]
fn a_scene_that_changes_keeps_the_pages_of_its_files() {
    let folder = folder();
    let cloud = workload_cloud("knot-20k", folder.path());
    let text = |color: &str| {
        format!(
            r#"{{"rayset": 1, "image": {{"size": [40, 40]}}, "root": {{"type": "cloud", "file": {:?}, "transferFunction": {{"color": "{color}"}}}}}}"#,
            cloud.path()
        )
    };
    let session = Session::builder().memory(64 << 20).build().expect("a session");
    let place = folder.path().join("scene.json");
    let picture = |file: &SceneFile| {
        let prepared = session.prepare(&file.scene, &file.settings).expect("a scene");
        prepared.view(&file.camera).expect("a view").picture().expect("a picture")
    };
    let reads = || session.statistics().total(|kind| kind.reads);
    let first = SceneFile::parse(&place, &text("#ff0000")).expect("a scene");
    let red = picture(&first);
    let read = reads();
    assert!(read > 0);
    let changed = first.parse_changed(&place, &text("#0000ff")).expect("a scene");
    let blue = picture(&changed);
    assert!(bits(&red.pixels) != bits(&blue.pixels));
    assert_eq!(reads(), read, "nothing was read again");
    let anew = SceneFile::parse(&place, &text("#0000ff")).expect("a scene");
    assert!(bits(&blue.pixels) == bits(&picture(&anew).pixels));
    assert!(reads() > read, "another opening is another file");
}

#[test]
fn nodes_that_are_pinned_stay_and_change_no_pixel() {
    let folder = folder();
    let cloud = workload_cloud("knot-200k", folder.path());
    let scene = scene(&cloud, Kernel::Wyvill, true);
    let settings = settings(40, 40);
    let picture = |session: &Session| {
        let prepared = session.prepare(&scene, &settings).expect("a scene");
        prepared.view(&turned(0, 1)).expect("a view").picture().expect("a picture")
    };
    let session = Session::over(paged(&scene, 1 << 30), exec(2)).expect("a session");
    let first = picture(&session);
    let page = u64::from(cloud.header().page_bytes);
    // Not a page more than there is room for.
    let kept = session.pin_nodes(&cloud, 2 * page - 1).expect("it reads");
    assert_eq!(kept, page);
    assert_eq!(session.pin_nodes(&cloud, 1 << 30).expect("it reads"), kept, "what is kept stays");
    session.evict_all();
    assert_eq!(session.statistics().kind(Kind::Octree).resident_bytes, kept);
    assert_eq!(session.statistics().kind(Kind::Points).resident_bytes, 0);
    assert!(bits(&picture(&session).pixels) == bits(&first.pixels));
    let other = workload_cloud("knot-20k", folder.path());
    assert_eq!(session.pin_nodes(&other, 1 << 30).expect("it is none of the session's"), 0);
}

#[test]
fn the_first_pass_is_the_mean_of_its_rays() {
    let folder = folder();
    let cloud = workload_cloud("knot-20k", folder.path());
    let scene = scene(&cloud, Kernel::Wyvill, true);
    let session = Session::over(paged(&scene, 1 << 30), exec(2)).expect("a session");
    let settings = RenderSettings { samples: Samples::Fixed(4), ..settings(24, 24) };
    let view = session.prepare(&scene, &settings).expect("a scene").view(&camera()).expect("a view");
    let (mut first, mut last) = (0.0, 0.0);
    let mut sink = |tile: &FinishedTile<'_>| -> Result<(), SinkError> {
        let sum: f64 = tile.pixels.iter().map(|pixel| f64::from(pixel[3])).sum();
        first += if tile.pass == 0 { sum } else { 0.0 };
        last += if tile.is_final() { sum } else { 0.0 };
        Ok(())
    };
    let work = Work::tiles(view.tiles(&view.region())).progressive();
    view.render(&work, &CancelToken::new(), &mut sink).expect("a picture");
    assert!(first > 0.0 && (first / last - 1.0).abs() < 0.1, "coverage {first} at first, {last} in the end");
}

#[test]
fn tiles_beyond_the_picture_and_refusing_sinks_are_errors_and_the_session_goes_on() {
    let folder = folder();
    let cloud = workload_cloud("knot-20k", folder.path());
    let scene = scene(&cloud, Kernel::Wyvill, true);
    let session = Session::over(paged(&scene, 1 << 30), exec(2)).expect("a session");
    let prepared = session.prepare(&scene, &settings(40, 40)).expect("a scene");
    let view = prepared.view(&camera()).expect("a view");
    let expected = bits(&view.picture().expect("a picture").pixels);
    for (x, y, width, height) in [(40, 0, 1, 1), (36, 0, 5, 1), (0, 39, 1, 2), (0, 0, 9, 1), (0, 0, 0, 1)] {
        let outside = gather(&view, &Work::tiles(vec![Tile { x, y, width, height }]));
        let Err(RenderError::Setting(SettingError::Tile { tile, width: 40, height: 40 })) = outside else {
            panic!("{x}, {y}")
        };
        assert_eq!(tile, Tile { x, y, width, height });
    }
    assert_eq!(gather(&view, &Work::tiles(Vec::new())).expect("nothing to do").tiles, 0);
    let mut taken = 0;
    let mut full = |_: &FinishedTile<'_>| -> Result<(), SinkError> {
        taken += 1;
        if taken == 3 { Err("the disk is full".into()) } else { Ok(()) }
    };
    let refused = view.render(&Work::tiles(view.tiles(&view.region())), &CancelToken::new(), &mut full);
    let refused = refused.expect_err("the sink refuses").to_string();
    assert_eq!((refused.as_str(), taken), ("the picture could not be written: the disk is full", 3));
    for (width, height) in [(0, 4), (4, 0), (1 << 21, 4)] {
        assert!(prepared.view_of_size(&camera(), width, height).is_err());
    }
    assert_eq!(session.pages().retained_bytes(), 0);
    assert!(bits(&view.picture().expect("a picture").pixels) == expected);
}

#[test]
fn renders_side_by_side_in_a_tenth_of_their_pages_are_each_as_if_alone() {
    let folder = folder();
    let clouds = ["sphere-100k", "knot-100k"].map(|name| workload_cloud(name, folder.path()));
    let scenes = [false, true].map(|lit| scene(&clouds[usize::from(lit)], Kernel::Triweight, lit));
    let settings = settings(48, 48);
    let alone = |scene| {
        let found = render_once(scene, &camera(), &settings, &exec(2), &paged(scene, 1 << 30));
        bits(&found.expect("a picture").0.pixels)
    };
    let expected = scenes.each_ref().map(alone);
    let bytes: u64 = clouds.iter().map(|cloud| cloud.header().file_bytes / 10).sum();
    for threads in [1, 2, 5] {
        let session = Session::over(paged(&scenes[0], bytes), exec(threads)).expect("a session");
        std::thread::scope(|scope| {
            for turn in 0..4 {
                let (session, scene, expected) = (&session, &scenes[turn % 2], &expected[turn % 2]);
                let settings = &settings;
                scope.spawn(move || {
                    for _ in 0..2 {
                        let prepared = session.prepare(scene, settings).expect("a scene");
                        let found = prepared.view(&camera()).expect("a view").picture().expect("a picture");
                        assert!(bits(&found.pixels) == *expected, "{threads} threads, scene {}", turn % 2);
                    }
                });
            }
        });
        assert_eq!(session.pages().retained_bytes(), 0);
    }
}

#[test]
fn tiles_of_a_region_beyond_the_picture_are_those_within_it() {
    let folder = folder();
    let scene = scene(&workload_cloud("knot-20k", folder.path()), Kernel::Wyvill, true);
    let session = Session::over(paged(&scene, 1 << 30), exec(1)).expect("a session");
    let view = session.prepare(&scene, &settings(40, 24)).expect("a scene").view(&camera()).expect("a view");
    let whole = view.tiles(&view.region());
    assert_eq!(whole.iter().map(Tile::pixels).sum::<usize>(), 40 * 24);
    let tiles = |columns, rows| view.tiles(&Region { columns, rows });
    assert_eq!(tiles(0..u32::MAX, 0..u32::MAX), whole);
    #[allow(clippy::reversed_empty_ranges, reason = "what a caller may give")]
    let none = [tiles(5..3, 0..9), tiles(5..5, 0..9), tiles(40..50, 0..9), tiles(0..9, 24..u32::MAX)];
    assert!(none.iter().all(Vec::is_empty), "{none:?}");
    assert!(Session::over(paged(&scene, 1 << 30), exec(usize::MAX)).is_err());
}

#[test]
fn a_sink_that_panics_ends_its_render_and_the_session_goes_on() {
    let folder = folder();
    let scene = scene(&workload_cloud("knot-20k", folder.path()), Kernel::Wyvill, true);
    let session = Session::over(paged(&scene, 1 << 30), exec(2)).expect("a session");
    let view = session.prepare(&scene, &settings(40, 40)).expect("a scene").view(&camera()).expect("a view");
    let expected = bits(&view.picture().expect("a picture").pixels);
    let work = Work::tiles(view.tiles(&view.region()));
    let mut panics =
        |_: &FinishedTile<'_>| -> Result<(), SinkError> { std::panic::resume_unwind(Box::new(7)) };
    let caught = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
        view.render(&work, &CancelToken::new(), &mut panics).map(drop)
    }));
    assert!(caught.is_err());
    assert!(bits(&view.picture().expect("a picture").pixels) == expected);
}

/// Cancels a picture at random moments within `longest`. Returns how long each call took to return
/// after that, sorted.
fn cancelled_at_random(view: &View, times: usize, longest: Duration) -> Vec<Duration> {
    let mut random = Random(3);
    let work = Work::tiles(view.tiles(&view.region()));
    let mut late: Vec<Duration> = (0..times)
        .map(|_| {
            let cancel = CancelToken::new();
            let canceller = {
                let (cancel, wait) = (cancel.clone(), longest.mul_f64(random.unit()));
                std::thread::spawn(move || {
                    std::thread::sleep(wait);
                    let now = Instant::now();
                    cancel.cancel();
                    now
                })
            };
            let outcome = view.render(&work, &cancel, &mut |_: &FinishedTile<'_>| Ok(()));
            let returned = Instant::now();
            assert!(matches!(outcome, Ok(_) | Err(RenderError::Cancelled)), "{outcome:?}");
            returned.saturating_duration_since(canceller.join().expect("it cancels"))
        })
        .collect();
    late.sort_unstable();
    late
}

/// Other tests keep the processors busy meanwhile: the bounds are wide, and what it takes on a
/// quiet machine stands in `docs/benchmarks.md`.
fn assert_prompt(late: &[Duration]) {
    let (median, most) = (late[late.len() / 2], late[late.len() * 99 / 100]);
    assert!(median < Duration::from_millis(100) && most < Duration::from_secs(1), "{median:?}, {most:?}");
}

#[test]
fn a_render_in_core_is_cancelled_at_once_and_leaves_nothing_retained() {
    let folder = folder();
    let (scene, settings) = shaded(folder.path());
    let settings = RenderSettings { shadows: Shadows::Exact, ..settings };
    let session = Session::over(paged(&scene, 1 << 30), exec(2)).expect("a session");
    let view = session.prepare(&scene, &settings).expect("a scene").view(&camera()).expect("a view");
    let expected = bits(&view.picture().expect("a picture").pixels);
    assert_prompt(&cancelled_at_random(&view, 60, Duration::from_millis(150)));
    assert_eq!(session.pages().retained_bytes(), 0);
    assert!(bits(&view.picture().expect("a picture").pixels) == expected);
    let cancelled = CancelToken::new();
    cancelled.cancel();
    let early =
        view.render(&Work::tiles(view.tiles(&view.region())), &cancelled, &mut |_: &FinishedTile<'_>| Ok(()));
    assert!(matches!(early, Err(RenderError::Cancelled)));
}

#[test]
fn a_render_that_waits_for_reads_of_two_seconds_is_cancelled_at_once() {
    let folder = folder();
    let scene = scene(&workload_cloud("sphere-100k", folder.path()), Kernel::Triweight, false);
    let settings = settings(64, 64);
    let expected = render_once(&scene, &camera(), &settings, &exec(2), &paged(&scene, 1 << 30));
    let pool = read::backend(BackendKind::Pool).expect("a pool");
    for predictor in [true, false] {
        let slow = Arc::new(Delayed::new(pool.clone(), Duration::from_secs(2)).expect("a thread"));
        let mut exec = exec(2);
        if !predictor {
            exec.predictor = Arc::new(rayset::trace::predict::NoPredictor);
        }
        // Room for few pages: some wait for their page, some for room.
        let page = u64::from(clouds_of(&scene)[0].header().page_bytes);
        let files = paged_with(&scene, 6 * page, slow, false);
        let session = Session::over(files, exec).expect("a session");
        let view = session.prepare(&scene, &settings).expect("a scene").view(&camera()).expect("a view");
        assert_prompt(&cancelled_at_random(&view, 60, Duration::from_millis(60)));
        assert_eq!(session.pages().retained_bytes(), 0);
    }
    let session = Session::over(paged(&scene, 1 << 30), exec(2)).expect("a session");
    let view = session.prepare(&scene, &settings).expect("a scene").view(&camera()).expect("a view");
    assert_prompt(&cancelled_at_random(&view, 10, Duration::from_millis(30)));
    let found = view.picture().expect("a picture");
    assert!(bits(&found.pixels) == bits(&expected.expect("a picture").0.pixels));
}

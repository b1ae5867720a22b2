//! Promise 1: the same picture, bit for bit, whatever the memory, threads, predictor, input, tiles,
//! slabs and cache.

use std::sync::Arc;
use std::time::Duration;

use rayset::cancel::CancelToken;
use rayset::field::Kernel;
use rayset::geometry::{DAffine3, DVec3};
use rayset::octree::build::BuildOptions;
use rayset::points::ArraySource;
use rayset::scene::{
    Camera, Form, Node, Operator, RenderSettings, SampleOffset, Samples, Scene, Shape, Step,
};
use rayset::trace::memory::least_pages;
use rayset::trace::predict::{LinePredictor, NoPredictor, PacketPredictor, Predictor};
use rayset::trace::{ExecSettings, Picture, Region, Session, View, render_once};
use rayset::working_set::read::{self, BackendKind, Delayed, Transport};

use crate::common::{
    bits, build_at, camera, clouds_of, folder, look, mixed_points, paged, paged_with, picture, plain_picture,
    points_in_few_places, scene, settings, workload_cloud,
};
use crate::graph::{scene as graph_scene, solid, turned_and_stretched};

fn exec(threads: usize) -> ExecSettings {
    ExecSettings { threads, ..ExecSettings::default() }
}

/// Four scenes. The first is a small sphere. The next two, under a headlight with hashed phases,
/// are a cloud of many radii and one of few places. In the last, steps differ from place to place
/// for many reasons: a ball is cut out of a cloud of many radii, and a moved cloud stands beside
/// it.
fn scenes(folder: &std::path::Path) -> Vec<(Scene, RenderSettings)> {
    let sphere = workload_cloud("sphere-40k", folder);
    let options = BuildOptions { page_bytes: Some(16 << 10), ..BuildOptions::default() };
    let mixed = build_at(&folder.join("mixed.rset"), Box::new(mixed_points(20_000, 6.0, 11)), &options);
    let few = points_in_few_places(60, 2000.0);
    let few = build_at(&folder.join("few.rset"), Box::new(few), &options);
    let cloud = |cloud, kernel| Node::new(Shape::Cloud(look(cloud, kernel)));
    let ball = solid(Form::Sphere { radius: 0.5 }, [0.2, 0.4, 0.8]);
    let ball = ball.moved(DAffine3::from_translation(DVec3::new(0.4, 0.3, 0.6)));
    let cut = Node::operator(Operator::Difference, [cloud(&mixed, Kernel::WendlandC2), ball]);
    let moved = cloud(&sphere, Kernel::Wyvill).moved(turned_and_stretched());
    let cut = graph_scene(Node::operator(Operator::Union, [moved, cut]), vec![]);
    let plain = settings(48, 40);
    let hashed = RenderSettings { sample_offset: SampleOffset::Hashed, ..plain };
    vec![
        (scene(&sphere, Kernel::Triweight, false), plain),
        (scene(&mixed, Kernel::Wyvill, true), hashed),
        (scene(&few, Kernel::Wyvill, true), hashed),
        (cut, RenderSettings { samples: Samples::Fixed(1), ..plain }),
    ]
}

#[test]
fn the_picture_is_the_same_for_every_budget_thread_count_predictor_and_backend() {
    let folder = folder();
    for (scene, settings) in scenes(folder.path()) {
        let is_graph = clouds_of(&scene).len() > 1;
        let expected = bits(&plain_picture(&scene, &settings));
        let page = u64::from(clouds_of(&scene)[0].header().page_bytes);
        let predictors: [Arc<dyn Predictor>; 3] =
            [Arc::new(NoPredictor), Arc::new(LinePredictor), Arc::new(PacketPredictor::default())];
        let mut backends: Vec<Arc<dyn Transport>> = vec![read::backend(BackendKind::Pool).expect("a pool")];
        if let Ok(uring) = read::backend(BackendKind::Uring) {
            backends.push(uring);
        }
        let pool = read::backend(BackendKind::Pool).expect("a pool");
        backends.push(Arc::new(Delayed::new(pool, Duration::from_micros(200)).expect("a thread")));
        for threads in [1, 2, 3] {
            for budget_pages in [least_pages(threads), 3 * least_pages(threads), 10_000] {
                for predictor in &predictors {
                    for backend in &backends {
                        for direct in [false, true] {
                            // Slow by design, and no different: once is enough.
                            if backend.name().contains("a read") && (threads != 2 || direct) {
                                continue;
                            }
                            // The same holds for a picture of several objects.
                            if is_graph && (threads == 2 || direct) {
                                continue;
                            }
                            let set = paged_with(&scene, budget_pages * page, backend.clone(), direct);
                            let exec = ExecSettings { predictor: predictor.clone(), ..exec(threads) };
                            let found =
                                picture(&scene, &camera(), &settings, &exec, &set).expect("a picture");
                            let what = format!(
                                "{threads} threads, {budget_pages} pages, {}, {}, direct {direct}",
                                predictor.name(),
                                backend.name()
                            );
                            assert!(bits(&found) == expected, "{what}");
                            let peak = set.pages.statistics().peak_bytes;
                            assert!(peak <= budget_pages * page, "{what}: {peak} bytes of pages");
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn tiles_that_are_put_off_become_the_same_pixels() {
    let folder = folder();
    for (scene, settings) in scenes(folder.path()) {
        let expected = bits(&plain_picture(&scene, &settings));
        let pool = read::backend(BackendKind::Pool).expect("a pool");
        let slow = Arc::new(Delayed::new(pool, Duration::from_millis(5)).expect("a thread"));
        let paged = paged_with(&scene, 1 << 30, slow, false);
        let rendered = render_once(&scene, &camera(), &settings, &exec(2), &paged);
        let (found, counts) = rendered.expect("a picture");
        assert!(counts.deferred > 0, "nothing was deferred");
        assert!(bits(&found.pixels) == expected);
    }
}

#[test]
fn looking_about_for_what_the_rest_costs_changes_no_pixel_and_no_count_of_samples() {
    let folder = folder();
    for (scene, settings) in scenes(folder.path()) {
        for samples in [settings.samples, Samples::Auto { exposure: 0.0 }] {
            let settings = RenderSettings { samples, layers: true, ..settings };
            let page = u64::from(clouds_of(&scene)[0].header().page_bytes);
            let rendered = |estimates_after: Option<Duration>, threads: usize| {
                let paged = paged(&scene, least_pages(threads) * page);
                let exec = ExecSettings { estimates_after, ..exec(threads) };
                render_once(&scene, &camera(), &settings, &exec, &paged).expect("a picture")
            };
            let (expected, counts) = rendered(None, 1);
            for threads in [1, 3] {
                let (found, found_counts) = rendered(Some(Duration::ZERO), threads);
                assert!(format!("{found:?}") == format!("{expected:?}"), "{samples:?}, {threads} threads");
                let samples_of = |counts: &rayset::RenderCounts| (counts.rays, counts.samples);
                assert_eq!(samples_of(&found_counts), samples_of(&counts), "{threads} threads");
            }
        }
    }
}

#[test]
fn where_the_pages_of_a_tile_do_not_fit_looking_ahead_reads_hardly_more_than_not_to() {
    let folder = folder();
    let scene = scene(&workload_cloud("sphere-1m", folder.path()), Kernel::Triweight, false);
    let page = u64::from(clouds_of(&scene)[0].header().page_bytes);
    for budget_pages in [20, 28, 40] {
        let reads = |predictor: Arc<dyn Predictor>| {
            let paged = paged(&scene, budget_pages * page);
            let exec = ExecSettings { predictor, ..exec(1) };
            render_once(&scene, &camera(), &settings(16, 16), &exec, &paged).expect("a picture");
            paged.pages.statistics().total(|kind| kind.reads)
        };
        let (without, with) = (reads(Arc::new(NoPredictor)), reads(Arc::new(PacketPredictor::default())));
        assert!(
            with as f64 <= 1.25 * without as f64,
            "{budget_pages} pages: {with} reads, {without} without"
        );
    }
}

#[test]
fn the_picture_is_the_same_for_every_tile_slab_and_band() {
    let folder = folder();
    for (scene, settings) in scenes(folder.path()) {
        let expected = bits(&plain_picture(&scene, &settings));
        let set = paged(&scene, 1 << 30);
        for (tile_pixels, slab_samples, band_rows) in
            [(8, 32, 8), (1, 32, 100), (3, 16, 7), (5, 1, 100), (8, 7, 33)]
        {
            let exec = ExecSettings { tile_pixels, slab_samples, ..exec(2) };
            let session = Session::over(set.clone(), exec).expect("a session");
            let prepared = session.prepare(&scene, &settings).expect("a scene");
            let view = prepared.view(&camera()).expect("a view");
            let mut found = Picture::default();
            view.render_bands(&view.region(), band_rows, &CancelToken::new(), &mut found).expect("a picture");
            assert!(
                bits(&found.pixels) == expected,
                "tiles of {tile_pixels}, slabs of {slab_samples}, bands of {band_rows}"
            );
        }
    }
}

#[test]
fn steps_that_single_precision_cannot_count_give_the_same_picture_for_every_slab() {
    let folder = folder();
    // A run as long as a hundred radii, and a step of which forty million lie across it.
    let position = (0..128).map(|i| [f64::from(i) - 64.0, 0.0, 0.0]).collect();
    let source = ArraySource::new(position, vec![("radius", vec![1.0; 128])]);
    let cloud = build_at(&folder.path().join("long.rset"), Box::new(source), &BuildOptions::default());
    let scene = scene(&cloud, Kernel::Wyvill, false);
    let settings = RenderSettings { step: Step::Fixed(3e-6), stop_transmittance: 0.9999, ..settings(4, 4) };
    let eye = Camera::look_at(DVec3::new(0.0, 0.2, 1.0001), DVec3::ZERO, DVec3::Y, 0.02);
    let set = paged(&scene, 1 << 30);
    let mut pictures = [32, 31, 7].map(|slab_samples| {
        let exec = ExecSettings { slab_samples, ..exec(2) };
        bits(&picture(&scene, &eye, &settings, &exec, &set).expect("a picture"))
    });
    assert!(f32::from_bits(pictures[0][5][3]) > 0.0);
    pictures.sort_unstable();
    assert!(pictures[0] == pictures[2]);
}

#[test]
fn a_view_with_other_samples_is_that_of_a_scene_prepared_with_them() {
    let folder = folder();
    let (scene, settings) = scenes(folder.path()).swap_remove(1);
    let session = Session::over(paged(&scene, 1 << 30), exec(1)).expect("a session");
    let view = |samples: u32| {
        let settings = settings.with_samples(samples);
        session.prepare(&scene, &settings).expect("a scene").view(&camera()).expect("a view")
    };
    let pixels = |view: &View| bits(&view.picture().expect("a picture").pixels);
    let (one, four) = (pixels(&view(1)), pixels(&view(2)));
    assert!(one != four);
    assert!(pixels(&view(2).with_samples(1).expect("in range")) == one);
    assert!(pixels(&view(1).with_samples(2).expect("in range")) == four);
    for samples in [0, 65] {
        assert!(view(1).with_samples(samples).is_err(), "{samples}");
    }
}

#[test]
fn a_pixel_alone_and_a_part_of_the_picture_equal_the_whole() {
    let folder = folder();
    for (scene, settings) in scenes(folder.path()) {
        let whole = bits(&plain_picture(&scene, &settings));
        let set = paged(&scene, 1 << 30);
        let session = Session::over(set, exec(1)).expect("a session");
        let prepared = session.prepare(&scene, &settings).expect("a scene");
        let view = prepared.view(&camera()).expect("a view");
        for (columns, rows) in [(30..31, 20..21), (11..12, 34..35), (5..40, 17..23), (0..48, 39..40)] {
            let region = Region { columns, rows };
            let mut sink = Picture::default();
            view.render_bands(&region, u32::MAX, &CancelToken::new(), &mut sink).expect("a picture");
            let mut found = bits(&sink.pixels).into_iter();
            for y in region.rows.clone() {
                for x in region.columns.clone() {
                    assert_eq!(
                        found.next(),
                        Some(whole[(y * settings.width + x) as usize]),
                        "pixel {x}, {y}"
                    );
                }
            }
        }
    }
}

#[test]
fn instruction_sets_agree_within_a_thousandth() {
    let folder = folder();
    for (scene, settings) in scenes(folder.path()) {
        let settings = RenderSettings { step: Step::Fixed(0.02), ..settings };
        let set = paged(&scene, 1 << 30);
        let mut pictures = rayset::field::SimdLevel::available().into_iter().map(|simd| {
            let exec = ExecSettings { simd, ..exec(2) };
            picture(&scene, &camera(), &settings, &exec, &set).expect("a picture")
        });
        let best = pictures.next().expect("at least one level");
        for other in pictures {
            let far =
                best.iter().zip(&other).filter(|(a, b)| (0..4).any(|c| (a[c] - b[c]).abs() > 1.0 / 1024.0));
            assert!(far.count() * 1000 <= best.len(), "more than a thousandth of the pixels differ");
        }
    }
}

#[test]
fn a_budget_may_change_while_rendering() {
    let folder = folder();
    let (scene, settings) = scenes(folder.path()).remove(0);
    let expected = bits(&plain_picture(&scene, &settings));
    let page = u64::from(clouds_of(&scene)[0].header().page_bytes);
    let set = paged(&scene, 40 * page);
    let (changing, done) = (set.pages.clone(), Arc::new(std::sync::atomic::AtomicBool::new(false)));
    let stop = done.clone();
    let changer = std::thread::spawn(move || {
        let mut pages = 40;
        while !stop.load(std::sync::atomic::Ordering::Relaxed) {
            pages = if pages == 40 { 6 } else { 40 };
            changing.set_limits(rayset::working_set::Limits::total(pages * page));
            std::thread::sleep(Duration::from_millis(1));
        }
    });
    for _ in 0..3 {
        let found = picture(&scene, &camera(), &settings, &exec(2), &set).expect("a picture");
        assert!(bits(&found) == expected);
    }
    done.store(true, std::sync::atomic::Ordering::Relaxed);
    changer.join().expect("the changer ends");
}

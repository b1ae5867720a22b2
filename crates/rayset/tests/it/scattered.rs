//! Points far apart, far smaller than others, or in one place: what rays do not meet costs them
//! nothing, and execution settings change no bit. (`steps_by_place` has the steps of their rays.)

use std::sync::Arc;

use rayset::field::Kernel;
use rayset::octree::Cloud;
use rayset::octree::build::BuildOptions;
use rayset::octree::node::NodePage;
use rayset::paged_file::HasPages;
use rayset::points::ArraySource;
use rayset::scene::{OpacityRule, RenderSettings, Scene, Step};
use rayset::trace::memory::least_pages;
use rayset::trace::reference::{ReferenceRenderer, ReferenceSteps};
use rayset::trace::{ExecSettings, RenderCounts, render_once};

use crate::common::{
    Random, bits, build_at, camera, folder, look, paged, picture, plain_picture, scene, scene_of, settings,
};

/// Points in a cube, all with radii between two of them, as often in each octave.
fn cube(count: usize, smallest: f64, largest: f64, seed: u64) -> (Vec<[f64; 3]>, Vec<f32>) {
    let mut random = Random(seed);
    let points = (0..count).map(|_| {
        let position: [f64; 3] = std::array::from_fn(|_| random.unit() - 0.5);
        (position, (largest * (smallest / largest).powf(random.unit())) as f32)
    });
    points.unzip()
}

fn cloud(folder: &std::path::Path, (position, radius): (Vec<[f64; 3]>, Vec<f32>)) -> Arc<Cloud> {
    let options = BuildOptions { page_bytes: Some(16 << 10), ..BuildOptions::default() };
    let source = ArraySource::new(position, vec![("radius", radius)]);
    build_at(&folder.join("c.rset"), Box::new(source), &options)
}

fn counts(scene: &Scene, settings: &RenderSettings) -> RenderCounts {
    let exec = ExecSettings { threads: 2, ..ExecSettings::default() };
    render_once(scene, &camera(), settings, &exec, &paged(scene, 1 << 30)).expect("a picture").1
}

#[test]
fn points_that_differ_by_100_000_cost_a_ray_no_more_than_those_that_it_meets() {
    let folder = folder();
    let cloud = cloud(folder.path(), cube(3000, 3e-6, 0.3, 1));
    let counts = counts(&scene(&cloud, Kernel::Wyvill, true), &settings(32, 32));
    // A quarter of the finest radius over the whole length of all rays would be 2 500 million
    // samples.
    assert!(counts.nonzero_samples > 1024, "{counts:?}");
    assert!(counts.samples < 4_000_000, "{counts:?}");
}

#[test]
fn one_point_of_no_size_costs_the_rays_that_miss_it_nothing() {
    let folder = folder();
    let (mut position, mut radius) = cube(300, 0.1, 0.1, 2);
    let without = cloud(folder.path(), (position.clone(), radius.clone()));
    let object = look(&without, Kernel::Wyvill);
    let least = counts(&scene_of(object.clone(), false), &settings(32, 32));
    position.push([0.123, 0.234, 0.345]);
    radius.push(1e-12);
    let with = cloud(folder.path(), (position, radius));
    let object = rayset::scene::CloudObject { cloud: with, ..object };
    let counts = counts(&scene_of(object, false), &settings(32, 32));
    assert!(counts.samples <= 2 * least.samples, "{counts:?} instead of {least:?}");
}

#[test]
fn tiny_points_far_apart_cost_a_ray_no_more_than_those_that_it_meets() {
    let folder = folder();
    let cloud = cloud(folder.path(), cube(3000, 1e-9, 1e-9, 3));
    let counts = counts(&scene(&cloud, Kernel::Wyvill, false), &settings(32, 32));
    assert!(counts.slabs < 10_000, "{counts:?}");
}

#[test]
fn scattered_points_make_the_same_picture_for_every_tile_slab_budget_and_thread_count() {
    let folder = folder();
    let cloud = cloud(folder.path(), cube(6000, 1e-4, 0.2, 4));
    let scene = scene(&cloud, Kernel::Triweight, true);
    let settings = settings(32, 24);
    let expected = bits(&plain_picture(&scene, &settings));
    let page = u64::from(cloud.header().page_bytes);
    for (threads, pages, tile_pixels, slab_samples) in
        [(1, least_pages(1), 8, 32), (3, least_pages(3), 3, 7), (2, 1000, 1, 1), (2, 10, 5, 32)]
    {
        let exec = ExecSettings { threads, tile_pixels, slab_samples, ..ExecSettings::default() };
        let paged = paged(&scene, pages * page);
        let found = picture(&scene, &camera(), &settings, &exec, &paged).expect("a picture");
        assert!(bits(&found) == expected, "{threads} threads, {pages} pages, {tile_pixels}, {slab_samples}");
    }
}

#[test]
fn more_wide_points_than_a_node_keeps_runs_of_by_themselves_are_all_seen() {
    // More than 512 runs of the root's own, at two ends of the cloud: no run may be taken to lie
    // where others do.
    let mut random = Random(6);
    let mut position = Vec::new();
    for _ in 0..70_000 {
        let end = if random.unit() < 0.5 { -0.8 } else { 0.8 };
        let p: [f64; 3] = std::array::from_fn(|_| 0.2 * (random.unit() - 0.5));
        position.push([p[0], p[1], p[2] + end]);
    }
    let folder = folder();
    let radius = vec![2.5; position.len()];
    let cloud = cloud(folder.path(), (position, radius));
    let mut most_own_runs = 0;
    cloud
        .stored_file()
        .for_each_page(|page, bytes| {
            if page >= cloud.header().point_pages {
                let nodes = NodePage::trusted(bytes);
                let own = (0..nodes.len()).filter_map(|i| nodes.get(i)).map(|node| node.own.runs);
                most_own_runs = own.chain([most_own_runs]).max().unwrap_or(0);
            }
        })
        .expect("it reads");
    assert!(most_own_runs > 512, "{most_own_runs} runs of one node");
    let mut object = look(&cloud, Kernel::Wyvill);
    object.transfer.opacity = OpacityRule::Extinction(3e-5);
    let scene = scene_of(object, false);
    // Steps of which a ray takes several slabs through the cloud.
    let step = 0.05;
    let settings = RenderSettings { stop_transmittance: 0.0, step: Step::Fixed(step), ..settings(24, 24) };
    let fast = plain_picture(&scene, &settings);
    let reference_renderer = ReferenceRenderer::load(&scene).expect("it reads");
    for (x, y) in [(12, 12), (8, 12), (12, 17), (6, 6), (17, 9)] {
        let exact = reference_renderer
            .pixel(&camera(), &settings, &ReferenceSteps::same(step), x, y)
            .expect("a camera");
        let found = fast[(y * 24 + x) as usize];
        assert!(exact[3] > 0.05, "pixel {x}, {y} shows something");
        for c in 0..4 {
            assert!((f64::from(found[c]) - exact[c]).abs() <= 1.0 / 1024.0, "{x}, {y}: {found:?}, {exact:?}");
        }
    }
}

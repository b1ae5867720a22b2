//! The renderer sees of points from afar what the judge says that is seen of them. How the work is
//! done makes no difference. Points that are large are seen as they always were.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use rayset::cancel::CancelToken;
use rayset::container::{PAGE_HEAD_BYTES, reseal};
use rayset::field::Kernel;
use rayset::geometry::DVec3;
use rayset::octree::Cloud;
use rayset::octree::aggregates::{AGGREGATE_BYTES, AggregateOptions, add_to_file};
use rayset::octree::build::{BuildOptions, Rule};
use rayset::points::{ArraySource, Workload};
use rayset::scene::{
    Camera, CloudObject, ColorMap, ColorRule, Lighting, Lod, MapInput, OpacityRule, Projection,
    RenderSettings, Samples, Scene, Step, TransferFunction,
};
use rayset::trace::reference::far::{Far, pixels};
use rayset::trace::{ExecSettings, render_once};
use rayset::working_set::Limits;
use rayset::{Picture, Region, Session};
use rayset_lab::simulated::Behaviour;

use crate::common::{Random, bits, build_at, folder, mixed_points, paged, picture, scene_of, settings};
use crate::remote_storage::{quick, remote};

fn add(path: &Path) {
    let options = AggregateOptions::default().with_memory_bytes(64 << 20).with_threads(2);
    add_to_file(path, path, &options, &|_, _| {}, &CancelToken::new()).expect("aggregates");
}

/// A cloud in a file, around the origin, seen from a distance.
fn seen_from(path: &Path, distance: f64) -> (CloudObject, Camera) {
    let cloud = Arc::new(Cloud::open(path).expect("it opens"));
    let transfer = TransferFunction { opacity: OpacityRule::Clamp, color: ColorRule::Uniform([1.0; 3]) };
    let position = DVec3::new(0.0, 0.0, -distance);
    let projection = Projection::Perspective { fovy: 2.0 * (1.3 / distance).atan() };
    let camera = Camera { position, direction: DVec3::Z, up: DVec3::Y, projection };
    (CloudObject { transfer, ..CloudObject::plain(cloud) }, camera)
}

fn sphere(path: &Path, name: &str) {
    let workload: Workload = name.parse().expect("a workload");
    let asked = BuildOptions { radius: workload.radius().map(Rule::Number), ..BuildOptions::default() };
    build_at(path, workload.source(), &asked);
    add(path);
}

/// The mean and the largest difference of a picture's opacities from those of the judge.
fn compare(object: &CloudObject, camera: &Camera, size: u32, lod: Lod) -> (f64, f64) {
    let scene = Scene { lighting: Lighting::Unlit, ..Scene::of_cloud(object.clone()) };
    let settings = settings(size, size).with_lod(lod).with_step(Step::Automatic { fraction: 0.1 });
    let settings = settings.with_stop_transmittance(0.0);
    let picture = picture(&scene, camera, &settings, &ExecSettings::default(), &paged(&scene, 1 << 30));
    let far = Far::new(object, scene.unit_distance, (camera, size, size), lod).expect("a file");
    let judged = pixels(&far.expect("aggregates"), (camera, size, size));
    let (mut sum, mut most) = (0.0, 0.0_f64);
    for (pixel, judged) in picture.expect("a picture").iter().zip(&judged) {
        let off = f64::from(pixel[3]) - judged.opacity;
        sum += off.abs();
        most = most.max(off.abs());
    }
    (sum / judged.len() as f64, most)
}

#[test]
fn pictures_from_afar_are_those_of_the_judge() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    sphere(&path, "sphere-100000");
    let (mut object, camera) = seen_from(&path, 3.0);
    for (rule, size, lod) in [
        (OpacityRule::Clamp, 48, Lod::AUTO),
        (OpacityRule::Clamp, 48, Lod::Footprint(0.4)),
        (OpacityRule::Extinction(0.5), 32, Lod::AUTO),
        (OpacityRule::Extinction(40.0), 24, Lod::Footprint(3.0)),
        (OpacityRule::Clamp, 48, Lod::Coarse(4.0)),
    ] {
        object.transfer.opacity = rule;
        let (mean, most) = compare(&object, &camera, size, lod);
        assert!(mean < 2e-3 && most < 0.02, "{size} {lod:?}: {mean}, {most}");
    }
    let source = mixed_points(20_000, 6.0, 8);
    build_at(&path, Box::new(source), &BuildOptions::default());
    add(&path);
    let (object, camera) = seen_from(&path, 3.0);
    for lod in [Lod::Footprint(0.3), Lod::AUTO, Lod::Footprint(4.0), Lod::Coarse(2.0), Lod::Coarse(4.0)] {
        let (mean, most) = compare(&object, &camera, 24, lod);
        assert!(mean < 2e-3 && most < 0.02, "mixed {lod:?}: {mean}, {most}");
    }
}

/// What a thin cloud, whose opacities are linear in the density, takes of the light altogether is
/// the same from near and from afar, down to where it is ten pixels wide.
#[test]
fn optical_depths_of_all_pixels_sum_to_the_same_over_a_zoom() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    sphere(&path, "sphere-100000");
    let (mut object, camera) = seen_from(&path, 3.0);
    object.transfer.opacity = OpacityRule::Extinction(0.02);
    let scene = Scene { lighting: Lighting::Unlit, ..Scene::of_cloud(object) };
    let depth = |lod: Lod, size: u32, height: f64| {
        let camera = Camera { projection: Projection::Orthographic { height }, ..camera };
        let settings = settings(size, size).with_lod(lod);
        let paged = paged(&scene, 1 << 30);
        let seen = picture(&scene, &camera, &settings, &ExecSettings::default(), &paged).expect("a picture");
        let sum: f64 = seen.iter().map(|pixel| -f64::from(-pixel[3]).ln_1p()).sum();
        sum * (height / f64::from(size)).powi(2)
    };
    let all = depth(Lod::Off, 96, 2.4);
    for lod in [Lod::AUTO, Lod::COARSE] {
        for (size, height) in [(96, 2.4), (48, 2.4), (24, 2.4), (12, 2.4)] {
            let of_all = depth(lod, size, height) / all;
            assert!((of_all - 1.0).abs() < 0.01, "{lod:?}, {size} pixels over {height}: {of_all}");
        }
    }
}

/// With layers and without, by one thread and by two.
#[test]
fn errors_that_are_told_are_those_of_the_judge_and_none_of_pictures_of_all_points() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    build_at(&path, Box::new(mixed_points(20_000, 6.0, 8)), &BuildOptions::default());
    add(&path);
    let (object, camera) = seen_from(&path, 3.0);
    let scene = Scene { lighting: Lighting::Unlit, ..Scene::of_cloud(object.clone()) };
    let rendered = |lod: Lod, layers: bool, threads: usize| {
        let session = Session::builder().memory(256 << 20).threads(threads).build().expect("a session");
        let settings = settings(24, 24).with_lod(lod).with_step(Step::Automatic { fraction: 0.1 });
        let settings = RenderSettings { layers, stop_transmittance: 0.0, ..settings };
        let view = session.prepare(&scene, &settings).and_then(|scene| scene.view(&camera)).expect("a view");
        let mut seen = Picture::default();
        let counts =
            view.render_bands(&Region { columns: 0..24, rows: 0..24 }, 24, &CancelToken::new(), &mut seen);
        (seen, counts.expect("a picture").lod_errors)
    };
    let far = Far::new(&object, scene.unit_distance, (&camera, 24, 24), Lod::AUTO).expect("a file");
    let judged = pixels(&far.expect("aggregates"), (&camera, 24, 24));
    let (seen, told) = rendered(Lod::AUTO, true, 1);
    let differences = seen.layers.iter().zip(&judged);
    let differences = differences.map(|(seen, judged)| f64::from(seen.lod_error) - judged.bound_of_error);
    let (mean, most) =
        differences.fold((0.0, 0.0_f64), |(sum, most), by| (sum + by.abs(), most.max(by.abs())));
    assert!(mean / 576.0 < 1e-3 && most < 0.02, "{} {most}", mean / 576.0);
    let (mut from_afar, mut sum) = (0, 0.0);
    for layers in &seen.layers {
        from_afar += u64::from(layers.lod_error > 0.0);
        sum += f64::from(layers.lod_error);
    }
    assert!(from_afar > 300 && (told.pixels, told.from_afar) == (576, from_afar), "{told:?}");
    assert!((told.mean().expect("some are from afar") - 0.2 * sum / from_afar as f64).abs() < 1e-6);
    let (without, told_without) = rendered(Lod::AUTO, false, 2);
    assert!(without.layers.is_empty() && without.pixels == seen.pixels && told_without == told);
    let (all, told) = rendered(Lod::Off, true, 1);
    assert!(all.layers.iter().all(|layers| layers.lod_error == 0.0) && told.mean().is_none());
}

/// Cells of two to four pixels are seen in part, and their points, of one to two pixels in radius,
/// as densities by the rest.
#[test]
fn points_of_a_pixel_are_densities_beside_coarse_cells_as_the_judge_has_it() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    let mut random = Random(23);
    let position = (0..20_000).map(|_| [0; 3].map(|_| 2.0 * random.unit() - 1.0)).collect();
    let asked = BuildOptions { radius: Some(Rule::Number(0.11)), ..BuildOptions::default() };
    build_at(&path, Box::new(ArraySource::new(position, Vec::new())), &asked);
    add(&path);
    let (mut object, camera) = seen_from(&path, 4.0);
    object.transfer.opacity = OpacityRule::Extinction(0.002);
    for size in [34, 38, 42] {
        let (mean, most) = compare(&object, &camera, size, Lod::COARSE);
        assert!(mean < 1e-5 && most < 1e-4, "{size}: {mean}, {most}");
    }
}

/// Points that are densities overlap others that are seen from afar: their colours are those of the
/// density of both.
#[test]
fn colours_of_densities_from_afar_are_those_of_many_rays() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    build_at(&path, Box::new(mixed_points(20_000, 4.0, 4)), &BuildOptions::default());
    add(&path);
    let (mut object, camera) = seen_from(&path, 4.0);
    let map = ColorMap::named("inferno".parse().expect("a map"), (0.0, 40.0));
    object.transfer.color = ColorRule::Map { map, input: MapInput::Density };
    object.transfer.opacity = OpacityRule::Extinction(0.2);
    let scene = Scene { lighting: Lighting::Unlit, ..Scene::of_cloud(object) };
    let seen = |lod: Lod, samples: u32| {
        let settings = settings(24, 24).with_lod(lod).with_samples(Samples::Fixed(samples));
        picture(&scene, &camera, &settings, &ExecSettings::default(), &paged(&scene, 1 << 30))
            .expect("a picture")
    };
    let (truth, from_afar) = (seen(Lod::Off, 8), seen(Lod::Footprint(2.0), 1));
    for channel in 0..4 {
        let mean = |pixels: &[[f32; 4]]| pixels.iter().map(|p| f64::from(p[channel])).sum::<f64>() / 576.0;
        let (is, was) = (mean(&from_afar), mean(&truth));
        assert!((is / was - 1.0).abs() < 0.1 && was > 0.002, "{channel}: {is} of {was}");
    }
}

/// Where clusters are made of points of many sizes, too.
#[test]
fn points_of_one_colour_have_it_from_afar() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    let mut random = Random(3);
    let (mut position, mut columns) = (Vec::new(), vec![Vec::new(); 4]);
    for _ in 0..40_000 {
        position.push([0; 3].map(|_| 2.0 * random.unit() - 1.0));
        columns[0].push((0.06 * 2_f64.powf(-4.0 * random.unit())) as f32);
        for (column, value) in columns[1..].iter_mut().zip([0.8, 0.5, 0.2]) {
            column.push(value);
        }
    }
    let names = ["radius", "red", "green", "blue"];
    let source = ArraySource::new(position, names.into_iter().zip(columns).collect());
    build_at(&path, Box::new(source), &BuildOptions::default());
    add(&path);
    let (mut object, camera) = seen_from(&path, 4.0);
    object.transfer.color = ColorRule::Points;
    object.transfer.opacity = OpacityRule::Extinction(0.2);
    let scene = Scene { lighting: Lighting::Unlit, ..Scene::of_cloud(object) };
    let with = |lod: Lod| {
        let settings = settings(24, 24).with_lod(lod);
        picture(&scene, &camera, &settings, &ExecSettings::default(), &paged(&scene, 1 << 30))
            .expect("a picture")
    };
    let color_of = |pixels: &[[f32; 4]]| {
        let sum = |channel: usize| pixels.iter().map(|p| f64::from(p[channel])).sum::<f64>();
        [0, 1, 2].map(|channel| sum(channel) / sum(3))
    };
    let whole = color_of(&with(Lod::Off));
    for factor in [0.7, 1.0, 1.4, 3.0] {
        for (is, was) in color_of(&with(Lod::Footprint(factor))).into_iter().zip(whole) {
            assert!((is / was - 1.0).abs() < 2e-3, "{factor}: {is} of {was}");
        }
    }
}

/// A lit scene with colours, shadows and layers' worth of outputs.
fn lit(object: CloudObject) -> Scene {
    scene_of(object, true)
}

#[test]
fn pictures_from_afar_depend_on_no_execution_setting() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    build_at(&path, Box::new(mixed_points(60_000, 5.0, 3)), &BuildOptions::default());
    add(&path);
    let (object, camera) = seen_from(&path, 4.0);
    let scene = lit(object);
    for lod in [Lod::Footprint(0.5), Lod::Footprint(2.0), Lod::Coarse(3.0)] {
        let settings = settings(40, 32).with_lod(lod);
        let with = |exec: &ExecSettings, budget: u64| {
            bits(&picture(&scene, &camera, &settings, exec, &paged(&scene, budget)).expect("a picture"))
        };
        let plain = with(&ExecSettings::default(), 1 << 30);
        for (threads, tile_pixels, slab_samples, budget) in
            [(1, 8, 32, 1 << 20), (3, 5, 8, 1 << 30), (2, 1, 32, 1 << 30), (2, 3, 1, 2 << 20)]
        {
            let exec = ExecSettings { threads, tile_pixels, slab_samples, ..ExecSettings::default() };
            assert!(with(&exec, budget) == plain, "{lod:?}: {threads} {tile_pixels} {slab_samples} {budget}");
        }
    }
}

/// What rays will need is looked for ahead, records of aggregates among it: one after another, each
/// would take a round trip.
#[test]
fn remote_clouds_seen_from_afar_make_the_same_picture_and_tiles_are_hardly_put_off() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    let workload: Workload = "sphere-200k".parse().expect("a workload");
    let radius = workload.radius().map(Rule::Number);
    let options = BuildOptions { radius, page_bytes: Some(16384), ..BuildOptions::default() };
    build_at(&path, workload.source(), &options);
    add(&path);
    let (object, camera) = seen_from(&path, 4.0);
    let file = std::fs::read(&path).expect("the file");
    let seen = |cloud: Arc<Cloud>, threads: usize, budget: u64, lod: Lod| {
        let scene = lit(CloudObject { cloud, ..object.clone() });
        let session = Session::builder().threads(threads).page_limits(Limits::total(budget)).build();
        let prepared = session.expect("a session").prepare(&scene, &settings(96, 96).with_lod(lod));
        let view = prepared.expect("a scene").view(&camera).expect("a view");
        let mut seen = Picture::default();
        let counts = view.render_bands(&view.region(), u32::MAX, &CancelToken::new(), &mut seen);
        (bits(&seen.pixels), counts.expect("a picture").deferred)
    };
    for lod in [Lod::AUTO, Lod::COARSE] {
        let (expected, _) = seen(object.cloud.clone(), 1, 1 << 30, lod);
        for (threads, budget) in [(1, 1 << 30), (3, 1 << 30), (2, 64 * 16384)] {
            let behaviour = Behaviour { latency: Duration::from_millis(5), ..Behaviour::default() };
            let (_, storage) = remote(&file, behaviour, quick());
            let cloud = Arc::new(Cloud::from_storage("remote", Arc::new(storage)).expect("a cloud"));
            let (picture, deferred) = seen(cloud, threads, budget, lod);
            assert!(picture == expected, "{lod:?}: {threads} threads, {budget} bytes");
            // Otherwise most tiles are, some of them several times.
            let most = if threads == 1 { 60 } else { u64::MAX };
            assert!(deferred <= most, "{lod:?}: {deferred} of 144 tiles");
        }
    }
}

#[test]
fn points_of_two_pixels_and_more_are_seen_as_without_level_of_detail() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    sphere(&path, "sphere-20000");
    let (object, camera) = seen_from(&path, 4.0);
    let scene = lit(object);
    let with = |size: u32, lod: Lod| {
        let settings = settings(size, size).with_lod(lod);
        bits(
            &picture(&scene, &camera, &settings, &ExecSettings::default(), &paged(&scene, 1 << 30))
                .expect("a picture"),
        )
    };
    assert!(with(96, Lod::AUTO) == with(96, Lod::Off));
    assert!(with(24, Lod::AUTO) != with(24, Lod::Off), "nothing is seen from afar");
    // Another kernel than that of the aggregates.
    let mut object = seen_from(&path, 4.0).0;
    object.kernel = Kernel::Triweight;
    let other = lit(object);
    let session = rayset::Session::builder().build().expect("a session");
    let prepared = session.prepare(&other, &settings(24, 24).with_lod(Lod::AUTO)).expect("a scene");
    assert!(
        matches!(prepared.remarks(), [said] if said.contains("another kernel")),
        "{:?}",
        prepared.remarks()
    );
    let with = |lod: Lod| {
        let settings = settings(24, 24).with_lod(lod);
        bits(
            &picture(&other, &camera, &settings, &ExecSettings::default(), &paged(&other, 1 << 30))
                .expect("a picture"),
        )
    };
    assert!(with(Lod::AUTO) == with(Lod::Off));
}

/// Specks beside large points ask for double precision only until they are left out of the
/// densities: what is left is decoded once, and not for each slab that it reaches.
#[test]
fn runs_whose_specks_are_seen_from_afar_are_decoded_once() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    let mut random = Random(3);
    let mut place = |size: f64| [0; 3].map(|_| size * (2.0 * random.unit() - 1.0));
    let (mut positions, mut radii) = (Vec::new(), Vec::new());
    for _ in 0..6000 {
        let (large, off) = (place(1.0), place(1e-3));
        positions.extend([large, [0, 1, 2].map(|axis| large[axis] + off[axis])]);
        radii.extend([0.15_f32, 1e-4]);
    }
    let source = ArraySource::new(positions, vec![("radius", radii)]);
    let cloud = build_at(&path, Box::new(source), &BuildOptions::default());
    add(&path);
    let runs = cloud.header().points.div_ceil(128);
    let (mut object, camera) = seen_from(&path, 3.0);
    object.transfer.opacity = OpacityRule::Extinction(0.05);
    let scene = Scene { lighting: Lighting::Unlit, ..Scene::of_cloud(object) };
    let settings = settings(32, 32).with_lod(Lod::Footprint(1.0));
    let exec = ExecSettings { threads: 1, ..ExecSettings::default() };
    let (_, counts) =
        render_once(&scene, &camera, &settings, &exec, &paged(&scene, 1 << 30)).expect("a picture");
    let decoded = counts.runs;
    assert!(decoded <= 4 * runs, "{decoded} for {runs}");
}

#[test]
fn footprints_out_of_range_are_refused() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    sphere(&path, "sphere-1000");
    let (object, camera) = seen_from(&path, 4.0);
    let scene = lit(object);
    for factor in [0.0, -1.0, 65.0, f32::NAN, f32::INFINITY] {
        for lod in [Lod::Footprint(factor), Lod::Coarse(factor)] {
            let (settings, exec) = (settings(8, 8).with_lod(lod), ExecSettings::default());
            let refused = picture(&scene, &camera, &settings, &exec, &paged(&scene, 1 << 30));
            assert!(refused.expect_err("refused").to_string().contains("level of detail"));
        }
    }
}

/// Aggregates whose checksums are right and that say anything else make a picture, or an error that
/// names the file.
#[test]
fn damaged_aggregates_make_pictures_or_errors() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    build_at(&path, Box::new(mixed_points(9000, 3.0, 6)), &BuildOptions::default());
    add(&path);
    let header = Cloud::open(&path).expect("it opens").header().clone();
    let whole = std::fs::read(&path).expect("a read");
    let first = header.page_offset(header.point_pages + header.node_pages) as usize + PAGE_HEAD_BYTES;
    let records = header.aggregates.expect("aggregates").records() as usize;
    let (mut random, mut pictures, mut errors) = (Random(9), 0, 0);
    for round in 0..60 {
        let mut bytes = whole.clone();
        // Of places in the tree and of all else, in some records of the first page.
        for _ in 0..1 + round % 8 {
            let record = (random.unit() * records.min(400) as f64) as usize;
            let byte = [27, 26, 28, 29, 32, 33, 34, 20, 22, 12][(random.unit() * 10.0) as usize];
            bytes[first + AGGREGATE_BYTES * record + byte] = (random.unit() * 256.0) as u8;
        }
        reseal(&mut bytes);
        std::fs::write(&path, &bytes).expect("a write");
        let (object, camera) = seen_from(&path, 4.0);
        let scene = lit(object);
        let settings = settings(12, 12).with_lod(Lod::Footprint(0.3));
        match picture(&scene, &camera, &settings, &ExecSettings::default(), &paged(&scene, 1 << 30)) {
            Ok(_) => pictures += 1,
            Err(error) => {
                assert!(error.to_string().contains("c.rset"), "{error}");
                errors += 1;
            }
        }
    }
    assert!(pictures > 3 && errors > 3, "{pictures} pictures and {errors} errors");
}

//! Promise 2: the right picture, against brute force in `f64` at the same samples.

use rayset::field::reference::ReferenceField;
use rayset::field::{
    Appended, AttributeColumns, Channels, FieldSamples, Kernel, Packet, RunBatch, RunDecoder, SLAB_SAMPLES,
    SimdLevel, Slab, SplatCounts, Splatter,
};
use rayset::geometry::{DVec3, Ray};
use rayset::octree::Cloud;
use rayset::octree::build::{BuildOptions, Rule};
use rayset::scene::{ColorMap, ColorRule, OpacityRule, RenderSettings, Scene, Step};
use rayset::trace::reference::{ReferenceRenderer, ReferenceSteps};

use crate::common::{
    Random, build_at, camera, folder, look, mixed_points, plain_picture, points_in_few_places, scene,
    scene_of, settings, workload_cloud,
};

/// Largest density error allowed, in units of the largest density.
const DENSITY_BOUND: f64 = 1e-4;
/// Pixels may differ by this in linear light, save for a few.
const PIXEL_BOUND: f64 = 1.0 / 1024.0;

/// The densities, weighted attributes and normals of all samples of some rays through a cloud about
/// the origin, two of a unit wide, against the reference renderer.
pub(crate) fn check_field(cloud: &Cloud, unit: f64, kernel: Kernel, simd: SimdLevel) {
    let header = cloud.header();
    let columns = AttributeColumns {
        color_as_displayed: false,
        color: header.has_color,
        scalars: (0..header.attributes.len() + 3).collect(),
        labels: Vec::new(),
    };
    let reference_renderer = ReferenceField::load(cloud, kernel, false, &columns).expect("the cloud reads");
    let channels = Channels { gradient: true, attributes: columns.channels(), labels: 0 };
    let splatter = Splatter { kernel, channels, simd };
    let decoder = RunDecoder::new(header, kernel, false, columns);
    let mut random = Random(7);
    let rays: Vec<(Ray, f64)> = (0..24)
        .map(|_| {
            let mut v = || DVec3::new(random.unit(), random.unit(), random.unit()) - 0.5;
            let (direction, target) = (v().normalize(), v() * unit);
            (Ray { origin: target - direction * 1e4 * unit, direction }, random.unit())
        })
        .collect();
    let step = f64::from(header.radius.max()) * 0.25;
    let packet = Packet::new(&rays, step);
    let first = (((1e4 - 2.0) * unit / step) as u64) / 32 * 32;
    let (mut worst_density, mut worst_attribute, mut worst_angle) = (0.0_f64, 0.0_f64, 0.0_f64);
    let (mut largest_density, mut largest_gradient) = (0.0_f64, 0.0_f64);
    let mut seen = Vec::new();
    let mut counts = SplatCounts::default();
    for slab in 0..(4.0 * unit / step) as u64 / 32 + 2 {
        let slab = Slab { first: first + 32 * slab, samples: SLAB_SAMPLES, level: 0 };
        let mut samples = FieldSamples::new(channels);
        let mut batch = RunBatch::default();
        cloud
            .for_each_run(|_, raw| {
                let append = |batch: &mut RunBatch| {
                    batch.append((&decoder, &raw, header), None, (&packet, slab, packet.all()), simd)
                };
                if append(&mut batch) == Appended::NoRoom {
                    counts += splatter.splat(&mut batch, &packet, slab, packet.all(), None, &mut samples);
                    append(&mut batch);
                }
            })
            .expect("the cloud reads");
        counts += splatter.splat(&mut batch, &packet, slab, packet.all(), None, &mut samples);
        for (lane, (ray, _)) in rays.iter().enumerate().filter(|(l, _)| samples.touched >> l & 1 != 0) {
            let near = reference_renderer.near(ray, |_| 0.0);
            for j in (0..SLAB_SAMPLES).step_by(3) {
                let q = ray.at(packet.sample_t(lane, slab.first + j as u64));
                let exact = near.sample(q);
                let density = f64::from(samples.density[lane].0[j]);
                let gradient: [f64; 3] = std::array::from_fn(|c| f64::from(samples.gradient[c][lane].0[j]));
                largest_density = largest_density.max(exact.density);
                largest_gradient = largest_gradient.max(exact.gradient.length());
                worst_density = worst_density.max((density - exact.density).abs());
                for (rows, exact) in samples.attribute.iter().zip(&exact.attributes) {
                    worst_attribute = worst_attribute.max((f64::from(rows[lane].0[j]) - exact).abs());
                }
                seen.push((DVec3::from_array(gradient), exact.gradient));
            }
        }
    }
    for (gradient, exact) in seen.iter().filter(|(_, exact)| exact.length() > 0.01 * largest_gradient) {
        worst_angle = worst_angle.max(gradient.angle_between(*exact).to_degrees());
    }
    assert!(largest_density > 0.1, "the rays meet the cloud");
    let SplatCounts { pairs_tested, pairs_added, kernel_evaluations } = counts;
    assert!(
        pairs_added > 0 && pairs_added <= pairs_tested && kernel_evaluations >= pairs_added,
        "{counts:?}"
    );
    let bound = DENSITY_BOUND * largest_density;
    assert!(worst_density <= bound, "{kernel}, {simd}: |ΔD| = {worst_density:e}, bound {bound:e}");
    // Attributes here are 1 at most.
    assert!(worst_attribute <= bound, "{kernel}, {simd}: |ΔDa| = {worst_attribute:e}, bound {bound:e}");
    assert!(worst_angle <= 0.1, "{kernel}, {simd}: normals differ by {worst_angle}°");
}

#[test]
fn density_and_normals_are_right_for_every_kernel_and_instruction_set() {
    let folder = folder();
    let cloud = build_at(
        &folder.path().join("c.rset"),
        Box::new(mixed_points(3000, 4.0, 1)),
        &BuildOptions::default(),
    );
    for &kernel in Kernel::OF_DENSITIES {
        for simd in SimdLevel::available() {
            check_field(&cloud, 1.0, kernel, simd);
        }
    }
}

#[test]
fn many_points_in_one_place_have_the_sum_of_their_densities_and_the_mean_of_their_colours() {
    let folder = folder();
    let source = points_in_few_places(60, 2000.0);
    let cloud = build_at(&folder.path().join("c.rset"), Box::new(source), &BuildOptions::default());
    assert!(cloud.header().points > 10_000);
    for simd in SimdLevel::available() {
        check_field(&cloud, 1.0, Kernel::Wyvill, simd);
    }
}

#[test]
fn density_is_right_where_radii_differ_by_a_factor_of_100_000() {
    let folder = folder();
    for unit in [1.0, 1000.0] {
        let options = BuildOptions { length_scale: unit, ..BuildOptions::default() };
        let source = mixed_points(2000, 17.0, 2);
        let cloud = build_at(&folder.path().join("c.rset"), Box::new(source), &options);
        assert!(cloud.header().radius.max() / cloud.header().radius.min() > 5e4);
        check_field(&cloud, unit, Kernel::Triweight, SimdLevel::default());
    }
}

/// Random pixels of a picture against the reference renderer; returns how many of them differ by
/// more than the bound.
pub(crate) fn count_wrong_pixels(
    scene: &Scene,
    settings: &RenderSettings,
    step: f64,
    pixels: usize,
) -> usize {
    let fast = plain_picture(scene, settings);
    let reference_renderer = ReferenceRenderer::load(scene).expect("it reads");
    let mut random = Random(99);
    let mut wrong = 0;
    let mut covered = 0;
    for _ in 0..pixels {
        let x = (random.unit() * f64::from(settings.width)) as u32;
        let y = (random.unit() * f64::from(settings.height)) as u32;
        let exact = reference_renderer
            .pixel(&camera(), settings, &ReferenceSteps::same(step), x, y)
            .expect("a camera");
        let found = fast[(y * settings.width + x) as usize];
        covered += usize::from(exact[3] > 0.0);
        let worst = (0..4).map(|c| (f64::from(found[c]) - exact[c]).abs()).fold(0.0, f64::max);
        wrong += usize::from(worst > PIXEL_BOUND || worst.is_nan());
    }
    assert!(covered * 8 > pixels, "{covered} of {pixels} pixels show anything");
    wrong
}

#[test]
fn pixels_of_the_standard_workloads_are_right() {
    let folder = folder();
    // All of sphere-10m in f64 takes a gigabyte: only when asked for.
    let all = std::env::var_os("RAYSET_TEST_LARGE").is_some();
    let names = ["sphere-100k", "sphere-1m", "cube-1m", "sphere-10m"];
    for name in &names[..if all { 4 } else { 3 }] {
        let cloud = workload_cloud(name, folder.path());
        for translucent in [false, true] {
            let mut object = look(&cloud, Kernel::Triweight);
            let radius = cloud.header().radius_mean;
            object.transfer.opacity = OpacityRule::Extinction(if translucent { 0.02 } else { 2.0 } / radius);
            let settings = RenderSettings {
                stop_transmittance: if translucent { 0.0 } else { 0.01 },
                ..settings(512, 512)
            };
            let step = f64::from(cloud.header().radius.max()) * 0.25;
            let wrong = count_wrong_pixels(&scene_of(object, false), &settings, step, 256);
            assert_eq!(wrong, 0, "{name}, translucent: {translucent}");
        }
    }
}

#[test]
fn lit_and_coloured_pictures_are_right_for_every_kernel_and_opacity_rule() {
    let folder = folder();
    let cloud = build_at(
        &folder.path().join("c.rset"),
        Box::new(mixed_points(2500, 1.0, 3)),
        &BuildOptions::default(),
    );
    let step = f64::from(cloud.header().radius.min()) * 0.3;
    let rules = [
        OpacityRule::Clamp,
        OpacityRule::Extinction(1.5),
        OpacityRule::Curve(vec![(0.1, 0.0), (0.5, 0.3), (2.0, 0.9), (5.0, 0.2)]),
    ];
    for (i, &kernel) in Kernel::OF_DENSITIES.iter().enumerate() {
        let mut object = look(&cloud, kernel);
        object.normalised = i % 2 == 1;
        object.transfer.opacity = rules[i % 3].clone();
        if i % 3 == 1 {
            let map = ColorMap::named("viridis".parse().expect("a map"), (0.0, 3.0));
            object.transfer.color = ColorRule::Map { map, input: rayset::scene::MapInput::Density };
        }
        let mut scene = scene_of(object, true);
        if i % 2 == 1 {
            scene.unit_distance = 0.02;
        }
        scene.background = (i % 2 == 0).then_some([0.1, 0.2, 0.3]);
        let settings = RenderSettings { step: Step::Fixed(step), ..settings(48, 48) };
        let wrong = count_wrong_pixels(&scene, &settings, step, 400);
        assert!(wrong <= 1, "{kernel}: {wrong} of 400 pixels beyond 1/1024");
    }
}

#[test]
fn pictures_with_other_radii_than_those_stored_are_right() {
    let folder = folder();
    let stored = build_at(
        &folder.path().join("c.rset"),
        Box::new(mixed_points(2500, 2.0, 6)),
        &BuildOptions::default(),
    );
    // Of many nodes, each of which reaches beyond what it reached before.
    let constant = workload_cloud("sphere-100k", folder.path());
    for cloud in [&stored, &constant] {
        for factor in [0.4_f32, 3.0] {
            let scaled = std::sync::Arc::new(cloud.with_radius_scale(factor).expect("radii in range"));
            assert_eq!(scaled.header().radius.max(), cloud.header().radius.max() * factor);
            let (before, after) =
                (cloud.sample(500).expect("it reads"), scaled.sample(500).expect("it reads"));
            for i in 0..before.len() {
                let expected = before.columns[0].get(i) as f32 * factor;
                assert_eq!(after.columns[0].get(i) as f32, expected, "point {i}");
            }
            check_field(&scaled, 1.0, Kernel::Wyvill, SimdLevel::default());
            let step = f64::from(scaled.header().radius.min()) * 0.3;
            for is_lit in [false, true] {
                let mut object = look(&scaled, Kernel::Wyvill);
                object.normalised = is_lit;
                // Translucent, so that every point on the way shows.
                object.transfer.opacity = OpacityRule::Extinction(if is_lit { 0.001 } else { 0.3 });
                let (step, stop) = (step.max(0.01), 0.0);
                let settings =
                    RenderSettings { step: Step::Fixed(step), stop_transmittance: stop, ..settings(48, 48) };
                let wrong = count_wrong_pixels(&scene_of(object, is_lit), &settings, step, 300);
                assert!(wrong <= 1, "{factor}, {is_lit}: {wrong} of 300 pixels beyond 1/1024");
            }
        }
        for wrong in [0.0, -1.0, f32::NAN, f32::INFINITY, 1e30, 1e-30] {
            assert!(cloud.with_radius_scale(wrong).is_none(), "{wrong}");
        }
    }
    // The factor counts from what is stored, not from what has been made of it.
    let twice = std::sync::Arc::new(stored.with_radius_scale(2.0).expect("radii in range"));
    let again = twice.with_radius_scale(3.0).expect("radii in range");
    assert_eq!(again.header().radius.max(), stored.header().radius.max() * 3.0);
}

#[test]
fn densities_colours_and_opacities_are_right_with_weights_of_both_signs() {
    let folder = folder();
    let mut random = Random(8);
    let mut position = Vec::new();
    let mut columns = vec![Vec::new(); 5];
    for _ in 0..2500 {
        let p: [f64; 3] = std::array::from_fn(|_| 2.0 * random.unit() - 1.0);
        // Of one sign on one side and of the other on the other, and of both in between.
        let sign = if p[0] + 0.6 * (random.unit() - 0.5) > 0.0 { 1.0 } else { -1.0 };
        position.push(p);
        columns[0].push((0.35 * 2_f64.powf(-random.unit())) as f32);
        columns[1].push((sign * (0.2 + random.unit())) as f32);
        columns[2..].iter_mut().for_each(|column| column.push(random.unit() as f32));
    }
    let names = ["radius", "weight", "red", "green", "blue"];
    let source = rayset::points::ArraySource::new(position, names.into_iter().zip(columns).collect());
    let cloud = build_at(&folder.path().join("c.rset"), Box::new(source), &BuildOptions::default());
    assert!(cloud.header().weight.min() < -1.0 && cloud.header().weight.max() > 1.0);
    for simd in SimdLevel::available() {
        check_field(&cloud, 1.0, Kernel::Wyvill, simd);
    }
    let step = f64::from(cloud.header().radius.min()) * 0.3;
    // Only what is positive shows; `graph` shows attributes where the sum is negative.
    let mut object = look(&cloud, Kernel::Wyvill);
    object.transfer.opacity = OpacityRule::Curve(vec![(-2.0, 0.3), (0.0, 0.0), (0.5, 0.0), (2.0, 0.3)]);
    let settings = RenderSettings { step: Step::Fixed(step), ..settings(48, 48) };
    let wrong = count_wrong_pixels(&scene_of(object, false), &settings, step, 400);
    assert!(wrong <= 1, "{wrong} of 400 pixels beyond 1/1024");
}

#[test]
fn automatic_steps_come_close_to_steps_eight_times_finer() {
    let folder = folder();
    let cloud = build_at(
        &folder.path().join("c.rset"),
        Box::new(mixed_points(2500, 3.0, 4)),
        &BuildOptions::default(),
    );
    let scene = scene(&cloud, Kernel::Wyvill, false);
    let auto = settings(64, 64);
    let fine = RenderSettings { step: Step::Automatic { fraction: 0.25 / 8.0 }, ..auto };
    let (a, b) = (plain_picture(&scene, &auto), plain_picture(&scene, &fine));
    let mean = a.iter().zip(&b).map(|(a, b)| f64::from((a[3] - b[3]).abs())).sum::<f64>() / a.len() as f64;
    assert!(mean < 0.01, "mean opacity error of automatic steps {mean}");
}

#[test]
fn stored_positions_are_within_the_stated_error() {
    let folder = folder();
    let source = mixed_points(5000, 6.0, 5);
    let mut given = Vec::new();
    let mut copy = source.clone();
    let mut batch = rayset::points::PointBatch::default();
    rayset::points::PointSource::fill(&mut copy, &mut batch, usize::MAX).expect("arrays read");
    given.extend(batch.position.iter().map(|p| DVec3::from_array(*p)));
    for precision in [
        rayset::octree::build::Precision::Relative(0.1),
        rayset::octree::build::Precision::default(),
        rayset::octree::build::Precision::Exact,
    ] {
        let options = BuildOptions { precision, radius: Some(Rule::Number(0.01)), ..BuildOptions::default() };
        let cloud = build_at(&folder.path().join("p.rset"), Box::new(source.clone()), &options);
        let mut stored = Vec::new();
        cloud
            .for_each_run(|_, run| stored.extend(run.positions(cloud.header().root_cell())))
            .expect("it reads");
        let error = cloud.header().position_error;
        assert_eq!(stored.len(), given.len());
        for p in &given {
            let nearest = stored.iter().map(|q| q.distance(*p)).fold(f64::INFINITY, f64::min);
            assert!(nearest <= error * (1.0 + 1e-9), "{precision:?}: {nearest} beyond {error}");
        }
        match precision {
            rayset::octree::build::Precision::Exact => assert_eq!(error, 0.0),
            rayset::octree::build::Precision::Relative(p) => {
                assert!(cloud.header().position_error_radii <= p);
            }
            other => panic!("{other:?}"),
        }
    }
}

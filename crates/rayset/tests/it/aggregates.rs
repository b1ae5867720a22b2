//! What stands for the points of cells from afar: its moments and densities are those of the
//! points, its bytes follow from them alone, and no damage to it goes unnoticed.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use rayset::cancel::CancelToken;
use rayset::container::{PAGE_HEAD_BYTES, SectionKind, reseal};
use rayset::field::Kernel;
use rayset::geometry::{DMat3, DVec3};
use rayset::octree::Cloud;
use rayset::octree::aggregates::{
    AGGREGATE_BYTES, Aggregate, AggregateError, AggregateHeader, AggregateOptions, AggregatePage, BINS,
    add_to_file,
};
use rayset::octree::build::{BuildOptions, Rule, ShapeRule};
use rayset::octree::verify::Depth;
use rayset::paged_file::HasPages;
use rayset::points::{ArraySource, Workload};
use rayset::scene::{
    Camera, CloudObject, ColorRule, Lighting, Lod, OpacityRule, Projection, Scene, TransferFunction,
};
use rayset::trace::ExecSettings;
use rayset::trace::reference::far::{Far, pixels};

use crate::common::{Random, build_at, folder, mixed_points, paged, picture, settings};

fn options() -> AggregateOptions {
    AggregateOptions::default().with_memory_bytes(64 << 20).with_threads(2)
}

fn add(input: &Path, output: &Path, options: &AggregateOptions) -> Result<AggregateHeader, AggregateError> {
    add_to_file(input, output, options, &|_, _| {}, &CancelToken::new())
}

/// A record, with its colour and its attributes.
struct Record {
    aggregate: Aggregate,
    level: u8,
    color: Option<[u8; 3]>,
    attributes: Vec<f32>,
}

/// All records of a file, in their order.
fn records(cloud: &Cloud) -> Vec<Record> {
    let header = cloud.header();
    let known = header.aggregates.as_ref().expect("aggregates");
    let mut records = Vec::new();
    let first = header.point_pages + header.node_pages;
    let scanned = cloud.stored_file().for_each_page(|page, bytes| {
        if page < first {
            return;
        }
        let page = AggregatePage::trusted(bytes, header, known);
        for index in 0..page.len() {
            let level = known.level_of(records.len() as u32);
            records.push(Record {
                aggregate: page.get(index, level).expect("a record"),
                level,
                color: page.color(index),
                attributes: (0..header.attributes.len()).filter_map(|a| page.attribute(index, a)).collect(),
            });
        }
    });
    scanned.expect("the file is whole");
    assert_eq!(records.len() as u32, known.records());
    records
}

/// The points of a file, in its order: position, radius, weight, semi-axes as columns.
fn points(cloud: &Cloud) -> Vec<(DVec3, f64, f64, DMat3)> {
    let header = cloud.header();
    let mut points = Vec::new();
    let scanned = cloud.for_each_run(|_, run| {
        let n = run.head.len();
        let radii: Vec<f32> = run.radii(header).map_or(vec![header.radius.min(); n], Iterator::collect);
        let weights: Vec<f32> = run.weights(header).map_or(vec![header.weight.min(); n], Iterator::collect);
        let axes: Vec<DMat3> = run
            .shapes(header)
            .map_or(vec![DMat3::IDENTITY; n], |s| s.map(|s| s.decode().semi_axes()).collect());
        for (i, position) in run.positions(header.root_cell()).into_iter().enumerate() {
            let radius = f64::from(radii[i]);
            points.push((position, radius, f64::from(weights[i]), axes[i] * radius));
        }
    });
    scanned.expect("the file is whole");
    points
}

/// Mass, centroid and covariance of points whose kernel has a variance.
fn moments(points: &[(DVec3, f64, f64, DMat3)], variance: f64) -> (f64, DVec3, DMat3) {
    let mass_of = |point: &(DVec3, f64, f64, DMat3)| point.2 * point.3.determinant().abs();
    let mass: f64 = points.iter().map(mass_of).sum();
    let centroid = points.iter().map(|point| point.0 * mass_of(point)).sum::<DVec3>() / mass;
    let mut covariance = DMat3::ZERO;
    for point in points {
        let (d, part) = (point.0 - centroid, mass_of(point) / mass);
        let outer = DMat3::from_cols(d * d.x, d * d.y, d * d.z);
        covariance += (outer + point.3 * point.3.transpose() * variance) * part;
    }
    (mass, centroid, covariance)
}

fn check_moments(aggregate: &Aggregate, points: &[(DVec3, f64, f64, DMat3)], variance: f64, edge: f64) {
    let (mass, centroid, covariance) = moments(points, variance);
    assert!((aggregate.mass / mass - 1.0).abs() < 2e-5, "{} and {mass}", aggregate.mass);
    assert!((aggregate.centroid - centroid).length() < 1e-6 * edge);
    let axes = DMat3::from_quat(aggregate.rotation);
    let squares = DVec3::from_array(aggregate.deviations.map(|length| length * length));
    let stored = axes * DMat3::from_diagonal(squares) * axes.transpose();
    let largest = squares.max_element();
    let off = (stored - covariance).to_cols_array().into_iter().fold(0.0, |most: f64, v| most.max(v.abs()));
    assert!(off < 0.06 * largest, "{stored:?} and {covariance:?}");
}

/// A cloud with so few points that it is one leaf, whose cells are found by the numbers of their
/// points.
fn one_leaf(path: &Path, source: ArraySource, options: &BuildOptions) -> Arc<Cloud> {
    let cloud = build_at(path, Box::new(source), options);
    assert_eq!(cloud.header().nodes, 1, "more than a leaf");
    cloud
}

fn check_cells(path: &Path, kernel: Kernel, normalised: bool) -> Vec<Record> {
    let asked = options().with_kernel(kernel).with_normalised(normalised);
    let known = add(path, path, &asked).expect("aggregates");
    let cloud = Cloud::open(path).expect("it opens");
    let mut points = points(&cloud);
    if normalised {
        points.iter_mut().for_each(|point| point.2 /= kernel.integral() * point.3.determinant().abs());
    }
    let records = records(&cloud);
    assert!(records.len() > 20 && known.few_points == 64);
    for record in &records {
        let Aggregate { first_point, more_points, .. } = record.aggregate;
        let of_cell = match record.level {
            0 => &points[..],
            _ => &points[usize::from(first_point)..=usize::from(first_point) + usize::from(more_points)],
        };
        let edge = cloud.header().root_size * 0.5_f64.powi(record.level.into());
        let small: Vec<_> = of_cell.iter().copied().filter(|point| point.1 <= edge).collect();
        assert!(!small.is_empty() && (record.level == 0 || record.aggregate.child_mask == 0));
        assert!(record.aggregate.cells == 0 || of_cell.len() > 64, "few points were divided");
        check_moments(&record.aggregate, &small, kernel.variance(), edge);
    }
    cloud.verify(Depth::Deep).expect("it is whole");
    records
}

#[test]
fn every_cell_of_a_leaf_has_the_moments_of_its_points_for_every_kernel() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    for (i, &kernel) in Kernel::OF_DENSITIES.iter().enumerate() {
        let source = mixed_points(3000, 1.5, 70 + i as u64);
        one_leaf(&path, source, &BuildOptions::default());
        check_cells(&path, kernel, i % 2 == 1);
    }
}

/// A sheet of discs, its points in classes by their quadrants, red on one side.
fn sheet(count: usize) -> ArraySource {
    let mut random = Random(5);
    let names = ["red", "green", "blue", "height", "class"];
    let (mut position, mut columns) = (Vec::new(), vec![Vec::new(); names.len()]);
    for _ in 0..count {
        let [x, y] = [0; 2].map(|_| 2.0 * random.unit() - 1.0);
        position.push([x, y, 0.3 * x]);
        let red = if x < 0.0 { 1.0 } else { 0.0 };
        let class = f32::from(u8::from(x > 0.0) + 2 * u8::from(y > 0.0));
        columns.iter_mut().zip([red, 0.0, 0.5, y as f32, class]).for_each(|(column, v)| column.push(v));
    }
    ArraySource::new(position, names.into_iter().zip(columns).collect())
}

#[test]
fn a_sheet_of_discs_is_flat_and_has_the_means_of_colours_and_attributes() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    let asked = BuildOptions {
        radius: Some(Rule::Auto),
        shape: ShapeRule::Auto,
        attributes: vec!["height".into(), "class".into()],
        ..BuildOptions::default()
    };
    let cloud = one_leaf(&path, sheet(3000), &asked);
    assert!(cloud.header().shape.is_some());
    let records = check_cells(&path, Kernel::Wyvill, false);
    let normal = DVec3::new(-0.3, 0.0, 1.0).normalize();
    for Record { aggregate, color, attributes, .. } in &records {
        let axis = DMat3::from_quat(aggregate.rotation).z_axis;
        assert!(axis.dot(normal).abs() > 0.98, "{axis}");
        assert!(aggregate.deviations[2] < 0.4 * aggregate.deviations[1]);
        let [x, y, _] = aggregate.centroid.to_array();
        // Cells do not lie across the middle, but for the root.
        if x.abs() > aggregate.deviations[0] {
            assert_eq!(color.expect("a colour")[0], if x < 0.0 { 255 } else { 0 });
        }
        assert!(color.expect("a colour")[2].abs_diff(128) <= 1);
        assert!((f64::from(attributes[0]) - y).abs() < 1e-4, "{attributes:?} at {y}");
        if x.abs() > aggregate.deviations[0] && y.abs() > aggregate.deviations[0] {
            let class = f32::from(u8::from(x > 0.0) + 2 * u8::from(y > 0.0));
            assert!(attributes[1] == class, "{attributes:?} at {x}, {y}");
        }
    }
}

#[test]
fn densities_are_distributed_as_those_of_the_points_are() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    let cloud = one_leaf(&path, mixed_points(2000, 1.5, 3), &BuildOptions::default());
    add(&path, &path, &options()).expect("aggregates");
    let root = &records(&Cloud::open(&path).expect("it opens"))[0].aggregate;
    let points = points(&Cloud::open(&path).expect("it opens"));
    assert_eq!(points.len() as u64, cloud.header().points);
    // The distribution at other places in the points than those of the file, by rejection.
    let (kernel, mut random) = (Kernel::Wyvill, Random(11));
    let mut masses = [0.0; BINS];
    for (center, radius, weight, _) in &points {
        let place = loop {
            let offset = DVec3::from_array([0; 3].map(|_| 2.0 * random.unit() - 1.0));
            if random.unit() < kernel.value(offset.length_squared()) {
                break *center + offset * *radius;
            }
        };
        let density: f64 =
            points.iter().map(|(p, r, w, _)| w * kernel.value((place - p).length_squared() / (r * r))).sum();
        let bin = (0..BINS).find(|&bin| density >= root.densities.lower_bound(bin)).unwrap_or(BINS - 1);
        masses[bin] += weight * radius.powi(3);
    }
    let total: f64 = masses.iter().sum();
    for bin in 0..BINS {
        let is = root.densities.fractions()[bin];
        assert!((is - masses[bin] / total).abs() < 0.06, "bin {bin}: {is} and {}", masses[bin] / total);
    }
}

#[test]
fn records_are_a_tree_of_all_cells_with_many_points() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    let workload: Workload = "sphere-30000".parse().expect("a workload");
    let asked = BuildOptions { radius: workload.radius().map(Rule::Number), ..BuildOptions::default() };
    build_at(&path, workload.source(), &asked);
    add(&path, &path, &options()).expect("aggregates");
    let cloud = Cloud::open(&path).expect("it opens");
    let (header, records) = (cloud.header(), records(&cloud));
    assert!(header.nodes > 1);
    let mut seen = vec![0; records.len()];
    seen[0] = 1;
    for record in &records {
        let first_child = record.aggregate.first_child as usize;
        let children = first_child..first_child + record.aggregate.children() as usize;
        let below: f64 = children
            .map(|child| {
                seen[child] += 1;
                assert_eq!(records[child].level, record.level + 1);
                records[child].aggregate.mass
            })
            .sum();
        assert!(below <= record.aggregate.mass * 1.0001);
    }
    assert!(seen.iter().all(|&times| times == 1), "a record with no parent, or two");
    let mass: f64 = points(&cloud).iter().map(|(_, r, w, _)| w * r.powi(3)).sum();
    assert!((records[0].aggregate.mass / mass - 1.0).abs() < 2e-5);
    cloud.verify(Depth::Deep).expect("it is whole");
}

/// Positions are rounded, some into the next cell: no other point may move with them.
#[test]
fn points_of_a_cell_lie_in_it_in_all_leaves_of_a_cloud() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    let mut random = Random(4);
    let places = (0..60_000).map(|_| [0; 3].map(|_| 100.0 * random.unit()));
    let source = ArraySource::new(places.collect(), Vec::new());
    let asked = BuildOptions { radius: Some(Rule::Number(3.0)), ..BuildOptions::default() };
    let cloud = build_at(&path, Box::new(source), &asked);
    assert!(cloud.header().nodes > 8);
    add(&path, &path, &options()).expect("aggregates");
    let cloud = Cloud::open(&path).expect("it opens");
    let records = records(&cloud);
    let mut seen = vec![0; records.len()];
    for record in &records {
        let edge = cloud.header().root_size * 0.5_f64.powi(record.level.into());
        // A uniform cube of this edge has a deviation of 0.29 edges, and a point adds to it.
        let most = (edge * edge / 4.0 + Kernel::Wyvill.variance() * 9.0).sqrt();
        assert!(record.aggregate.deviations[0] < 1.1 * most, "{:?} of {edge}", record.aggregate);
        let first_child = record.aggregate.first_child;
        (0..record.aggregate.children()).for_each(|child| seen[(first_child + child) as usize] += 1);
    }
    assert!(seen[1..].iter().all(|&times| times == 1), "a record with no parent, or two");
}

#[test]
fn bytes_depend_on_neither_threads_nor_memory_and_points_keep_theirs() {
    let folder = folder();
    let path = |name: &str| -> PathBuf { folder.path().join(name) };
    build_at(&path("c.rset"), Box::new(mixed_points(20_000, 6.0, 8)), &BuildOptions::default());
    let before = std::fs::read(path("c.rset")).expect("a read");
    let least = match add(&path("c.rset"), &path("x.rset"), &options().with_memory_bytes(1)) {
        Err(AggregateError::Memory { needed, .. }) => needed,
        other => panic!("{other:?}"),
    };
    let mut made = Vec::new();
    for (threads, memory) in [(1, least), (1, 64 << 20), (3, 64 << 20), (7, 1 << 30)] {
        let asked = options().with_threads(threads).with_memory_bytes(memory);
        add(&path("c.rset"), &path("a.rset"), &asked).expect("aggregates");
        made.push(std::fs::read(path("a.rset")).expect("a read"));
    }
    // Made anew, in place.
    add(&path("a.rset"), &path("a.rset"), &options()).expect("aggregates");
    made.push(std::fs::read(path("a.rset")).expect("a read"));
    assert!(made.iter().all(|bytes| *bytes == made[0]));
    assert_eq!(std::fs::read(path("c.rset")).expect("a read"), before);
    let header = Cloud::open(path("c.rset")).expect("it opens").header().clone();
    let pages = 4096..4096 + header.pages() as usize * header.page_bytes as usize;
    assert!(made[0][pages.clone()] == before[pages], "points or nodes are others");
    let too_few = add(&path("c.rset"), &path("x.rset"), &options().with_memory_bytes(least - 1));
    assert!(matches!(too_few, Err(AggregateError::Memory { .. })) && !path("x.rset").exists());
}

#[test]
fn where_very_many_points_lie_in_one_place_it_takes_little_time() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    let places = (0..120_000).map(|i| if i % 12 == 0 { [1.0; 3] } else { [f64::from(i) * 1e-9, 0.0, 0.0] });
    let source = ArraySource::new(places.collect(), Vec::new());
    let asked = BuildOptions { radius: Some(Rule::Number(0.5)), ..BuildOptions::default() };
    build_at(&path, Box::new(source), &asked);
    add(&path, &path, &options()).expect("aggregates");
    Cloud::open(&path).expect("it opens").verify(Depth::Deep).expect("it is whole");
}

#[test]
fn damage_under_right_checksums_is_an_error_that_says_what() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    build_at(&path, Box::new(mixed_points(9000, 3.0, 6)), &BuildOptions::default());
    add(&path, &path, &options()).expect("aggregates");
    let header = Cloud::open(&path).expect("it opens").header().clone();
    let whole = std::fs::read(&path).expect("a read");
    let changed = |change: &dyn Fn(&mut [u8]), depth: Depth| {
        let mut bytes = whole.clone();
        change(&mut bytes);
        reseal(&mut bytes);
        std::fs::write(&path, &bytes).expect("a write");
        let opened = Cloud::open(&path).map_err(|e| e.to_string());
        opened.and_then(|cloud| cloud.verify(depth).map(|_| ()).map_err(|e| e.to_string()))
    };
    assert_eq!(changed(&|_| {}, Depth::Deep), Ok(()));
    let first = header.page_offset(header.point_pages + header.node_pages) as usize + PAGE_HEAD_BYTES;
    let put =
        |at: usize, with: Vec<u8>| move |bytes: &mut [u8]| bytes[at..at + with.len()].copy_from_slice(&with);
    // What walks rely on is checked as soon as the page is read.
    for (at, with, said) in [
        (first + 36, vec![0; BINS], "without densities"),
        (first + 28, vec![0; 4], "one level below"),
        (first + 28, vec![0xff; 4], "one level below"),
    ] {
        let message = changed(&put(at, with), Depth::Pages).expect_err("it is noticed");
        assert!(message.contains(said) && message.contains("c.rset"), "{message}");
    }
    // The rest is what the points say.
    for at in [0, 13, 15, 17, 20, 24, 32, 37, AGGREGATE_BYTES] {
        let flip = |bytes: &mut [u8]| bytes[first + at] ^= 1;
        assert_eq!(changed(&flip, Depth::Pages), Ok(()), "byte {at}");
        let message = changed(&flip, Depth::Deep).expect_err("it is noticed");
        assert!(message.contains("aggregate 0") && message.contains("points make"), "{message}");
    }
    // What the file says of all.
    let sections = rayset::container::FileHeader::decode(
        whole[..4096].try_into().expect("a block"),
        rayset::container::FileKind::Cloud,
    );
    let section = *sections.expect("a header").section(SectionKind::AGGREGATE_HEADER).expect("a section");
    for (at, with, said) in [
        (0, vec![49, 0, 0, 0], "as long as"),
        (8, vec![9, 0, 0, 0], "unknown kernel"),
        (4, vec![3, 0, 0, 0], "fewer than four"),
        (12, vec![2, 0, 0, 0], "unknown kind"),
        (16, vec![1, 0, 0, 0], "follow each other"),
        (20, vec![0, 0, 0, 0], "follow each other"),
        (16 + 4 * 21, vec![0xff; 4], "as many as"),
    ] {
        let message = changed(&put(section.offset as usize + at, with), Depth::Pages).expect_err("noticed");
        assert!(message.contains(said), "{message}");
    }
}

#[test]
fn points_that_have_none_are_refused_by_name() {
    let folder = folder();
    let (path, other) = (folder.path().join("c.rset"), folder.path().join("a.rset"));
    let refused = |asked: &AggregateOptions| {
        let message = add(&path, &other, asked).expect_err("none are made").to_string();
        assert!(!other.exists() && message.contains("c.rset"), "{message}");
        message
    };
    let source = ArraySource::new(
        (0..100).map(|i| [f64::from(i), 0.0, 0.0]).collect(),
        vec![("weight", (0..100).map(|i| i as f32 - 50.0).collect())],
    );
    let asked = BuildOptions { radius: Some(Rule::Number(1.0)), ..BuildOptions::default() };
    build_at(&path, Box::new(source), &asked);
    assert!(refused(&options()).contains("negative weights"));
    build_at(&path, Box::new(mixed_points(64, 1.0, 1)), &BuildOptions::default());
    assert!(refused(&options()).contains("so few points"));
    build_at(&path, Box::new(mixed_points(65, 1.0, 1)), &BuildOptions::default());
    assert!(refused(&options().with_kernel(Kernel::Splat)).contains("splats"));
    assert!(add(&path, &other, &options()).expect("some aggregates").records() > 1);
    std::fs::remove_file(&other).expect("it goes");
    // In place, too, nothing is replaced.
    let weightless = ArraySource::new((0..100).map(|i| [f64::from(i), 0.0, 0.0]).collect(), Vec::new());
    let asked = BuildOptions {
        radius: Some(Rule::Number(1.0)),
        weight: Some(Rule::Number(0.0)),
        ..BuildOptions::default()
    };
    build_at(&path, Box::new(weightless), &asked);
    let before = std::fs::read(&path).expect("a read");
    assert!(refused(&options()).contains("without weight"));
    assert!(add(&path, &path, &options()).is_err());
    assert!(std::fs::read(&path).expect("a read") == before, "the file is another");
    build_at(&path, Box::new(mixed_points(65, 1.0, 1)), &BuildOptions::default());
    let token = CancelToken::new();
    token.cancel();
    let cancelled = add_to_file(&path, &path, &options(), &|_, _| {}, &token);
    assert!(matches!(cancelled, Err(AggregateError::Cancelled)), "{cancelled:?}");
}

/// A cloud with aggregates, alone, and a camera at a distance before it.
fn seen_from(path: &Path, distance: f64) -> (CloudObject, Camera) {
    let cloud = Arc::new(Cloud::open(path).expect("it opens"));
    let transfer = TransferFunction { opacity: OpacityRule::Clamp, color: ColorRule::Uniform([1.0; 3]) };
    let position = DVec3::new(0.0, 0.0, -distance);
    let projection = Projection::Perspective { fovy: 2.0 * (1.3 / distance).atan() };
    let camera = Camera { position, direction: DVec3::Z, up: DVec3::Y, projection };
    (CloudObject { transfer, ..CloudObject::plain(cloud) }, camera)
}

#[test]
fn every_point_is_seen_once_however_wide_pixels_are() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    for (source, distance) in [(mixed_points(20_000, 6.0, 8), 40.0), (sheet(9000), 2.0)] {
        build_at(&path, Box::new(source), &BuildOptions::default());
        add(&path, &path, &options()).expect("aggregates");
        let (object, camera) = seen_from(&path, distance);
        let integral = object.kernel.integral();
        let all: f64 = points(&object.cloud).iter().map(|(_, _, w, axes)| w * axes.determinant().abs()).sum();
        let mut most = 0;
        for octave in -8..12 {
            let factor = 2_f64.powf(f64::from(octave) * 0.7);
            let far = Far::new(&object, 1.0, (&camera, 32, 32), Lod::Footprint(factor as f32))
                .expect("a file")
                .expect("aggregates");
            let (gaussians, _) = far.counts();
            most = most.max(gaussians);
            assert!((far.mass() / (integral * all) - 1.0).abs() < 1e-4, "{factor}: {} of {all}", far.mass());
            if octave == 11 {
                assert!(gaussians < 10, "{gaussians} in one pixel");
            }
        }
        assert!(most > 1000, "nothing but a few was seen");
    }
}

#[test]
fn opacities_from_aggregates_are_those_of_the_points_where_pixels_are_wide() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    let workload: Workload = "sphere-20000".parse().expect("a workload");
    let asked = BuildOptions { radius: workload.radius().map(Rule::Number), ..BuildOptions::default() };
    build_at(&path, workload.source(), &asked);
    add(&path, &path, &options()).expect("aggregates");
    let (mut object, camera) = seen_from(&path, 20.0);
    object.transfer.opacity = OpacityRule::Extinction(0.5);
    let (size, parts) = (12, 16);
    let scene = Scene { lighting: Lighting::Unlit, ..Scene::of_cloud(object.clone()) };
    let fine = settings(size * parts, size * parts);
    let picture = picture(&scene, &camera, &fine, &ExecSettings::default(), &paged(&scene, 1 << 30));
    let picture = picture.expect("a picture");
    let mut truth = vec![0.0; (size * size) as usize];
    for (at, pixel) in (0..).zip(&picture) {
        let (x, y) = (at % (size * parts) / parts, at / (size * parts) / parts);
        truth[(y * size + x) as usize] += f64::from(pixel[3]) / f64::from(parts * parts);
    }
    let far = Far::new(&object, scene.unit_distance, (&camera, size, size), Lod::AUTO).expect("a file");
    let far = far.expect("aggregates");
    let seen: Vec<f64> = pixels(&far, (&camera, size, size)).iter().map(|seen| seen.opacity).collect();
    // In the middle: the silhouette is a third of a pixel too large.
    let is_inside = |at: &usize| (4..8).contains(&(at % 12)) && (4..8).contains(&(at / 12));
    let inside: Vec<usize> = (0..truth.len()).filter(is_inside).collect();
    let mean = |of: &dyn Fn(usize) -> f64| inside.iter().map(|&at| of(at)).sum::<f64>() / inside.len() as f64;
    let (bias, error) = (mean(&|at| seen[at] - truth[at]), mean(&|at| (seen[at] - truth[at]).abs()));
    assert!((0.4..0.8).contains(&mean(&|at| truth[at])), "{}", mean(&|at| truth[at]));
    assert!(bias.abs() < 0.03 && error < 0.04, "bias {bias}, error {error}");
    let (gaussians, points) = far.counts();
    assert!(gaussians < 5000 && points == 0, "{gaussians} and {points}");
}

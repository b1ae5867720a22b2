//! Builds in parts: the bytes of a local build, whatever the number of parts, and clear refusals.

use std::path::Path;

use rayset::octree::build::{self, BuildControl, BuildError, BuildOptions, BuildParts, BuildStep, Rule};
use rayset::points::{self, ArraySource, PointBatch, PointSource, ReadError, ReadOptions, Schema, Workload};

use crate::common::{Random, folder, mixed_points};

type Sources<'a> = &'a dyn Fn() -> Vec<Box<dyn PointSource>>;

/// Does a step of all parts.
fn do_step(
    parts: &BuildParts,
    step: BuildStep,
    sources: Sources<'_>,
    options: &BuildOptions,
) -> Result<(), BuildError> {
    let control = BuildControl::default();
    (1..=parts.parts()).try_for_each(|part| match step {
        BuildStep::Read => parts.read(part, sources(), options, &control),
        _ => parts.run(step, part, options, &control),
    })
}

fn do_steps(parts: &BuildParts, sources: Sources<'_>, options: &BuildOptions) -> Result<(), BuildError> {
    BuildStep::ALL.into_iter().try_for_each(|step| do_step(parts, step, sources, options))
}

/// The bytes of a build in parts.
fn in_parts(
    folder: &Path,
    count: u32,
    sources: Sources<'_>,
    options: &BuildOptions,
) -> Result<Vec<u8>, BuildError> {
    let exchange = folder.join("parts");
    let parts = BuildParts::new(&exchange, count)?;
    do_steps(&parts, sources, options)?;
    let path = folder.join("merged.rset");
    BuildParts::open(&exchange)?.merge(&path, options, &BuildControl::default())?;
    parts.remove()?;
    assert!(!exchange.exists(), "the folder goes with the last of its files");
    Ok(std::fs::read(path).expect("the file reads"))
}

fn local(folder: &Path, sources: Sources<'_>, options: &BuildOptions) -> Vec<u8> {
    let path = folder.join("local.rset");
    build::run(sources(), &path, options, &BuildControl::default()).expect("the cloud builds");
    std::fs::read(path).expect("the file reads")
}

/// Builds at once and in 1, 2 and 7 parts, the latter with little memory, and compares the bytes.
pub(crate) fn check(name: &str, sources: Sources<'_>, options: &BuildOptions) {
    let folder = folder();
    let whole = local(folder.path(), sources, options);
    for (count, threads) in [(1, 1), (2, 2), (7, 1)] {
        let memory_bytes = if count == 2 { 64 << 20 } else { build::minimum_memory(threads).max(6 << 20) };
        let options = BuildOptions { threads, memory_bytes, ..options.clone() };
        let merged = in_parts(folder.path(), count, sources, &options);
        assert!(merged.expect("the cloud builds") == whole, "{name} in {count} parts: another file");
    }
}

fn with_radius(radius: f64) -> BuildOptions {
    BuildOptions { radius: Some(Rule::Number(radius)), ..BuildOptions::default() }
}

/// A scan of colours that state no depth, an attribute, and records that are skipped.
fn scan(count: usize, seed: u64) -> Box<dyn PointSource> {
    let mut random = Random(seed);
    let position = (0..count)
        .map(|i| std::array::from_fn(|_| if i % 97 == 5 { f64::NAN } else { random.unit() - 0.5 }))
        .collect();
    let mut column = |scale: f64| (0..count).map(|_| (scale * random.unit()).floor() as f32).collect();
    let columns = vec![
        ("red", column(200.0)),
        ("green", column(100.0)),
        ("blue", column(150.0)),
        ("intensity", column(9000.0)),
    ];
    Box::new(ArraySource::new(position, columns))
}

#[test]
fn a_build_in_parts_has_the_bytes_of_a_local_one() {
    let sphere: Workload = "sphere-90k".parse().expect("a workload");
    check("a sphere", &|| vec![sphere.source()], &with_radius(0.03));
    let several = || vec![scan(9000, 1), scan(1, 2), scan(0, 3), scan(20_000, 4)];
    let options = BuildOptions { attributes: vec!["intensity".into()], ..with_radius(0.01) };
    check("scans with skipped records", &several, &options);
    check(
        "one point",
        &|| vec![Box::new(ArraySource::new(vec![[1.0, 2.0, 3.0]], vec![]))],
        &with_radius(1.0),
    );
    check("no point", &|| vec![Box::new(ArraySource::new(vec![], vec![]))], &with_radius(1.0));
    let equal = || -> Vec<Box<dyn PointSource>> {
        vec![Box::new(ArraySource::new(vec![[0.5, 0.25, -3.0]; 30_000], vec![]))]
    };
    check("equal points", &equal, &with_radius(1e-4));
    // Copies that are merged though radii are given: everywhere, and with weights of their own.
    let twice = || vec![scan(9000, 6), scan(500, 7), scan(9000, 6)];
    check("twice the same", &twice, &options);
    let radius = Some(Rule::Attribute("green".into()));
    let weighted = BuildOptions { radius, weight: Some(Rule::Attribute("red".into())), ..options };
    check("twice the same, with radii and weights", &twice, &weighted);
}

#[test]
fn points_owned_by_inner_nodes_are_in_no_two_parts() {
    let options = BuildOptions { attributes: vec!["weight".into(), "red".into()], ..BuildOptions::default() };
    check("radii over octaves", &|| vec![Box::new(mixed_points(60_000, 12.0, 31))], &options);
    let sources = || -> Vec<Box<dyn PointSource>> { vec![Box::new(mixed_points(40_000, 0.0, 32))] };
    check("one radius wider than the cloud", &sources, &with_radius(50.0));
}

fn measured() -> BuildOptions {
    BuildOptions { radius: Some(Rule::Auto), ..BuildOptions::default() }
}

#[test]
fn radii_that_are_measured_in_parts_are_those_of_a_local_build() {
    let knot: Workload = "knot-50k".parse().expect("a workload");
    check("a knot", &|| vec![knot.source()], &measured());
    let options = BuildOptions { attributes: vec!["intensity".into()], ..measured() };
    check("scans with skipped records", &|| vec![scan(9000, 1), scan(0, 3), scan(20_000, 4)], &options);
    check("eight points", &|| vec![scan(8, 5)], &measured());
    check("no point", &|| vec![Box::new(ArraySource::new(vec![], vec![]))], &measured());
    // A third far apart, a third within a thousandth of that, a third at one place: a crowd.
    let crowd = || -> Vec<Box<dyn PointSource>> {
        let mut random = Random(33);
        let scaled = |i: usize| [1.0, 1e-3, 0.0][i % 3];
        let position = (0..40_000).map(|i| std::array::from_fn(|_| scaled(i) * (random.unit() - 0.5)));
        vec![Box::new(ArraySource::new(position.collect(), vec![]))]
    };
    check("a crowd", &crowd, &measured());
    // Copies that are merged: everywhere, in several sources, and with weights of their own.
    let twice = || vec![scan(5000, 6), scan(5000, 6)];
    check("twice the same", &twice, &options);
    let weighted = BuildOptions { weight: Some(Rule::Attribute("red".into())), ..options };
    check("twice the same with weights", &twice, &weighted);
}

#[test]
fn a_cloud_of_parts_that_each_have_their_own_points_is_that_of_all() {
    let folder = folder();
    let options = BuildOptions { attributes: vec!["intensity".into()], ..measured() };
    let whole = local(folder.path(), &|| vec![scan(9000, 1), scan(20_000, 4)], &options);
    let (control, parts) = (BuildControl::default(), BuildParts::new(&folder.path().join("p"), 2));
    let parts = parts.expect("a number of parts");
    parts.read_own(1, vec![scan(9000, 1)], &options, &control).expect("it reads");
    let other = BuildOptions { precision: build::Precision::Exact, ..options.clone() };
    for wrong in [other, BuildOptions { attributes: vec![], ..options.clone() }] {
        parts.read_own(2, vec![scan(20_000, 4)], &wrong, &control).expect("it reads");
        let error = parts.run(BuildStep::SpacingCount, 1, &options, &control).expect_err("others");
        assert!(error.to_string().contains("read with other options"), "{error}");
    }
    parts.read_own(2, vec![scan(20_000, 4)], &options, &control).expect("it reads");
    for step in &BuildStep::ALL[1..] {
        for part in [2, 1] {
            assert_eq!(parts.next_step(part).expect("it is this one's turn"), Some(*step));
            parts.run(*step, part, &options, &control).expect("the step ends");
        }
    }
    assert_eq!(parts.next_step(1).expect("all is done"), None);
    let path = folder.path().join("merged.rset");
    parts.merge(&path, &options, &control).expect("a cloud");
    assert!(std::fs::read(path).expect("the file reads") == whole);
}

/// The splats of a fixture.
fn splats() -> Box<dyn PointSource> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/splats/records.splat");
    points::open(&path, &ReadOptions::default()).expect("a fixture")
}

/// The same as points whose weights add.
struct NoSplats(Box<dyn PointSource>, Schema);

impl PointSource for NoSplats {
    fn schema(&self) -> &Schema {
        &self.1
    }
    fn count_hint(&self) -> Option<u64> {
        self.0.count_hint()
    }
    fn select(&mut self, columns: &[usize]) {
        self.0.select(columns);
    }
    fn fill(&mut self, batch: &mut PointBatch, limit: usize) -> Result<(), ReadError> {
        self.0.fill(batch, limit)
    }
}

fn no_splats() -> Box<dyn PointSource> {
    let schema = Schema { weights_add: true, ..splats().schema().clone() };
    Box::new(NoSplats(splats(), schema))
}

fn copies_in(cloud: &[u8]) -> u64 {
    let folder = folder();
    let path = folder.path().join("c.rset");
    std::fs::write(&path, cloud).expect("a write");
    rayset::Cloud::open(&path).expect("a cloud").header().copies
}

#[test]
fn no_copies_are_merged_if_any_part_of_a_build_reads_splats() {
    let folder = folder();
    for options in [BuildOptions::default(), measured()] {
        let twice = || vec![splats(), splats()];
        let whole = local(folder.path(), &twice, &options);
        assert_eq!(copies_in(&whole), 0);
        assert!(in_parts(folder.path(), 3, &twice, &options).expect("a cloud") == whole);
        assert!(copies_in(&local(folder.path(), &|| vec![no_splats(), no_splats()], &options)) > 0);
        for swapped in [false, true] {
            let both = || {
                let mut both = vec![splats(), no_splats()];
                both[..].rotate_left(usize::from(swapped));
                both
            };
            let whole = local(folder.path(), &both, &options);
            assert_eq!(copies_in(&whole), 0);
            let (control, exchange) = (BuildControl::default(), folder.path().join("own"));
            let parts = BuildParts::new(&exchange, 2).expect("a number of parts");
            for (part, source) in (1..).zip(both()) {
                parts.read_own(part, vec![source], &options, &control).expect("it reads");
            }
            for step in &BuildStep::ALL[1..] {
                (1..=2).for_each(|part| parts.run(*step, part, &options, &control).expect("the step ends"));
            }
            let path = folder.path().join("merged.rset");
            parts.merge(&path, &options, &control).expect("a cloud");
            parts.remove().expect("a folder of its own");
            assert!(std::fs::read(path).expect("the file reads") == whole);
        }
    }
}

#[test]
fn a_step_waits_for_all_parts_of_the_one_before_and_names_those_that_are_missing() {
    let folder = folder();
    let sphere: Workload = "sphere-20k".parse().expect("a workload");
    let (options, control) = (with_radius(0.03), BuildControl::default());
    let parts = BuildParts::new(&folder.path().join("p"), 4).expect("a number of parts");
    for part in [1, 3] {
        parts.read(part, vec![sphere.source()], &options, &control).expect("it reads");
    }
    for error in [
        parts.run(BuildStep::Count, 1, &options, &control).expect_err("two are missing"),
        parts.next_step(1).expect_err("two are missing"),
        parts.merge(&folder.path().join("m.rset"), &options, &control).expect_err("two are missing"),
    ] {
        assert!(
            error.to_string().starts_with("parts 2, 4 of 4 of step `read` have not been done"),
            "{error}"
        );
    }
    assert_eq!(parts.next_step(2).expect("it can be read"), Some(BuildStep::Read));
    assert!(BuildParts::new(folder.path(), 0).is_err() && BuildParts::new(folder.path(), 513).is_err());
    assert!(parts.read(5, vec![sphere.source()], &options, &control).is_err());
    assert!(BuildParts::open(folder.path()).is_err());
}

/// Changes a file of a finished build in parts, and merges it.
fn merged_after(change: impl FnOnce(&Path)) -> Result<(), BuildError> {
    let folder = folder();
    let sphere: Workload = "sphere-30k".parse().expect("a workload");
    let (options, control) = (with_radius(0.03), BuildControl::default());
    let parts = BuildParts::new(&folder.path().join("p"), 2).expect("a number of parts");
    do_steps(&parts, &|| vec![sphere.source()], &options).expect("the steps end");
    change(&folder.path().join("p"));
    let path = folder.path().join("m.rset");
    std::fs::write(&path, "what was there").expect("a write");
    let merged = parts.merge(&path, &options, &control);
    if merged.is_err() {
        assert_eq!(std::fs::read(&path).expect("it reads"), b"what was there");
        let names = std::fs::read_dir(folder.path()).expect("a folder").count();
        assert_eq!(names, 2, "nothing unfinished stays");
    }
    merged.map(drop)
}

/// Changes a byte in the middle of a file.
fn damage(path: &Path) {
    let mut bytes = std::fs::read(path).expect("it reads");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(path, bytes).expect("a write");
}

#[test]
fn parts_that_are_damaged_missing_foreign_or_renamed_are_refused() {
    let said = |change: fn(&Path)| merged_after(change).expect_err("it is refused").to_string();
    assert!(merged_after(|_| {}).is_ok());
    for name in ["read-1-of-2.part", "order-2-of-2.part"] {
        let error = merged_after(|folder| damage(&folder.join(name))).expect_err("it is refused").to_string();
        assert!(error.contains("its checksum is wrong") && error.contains(name), "{error}");
    }
    let error = said(|folder| damage(&folder.join("order-1-of-2.data")));
    assert!(error.contains("order-1-of-2.data: it is damaged at byte"), "{error}");
    let error = said(|folder| {
        let path = folder.join("order-2-of-2.data");
        let file = std::fs::File::options().write(true).open(path).expect("it opens");
        file.set_len(1000).expect("it is cut");
    });
    assert!(error.contains("it has 1000 bytes"), "{error}");
    let error = said(|folder| std::fs::remove_file(folder.join("order-2-of-2.part")).expect("it goes"));
    assert!(error.starts_with("part 2 of 2 of step `order` has not been done"), "{error}");
    let error = said(|folder| {
        std::fs::copy(folder.join("order-1-of-2.part"), folder.join("order-2-of-2.part")).expect("a copy");
    });
    assert!(error.contains("it is part 1 of 2 of `order`, renamed"), "{error}");
    let error = said(|folder| {
        // The records of another share.
        let cube: Workload = "cube-30k".parse().expect("a workload");
        let parts = BuildParts::new(folder, 2).expect("a number of parts");
        parts.read(2, vec![cube.source()], &with_radius(0.03), &BuildControl::default()).expect("it reads");
    });
    assert!(error.contains("it was made of other parts of `read`; run that step again"), "{error}");
    let error = said(|folder| std::fs::write(folder.join("order-1-of-2.part"), "text").expect("a write"));
    assert!(error.contains("it is no part of a build"), "{error}");
}

#[test]
fn data_that_were_damaged_between_steps_are_found_before_anything_is_made_of_them() {
    let sphere: Workload = "sphere-30k".parse().expect("a workload");
    for (options, steps) in [
        (with_radius(0.03), &["read", "scatter"][..]),
        (measured(), &["read", "spacing-scatter", "spacing-sort", "spacing-measure", "count", "scatter"]),
    ] {
        for damaged in steps {
            let folder = folder();
            let parts = BuildParts::new(&folder.path().join("p"), 2).expect("a number of parts");
            let outcome = BuildStep::ALL.into_iter().try_for_each(|step| {
                do_step(&parts, step, &|| vec![sphere.source()], &options)?;
                if step.name() == *damaged {
                    damage(&parts.files(step, 2)[1]);
                }
                Ok::<_, BuildError>(())
            });
            let error = outcome.expect_err(damaged).to_string();
            assert!(error.contains("damaged"), "{damaged}: {error}");
        }
    }
}

#[test]
fn a_share_that_was_read_for_the_same_request_is_not_read_again_and_one_for_another_is_refused() {
    let folder = folder();
    let sphere: Workload = "sphere-20k".parse().expect("a workload");
    let (options, control) = (with_radius(0.03), BuildControl::default());
    let parts = |request: &str| {
        let parts = BuildParts::new(&folder.path().join("p"), 1).expect("a number of parts");
        parts.with_request(request.into())
    };
    let read = |request: &str| parts(request).read(1, vec![sphere.source()], &options, &control);
    read("a sphere").expect("it reads");
    let changed = |path: &Path| std::fs::metadata(path).and_then(|m| m.modified()).expect("a time");
    let [head, _] = parts("").files(BuildStep::Read, 1);
    let before = changed(&head);
    read("a sphere").expect("it is there");
    assert_eq!(changed(&head), before);
    for error in [
        read("a cube").expect_err("another build"),
        parts("a cube").run(BuildStep::Count, 1, &options, &control).expect_err("another build"),
    ] {
        assert!(error.to_string().contains("of other inputs or with other options"), "{error}");
    }
}

#[test]
fn later_steps_hold_less_memory_than_was_planned_for_only_with_a_clear_error() {
    let folder = folder();
    let sphere: Workload = "sphere-20k".parse().expect("a workload");
    let control = BuildControl::default();
    let options = BuildOptions { memory_bytes: 64 << 20, ..with_radius(0.03) };
    let parts = BuildParts::new(folder.path(), 1).expect("a number of parts");
    parts.read(1, vec![sphere.source()], &options, &control).expect("it reads");
    let less = BuildOptions { memory_bytes: 32 << 20, threads: 1, ..options };
    let error = parts.run(BuildStep::Count, 1, &less, &control).expect_err("too little");
    assert!(matches!(error, BuildError::Memory { needed, .. } if needed == 64 << 20), "{error}");
}

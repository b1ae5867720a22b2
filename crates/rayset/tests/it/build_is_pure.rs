//! The same input and options give the same bytes, whatever the threads, the memory and the order
//! of the input.

use std::path::Path;

use rayset::octree::Cloud;
use rayset::octree::build::{self, BuildControl, BuildOptions, Rule};
use rayset::octree::verify::Depth;
use rayset::points::{ArraySource, PointBatch, PointSource, Workload};

use crate::common::{Random, folder, mixed_points};

/// Builds under several conditions and checks that all files are the same, and whole.
pub(crate) fn check(folder: &Path, sources: &dyn Fn() -> Vec<Box<dyn PointSource>>, options: &BuildOptions) {
    let mut first: Option<Vec<u8>> = None;
    for (threads, memory) in
        [(1, build::minimum_memory(1)), (2, build::minimum_memory(2)), (3, 64 << 20), (1, 1 << 30)]
    {
        let path = folder.join("c.rset");
        let options = BuildOptions { threads, memory_bytes: memory, ..options.clone() };
        build::run(sources(), &path, &options, &BuildControl::default()).expect("the cloud builds");
        let cloud = Cloud::open(&path).expect("the cloud opens");
        cloud.verify(Depth::Deep).expect("all bounds hold");
        let bytes = std::fs::read(&path).expect("the file reads");
        match &first {
            None => first = Some(bytes),
            Some(first) => assert!(*first == bytes, "{threads} threads, {memory} bytes: another file"),
        }
    }
}

fn boxed(source: ArraySource) -> Vec<Box<dyn PointSource>> {
    vec![Box::new(source)]
}

#[test]
fn a_sphere_with_one_radius() {
    let folder = folder();
    let workload: Workload = "sphere-120k".parse().expect("a workload");
    let options = BuildOptions { radius: Some(Rule::Number(0.03)), ..BuildOptions::default() };
    check(folder.path(), &|| vec![workload.source()], &options);
}

#[test]
fn radii_over_many_octaves_and_every_column() {
    let folder = folder();
    let options = BuildOptions { attributes: vec!["weight".into(), "red".into()], ..BuildOptions::default() };
    check(folder.path(), &|| boxed(mixed_points(70_000, 12.0, 31)), &options);
}

#[test]
fn automatic_radii() {
    let folder = folder();
    let workload: Workload = "knot-90k".parse().expect("a workload");
    let options = BuildOptions { radius: Some(Rule::Auto), ..BuildOptions::default() };
    check(folder.path(), &|| vec![workload.source()], &options);
}

#[test]
fn one_radius_wider_than_the_cloud_makes_one_deep_list() {
    let folder = folder();
    let options = BuildOptions { radius: Some(Rule::Number(50.0)), ..BuildOptions::default() };
    check(folder.path(), &|| boxed(mixed_points(60_000, 0.0, 32)), &options);
}

#[test]
fn a_cluster_too_dense_for_one_bucket_and_many_coinciding_points() {
    let folder = folder();
    let source = || {
        let mut random = Random(33);
        let mut position = Vec::new();
        for i in 0..90_000 {
            // A third far apart, a third within a thousandth of that, a third at one place.
            let scale = [1.0, 1e-3, 0.0][i % 3];
            position.push(std::array::from_fn(|_| scale * (random.unit() - 0.5)));
        }
        boxed(ArraySource::new(position, vec![]))
    };
    for rule in [Rule::Number(1e-4), Rule::Auto] {
        check(folder.path(), &source, &BuildOptions { radius: Some(rule), ..BuildOptions::default() });
    }
}

#[test]
fn the_order_of_the_input_does_not_matter() {
    let folder = folder();
    let mut source = mixed_points(30_000, 3.0, 34);
    source.select(&[0, 1, 2, 3, 4]);
    let mut batch = PointBatch::default();
    source.fill(&mut batch, usize::MAX).expect("arrays read");
    let names = ["radius", "weight", "red", "green", "blue"];
    let part = |range: &mut dyn Iterator<Item = usize>| -> Box<dyn PointSource> {
        let indices: Vec<usize> = range.collect();
        let position = indices.iter().map(|&i| batch.position[i]).collect();
        let column = |c: usize| indices.iter().map(|&i| batch.columns[c].get(i) as f32).collect();
        let columns = names.iter().enumerate().map(|(c, name)| (*name, column(c))).collect();
        Box::new(ArraySource::new(position, columns))
    };
    let build = |name: &str, sources| {
        let path = folder.path().join(name);
        build::run(sources, &path, &BuildOptions::default(), &BuildControl::default())
            .expect("the cloud builds");
        std::fs::read(&path).expect("the file reads")
    };
    let forward = build("a", vec![part(&mut (0..30_000))]);
    let backward = build("b", vec![part(&mut (15_000..30_000).rev()), part(&mut (0..15_000).rev())]);
    assert!(forward == backward);
}

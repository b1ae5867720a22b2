//! Points that are equal in every column become one of their summed weight where they are many, and
//! nothing else changes.

use std::sync::Arc;

use rayset::field::Kernel;
use rayset::octree::Cloud;
use rayset::octree::build::{BuildOptions, Rule};
use rayset::octree::format::Column;
use rayset::octree::verify::Depth;
use rayset::points::ArraySource;

use crate::common::{Random, bits, build_at, folder, plain_picture, scene, settings};

/// A point and the number in its column.
type Point = ([f64; 3], f32);

/// Some points in a box.
fn places(count: usize) -> Vec<Point> {
    let mut random = Random(71);
    let mut coordinate = || 2.0 * random.unit() - 1.0;
    (0..count).map(|i| ([coordinate(), coordinate(), coordinate()], i as f32)).collect()
}

/// Points in an order in which none stands beside its copies.
fn shuffled(mut points: Vec<Point>) -> Vec<Point> {
    let mut random = Random(72);
    for at in (1..points.len()).rev() {
        points.swap(at, (random.unit() * at as f64) as usize);
    }
    points
}

/// A cloud with measured radii; weights are those of a column if there is one.
fn built(points: Vec<Point>, weights: Option<Vec<f32>>) -> Arc<Cloud> {
    built_with(Rule::Auto, points, weights)
}

/// The same with any rule for radii, which may name the column "size", one of four sizes.
fn built_with(radius: Rule, points: Vec<Point>, weights: Option<Vec<f32>>) -> Arc<Cloud> {
    let sizes = points.iter().map(|(_, number)| 0.1 + 0.02 * (number % 4.0)).collect();
    let (position, numbers) = points.into_iter().unzip();
    let columns = weights.map(|weights| ("weight", weights)).into_iter();
    let source = ArraySource::new(position, columns.chain([("number", numbers), ("size", sizes)]).collect());
    let attributes = vec!["number".into()];
    let options = BuildOptions { radius: Some(radius), attributes, ..BuildOptions::default() };
    let folder = folder();
    let path = folder.path().join("c.rset");
    let cloud = build_at(&path, Box::new(source), &options);
    cloud.verify(Depth::Deep).expect("all bounds hold");
    // The file may go: it is read into memory.
    let bytes = std::fs::read(&path).expect("the file reads");
    Arc::new(Cloud::from_bytes(bytes).expect("the cloud opens"))
}

fn picture(cloud: &Arc<Cloud>) -> Vec<[u32; 4]> {
    bits(&plain_picture(&scene(cloud, Kernel::WendlandC2, true), &settings(40, 30)))
}

#[test]
fn copies_are_the_picture_of_one_point_with_the_sum_of_their_weights() {
    let places = places(3000);
    let times = |i: usize| 1 + i % 4;
    let copied = (0..).zip(&places).flat_map(|(i, point)| vec![*point; times(i)]).collect::<Vec<_>>();
    let count = copied.len() as u64;
    let cloud = built(shuffled(copied), None);
    let header = cloud.header();
    assert_eq!((header.points, header.copies), (3000, count - 3000));
    assert_eq!(header.weight, Column::Varying { min: 1.0, max: 4.0 });
    let weighted = built(places.clone(), Some((0..3000).map(|i| times(i) as f32).collect()));
    assert_eq!(weighted.header().copies, 0);
    assert!(picture(&cloud) == picture(&weighted), "the pictures differ");
    // Weights of their own are summed, too.
    let twice: Vec<Point> = places.iter().chain(&places).copied().collect();
    let cloud = built(twice, Some((0..6000).map(|i| times(i % 3000) as f32 / 2.0).collect()));
    assert_eq!((cloud.header().points, cloud.header().copies), (3000, 3000));
    assert!(picture(&cloud) == picture(&weighted), "the pictures differ");
}

#[test]
fn each_point_twice_has_the_radii_of_each_once() {
    let places = places(3000);
    let once = built(places.clone(), None);
    let twice = built(shuffled(places.iter().chain(&places).copied().collect()), None);
    let (once, twice) = (once.header(), twice.header());
    assert_eq!((once.radius, once.radius_mean), (twice.radius, twice.radius_mean));
    assert_eq!(twice.weight, Column::Constant(2.0), "one weight is stored once");
}

#[test]
fn all_points_at_one_place_are_one() {
    let cloud = built(vec![([1.0, 2.0, 3.0], 5.0); 100_000], None);
    assert_eq!((cloud.header().points, cloud.header().copies), (1, 99_999));
    assert_eq!(cloud.header().weight, Column::Constant(1e5));
}

#[test]
fn points_that_differ_in_a_column_and_few_copies_stay_as_they_are() {
    let places = places(3000);
    let other = |(position, number): &Point| (*position, number + 0.5);
    let differing = built(places.iter().copied().chain(places.iter().map(other)).collect(), None);
    assert_eq!((differing.header().points, differing.header().copies), (6000, 0));
    let few = built(places.iter().chain(&places[..300]).copied().collect(), None);
    assert_eq!((few.header().points, few.header().copies), (3300, 0));
    assert_eq!(few.header().weight, Column::Constant(1.0));
    // An eighth is many, and one of fifteen is not.
    for (copies, merged) in [(1, 0), (2, 2)] {
        let cloud = built(places[..14].iter().chain(&places[..copies]).copied().collect(), None);
        assert_eq!(cloud.header().copies, merged, "{copies} copies of 14 points");
    }
}

#[test]
fn copies_are_merged_whether_radii_are_measured_or_given() {
    let places = places(3000);
    let times = |i: usize| 1 + i % 4;
    let copied: Vec<Point> = (0..).zip(&places).flat_map(|(i, point)| vec![*point; times(i)]).collect();
    for radius in [Rule::Number(0.12), Rule::Attribute("size".into())] {
        let cloud = built_with(radius.clone(), shuffled(copied.clone()), None);
        let header = cloud.header();
        assert_eq!((header.points, header.copies), (3000, copied.len() as u64 - 3000), "{radius:?}");
        assert_eq!(header.weight, Column::Varying { min: 1.0, max: 4.0 });
        let weights = Some((0..3000).map(|i| times(i) as f32).collect());
        let weighted = built_with(radius.clone(), places.clone(), weights);
        assert_eq!((header.radius, weighted.header().copies), (weighted.header().radius, 0));
        assert!(picture(&cloud) == picture(&weighted), "the pictures differ: {radius:?}");
        // Many points without copies keep their order and their files.
        let few = places.iter().chain(&places[..300]).copied().collect();
        assert_eq!(built_with(radius, few, None).header().copies, 0);
    }
}

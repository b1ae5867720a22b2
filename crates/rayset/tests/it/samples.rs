//! Samples of clouds and grids, from which looks are chosen: values that are there, spread over the
//! whole file.

use std::sync::Arc;

use rayset::grid::Grid;
use rayset::grid::build::{self as grid_build, GridBuildOptions};
use rayset::octree::build::{BuildControl, BuildOptions};
use rayset::points::{ArraySource, ColumnInfo, ColumnType, Values};
use rayset::volumes::RawLayout;

use crate::common::{Random, build_at, folder};

fn cloud(points: usize, folder: &std::path::Path) -> Arc<rayset::Cloud> {
    let mut random = Random(3);
    let position: Vec<[f64; 3]> = (0..points).map(|_| std::array::from_fn(|_| random.unit())).collect();
    let number: Vec<u32> = (0..points as u32).collect();
    let bright: Vec<u8> = number.iter().map(|n| (n % 256) as u8).collect();
    let mut columns = vec![(ColumnInfo::new("number", ColumnType::U32), Values::U32(number))];
    for name in ["red", "green", "blue"] {
        columns.push((ColumnInfo::new(name, ColumnType::U8), Values::from(bright.clone())));
    }
    let options = BuildOptions { attributes: vec!["number".into()], ..BuildOptions::default() };
    build_at(&folder.join("c.rset"), Box::new(ArraySource::typed(position, columns)), &options)
}

#[test]
fn a_sample_of_a_small_cloud_is_all_of_it() {
    let folder = folder();
    let cloud = cloud(1000, folder.path());
    let (sample, schema) = (cloud.sample(1000).expect("it reads"), cloud.sample_schema());
    let names: Vec<&str> = schema.names().collect();
    assert_eq!(names, ["radius", "weight", "red", "green", "blue", "number"]);
    let mut numbers: Vec<u32> = (0..sample.len()).map(|i| sample.columns[5].get(i) as u32).collect();
    numbers.sort_unstable();
    assert_eq!(numbers, (0..1000).collect::<Vec<u32>>());
}

#[test]
fn a_sample_of_a_large_cloud_is_small_and_comes_from_everywhere() {
    let folder = folder();
    let cloud = cloud(100_000, folder.path());
    let sample = cloud.sample(2000).expect("it reads");
    assert!((1000..=2200).contains(&sample.len()), "{} points", sample.len());
    let mut octants = [0; 8];
    for p in &sample.position {
        octants[(0..3).map(|axis| usize::from(p[axis] > 0.5) << axis).sum::<usize>()] += 1;
    }
    assert!(octants.iter().all(|&n| n > sample.len() / 32), "{octants:?}");
    let again = cloud.sample(2000).expect("it reads");
    assert_eq!(sample.position, again.position, "a function of the file alone");
}

#[test]
fn the_nearest_point_is_the_one_that_is_nearest_of_all() {
    let folder = folder();
    let cloud = cloud(20_000, folder.path());
    let all = cloud.sample(20_000).expect("it reads");
    assert_eq!(all.len(), 20_000);
    let mut random = Random(9);
    for _ in 0..100 {
        // Some of them outside.
        let place: [f64; 3] = std::array::from_fn(|_| 1.4 * random.unit() - 0.2);
        let distance = |p: &[f64; 3]| (0..3).map(|axis| (p[axis] - place[axis]).powi(2)).sum::<f64>().sqrt();
        let found = cloud.nearest(place.into(), 1.0).expect("it reads");
        let nearest =
            (0..all.len()).min_by(|&a, &b| distance(&all.position[a]).total_cmp(&distance(&all.position[b])));
        let nearest = nearest.expect("there are points");
        assert_eq!(found.position, [all.position[nearest]]);
        assert_eq!(found.columns[5].get(0), all.columns[5].get(nearest), "its attributes are its own");
        let closer = cloud.nearest(place.into(), 0.999 * distance(&all.position[nearest])).expect("it reads");
        assert!(closer.is_empty());
    }
}

#[test]
fn the_regions_of_pages_have_every_page_once_and_hold_the_points_of_their_pages() {
    let folder = folder();
    let cloud = cloud(100_000, folder.path());
    for most in [1, 7, 1000] {
        let regions = cloud.page_regions(most).expect("it reads");
        assert!(regions.len() <= most);
        let mut next = 0;
        for (pages, bounds) in &regions {
            assert_eq!(pages.start, next);
            next = pages.end;
            assert!(!bounds.is_empty());
        }
        assert_eq!(next, cloud.header().point_pages);
        let mut outside = 0;
        cloud
            .for_each_run(|page, run| {
                let (_, bounds) = regions.iter().find(|(pages, _)| pages.contains(&page)).expect("a region");
                let positions = run.positions(cloud.header().root_cell());
                outside += positions.iter().filter(|&&p| !bounds.contains(p)).count();
            })
            .expect("it reads");
        assert_eq!(outside, 0, "with {most} groups");
    }
}

#[test]
fn a_sample_of_a_grid_has_every_voxel_once_if_there_is_room_for_all() {
    let folder = folder();
    // Several bricks along each axis, the last of them narrow.
    let size = [70_u64, 33, 65];
    let voxels: Vec<u8> = (0..size.iter().product::<u64>()).map(|i| (i * i % 251) as u8).collect();
    let raw = folder.path().join("v.raw");
    std::fs::write(&raw, &voxels).expect("a write");
    let layout: RawLayout = "70x33x65,u8".parse().expect("a layout");
    let source = layout.open(&raw).expect("it opens");
    let path = folder.path().join("g.rset");
    grid_build::build(source, &path, &GridBuildOptions::default(), &BuildControl::default())
        .expect("it builds");
    let grid = Grid::open(&path).expect("it opens");
    let sample = grid.sample(voxels.len()).expect("it reads");
    let mut found: Vec<f64> = (0..sample.len()).map(|i| sample.columns[0].get(i)).collect();
    for (p, value) in sample.position.iter().zip(&found) {
        let [x, y, z] = p.map(|v| v as u64);
        assert_eq!(f64::from(voxels[((z * size[1] + y) * size[0] + x) as usize]), *value, "at {p:?}");
    }
    let mut all: Vec<f64> = voxels.iter().map(|&v| f64::from(v)).collect();
    found.sort_by(f64::total_cmp);
    all.sort_by(f64::total_cmp);
    assert!(found == all, "{} values of {}", found.len(), all.len());
    let few = grid.sample(500).expect("it reads");
    assert!((300..=600).contains(&few.len()), "{} voxels", few.len());
}

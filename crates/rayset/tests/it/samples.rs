//! Samples of clouds and grids, from which looks are chosen: values that are there, spread over the whole file.

use std::sync::Arc;

use rayset::grid::Grid;
use rayset::grid::build::{self as grid_build, GridBuildOptions};
use rayset::grid::read::VolumeSource;
use rayset::octree::build::{BuildControl, BuildOptions};
use rayset::points::{ArraySource, ColumnInfo, ColumnType, Values};

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
fn a_sample_of_a_grid_has_every_voxel_once_if_there_is_room_for_all() {
    let folder = folder();
    // Several bricks along each axis, the last of them narrow.
    let size = [70_u64, 33, 65];
    let voxels: Vec<u8> = (0..size.iter().product::<u64>()).map(|i| (i * i % 251) as u8).collect();
    let raw = folder.path().join("v.raw");
    std::fs::write(&raw, &voxels).expect("a write");
    let layout = "70x33x65,u8".parse().expect("a layout");
    let source = VolumeSource::open_raw(&raw, &layout).expect("it opens");
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

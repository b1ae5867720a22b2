//! Points that are ellipsoids: in files, in the field, in pictures.

use rayset::field::{Kernel, SimdLevel};
use rayset::octree::build::BuildOptions;
use rayset::octree::verify::Depth;
use rayset::points::ArraySource;

use crate::common::{Random, build_at, folder};
use crate::right_picture::check_field;

/// Points as `mixed_points` has them, that are ellipsoids of any directions, whose ratios are down
/// to `2^-thin`.
fn ellipsoids(count: usize, octaves: f64, thin: f64, seed: u64) -> ArraySource {
    let mut random = Random(seed);
    let (mut position, mut columns) = (Vec::new(), vec![Vec::new(); 12]);
    for _ in 0..count {
        position.push(std::array::from_fn(|_| 2.0 * random.unit() - 1.0));
        let radius = 0.35 * 2_f64.powf(-octaves * random.unit());
        let ratios = [0, 1].map(|_| 2_f64.powf(-thin * random.unit()));
        let mut axes = [1.0, ratios[0], ratios[1]].map(|ratio| radius * ratio);
        axes.rotate_left((3.0 * random.unit()) as usize);
        let rotation = [0, 1, 2, 3].map(|_| random.unit() - 0.5);
        let rest = [0; 4].map(|_| 0.2 + 0.8 * random.unit());
        let values = [radius].into_iter().chain(axes).chain(rotation).chain(rest);
        columns.iter_mut().zip(values).for_each(|(column, value)| column.push(value as f32));
    }
    let names = [
        "radius",
        "semi_axis_1",
        "semi_axis_2",
        "semi_axis_3",
        "rotation_x",
        "rotation_y",
        "rotation_z",
        "rotation_w",
        "weight",
        "red",
        "green",
        "blue",
    ];
    ArraySource::new(position, names.into_iter().zip(columns).collect())
}

#[test]
fn density_and_normals_of_ellipsoids_are_right_for_every_kernel_and_instruction_set() {
    let folder = folder();
    let source = Box::new(ellipsoids(3000, 4.0, 4.0, 1));
    let cloud = build_at(&folder.path().join("c.rset"), source, &BuildOptions::default());
    assert!(cloud.header().shape.is_some());
    for &kernel in Kernel::ALL {
        for simd in SimdLevel::available() {
            check_field(&cloud, 1.0, kernel, simd);
        }
    }
}

#[test]
fn density_is_right_where_ellipsoids_are_a_thousand_times_as_wide_as_thick() {
    let folder = folder();
    let source = Box::new(ellipsoids(3000, 1.0, 11.0, 2));
    let cloud = build_at(&folder.path().join("c.rset"), source, &BuildOptions::default());
    check_field(&cloud, 1.0, Kernel::Wyvill, SimdLevel::default());
}

#[test]
fn a_file_of_ellipsoids_is_what_it_says() {
    let folder = folder();
    let source = Box::new(ellipsoids(30_000, 4.0, 8.0, 3));
    let cloud = build_at(&folder.path().join("c.rset"), source, &BuildOptions::default());
    cloud.verify(Depth::Deep).expect("it is whole");
}

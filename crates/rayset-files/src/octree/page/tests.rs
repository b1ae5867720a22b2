//! Tests of the guarantees of an encoded run.

use super::*;
use crate::octree::format::{AttributeInfo, Column};
use crate::octree::layout::NodeRef;
use crate::octree::run_encoder::{RunColumns, encode_run, step_code_for};
use crate::octree::shape::SHAPE_COLUMNS;
use crate::points::ColumnType;
use rayset_base::geometry::{DQuat, Shape};

#[test]
fn the_step_of_a_run_is_the_finest_that_is_large_enough() {
    for root_size in [2_f64.powi(-60), 1.0, 2_f64.powi(20)] {
        let step_of = |code: u8| root_size * step_fraction(code);
        for exponent in 10..150 {
            // Exact powers of two, and adjacent numbers, whose logarithms round to those of the
            // powers.
            for factor in [1.0, 1.0 + f64::EPSILON, 1.0 - f64::EPSILON / 2.0, 1.3] {
                let step = root_size * 2_f64.powi(-exponent) * factor;
                let code = step_code_for(step, root_size);
                let last = (STEP_CODES - 1) as u8;
                assert!(code <= last);
                assert!(step_of(code) >= step || code == 0, "{step} of {root_size}: code {code}");
                assert!(code == last || step_of(code + 1) < step, "{step} of {root_size}: code {code}");
            }
        }
        assert_eq!(step_code_for(0.0, root_size), (STEP_CODES - 1) as u8, "one place needs no width");
    }
}

/// Points in a box within the root cell.
fn points(count: usize, corner: f64, extent: [f64; 3]) -> Vec<[f64; 3]> {
    let place = |i: usize, axis: usize| {
        let t = (i as f64 * [0.618, 0.755, 0.57][axis]).fract();
        corner + extent[axis] * t
    };
    (0..count).map(|i| std::array::from_fn(|axis| place(i, axis))).collect()
}

#[test]
fn the_bounds_of_a_run_hold_its_points_closely() {
    let root = RootCell { min: DVec3::new(-64.0, 0.0, 3.0), size: 128.0 };
    for (extent, radius) in [([1.0, 0.5, 0.25], 0.1), ([1e-3, 2e-3, 1e-5], 1e-4), ([50.0, 40.0, 0.0], 3.0)] {
        for corner in [3.5, 17.25] {
            let position = points(100, corner, extent);
            let radius = vec![radius; position.len()];
            for precision in [0.0, 1.0 / 4096.0, 1e-8] {
                let run = RunColumns {
                    position: &position,
                    radius: &radius,
                    store_radius: false,
                    weight: None,
                    color: None,
                    harmonics: &[],
                    shape: None,
                    attributes: &[],
                };
                let mut data = Vec::new();
                let encoded = encode_run(&run, root, precision, &mut data);
                let bounds = encoded.head.position_bounds(root);
                let mut tight = Aabb::EMPTY;
                position.iter().for_each(|p| tight.include(DVec3::from_array(*p)));
                assert!(bounds.inflated(encoded.position_error).encloses(&tight));
                assert_eq!(precision == 0.0, encoded.head.encoding() == Encoding::F64);
                assert!(encoded.position_error <= precision * f64::from(radius[0]));
                // One unit of the lattice of corners, and two of the extent, of which at least 127
                // span the widest axis.
                let slack = root.size / ORIGIN_STEPS + 3.0 * tight.size().max_element() / 126.0;
                let wider = (bounds.size() - tight.size()).max_element();
                assert!(
                    wider <= slack,
                    "{extent:?}, {precision}: {wider} wider than the points, {slack} allowed"
                );
            }
        }
    }
}

/// The header of a file whose points have radii, colours and shapes, and one attribute of two
/// bytes.
fn header_with_shapes() -> Header {
    let attribute = AttributeInfo {
        name: "class".to_owned(),
        kind: ColumnType::U16,
        unit: String::new(),
        is_class: false,
        min: 0.0,
        max: 200.0,
    };
    let mut header = Header {
        identity: rayset_store::container::Identity::default(),
        page_bytes: 65536,
        point_pages: 1,
        node_pages: 1,
        file_bytes: 0,
        points: 100,
        skipped: 0,
        nodes: 1,
        root: NodeRef::default(),
        root_min: DVec3::ZERO,
        root_size: 128.0,
        bounds: Aabb::new(DVec3::ZERO, DVec3::splat(100.0)),
        radius: Column::Varying { min: 0.1, max: 2.0 },
        radius_mean: 1.0,
        radius_scale: 1.0,
        weight: Column::Constant(1.0),
        position_error: 0.0,
        position_error_radii: 0.0,
        has_color: true,
        harmonics: 0,
        shape: Some((1e-3, 1.0)),
        attributes: vec![attribute],
        point_data_bytes: 0,
        render_memory: 0,
        crs: String::new(),
        sources: Vec::new(),
        up: None,
        step: None,
        copies: 0,
        aggregates: None,
        columns: ColumnLayout::default(),
    };
    header.columns = header.column_layout(1);
    header
}

#[test]
fn points_with_shapes_are_placed_as_their_thinnest_axes_need_and_take_fourteen_bytes_more() {
    let header = header_with_shapes();
    let root = header.root_cell();
    for count in [1, 2, 77, 128] {
        let position = points(count, 3.5, [6.0, 5.0, 7.0]);
        let radius: Vec<f32> = (0..count).map(|i| 0.2 + 0.01 * i as f32).collect();
        let color: Vec<[u8; 3]> = (0..count).map(|i| [i as u8, 1, 2]).collect();
        let classes: Vec<u8> = (0..count as u16).flat_map(u16::to_le_bytes).collect();
        let shape = |i: usize, thinnest: f64| {
            let rotation = DQuat::from_rotation_x(i as f64) * DQuat::from_rotation_y(0.7 * i as f64);
            StoredShape::encode(&Shape { rotation, ratios: [0.9, thinnest] })
        };
        for (thinnest, encoding) in [(0.5, Encoding::U24), (0.01, Encoding::U24), (1e-4, Encoding::U32)] {
            let shapes: Vec<StoredShape> = (0..count).map(|i| shape(i, thinnest)).collect();
            let run = RunColumns {
                position: &position,
                radius: &radius,
                store_radius: true,
                weight: None,
                color: Some(&color),
                harmonics: &[],
                shape: Some(&shapes),
                attributes: &[&classes],
            };
            let mut data = Vec::new();
            let encoded = encode_run(&run, root, 1.0 / 4096.0, &mut data);
            assert!(encoded.position_error_radii <= 1.0 / 4096.0);
            if count > 2 {
                assert_eq!(encoded.head.encoding(), encoding, "{count} points of {thinnest}");
            }
            assert_eq!(data.len(), encoded.head.data_bytes(header.columns));
            let balls = RunColumns { shape: None, ..run };
            let mut of_balls = Vec::new();
            let balls = encode_run(&balls, root, 1.0 / 4096.0, &mut of_balls).head;
            if balls.encoding() == Encoding::U16 && encoding == Encoding::U24 {
                let most = 14 * count + 4 * (3 + SHAPE_COLUMNS);
                assert!(data.len() - of_balls.len() <= most, "{} bytes more", data.len() - of_balls.len());
            }
            let run = Run { head: encoded.head, data: &data };
            let stored: Vec<StoredShape> = run.shapes(&header).unwrap().collect();
            assert_eq!(stored, shapes);
            assert_eq!(run.radii(&header).unwrap().collect::<Vec<_>>(), radius);
            assert_eq!(run.colors(&header).unwrap().collect::<Vec<_>>(), color);
            assert_eq!(run.attribute_bytes(&header, 0), classes);
            for (is, (was, radius)) in run.positions(root).iter().zip(position.iter().zip(&radius)) {
                let error = is.distance(DVec3::from_array(*was));
                assert!(error <= f64::from(*radius) * thinnest / 4096.0, "{error} of {radius}");
            }
        }
    }
}

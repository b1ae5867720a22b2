//! Tests of the guarantees of an encoded run.

use super::*;
use crate::octree::run_encoder::{RunColumns, encode_run, step_code_for};

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

//! Encoding runs of points, as point pages have them.

use super::layout::{RUN_POINTS, RootCell};
use super::page::{
    COARSEST_STEP, Encoding, ORIGIN_STEPS, RunHead, STEP_CODES, round_up_to_16_bits, step_fraction,
};
use super::shape::{SHAPE_COLUMNS, StoredShape};
use rayset_base::geometry::{Aabb, DVec3};

/// The columns of one run, as provided by the builder.
#[derive(Clone, Copy, Debug)]
pub struct RunColumns<'a> {
    /// Positions in world space, 1 to 128 of them.
    pub position: &'a [[f64; 3]],
    /// Radii.
    pub radius: &'a [f32],
    /// Whether the radii are stored.
    pub store_radius: bool,
    /// Weights, if they are stored.
    pub weight: Option<&'a [f32]>,
    /// Colours, if they are stored.
    pub color: Option<&'a [[u8; 3]]>,
    /// The bytes of the coefficients of all points; empty if none are stored.
    pub harmonics: &'a [u8],
    /// Shapes, if they are stored.
    pub shape: Option<&'a [StoredShape]>,
    /// Attribute columns, each value in its own type, little-endian.
    pub attributes: &'a [&'a [u8]],
}

/// A run ready to be placed in a page.
#[derive(Clone, Debug)]
pub struct EncodedRun {
    /// The record; its offset is set when the run is placed.
    pub head: RunHead,
    /// Largest distance between a stored and a given position, world space.
    pub position_error: f64,
    /// The same divided by the smallest radius of the run, of points with shapes by the shortest
    /// semi-axis.
    pub position_error_radii: f64,
}

/// Encodes a run, appending its data to `data`.
///
/// `precision` is the largest position error allowed, as a fraction of the smallest radius of the
/// run, of points with shapes of the shortest semi-axis; with zero, positions are stored exactly.
pub fn encode_run(run: &RunColumns<'_>, root: RootCell, precision: f64, data: &mut Vec<u8>) -> EncodedRun {
    let mut bounds = Aabb::EMPTY;
    run.position.iter().for_each(|p| bounds.include(DVec3::from_array(*p)));
    let cell = root.size / ORIGIN_STEPS;
    let origin =
        ((bounds.min - root.min) / cell).floor().max(DVec3::ZERO).min(DVec3::splat(ORIGIN_STEPS - 1.0));
    let corner = root.min + origin * cell;
    let extent = (bounds.max - corner).max(DVec3::ZERO);
    let shortest = shortest_semi_axis(run);
    let radius_max = run.radius.iter().copied().fold(0.0, f32::max);

    // For each encoding, the finest step whose largest offset fits; of the encodings, the smallest
    // that is precise enough.
    let finest = |steps: f64| step_code_for(extent.max_element() / steps, root.size);
    let step = |code: u8| root.size * step_fraction(code);
    let worst_error = |code: u8| 0.5 * 3_f64.sqrt() * step(code);
    let good = |code: u8| worst_error(code) <= precision * shortest;
    let (code_u16, code_u32) = (finest(65279.0), finest(4_278_000_000.0));
    let code_u24 = finest(16_711_000.0);
    let (encoding, step_code) = if precision > 0.0 && good(code_u16) {
        (Encoding::U16, code_u16)
    } else if precision > 0.0 && run.shape.is_some() && good(code_u24) {
        (Encoding::U24, code_u24)
    } else if precision > 0.0 && good(code_u32) {
        (Encoding::U32, code_u32)
    } else {
        (Encoding::F64, code_u16)
    };
    let unit = step(step_code) * encoding.extent_steps();

    let start = data.len();
    let (mut errors_squared, mut worst_axis) = ([0.0; RUN_POINTS], 0.0_f64);
    for axis in 0..3 {
        if encoding == Encoding::F64 {
            run.position.iter().for_each(|p| data.extend_from_slice(&p[axis].to_le_bytes()));
            continue;
        }
        let step = step(step_code);
        for (p, squared) in run.position.iter().zip(&mut errors_squared) {
            let offset = nearest_whole((p[axis] - corner[axis]) / step);
            match encoding {
                Encoding::U16 => data.extend_from_slice(&(offset as u16).to_le_bytes()),
                Encoding::U24 => data.extend_from_slice(&offset.to_le_bytes()[..3]),
                _ => data.extend_from_slice(&offset.to_le_bytes()),
            }
            let error = corner[axis] + f64::from(offset) * step - p[axis];
            *squared += error * error;
            worst_axis = worst_axis.max(error.abs());
        }
    }
    data.resize(start + (data.len() - start).next_multiple_of(4), 0);
    let mut put = |values: &[f32]| values.iter().for_each(|v| data.extend_from_slice(&v.to_le_bytes()));
    if run.store_radius {
        put(run.radius);
    }
    if let Some(weight) = run.weight {
        put(weight);
    }
    if let Some(color) = run.color {
        color.iter().for_each(|c| data.extend_from_slice(&[c[0], c[1], c[2], 0]));
    }
    data.extend_from_slice(run.harmonics);
    if let Some(shapes) = run.shape {
        for word in 0..SHAPE_COLUMNS {
            shapes.iter().for_each(|shape| data.extend_from_slice(&shape.0[word].to_le_bytes()));
            data.resize(start + (data.len() - start).next_multiple_of(4), 0);
        }
    }
    for attribute in run.attributes {
        data.extend_from_slice(attribute);
        data.resize(start + (data.len() - start).next_multiple_of(4), 0);
    }

    // Rounded offsets may exceed the exact extent by half a step, so the stored extent is rounded
    // up.
    let extent = (extent / unit + 0.5 / encoding.extent_steps()).ceil().min(DVec3::splat(255.0));
    let head = RunHead {
        origin: origin.to_array().map(|v| v as u32),
        extent: extent.to_array().map(|v| v as u8),
        radius_max: round_up_to_16_bits(radius_max),
        count: run.position.len() as u8,
        encoding,
        step_code,
        offset_words: 0,
    };
    // Squares of errors below 1e-154 underflow, but a nonzero error must not be reported as zero.
    let position_error = errors_squared.iter().copied().fold(0.0, f64::max).sqrt().max(worst_axis);
    EncodedRun { head, position_error, position_error_radii: position_error / shortest }
}

/// The shortest semi-axis of all points, of balls the radius.
fn shortest_semi_axis(run: &RunColumns<'_>) -> f64 {
    let radii = run.radius.iter().copied().map(f64::from);
    match run.shape {
        None => radii.fold(f64::INFINITY, f64::min),
        Some(shapes) => {
            let semi_axes = radii.zip(shapes).map(|(radius, shape)| radius * shape.decode().ratios[1]);
            semi_axes.fold(f64::INFINITY, f64::min)
        }
    }
}

/// The nearest whole number, halves upwards; below 0 it is 0. Without the processor's own
/// instruction, which not all of them have, `f64::round` is a call.
fn nearest_whole(x: f64) -> u32 {
    let below = x as u32;
    below.saturating_add(u32::from(x - f64::from(below) >= 0.5))
}

/// The largest code whose step is at least `step`.
pub(super) fn step_code_for(step: f64, root_size: f64) -> u8 {
    let exponent = if step > 0.0 { (root_size / step).log2().floor() as i32 } else { i32::MAX };
    let mut code = exponent.saturating_sub(COARSEST_STEP).clamp(0, STEP_CODES - 1);
    while code > 0 && root_size * 2_f64.powi(-COARSEST_STEP - code) < step {
        code -= 1;
    }
    code as u8
}

#[cfg(test)]
mod tests {
    use super::nearest_whole;

    #[test]
    fn offsets_are_rounded_as_round_does() {
        let wholes = [0, 1, 2, 254, 65_278, 65_279, 1 << 24, 4_277_999_999, u32::MAX].map(f64::from);
        let halves = wholes.map(|whole| whole + 0.5);
        for x in wholes.into_iter().chain(halves) {
            for x in [x.next_down().next_down(), x.next_down(), x, x.next_up()] {
                assert_eq!(nearest_whole(x), x.round() as u32, "{x:e}");
            }
        }
        for x in [-1e9, -1.0, -0.7, -0.0, 1e300, f64::INFINITY, f64::NEG_INFINITY, f64::NAN] {
            assert_eq!(nearest_whole(x), x.round() as u32, "{x:e}");
        }
    }
}

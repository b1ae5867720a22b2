//! Records of aggregates: what stands for all points of a cell, seen from where the cell is small.

use super::histogram::{BINS, DensityBins, Width};
use super::scale::{Scale, ShortFloat};
use crate::octree::layout::RootCell;
use rayset_base::geometry::{DQuat, DVec3};

/// Bytes of a record before its columns.
pub const AGGREGATE_BYTES: usize = 48;

/// Steps of a centroid along the edge of the root cell.
const PLACES: f64 = 4_294_967_296.0;

/// What stands for the points of a cell. Masses are v·s₁·s₂·s₃, of the weight of a point as the
/// density has it, and its semi-axes: of a mass M the density integrates to M times the integral of
/// the kernel over the unit ball.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aggregate {
    /// Mean position of the mass, world space.
    pub centroid: DVec3,
    /// Mass.
    pub mass: f64,
    /// Standard deviations of the mass, points as their kernels spread it, along the principal
    /// axes, longest first; world space.
    pub deviations: [f64; 3],
    /// Turns the axes x, y and z to the principal axes.
    pub rotation: DQuat,
    /// The root of the mean of r², by mass; of ellipsoids r² is the harmonic mean of the squares of
    /// the semi-axes. World space.
    pub radius: f64,
    /// How the mass is distributed over densities.
    pub densities: DensityBins,
    /// Of an inner node of the octree, which children have records, by their ranks along the curve.
    pub child_mask: u8,
    /// Of a leaf, or a cell of one, how many cells below it have records: all that have points no
    /// larger than they are.
    pub cells: u8,
    /// The number of the first child's record, or the first cell's; the others follow it.
    pub first_child: u32,
    /// Of a cell of a leaf, the number of its first point among those of the leaf.
    pub first_point: u16,
    /// Of a cell of a leaf, how many points it has, less one.
    pub more_points: u16,
}

/// Set in the byte of the bins' width if the byte behind it counts cells.
const HAS_CELLS: u8 = 0x80;

/// The children of an inner node, and the number of cells below a leaf or a cell of one.
fn children([kind, below]: [u8; 2]) -> (u8, u8) {
    if kind & HAS_CELLS == 0 { (below, 0) } else { (0, below) }
}

/// What a walk reads of a record.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellPlace {
    /// See [`Aggregate::centroid`].
    pub centroid: DVec3,
    /// See [`Aggregate::child_mask`].
    pub child_mask: u8,
    /// See [`Aggregate::cells`].
    pub cells: u8,
    /// The longest of [`Aggregate::deviations`].
    pub deviation: f64,
    /// See [`Aggregate::first_child`].
    pub first_child: u32,
    /// See [`Aggregate::first_point`].
    pub first_point: u16,
    /// See [`Aggregate::more_points`].
    pub more_points: u16,
}

impl CellPlace {
    /// Reads it from the bytes of a record, of which there must be [`AGGREGATE_BYTES`].
    pub(super) fn decode(bytes: &[u8], root: RootCell, edge: f64) -> Option<Self> {
        let bytes: &[u8; AGGREGATE_BYTES] = bytes.first_chunk()?;
        let u16_at = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
        let u32_at = |at: usize| u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
        let place = DVec3::from_array([0, 4, 8].map(|at| f64::from(u32_at(at)) / PLACES));
        let (child_mask, cells) = children([bytes[26], bytes[27]]);
        Some(Self {
            centroid: root.min + place * root.size,
            child_mask,
            cells,
            deviation: Scale::Sixteenths.length(bytes[12]) * edge,
            first_child: u32_at(28),
            first_point: u16_at(32),
            more_points: u16_at(34),
        })
    }
}

impl CellPlace {
    /// How many records are below it.
    #[must_use]
    pub fn children(&self) -> u32 {
        self.child_mask.count_ones() + u32::from(self.cells)
    }
}

impl Aggregate {
    /// How many records are below it.
    #[must_use]
    pub fn children(&self) -> u32 {
        self.child_mask.count_ones() + u32::from(self.cells)
    }

    /// Writes the record into its 48 bytes. `edge` is that of its cell, world space.
    pub(super) fn encode(&self, root: RootCell, edge: f64, bytes: &mut [u8]) {
        let mut at = 0;
        let mut put = |field: &[u8]| {
            bytes[at..at + field.len()].copy_from_slice(field);
            at += field.len();
        };
        let place = (self.centroid - root.min) / root.size * PLACES;
        for v in place.to_array() {
            put(&(v.round().clamp(0.0, PLACES - 1.0) as u32).to_le_bytes());
        }
        put(&self.deviations.map(|length| Scale::Sixteenths.code(length / edge)));
        put(&[Scale::Eighths.code(self.radius / edge)]);
        put(&pack_rotation(self.rotation).to_le_bytes());
        let mass = ShortFloat::of(self.mass);
        put(&mass.mantissa.to_le_bytes());
        put(&mass.exponent.to_le_bytes());
        put(&self.densities.top.to_le_bytes());
        let has_cells = self.cells != 0;
        let below = if has_cells { self.cells } else { self.child_mask };
        put(&[self.densities.width.code() | if has_cells { HAS_CELLS } else { 0 }, below]);
        put(&self.first_child.to_le_bytes());
        put(&self.first_point.to_le_bytes());
        put(&self.more_points.to_le_bytes());
        put(&self.densities.roots);
    }

    /// Reads the record of a cell with this edge, world space; `None` if it has no
    /// densities.
    #[must_use]
    pub fn decode(bytes: &[u8], root: RootCell, edge: f64) -> Option<Self> {
        let u16_at = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
        let u32_at = |at: usize| u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
        let place = DVec3::from_array([0, 4, 8].map(|at| f64::from(u32_at(at)) / PLACES));
        let roots = std::array::from_fn(|bin| bytes[36 + bin]);
        let densities = DensityBins { width: Width::of_code(bytes[26]), top: u16_at(24) as i16, roots };
        let (child_mask, cells) = children([bytes[26], bytes[27]]);
        if roots == [0; BINS] {
            return None;
        }
        Some(Self {
            centroid: root.min + place * root.size,
            deviations: [12, 13, 14].map(|at| Scale::Sixteenths.length(bytes[at]) * edge),
            radius: Scale::Eighths.length(bytes[15]) * edge,
            rotation: unpack_rotation(u32_at(16)),
            mass: ShortFloat { mantissa: u16_at(20), exponent: u16_at(22) as i16 }.number(),
            densities,
            child_mask,
            cells,
            first_child: u32_at(28),
            first_point: u16_at(32),
            more_points: u16_at(34),
        })
    }
}

/// The largest number of a component of a rotation, and the one that stands for 0.
const MOST: f64 = 511.0;
const ZERO: i32 = 512;

/// A rotation in four bytes: the number of the largest component of its quaternion in the upper two
/// bits, and the others, from the one behind it on, in ten bits each.
fn pack_rotation(rotation: DQuat) -> u32 {
    let q = rotation.to_array();
    let largest = (1..4).fold(0, |largest, i| if q[i].abs() > q[largest].abs() { i } else { largest });
    let sign = 1_f64.copysign(q[largest]);
    (1..4).fold((largest as u32) << 30, |packed, further| {
        let v = q[(largest + further) % 4] * sign * std::f64::consts::SQRT_2 * MOST;
        let number = (v.round().clamp(-MOST, MOST) as i32 + ZERO) as u32;
        packed | number << (10 * (further - 1))
    })
}

fn unpack_rotation(packed: u32) -> DQuat {
    let largest = (packed >> 30) as usize;
    let mut q = [0.0; 4];
    let mut squares = 0.0;
    for further in 1..4 {
        let number = (packed >> (10 * (further - 1)) & 1023) as i32 - ZERO;
        let v = f64::from(number) / (MOST * std::f64::consts::SQRT_2);
        q[(largest + further) % 4] = v;
        squares += v * v;
    }
    q[largest] = (1.0_f64 - squares).max(0.0).sqrt();
    DQuat::from_array(q).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const ROOT: RootCell = RootCell { min: DVec3::new(-3.0, 100.0, 0.5), size: 64.0 };

    proptest! {
        #[test]
        fn a_record_is_close_to_what_it_is_made_of_and_has_the_same_bytes_again(
            place in prop::array::uniform3(0.0..64.0_f64),
            exponents in prop::array::uniform4(-9.0..1.0_f64),
            q in prop::array::uniform4(-1.0..1.0_f64),
            mass in -200.0..200.0_f64,
            (counts, numbers) in any::<(bool, (u8, u32, u16, u16))>(),
        ) {
            prop_assume!(q.iter().any(|v| v.abs() > 0.1));
            let [a, b, c, radius] = exponents.map(f64::exp2);
            let roots = [3, 0, 255, 1, 0, 0, 0, 2, 0, 0, 9, 1];
            let (below, first_child, first_point, more_points) = numbers;
            let (child_mask, cells) = if counts { (0, below) } else { (below, 0) };
            let aggregate = Aggregate {
                centroid: ROOT.min + DVec3::from_array(place),
                mass: mass.exp2(),
                deviations: [a, b, c],
                rotation: DQuat::from_array(q).normalize(),
                radius,
                densities: DensityBins { width: Width::Octave, top: -300, roots },
                child_mask, cells, first_child, first_point, more_points,
            };
            let mut bytes = [0; AGGREGATE_BYTES];
            aggregate.encode(ROOT, 2.0, &mut bytes);
            let read = Aggregate::decode(&bytes, ROOT, 2.0).unwrap();
            prop_assert!((read.centroid - aggregate.centroid).length() < 64.0 / PLACES);
            prop_assert!((read.mass / aggregate.mass - 1.0).abs() < 1e-5);
            let lengths = read.deviations.into_iter().zip(aggregate.deviations);
            for (is, was) in lengths.chain([(read.radius, radius)]) {
                prop_assert!((is / was).log2().abs() <= 1.0 / 16.0 + 1e-9, "{is} of {was}");
            }
            let turn = 2.0 * read.rotation.dot(aggregate.rotation).abs().min(1.0).acos();
            prop_assert!(turn.to_degrees() < 0.3, "{} degrees", turn.to_degrees());
            prop_assert_eq!(read.densities, aggregate.densities);
            prop_assert_eq!((read.child_mask, read.cells), (child_mask, cells));
            prop_assert_eq!((below, read.first_child, read.first_point, read.more_points), numbers);
            let mut again = [0; AGGREGATE_BYTES];
            read.encode(ROOT, 2.0, &mut again);
            prop_assert_eq!(&again[..16], &bytes[..16]);
        }

        #[test]
        fn any_bytes_are_a_record_of_finite_numbers_or_none(bytes in prop::collection::vec(any::<u8>(), AGGREGATE_BYTES)) {
            if let Some(read) = Aggregate::decode(&bytes, ROOT, 2.0) {
                prop_assert!(read.centroid.is_finite() && read.mass.is_finite() && read.mass >= 0.0);
                prop_assert!(read.deviations.iter().all(|length| *length > 0.0));
                prop_assert!((read.rotation.length() - 1.0).abs() < 1e-12);
            }
        }
    }
}

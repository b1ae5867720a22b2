//! The rays of a packet in the space of a cloud, clipped against boxes together.

use super::{CloudPlacement, Ray};
use crate::field::{LANES, SimdLevel, dispatch};
use rayset_base::geometry::{Aabb, Beam};

/// Rays in the local space of a cloud, parametrised by distance in world space.
pub(super) struct LocalRays {
    pub(super) rays: Vec<Ray>,
    /// Lengths of their directions.
    pub(super) stretch: Vec<f64>,
    /// The least and the greatest of these.
    pub(super) stretches: (f64, f64),
    /// All rays.
    pub(super) beam: Beam,
    columns: Box<Columns>,
    pub(super) simd: SimdLevel,
}

/// Lanes that are clipped together, or not at all.
const TOGETHER: usize = 16;
const _: () = assert!(LANES.is_multiple_of(TOGETHER) && TOGETHER < 64);

/// The rays by columns; unused ones repeat the last.
struct Columns {
    origin: [[f64; LANES]; 3],
    /// 1 / direction; large and with the right sign if the component is zero.
    inverse: [[f64; LANES]; 3],
}

/// Where rays are inside a box: for each, from where to where along it. Exact, and the same in all
/// packets, so that steps may depend on it.
pub(super) struct Clipped {
    /// A bit for each ray that is in the box anywhere.
    pub(super) lanes: u64,
    pub(super) enter: [f64; LANES],
    pub(super) exit: [f64; LANES],
}

impl LocalRays {
    /// Bytes for a packet.
    pub(super) const BYTES: usize =
        size_of::<Self>() + LANES * (size_of::<Ray>() + size_of::<f64>()) + size_of::<Columns>();

    pub(super) fn new(world: &[Ray], cloud: &CloudPlacement, simd: SimdLevel) -> Self {
        let rays: Vec<Ray> = world.iter().map(|ray| cloud.local_ray(ray)).collect();
        let stretch: Vec<f64> = rays.iter().map(|ray| ray.direction.length()).collect();
        let stretches = stretch.iter().fold((f64::INFINITY, 0.0_f64), |(a, b), &s| (a.min(s), b.max(s)));
        let mut beam = Beam::EMPTY;
        rays.iter().for_each(|ray| beam.include(ray));
        let mut columns = Box::new(Columns { origin: [[0.0; LANES]; 3], inverse: [[0.0; LANES]; 3] });
        for lane in 0..LANES {
            let Ray { origin, direction } = rays[lane.min(rays.len() - 1)];
            for axis in 0..3 {
                columns.origin[axis][lane] = origin[axis];
                columns.inverse[axis][lane] =
                    1.0 / direction[axis].abs().max(1e-300).copysign(direction[axis]);
            }
        }
        Self { rays, stretch, stretches, beam, columns, simd }
    }

    /// Where the rays of `lanes` are in a box.
    pub(super) fn clip(&self, bounds: &Aabb, lanes: u64) -> Clipped {
        let mut clipped = Clipped { lanes, enter: [0.0; LANES], exit: [f64::INFINITY; LANES] };
        dispatch!(self.simd.level(), _simd => clip(&self.columns, bounds, &mut clipped));
        clipped
    }
}

// Loops and comparisons instead of functions: the compiler makes vectors of them, of any length,
// with the same bits.
#[inline(always)]
fn clip(rays: &Columns, bounds: &Aabb, clipped: &mut Clipped) {
    let mut inside = 0;
    for first in (0..LANES).step_by(TOGETHER) {
        if clipped.lanes >> first & ((1 << TOGETHER) - 1) == 0 {
            continue;
        }
        let enter = &mut clipped.enter[first..first + TOGETHER];
        let exit = &mut clipped.exit[first..first + TOGETHER];
        for axis in 0..3 {
            let (low, high) = (bounds.min[axis], bounds.max[axis]);
            let origin = &rays.origin[axis][first..first + TOGETHER];
            let inverse = &rays.inverse[axis][first..first + TOGETHER];
            for lane in 0..TOGETHER {
                let a = (low - origin[lane]) * inverse[lane];
                let b = (high - origin[lane]) * inverse[lane];
                let (near, far) = if a < b { (a, b) } else { (b, a) };
                enter[lane] = if near > enter[lane] { near } else { enter[lane] };
                exit[lane] = if far < exit[lane] { far } else { exit[lane] };
            }
        }
        for lane in 0..TOGETHER {
            inside |= u64::from(enter[lane] <= exit[lane]) << (first + lane);
        }
    }
    clipped.lanes &= inside;
}

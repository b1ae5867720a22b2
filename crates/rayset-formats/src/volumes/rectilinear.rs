//! Rectilinear grids: the coordinates of their points along each axis, which are read if they are
//! evenly spaced.

use rayset_files::grid::what_of;
use std::io::Read;

use rayset_base::geometry::DVec3;
use rayset_base::numbers::Stored;

/// How far a point may be from where even spacing puts it, in spacings. A thousandth of a voxel is
/// not seen.
const MOST_UNEVEN: f64 = 1e-3;
/// How often the relative rounding error of its type a coordinate may be away, too.
const MOST_ROUNDED: f64 = 4.0;

/// The coordinates of the points along an axis.
pub(super) struct Coordinates {
    pub(super) axis: usize,
    pub(super) stored: Stored,
    pub(super) big_endian: bool,
    /// At least one.
    pub(super) count: u64,
}

/// Evenly spaced points of a grid.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Even {
    pub(super) first: DVec3,
    pub(super) spacing: DVec3,
}

impl Coordinates {
    /// Notes in `even` the first coordinate and the spacing. The numbers are read twice from what
    /// `open` opens: the last one tells the spacing that all are compared with.
    ///
    /// # Errors
    /// What is wrong with them; as `Err` of `open` if that fails.
    pub(super) fn read<E>(
        &self,
        even: &mut Even,
        mut open: impl FnMut() -> Result<Box<dyn Read + Send>, E>,
    ) -> Result<Result<(), String>, E> {
        let name = ["x", "y", "z"][self.axis];
        let (mut first, mut last) = (0.0, 0.0);
        let ends = self.each(&mut *open()?, |place, at| {
            if place == 0 {
                first = at;
            }
            last = at;
            at.is_finite().then_some(()).ok_or_else(|| format!("point {place} along {name} is at {at}"))
        });
        if let Err(what) = ends {
            return Ok(Err(what));
        }
        let step = (last - first) / (self.count - 1).max(1) as f64;
        let rounding = if self.stored == Stored::F32 { f64::from(f32::EPSILON) } else { f64::EPSILON };
        let rounding = MOST_ROUNDED * rounding * first.abs().max(last.abs());
        let most = rounding.max(MOST_UNEVEN * step.abs());
        let checked = self.each(&mut *open()?, |place, at| {
            let expected = first + step * place as f64;
            if (at - expected).abs() <= most {
                return Ok(());
            }
            Err(format!(
                "the grid is not evenly spaced along {name}: point {place}, counted from 0, is at {at}, where steps of {step} \
                 put it at {expected}; resample the grid to a regular one, as ParaView's filter Resample To Image does"
            ))
        });
        (even.first[self.axis], even.spacing[self.axis]) = (first, step);
        Ok(checked)
    }

    fn each(
        &self,
        data: &mut dyn Read,
        mut take: impl FnMut(u64, f64) -> Result<(), String>,
    ) -> Result<(), String> {
        let mut bytes = [0; 8];
        let bytes = &mut bytes[..self.stored.bytes()];
        for place in 0..self.count {
            data.read_exact(bytes).map_err(|error| {
                let name = ["x", "y", "z"][self.axis];
                format!("the coordinates along {name}: {}", what_of(&error))
            })?;
            if self.big_endian {
                bytes.reverse();
            }
            take(place, self.stored.number(bytes))?;
        }
        Ok(())
    }
}

//! By which part each point of a run is seen by itself, where cells stand for some of the points of
//! its node.

use super::cut::{CellLevel, PointsOfNode, Seen};
use super::record_pages::RecordPages;
use crate::field::PointParts;
use crate::trace::access::Halt;
use rayset_files::octree::layout::RUN_POINTS;

/// A cell that has some points of a run.
#[derive(Clone, Copy, Debug)]
struct Cover {
    /// Numbers of its points in the run.
    from: usize,
    end: usize,
    /// Points with larger radii are not in its record.
    edge: f64,
    /// The part of its points for which it stands.
    part: f32,
    /// The area that a unit of its mass takes of the light, and its colour.
    of_mass: (f64, [f32; 3]),
}

/// What stands for points of a run.
pub(super) struct Covers<'t> {
    node: &'t PointsOfNode,
    of_mass: (f64, [f32; 3]),
    covers: Vec<Cover>,
}

impl<'t> Covers<'t> {
    /// Of a run of a node, whose points are so many from one on.
    pub(super) fn find(
        (seen, pages): (Seen<'_>, &mut RecordPages<'_>),
        node: &'t PointsOfNode,
        (first_point, len): (u32, usize),
    ) -> Result<Self, Halt> {
        let (nearest, level) = node.part.nearest;
        let of_mass = seen.lod.decoder.of_mass(&pages.record(nearest, level)?);
        let mut found = Self { node, of_mass, covers: Vec::new() };
        for cells in &node.levels {
            let first = first_at(pages, *cells, first_point)?;
            // Each has a point of its own, unless the file contradicts itself.
            let end = first.saturating_add(len as u32 + 1).min(cells.end);
            for record in first..end {
                let place = pages.place(record, cells.level)?;
                let from = i64::from(place.first_point) - i64::from(first_point);
                let end = from + i64::from(place.more_points) + 1;
                if from >= len as i64 {
                    break;
                }
                let of_mass = seen.lod.decoder.of_mass(&pages.record(record, cells.level)?);
                let (from, end) = (from.max(0) as usize, end.clamp(0, len as i64) as usize);
                found.covers.push(Cover {
                    from,
                    end,
                    edge: cells.edge,
                    part: cells.part_of(&place),
                    of_mass,
                });
            }
        }
        Ok(found)
    }

    /// The parts of points with these radii.
    pub(super) fn parts(&self, radii: &[f32; RUN_POINTS], len: usize) -> PointParts {
        let rest = self.node.part.rest;
        let (of_mass, color) = self.of_mass;
        let (of_mass, color) = ([of_mass; RUN_POINTS], [color; RUN_POINTS]);
        let mut parts = PointParts { part: [rest; RUN_POINTS], of_mass, color };
        for &Cover { from, end, edge, part, of_mass } in &self.covers {
            for i in from..end.max(from) {
                if f64::from(radii[i]) <= edge {
                    parts.part[i] = (parts.part[i] - part).max(0.0);
                    (parts.of_mass[i], parts.color[i]) = of_mass;
                }
            }
        }
        for (part, &radius) in parts.part[..len].iter_mut().zip(radii) {
            if f64::from(radius) > self.node.edge {
                *part = self.node.part.whole;
            }
        }
        parts
    }
}

/// The first cell of a level that has a point from a number on.
fn first_at(pages: &mut RecordPages<'_>, cells: CellLevel, point: u32) -> Result<u32, Halt> {
    let (mut low, mut high) = (cells.first, cells.end);
    while low < high {
        let middle = low + (high - low) / 2;
        let place = pages.place(middle, cells.level)?;
        if u32::from(place.first_point) + u32::from(place.more_points) < point {
            low = middle + 1;
        } else {
            high = middle;
        }
    }
    Ok(low)
}

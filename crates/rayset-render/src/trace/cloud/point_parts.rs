//! By which part each point of a run is seen by itself, where cells stand for some of the points of
//! its node.

use super::cut::PointsOfNode;
use super::leaf_cut::Covers;
use super::parts::Seen;
use super::record_pages::RecordPages;
use crate::field::PointParts;
use crate::lod::LEAST_PART;
use crate::trace::access::Halt;
use rayset_files::octree::layout::RUN_POINTS;

/// Sets the parts of the points of a run with these radii, which are so many of their node's from
/// one on.
pub(super) fn set_parts(
    (seen, pages): (Seen<'_>, &mut RecordPages<'_>),
    node: &PointsOfNode,
    (first_point, len): (u32, usize),
    radii: &[f32; RUN_POINTS],
    out: &mut PointParts,
) -> Result<(), Halt> {
    out.part.fill(node.part.rest);
    // Not a number until it is known.
    out.of_mass.fill(f64::NAN);
    let end_point = first_point + len as u32;
    let in_run = |point: u32| (point.clamp(first_point, end_point) - first_point) as usize;
    let levels = node.leaf.as_ref().map_or(&[][..], |leaf| &leaf.levels);
    for Covers { edge, cells, of_mass, .. } in levels {
        let first = cells.partition_point(|cover| cover.end() <= first_point);
        let here = cells.iter().enumerate().skip(first).take_while(|(_, cover)| cover.from < end_point);
        for (number, cover) in here {
            let (of_mass, color) = of_mass.get(number).copied().unwrap_or((f64::NAN, [0.0; 3]));
            for i in in_run(cover.from)..in_run(cover.end()) {
                // Points with larger radii are not in the record.
                if f64::from(radii[i]) <= *edge {
                    out.part[i] = (out.part[i] - cover.part).max(0.0);
                    (out.of_mass[i], out.color[i]) = (of_mass, color);
                }
            }
        }
    }
    for (part, &radius) in out.part[..len].iter_mut().zip(radii) {
        if f64::from(radius) > node.edge {
            *part = node.part.whole;
        }
    }
    let mut known = None;
    for i in 0..len {
        if !out.of_mass[i].is_nan() {
            continue;
        }
        if f64::from(out.part[i]) <= LEAST_PART {
            out.of_mass[i] = 0.0;
            continue;
        }
        // The smallest cell that it is in has others below it, or there is none.
        let point = first_point + i as u32;
        let smallest = levels.iter().rev().find_map(|covers| {
            let number = covers.cells.partition_point(|cover| cover.end() <= point);
            let cover = covers.cells.get(number)?;
            let has_it = cover.from <= point && f64::from(radii[i]) <= covers.edge;
            has_it.then_some((covers.first_record + number as u32, covers.level))
        });
        let (record, level) = smallest.unwrap_or(node.part.nearest);
        let of_mass = match known {
            Some((of, known)) if of == record => known,
            _ => seen.lod.decoder.of_mass(&pages.record(record, level)?),
        };
        known = Some((record, of_mass));
        (out.of_mass[i], out.color[i]) = of_mass;
    }
    Ok(())
}

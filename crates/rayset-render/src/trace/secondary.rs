//! Grouping of rays with arbitrary origins into coherent packets.

use crate::field::{LANES, SLAB_SAMPLES};
use rayset_base::geometry::{Aabb, DVec3, Ray};

/// A packet is split if its bound over a slab is more than this many times as long as the slab of a
/// single ray.
const MOST_SPREAD: f64 = 4.0;

/// Splits `members`, which are numbers of rays, until the rays of each group fit into a packet and
/// are close together over their first slab.
pub(super) fn coherent_groups<'r>(
    ray: impl Fn(usize) -> &'r Ray,
    members: Vec<usize>,
    step: f64,
) -> Vec<Vec<usize>> {
    let length = step * SLAB_SAMPLES as f64;
    let mut done = Vec::new();
    let mut open = vec![members];
    while let Some(mut group) = open.pop() {
        let mut bound = Aabb::EMPTY;
        for &i in &group {
            bound.include(ray(i).origin);
            bound.include(ray(i).at(length));
        }
        let fits = group.len() <= LANES && bound.size().max_element() <= MOST_SPREAD * length;
        if group.len() == 1 || fits {
            done.push(group);
            continue;
        }
        // Split in halves along the axis on which the midpoints of the first slabs are farthest
        // apart.
        let middle = |i: usize| ray(i).at(0.5 * length);
        let mut middles = Aabb::EMPTY;
        group.iter().for_each(|&i| middles.include(middle(i)));
        let size: DVec3 = middles.size();
        let axis = (0..3).max_by(|&a, &b| size[a].total_cmp(&size[b])).unwrap_or(0);
        group.sort_by(|&a, &b| middle(a)[axis].total_cmp(&middle(b)[axis]));
        // Into whole packets if they are more than one.
        let middle = group.len() / 2;
        let half = group.split_off(if group.len() > LANES { middle.next_multiple_of(LANES) } else { middle });
        open.push(group);
        open.push(half);
    }
    done
}

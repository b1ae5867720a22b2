//! The paper's argument of section 3.4: octants against cells of a k-d tree split at the median,
//! both with lists of all points that reach them, in memory.

use std::cell::Cell;

use rayset::field::reference::ReferenceSample;
use rayset::geometry::DVec3;
use rayset::scene::CloudObject;
use rayset::trace::reference::{PointField, Purpose};

use crate::engine::add;
use crate::index::Limits;
use crate::record::{Node, Point};

/// How a cell is divided.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Division {
    /// Into eight octants.
    Octants,
    /// At the median of the points that lie in it, across its longest side.
    Median,
}

/// A tree of cells over points.
pub struct Cells {
    points: Vec<Point>,
    cells: Vec<Boxed>,
    root: u32,
}

struct Boxed {
    min: DVec3,
    max: DVec3,
    below: Below,
}

enum Below {
    Octants([u32; 8]),
    Halves { axis: usize, at: f64, children: [u32; 2] },
    Points(Vec<u32>),
}

/// What a tree takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Size {
    /// Cells that are not divided.
    pub leaves: u64,
    /// Points in all their lists together.
    pub references: u64,
    /// In the longest.
    pub most_in_leaf: u64,
}

impl Cells {
    /// Divides a cube while a cell has more points than the limit, at most to its height in
    /// octants: three halvings each.
    #[must_use]
    pub fn build(points: Vec<Point>, (min, max): (DVec3, DVec3), limits: Limits, division: Division) -> Self {
        let mut tree = Self { points, cells: Vec::new(), root: 0 };
        let all = (0..tree.points.len() as u32).collect();
        let levels = if division == Division::Octants { limits.height } else { 3 * limits.height };
        tree.root = tree.make((min, max), all, levels, limits.leaf_points, division);
        tree
    }

    fn make(
        &mut self,
        (min, max): (DVec3, DVec3),
        list: Vec<u32>,
        levels: u32,
        leaf_points: u64,
        division: Division,
    ) -> u32 {
        let make = |tree: &mut Self, min: DVec3, max: DVec3| {
            let reaches = |&&n: &&u32| tree.points[n as usize].reaches(min, max);
            let part = list.iter().filter(reaches).copied().collect();
            tree.make((min, max), part, levels - 1, leaf_points, division)
        };
        let below = if levels == 0 || list.len() as u64 <= leaf_points {
            None
        } else if division == Division::Octants {
            let node = Node { min, max, parent: 0, below: crate::record::Below::Children([0; 8]) };
            Some(Below::Octants(std::array::from_fn(|octant| {
                let (min, max) = node.octant_box(octant);
                make(self, min, max)
            })))
        } else {
            self.median((min, max), &list).map(|(axis, at)| {
                let (mut left_max, mut right_min) = (max, min);
                (left_max[axis], right_min[axis]) = (at, at);
                let children = [make(self, min, left_max), make(self, right_min, max)];
                Below::Halves { axis, at, children }
            })
        };
        let below = below.unwrap_or(Below::Points(list));
        self.cells.push(Boxed { min, max, below });
        self.cells.len() as u32 - 1
    }

    /// Where a cell is halved: in the middle if no point lies in it, and is only reached; nowhere
    /// if all of them are at its side.
    fn median(&self, (min, max): (DVec3, DVec3), list: &[u32]) -> Option<(usize, f64)> {
        let size = max - min;
        let axis = (0..3).max_by(|&a, &b| size[a].total_cmp(&size[b]))?;
        let inside = |p: &DVec3| p.cmpge(min).all() && p.cmplt(max).all();
        let mut places: Vec<f64> =
            list.iter().map(|&n| self.points[n as usize].position).filter(inside).map(|p| p[axis]).collect();
        let at = if places.is_empty() {
            0.5 * (min[axis] + max[axis])
        } else {
            let middle = places.len() / 2;
            *places.select_nth_unstable_by(middle, f64::total_cmp).1
        };
        (at > min[axis] && at < max[axis]).then_some((axis, at))
    }

    /// What it takes.
    #[must_use]
    pub fn size(&self) -> Size {
        let mut size = Size::default();
        for cell in &self.cells {
            if let Below::Points(list) = &cell.below {
                size.leaves += 1;
                size.references += list.len() as u64;
                size.most_in_leaf = size.most_in_leaf.max(list.len() as u64);
            }
        }
        size
    }

    /// The list of the cell that holds a place, and how many cells lead to it. Nothing outside.
    fn find(&self, q: DVec3) -> Option<(&[u32], u64)> {
        let root = &self.cells[self.root as usize];
        if !(q.cmpge(root.min).all() && q.cmplt(root.max).all()) {
            return None;
        }
        let (mut cell, mut steps) = (root, 1);
        loop {
            let next = match &cell.below {
                Below::Points(list) => return Some((list, steps)),
                Below::Halves { axis, at, children } => children[usize::from(q[*axis] >= *at)],
                Below::Octants(children) => {
                    let above = q.cmpge(0.5 * (cell.min + cell.max));
                    children[usize::from(above.x) | usize::from(above.y) << 1 | usize::from(above.z) << 2]
                }
            };
            (cell, steps) = (&self.cells[next as usize], steps + 1);
        }
    }
}

/// What samples took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Taken {
    /// Samples in the root's cube.
    pub samples: u64,
    /// Cells on the way down to them.
    pub steps: u64,
    /// Points looked at.
    pub looked_at: u64,
    /// Of these, the ones that reach the sample.
    pub reaching: u64,
}

/// The field of an object over such a tree.
pub struct CellField<'a> {
    tree: &'a Cells,
    object: &'a CloudObject,
    taken: Cell<Taken>,
}

impl<'a> CellField<'a> {
    /// With gradients.
    #[must_use]
    pub fn new(tree: &'a Cells, object: &'a CloudObject) -> Self {
        Self { tree, object, taken: Cell::default() }
    }

    /// What all samples took so far.
    #[must_use]
    pub fn taken(&self) -> Taken {
        self.taken.get()
    }
}

impl PointField for CellField<'_> {
    fn sample(&self, q: DVec3, _purpose: Purpose) -> ReferenceSample {
        let mut sum = ReferenceSample::default();
        let Some((list, steps)) = self.tree.find(q) else { return sum };
        let mut reaching = 0;
        for &number in list {
            let point = &self.tree.points[number as usize];
            reaching += u64::from(add(&mut sum, point, q, self.object.kernel, self.object.normalised, true));
        }
        let mut taken = self.taken.get();
        taken.samples += 1;
        taken.steps += steps;
        taken.looked_at += list.len() as u64;
        taken.reaching += reaching;
        self.taken.set(taken);
        sum
    }
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;

    use rayset::points::Workload;

    use super::*;
    use crate::engine::{all_pixels, render};
    use crate::experiments::{Subject, differing};
    use crate::structures::InCore;

    #[test]
    fn both_divisions_give_the_picture_of_the_reference() {
        let folder = tempfile::tempdir().expect("a folder");
        let workload: Workload = "vase-2k".parse().expect("a workload");
        let subject = Subject::build(workload.source(), None, 16, &folder.path().join("c.rset"));
        let subject = subject.expect("a cloud");
        let limits = Limits { height: 5, leaf_points: 24 };
        let index = subject.index(folder.path(), limits).expect("an index");
        let records = InCore::load(&index).expect("records");
        let pixels = || all_pixels(&subject.settings);
        let (picture, _) =
            subject.reference(records, crate::predict::Variant::None, pixels()).expect("a picture");
        let (object, view) = (subject.object(), (&subject.camera, &subject.settings, subject.step));
        let (points, root) = index.points_and_root().expect("points");
        for division in [Division::Octants, Division::Median] {
            let tree = Cells::build(points.clone(), root, limits, division);
            if division == Division::Octants {
                assert_eq!(tree.size().references, index.summary.references);
            }
            let field = CellField::new(&tree, &object);
            let given = |_: &CloudObject| &field as &dyn PointField;
            let found =
                render(&subject.scene, view, &RefCell::new(None), given, pixels()).expect("a picture");
            assert!(differing(&found, &picture) == 0.0, "{division:?}");
            let taken = field.taken();
            assert!(taken.reaching > 0 && taken.reaching <= taken.looked_at, "{taken:?}");
        }
    }
}

//! The in-core program: octree and points as structures in its memory, wherever that is.
//!
//! They lie either as the files of an index do, in the order of the tree, or as a program leaves
//! them in its heap that takes one point after another ([`grow`]).

use std::fs::File;
use std::io::Read as _;
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::cache::CacheError;
use crate::index::{Index, Limits};
use crate::memory::{Flat, Memory};
use crate::record::{
    Below, CHAINED, DIRECT, NODE_BYTES, NOWHERE, Node, POINT_BYTES, Point, SECONDARY, chained, direct,
    secondary, secondary_records, set_below, set_chained, set_direct, set_next,
};
use crate::records::{Hold, Records, Work};
use crate::swap::OS_PAGE_BYTES;

/// Where things are in memory.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Layout {
    nodes_at: u64,
    secondary_at: u64,
    points_at: u64,
    /// Whether the secondary records of a leaf are linked, last first; else they stand side by
    /// side.
    is_chained: bool,
    end: u64,
}

impl Layout {
    /// Bytes of all of it: whole pages.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.end
    }
}

/// Octree and points in memory.
pub struct Structures<M> {
    memory: M,
    layout: Layout,
}

/// All there.
pub type InCore = Structures<Flat<Vec<u8>>>;

impl InCore {
    /// Loads the files of an index.
    ///
    /// # Errors
    /// What the system says.
    pub fn load(index: &Index) -> std::io::Result<Self> {
        let (image, layout) = image_of_files(index)?;
        Ok(Self::new(Flat(image), layout))
    }
}

impl<M: Memory> Structures<M> {
    /// Structures that lie so in memory.
    #[must_use]
    pub fn new(memory: M, layout: Layout) -> Self {
        Self { memory, layout }
    }

    /// The memory.
    #[must_use]
    pub fn memory(&self) -> &M {
        &self.memory
    }

    fn node(&mut self, number: u64) -> Result<&[u8], CacheError> {
        self.memory
            .read(self.layout.nodes_at.saturating_add(number.saturating_mul(NODE_BYTES as u64)), NODE_BYTES)
    }

    fn secondary(&mut self, number: u64) -> Result<&[u8], CacheError> {
        let at = self.layout.secondary_at.saturating_add(number.saturating_mul(NODE_BYTES as u64));
        self.memory.read(at, NODE_BYTES)
    }
}

impl<M: Memory> Records for Structures<M> {
    fn retain(&mut self, number: u64, _priority: u8) -> Result<(Node, Hold), CacheError> {
        Ok((Node::decode(self.node(number)?), number as Hold))
    }

    fn release(&mut self, _hold: Hold) {}

    fn list(
        &mut self,
        (leaf, hold): (&Node, Hold),
        _priority: u8,
        out: &mut Vec<u32>,
    ) -> Result<(), CacheError> {
        let Below::Points { count, secondary: first } = leaf.below else { return Ok(()) };
        out.extend(direct(self.node(u64::from(hold))?, count));
        let mut left = (count as usize).saturating_sub(DIRECT);
        if !self.layout.is_chained {
            for number in 0..secondary_records(count) {
                out.extend(secondary(self.secondary(first.saturating_add(number))?, left));
                left = left.saturating_sub(SECONDARY);
            }
            return Ok(());
        }
        // No list is longer than all memory, whatever a damaged one says.
        let bytes = left.div_ceil(CHAINED).saturating_mul(NODE_BYTES);
        if bytes as u64 > self.layout.end {
            return Err(CacheError::Beyond { at: first, bytes, end: self.layout.end });
        }
        // The last record comes first, and is the one that may not be full.
        let (mut record, mut place) = (first, out.len() + left);
        out.resize(place, 0);
        while left > 0 {
            let here = if left.is_multiple_of(CHAINED) { CHAINED } else { left % CHAINED };
            let (references, next) = chained(self.secondary(record)?, here);
            place -= here;
            out[place..place + here].iter_mut().zip(references).for_each(|(to, from)| *to = from);
            (record, left) = (next, left - here);
        }
        Ok(())
    }

    fn point(&mut self, number: u32, _priority: u8) -> Result<Point, CacheError> {
        let at = self.layout.points_at.saturating_add(u64::from(number) * POINT_BYTES as u64);
        Ok(Point::decode(self.memory.read(at, POINT_BYTES)?))
    }

    fn work(&mut self, work: Work) {
        self.memory.work(work);
    }
}

/// Where the files of an index are, one behind the other.
///
/// # Errors
/// What the system says.
pub fn layout_of_files(index: &Index) -> std::io::Result<Layout> {
    let [nodes, secondary, points] = index.files();
    let length = |path: &Path| std::fs::metadata(path).map(|m| m.len());
    let secondary_at = length(&nodes)?;
    let points_at = secondary_at + length(&secondary)?;
    let end = points_at + length(&points)?;
    Ok(Layout { nodes_at: 0, secondary_at, points_at, is_chained: false, end })
}

/// The files of an index one behind the other: memory in the order of the tree.
///
/// # Errors
/// What the system says.
pub fn image_of_files(index: &Index) -> std::io::Result<(Vec<u8>, Layout)> {
    let layout = layout_of_files(index)?;
    let mut image = Vec::with_capacity(usize::try_from(layout.end).unwrap_or(0));
    for file in index.files() {
        File::open(file)?.read_to_end(&mut image)?;
    }
    Ok((image, layout))
}

/// Writes them so.
///
/// # Errors
/// What the system says.
pub fn write_files(index: &Index, path: &Path) -> std::io::Result<Layout> {
    let mut image = File::create(path)?;
    for file in index.files() {
        std::io::copy(&mut File::open(file)?, &mut image)?;
    }
    layout_of_files(index)
}

/// The same octree as a program makes it in its heap: points in an array; the octree grows as it
/// takes one after another, divides a leaf that has too many, and takes a secondary record where a
/// list has no more room. Returns its memory.
///
/// `touch` is told of what the program reads (false) and writes (true), from which address on.
///
/// # Errors
/// What the system says.
pub fn grow(index: &Index, touch: &mut dyn FnMut(u64, usize, bool)) -> std::io::Result<(Vec<u8>, Layout)> {
    let [_, _, points] = index.files();
    let (min, max) = index.root()?;
    let points = std::fs::read(points)?;
    let nodes_at = points.len() as u64;
    let limits = index.summary.limits;
    (0..nodes_at).step_by(OS_PAGE_BYTES).for_each(|at| touch(at, OS_PAGE_BYTES, true));
    let mut heap = Heap { blocks: Vec::new(), free: Vec::new(), points: &points, limits, touch };
    heap.take_group();
    heap.write(0, &Node { min, max, parent: NOWHERE, below: EMPTY });
    for number in 0..index.summary.points as u32 {
        let point = heap.point(number);
        heap.insert(0, 0, number, &point);
        (heap.touch)(u64::from(number) * POINT_BYTES as u64, POINT_BYTES, false);
    }
    let Heap { blocks, .. } = heap;
    let mut image = points;
    image.extend_from_slice(&blocks);
    let end = image.len().next_multiple_of(OS_PAGE_BYTES);
    image.resize(end, 0);
    let layout = Layout { nodes_at, secondary_at: nodes_at, points_at: 0, is_chained: true, end: end as u64 };
    Ok((image, layout))
}

const EMPTY: Below = Below::Points { count: 0, secondary: NOWHERE };

/// Blocks of a record each: nodes in eights, secondary records, and those that are free again.
struct Heap<'a> {
    blocks: Vec<u8>,
    free: Vec<u64>,
    points: &'a [u8],
    limits: Limits,
    touch: &'a mut dyn FnMut(u64, usize, bool),
}

impl Heap<'_> {
    fn point(&self, number: u32) -> Point {
        let from = number as usize * POINT_BYTES;
        Point::decode(&self.points[from..from + POINT_BYTES])
    }

    fn touch_block(&mut self, number: u64, writes: bool) {
        (self.touch)(self.points.len() as u64 + number * NODE_BYTES as u64, NODE_BYTES, writes);
    }

    fn block(&mut self, number: u64) -> &[u8] {
        self.touch_block(number, false);
        let from = number as usize * NODE_BYTES;
        &self.blocks[from..from + NODE_BYTES]
    }

    fn block_mut(&mut self, number: u64) -> &mut [u8] {
        self.touch_block(number, true);
        let from = number as usize * NODE_BYTES;
        &mut self.blocks[from..from + NODE_BYTES]
    }

    fn take(&mut self, blocks: usize) -> u64 {
        let first = self.blocks.len() / NODE_BYTES;
        self.blocks.resize(self.blocks.len() + blocks * NODE_BYTES, 0);
        first as u64
    }

    fn take_group(&mut self) -> u64 {
        self.take(8)
    }

    fn take_secondary(&mut self) -> u64 {
        self.free.pop().unwrap_or_else(|| self.take(1))
    }

    fn write(&mut self, number: u64, node: &Node) {
        self.block_mut(number).copy_from_slice(&node.encode(&[]));
    }

    fn insert(&mut self, number: u64, depth: u32, reference: u32, point: &Point) {
        let node = Node::decode(self.block(number));
        match node.below {
            Below::Children(children) => self.insert_below(&node, children, depth, reference, point),
            Below::Points { count, .. }
                if depth < self.limits.height && u64::from(count) >= self.limits.leaf_points =>
            {
                let children = self.divide(number, &node, depth);
                self.insert_below(&node, children, depth, reference, point);
            }
            Below::Points { count, secondary } => self.append(number, count, secondary, reference),
        }
    }

    fn insert_below(&mut self, node: &Node, children: [u64; 8], depth: u32, reference: u32, point: &Point) {
        for (octant, child) in children.into_iter().enumerate() {
            let (min, max) = node.octant_box(octant);
            if point.reaches(min, max) {
                self.insert(child, depth + 1, reference, point);
            }
        }
    }

    /// Makes a node of a leaf; its points go to its children.
    fn divide(&mut self, number: u64, node: &Node, depth: u32) -> [u64; 8] {
        let references = self.take_list(number, node);
        let first = self.take_group();
        let children = std::array::from_fn(|octant| first + octant as u64);
        for (octant, child) in children.into_iter().enumerate() {
            let (min, max) = node.octant_box(octant);
            self.write(child, &Node { min, max, parent: number, below: EMPTY });
        }
        let divided = Node { below: Below::Children(children), ..*node };
        self.write(number, &divided);
        for reference in references {
            let point = self.point(reference);
            self.insert_below(&divided, children, depth, reference, &point);
        }
        children
    }

    /// The references of a leaf, whose secondary records are free from then on.
    fn take_list(&mut self, number: u64, node: &Node) -> Vec<u32> {
        let Below::Points { count, secondary } = node.below else { return Vec::new() };
        let mut references: Vec<u32> = direct(self.block(number), count).collect();
        let (mut left, mut record, mut parts) = (count as usize - references.len(), secondary, Vec::new());
        while left > 0 {
            let here = if left.is_multiple_of(CHAINED) { CHAINED } else { left % CHAINED };
            let (part, next) = chained(self.block(record), here);
            parts.push(part.collect::<Vec<u32>>());
            self.free.push(record);
            (record, left) = (next, left - here);
        }
        references.extend(parts.into_iter().rev().flatten());
        references
    }

    fn append(&mut self, number: u64, count: u32, secondary: u64, reference: u32) {
        let mut record = secondary;
        match (count as usize).checked_sub(DIRECT) {
            None => set_direct(self.block_mut(number), count as usize, reference),
            Some(behind) => {
                let place = behind % CHAINED;
                if place == 0 {
                    record = self.take_secondary();
                    set_next(self.block_mut(record), secondary);
                }
                set_chained(self.block_mut(record), place, reference);
            }
        }
        set_below(self.block_mut(number), (count + 1, record));
    }
}

#[cfg(test)]
mod tests {
    use rayset::geometry::DVec3;
    use rayset::points::Workload;

    use super::*;
    use crate::experiments::Subject;

    /// Every leaf of a tree: its box and its list.
    fn leaves(records: &mut impl Records) -> Vec<([DVec3; 2], Vec<u32>)> {
        let (mut stack, mut found) = (vec![0], Vec::new());
        while let Some(number) = stack.pop() {
            let (node, hold) = records.retain(number, 0).expect("a node");
            match node.below {
                Below::Children(children) => stack.extend(children),
                Below::Points { .. } => {
                    let mut list = Vec::new();
                    records.list((&node, hold), 0, &mut list).expect("a list");
                    found.push(([node.min, node.max], list));
                }
            }
        }
        found
    }

    #[test]
    fn the_heap_of_a_program_holds_the_tree_of_the_files_leaf_by_leaf() {
        let folder = tempfile::tempdir().expect("a folder");
        let workload: Workload = "sphere-3k".parse().expect("a workload");
        let subject = Subject::build(workload.source(), Some(0.2), 8, &folder.path().join("c.rset"));
        let subject = subject.expect("a cloud");
        for limits in [Limits { height: 4, leaf_points: 50 }, Limits { height: 2, leaf_points: 1 }] {
            let index = subject.index(folder.path(), limits).expect("an index");
            let of_files = leaves(&mut InCore::load(&index).expect("the files"));
            let (image, layout) = grow(&index, &mut |_, _, _| {}).expect("points");
            assert_eq!(image.len() as u64, layout.bytes());
            let grown = leaves(&mut Structures::new(Flat(image), layout));
            let longest = of_files.iter().map(|(_, list)| list.len()).max();
            assert!(limits.height == 4 || longest > Some(DIRECT + 2 * SECONDARY), "{longest:?}");
            assert_eq!(grown, of_files);
        }
    }

    #[test]
    fn structures_that_lead_out_of_their_memory_are_an_error() {
        let folder = tempfile::tempdir().expect("a folder");
        let workload: Workload = "sphere-1k".parse().expect("a workload");
        let subject = Subject::build(workload.source(), Some(0.2), 8, &folder.path().join("c.rset"));
        let index = subject.expect("a cloud").index(folder.path(), Limits { height: 3, leaf_points: 9 });
        let mut records = InCore::load(&index.expect("an index")).expect("the files");
        for number in [1 << 20, u64::MAX / 2, NOWHERE] {
            let error = records.retain(number, 0).expect_err("an error").to_string();
            assert!(error.contains("beyond"), "{error}");
        }
        assert!(records.point(u32::MAX, 0).is_err());
    }
}

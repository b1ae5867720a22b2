//! What the ray tracer asks of an index, and the controllers that answer out of core: node and
//! point caches over a disk.

use rayset::geometry::DVec3;

use crate::cache::{CacheCounts, CacheError, RecordCache, Slot};
use crate::disk::Disk;
use crate::record::{
    Below, DIRECT, NODE_BYTES, Node, POINT_BYTES, Point, SECONDARY, direct, secondary, secondary_records,
};
use crate::simulated::Clock;

/// A node that is held.
pub type Hold = Slot;

/// The records of an index. Numbers are those of the file.
pub trait Records {
    /// Retains a node.
    ///
    /// # Errors
    /// [`CacheError`] where it cannot be had.
    fn retain(&mut self, number: u64, priority: u8) -> Result<(Node, Hold), CacheError>;
    /// Gives it back.
    fn release(&mut self, hold: Hold);
    /// The points of a leaf that is retained.
    ///
    /// # Errors
    /// [`CacheError`] where they cannot be had.
    fn list(&mut self, leaf: (&Node, Hold), priority: u8, out: &mut Vec<u32>) -> Result<(), CacheError>;
    /// A point.
    ///
    /// # Errors
    /// [`CacheError`] where it cannot be had.
    fn point(&mut self, number: u32, priority: u8) -> Result<Point, CacheError>;
    /// Says that points will be wanted.
    ///
    /// # Errors
    /// [`CacheError`] where an earlier read failed.
    fn hint_points(&mut self, _numbers: &[u32], _priority: u8) -> Result<(), CacheError> {
        Ok(())
    }
    /// Algorithm 2: goes from a node that is retained toward a place without waiting for any
    /// record; asks for the first that is absent.
    ///
    /// # Errors
    /// [`CacheError`] where an earlier read failed.
    fn precache(&mut self, _from: &Node, _place: DVec3, _priority: u8) -> Result<Ahead, CacheError> {
        Ok(Ahead::Nowhere)
    }
    /// Lets counted time pass, where time is counted.
    fn work(&mut self, _work: Work) {}
}

/// What came of looking ahead.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Ahead {
    /// The leaf of the place is in core.
    Reached(Node),
    /// A node on the way to it is not, and has been asked for.
    Asked,
    /// Nothing has to be brought in.
    Nowhere,
}

/// Work of the processor, for disks whose time is counted.
#[derive(Clone, Copy, Debug)]
pub enum Work {
    /// A step from a node to another.
    Step,
    /// A point against a sample.
    Point,
    /// A sample, whatever else there is to it.
    Sample,
}

impl Work {
    /// What it takes, nanoseconds: the order of a processor of the paper's day (1–3 GHz), five
    /// times what the in-core engine takes on a machine of 2025.
    #[must_use]
    pub fn nanoseconds(self) -> u64 {
        match self {
            Self::Step => 100,
            Self::Point => 50,
            Self::Sample => 500,
        }
    }
}

/// Records in memory at most, by kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Budget {
    /// Nodes and secondary records.
    pub nodes: usize,
    /// Points.
    pub points: usize,
}

/// The node controller and the point controller of a cloud, over one disk.
pub struct OutOfCore {
    disk: Box<dyn Disk>,
    nodes: RecordCache,
    secondary: RecordCache,
    points: RecordCache,
    /// Reads in one call.
    batch: usize,
    prefetches: bool,
    clock: Option<Clock>,
}

/// A part of the budget for nodes is for secondary records: one in so many.
const SECONDARY_PART: usize = 4;

impl OutOfCore {
    /// Caches over a disk whose files are those of [`Index::files`]; `clock` where its time is
    /// counted.
    #[must_use]
    pub fn new(
        disk: Box<dyn Disk>,
        budget: Budget,
        batch: usize,
        prefetches: bool,
        clock: Option<Clock>,
    ) -> Self {
        let for_secondary = (budget.nodes / SECONDARY_PART).max(1);
        let for_nodes = (budget.nodes - for_secondary.min(budget.nodes)).max(1);
        Self {
            disk,
            nodes: RecordCache::new(0, NODE_BYTES, 8, for_nodes),
            secondary: RecordCache::new(1, NODE_BYTES, 1, for_secondary),
            points: RecordCache::new(2, POINT_BYTES, 1, budget.points),
            batch,
            prefetches,
            clock,
        }
    }

    /// Reads so many bytes at a time, whatever is asked for: records that stand side by side in
    /// them come together. The paper reads eight children together, and all else record by record.
    #[must_use]
    pub fn reading(mut self, bytes: usize) -> Self {
        let together = |record: usize| (bytes / record).max(1) as u64;
        self.nodes = RecordCache::new(0, NODE_BYTES, together(NODE_BYTES), self.nodes.capacity());
        self.secondary = RecordCache::new(1, NODE_BYTES, together(NODE_BYTES), self.secondary.capacity());
        self.points = RecordCache::new(2, POINT_BYTES, together(POINT_BYTES), self.points.capacity());
        self
    }

    /// Changes how many nodes, secondary records and points are held, also while they are in use.
    pub fn set_capacities(&mut self, nodes: usize, secondary: usize, points: usize) {
        self.nodes.set_capacity(nodes);
        self.secondary.set_capacity(secondary);
        self.points.set_capacity(points);
    }

    /// Nodes, secondary records and points that are held.
    #[must_use]
    pub fn resident(&self) -> [usize; 3] {
        [self.nodes.resident(), self.secondary.resident(), self.points.resident()]
    }

    /// What the caches of nodes, secondary records and points did.
    #[must_use]
    pub fn counts(&self) -> [CacheCounts; 3] {
        [self.nodes.counts(), self.secondary.counts(), self.points.counts()]
    }

    /// Nanoseconds waited for the disk.
    #[must_use]
    pub fn stalled_nanoseconds(&self) -> u64 {
        self.disk.stalled_nanoseconds()
    }

    /// The references of a leaf that are in its own record.
    fn known_references(&self, hold: Hold, count: u32, out: &mut Vec<u32>) {
        out.extend(direct(self.nodes.bytes(hold), count));
    }
}

impl Records for OutOfCore {
    fn retain(&mut self, number: u64, priority: u8) -> Result<(Node, Hold), CacheError> {
        let hold = self.nodes.retain(&mut *self.disk, number, priority)?;
        let node = Node::decode(self.nodes.bytes(hold));
        // The access of a node that is no leaf brings in all its children.
        if self.prefetches
            && let Below::Children([first, ..]) = node.below
        {
            self.nodes.prefetch(&mut *self.disk, &[first], priority / 2, self.batch)?;
        }
        Ok((node, hold))
    }

    fn release(&mut self, hold: Hold) {
        self.nodes.release(hold);
    }

    fn list(
        &mut self,
        (leaf, hold): (&Node, Hold),
        priority: u8,
        out: &mut Vec<u32>,
    ) -> Result<(), CacheError> {
        let Below::Points { count, secondary: first } = leaf.below else { return Ok(()) };
        self.known_references(hold, count, out);
        if secondary_records(count) == 0 {
            return Ok(());
        }
        let end = self.disk.length(1) / NODE_BYTES as u64;
        let records = first.saturating_add(secondary_records(count));
        if records > end {
            let width = NODE_BYTES as u64;
            let bytes = secondary_records(count) as usize * NODE_BYTES;
            return Err(CacheError::Beyond { at: first.saturating_mul(width), bytes, end: end * width });
        }
        let records: Vec<u64> = (first..records).collect();
        if self.prefetches {
            self.secondary.prefetch(&mut *self.disk, &records, priority, self.batch)?;
        }
        let mut left = (count as usize).saturating_sub(DIRECT);
        for number in records {
            let slot = self.secondary.retain(&mut *self.disk, number, priority)?;
            out.extend(secondary(self.secondary.bytes(slot), left));
            self.secondary.release(slot);
            left = left.saturating_sub(SECONDARY);
        }
        Ok(())
    }

    fn point(&mut self, number: u32, priority: u8) -> Result<Point, CacheError> {
        let slot = self.points.retain(&mut *self.disk, u64::from(number), priority)?;
        let point = Point::decode(self.points.bytes(slot));
        self.points.release(slot);
        Ok(point)
    }

    fn hint_points(&mut self, numbers: &[u32], priority: u8) -> Result<(), CacheError> {
        if !self.prefetches {
            return Ok(());
        }
        // More than the cache holds would only drive each other out.
        let records: Vec<u64> =
            numbers.iter().take(self.points.capacity() / 2).map(|&n| u64::from(n)).collect();
        self.points.prefetch(&mut *self.disk, &records, priority, self.batch)
    }

    fn precache(&mut self, from: &Node, place: DVec3, priority: u8) -> Result<Ahead, CacheError> {
        let mut node = *from;
        loop {
            let Below::Children(children) = node.below else { return Ok(Ahead::Reached(node)) };
            self.work(Work::Step);
            let child = children[node.octant(place)];
            let Some(slot) = self.nodes.peek(&mut *self.disk, child)? else {
                self.nodes.prefetch(&mut *self.disk, &[child], priority, self.batch)?;
                return Ok(Ahead::Asked);
            };
            let inner = Node::decode(self.nodes.bytes(slot));
            if !inner.contains(place) || !(inner.max - inner.min).cmplt(node.max - node.min).all() {
                // Damaged: whoever goes there is told.
                return Ok(Ahead::Nowhere);
            }
            node = inner;
            if let Below::Points { count, .. } = node.below {
                // The node controller tells the point controller.
                let mut points = Vec::with_capacity(DIRECT);
                self.known_references(slot, count, &mut points);
                self.hint_points(&points, priority)?;
            }
        }
    }

    fn work(&mut self, work: Work) {
        if let Some(clock) = &self.clock {
            clock.advance(work.nanoseconds());
        }
    }
}

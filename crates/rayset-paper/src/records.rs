//! Where the records of an index are while it is rendered: in memory, in caches over a disk, or in pages that an operating
//! system would bring in.

use std::ops::Deref;
use std::path::Path;

use rayset::geometry::DVec3;

use crate::cache::{CacheCounts, CacheError, RecordCache, Slot};
use crate::disk::{Clock, Disk};
use crate::index::Index;
use crate::record::{
    Below, DIRECT, NODE_BYTES, NOWHERE, Node, POINT_BYTES, Point, SECONDARY, direct, secondary,
    secondary_records,
};

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
    /// Algorithm 2: goes from a node that is retained toward a place without waiting for any record; asks for the first
    /// that is absent. True where the leaf of the place was found.
    ///
    /// # Errors
    /// [`CacheError`] where an earlier read failed.
    fn precache(&mut self, _from: &Node, _place: DVec3, _priority: u8) -> Result<bool, CacheError> {
        Ok(true)
    }
    /// Lets counted time pass, where time is counted.
    fn work(&mut self, _work: Work) {}
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
    /// What it takes, nanoseconds: the order of a processor of the paper's day (1–3 GHz), five times what the in-core engine
    /// takes on a machine of 2025.
    #[must_use]
    pub fn nanoseconds(self) -> u64 {
        match self {
            Self::Step => 100,
            Self::Point => 50,
            Self::Sample => 500,
        }
    }
}

/// All records at once, in bytes of the file: in memory, or where an operating system puts a map.
pub struct Whole<B> {
    nodes: B,
    secondary: B,
    points: B,
}

/// Everything in memory.
pub type InCore = Whole<Vec<u8>>;

impl InCore {
    /// Loads an index.
    ///
    /// # Errors
    /// What the system says.
    pub fn load(index: &Index) -> std::io::Result<Self> {
        let [nodes, secondary, points] = index.files();
        Ok(Self::new([std::fs::read(nodes)?, std::fs::read(secondary)?, std::fs::read(points)?]))
    }
}

impl<B: Deref<Target = [u8]>> Whole<B> {
    /// Over the bytes of [`Index::files`].
    #[must_use]
    pub fn new([nodes, secondary, points]: [B; 3]) -> Self {
        Self { nodes, secondary, points }
    }
}

fn record(bytes: &[u8], number: u64, width: usize) -> &[u8] {
    let from = number as usize * width;
    &bytes[from..from + width]
}

impl<B: Deref<Target = [u8]>> Records for Whole<B> {
    fn retain(&mut self, number: u64, _priority: u8) -> Result<(Node, Hold), CacheError> {
        Ok((Node::decode(record(&self.nodes, number, NODE_BYTES)), number as Hold))
    }

    fn release(&mut self, _hold: Hold) {}

    fn list(
        &mut self,
        (leaf, hold): (&Node, Hold),
        _priority: u8,
        out: &mut Vec<u32>,
    ) -> Result<(), CacheError> {
        let Below::Points { count, secondary: first } = leaf.below else { return Ok(()) };
        out.extend(direct(record(&self.nodes, u64::from(hold), NODE_BYTES), count));
        let mut left = (count as usize).saturating_sub(DIRECT);
        for number in 0..secondary_records(count) {
            out.extend(secondary(record(&self.secondary, first + number, NODE_BYTES), left));
            left = left.saturating_sub(SECONDARY);
        }
        Ok(())
    }

    fn point(&mut self, number: u32, _priority: u8) -> Result<Point, CacheError> {
        Ok(Point::decode(record(&self.points, u64::from(number), POINT_BYTES)))
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
    /// Caches over a disk whose files are those of [`Index::files`]; `clock` where its time is counted.
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

    /// Changes how many nodes, secondary records and points are held, also while they are in use.
    pub fn set_capacities(&mut self, nodes: usize, secondary: usize, points: usize) {
        self.nodes.set_capacity(nodes);
        self.secondary.set_capacity(secondary);
        self.points.set_capacity(points);
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
        if first == NOWHERE {
            return Ok(());
        }
        let records: Vec<u64> = (first..first + secondary_records(count)).collect();
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

    fn precache(&mut self, from: &Node, place: DVec3, priority: u8) -> Result<bool, CacheError> {
        let mut node = *from;
        loop {
            let Below::Children(children) = node.below else { return Ok(true) };
            self.work(Work::Step);
            let child = children[node.octant(place)];
            let Some(slot) = self.nodes.peek(&mut *self.disk, child)? else {
                self.nodes.prefetch(&mut *self.disk, &[child], priority, self.batch)?;
                return Ok(false);
            };
            node = Node::decode(self.nodes.bytes(slot));
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

/// Bytes of a page of the operating system.
const OS_PAGE_BYTES: usize = 4096;

/// The structures of [`InCore`], of which an operating system holds only some pages: demand paging, least recently used.
pub struct Paged {
    whole: InCore,
    disk: Box<dyn Disk>,
    pages: RecordCache,
    /// Where nodes, secondary records and points begin in memory.
    starts: [u64; 3],
    clock: Clock,
}

impl Paged {
    /// Over a disk of one file, made by [`write_image`].
    ///
    /// # Errors
    /// What the system says.
    pub fn new(index: &Index, disk: Box<dyn Disk>, memory_bytes: u64, clock: Clock) -> std::io::Result<Self> {
        let mut starts = [0; 3];
        let mut end = 0;
        for (start, path) in starts.iter_mut().zip(index.files()) {
            *start = end;
            end += std::fs::metadata(path)?.len();
        }
        let pages = RecordCache::new(0, OS_PAGE_BYTES, 1, (memory_bytes as usize / OS_PAGE_BYTES).max(1));
        Ok(Self { whole: InCore::load(index)?, disk, pages, starts, clock })
    }

    /// What paging did.
    #[must_use]
    pub fn counts(&self) -> CacheCounts {
        self.pages.counts()
    }

    fn touch(&mut self, part: usize, at: u64, bytes: usize) -> Result<(), CacheError> {
        let from = self.starts[part] + at;
        for page in from / OS_PAGE_BYTES as u64..=(from + bytes as u64 - 1) / OS_PAGE_BYTES as u64 {
            let slot = self.pages.retain(&mut *self.disk, page, 0)?;
            self.pages.release(slot);
        }
        Ok(())
    }
}

/// Writes the files of an index one behind the other: the memory of a program that is paged.
///
/// # Errors
/// What the system says.
pub fn write_image(index: &Index, path: &Path) -> std::io::Result<()> {
    let mut image = std::fs::File::create(path)?;
    for file in index.files() {
        std::io::copy(&mut std::fs::File::open(file)?, &mut image)?;
    }
    Ok(())
}

impl Records for Paged {
    fn retain(&mut self, number: u64, priority: u8) -> Result<(Node, Hold), CacheError> {
        self.touch(0, number * NODE_BYTES as u64, NODE_BYTES)?;
        self.whole.retain(number, priority)
    }

    fn release(&mut self, _hold: Hold) {}

    fn list(&mut self, leaf: (&Node, Hold), priority: u8, out: &mut Vec<u32>) -> Result<(), CacheError> {
        if let Below::Points { count, secondary } = leaf.0.below
            && secondary != NOWHERE
        {
            let bytes = secondary_records(count) as usize * NODE_BYTES;
            self.touch(1, secondary * NODE_BYTES as u64, bytes)?;
        }
        self.whole.list(leaf, priority, out)
    }

    fn point(&mut self, number: u32, priority: u8) -> Result<Point, CacheError> {
        self.touch(2, u64::from(number) * POINT_BYTES as u64, POINT_BYTES)?;
        self.whole.point(number, priority)
    }

    fn work(&mut self, work: Work) {
        self.clock.advance(work.nanoseconds());
    }
}

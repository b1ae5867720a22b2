//! Plans the octree from counts alone: which nodes exist above a certain level, and which stretches
//! of the sorted points belong to them. Stretches are grouped into buckets that fit in memory.

use super::record::{Key, KeyMaker};
use rayset_base::geometry::curve::MAX_LEVEL;

/// A node with at most this number of points is a leaf.
pub(super) const LEAF_POINTS: u64 = 4096;

/// A cell of the octree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Cell {
    pub(super) level: u32,
    /// Index among all cells of its level, in Hilbert order.
    pub(super) number: u64,
}

impl Cell {
    pub(super) const ROOT: Self = Self { level: 0, number: 0 };

    /// The index of this cell among the children of its parent.
    pub(super) fn octant(self) -> u8 {
        (self.number & 7) as u8
    }
}

/// An event in a traversal of the upper part of the octree, in file order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Event {
    /// An inner node begins.
    Open(Cell),
    /// Points whose radii are too large for the children of the open node.
    Own { count: u64, bucket: u32 },
    /// All points of a node whose subtree is determined later, in memory.
    Subtree { cell: Cell, count: u64, bucket: u32 },
    /// The open node ends.
    Close,
}

/// A stretch of ordered points that is loaded at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Bucket {
    pub(super) count: u64,
}

/// Counts of points by owner cell, for some levels from a base cell down.
pub(super) struct Pyramid {
    base: Cell,
    depth: u32,
    /// For each level from the base, one counter per cell. The last level also counts points owned
    /// by deeper cells.
    pub(super) counts: Vec<Vec<std::sync::atomic::AtomicU64>>,
}

impl Pyramid {
    /// A pyramid deep enough, within its limits, that its last cells hold a few hundred of `count`
    /// points if these are spread evenly.
    pub(super) fn new(base: Cell, count: u64, limit_bytes: u64) -> Self {
        let mut depth = 1;
        while depth < 6
            && base.level + depth < MAX_LEVEL
            && 8_u64.pow(depth) < count / 512
            && 24 * 8_u64.pow(depth + 1) < limit_bytes
        {
            depth += 1;
        }
        let counts = (0..=depth).map(|l| (0..8_usize.pow(l)).map(|_| 0.into()).collect()).collect();
        Self { base, depth, counts }
    }

    /// Level (from the base) and index of the counter for a key.
    pub(super) fn slot(&self, key: Key) -> (usize, usize) {
        let level = key.level().clamp(self.base.level, self.base.level + self.depth);
        let relative = level - self.base.level;
        let index = key.cell_at(level) - (self.base.number << (3 * relative));
        (relative as usize, index as usize)
    }

    /// All counters, level by level.
    #[cfg(feature = "parts")]
    pub(super) fn counters(&self) -> impl Iterator<Item = &std::sync::atomic::AtomicU64> {
        self.counts.iter().flatten()
    }

    pub(super) fn count(&self, keys: &KeyMaker, record: &[u8]) {
        let (level, index) = self.slot(keys.key(record));
        self.counts[level][index].fetch_add(1, std::sync::atomic::Ordering::Relaxed);
    }
}

/// The events of the upper tree, and the bucket of every point.
pub(super) struct Plan {
    pub(super) pyramid: Pyramid,
    pub(super) events: Vec<Event>,
    pub(super) buckets: Vec<Bucket>,
    bucket_of: Vec<Vec<u32>>,
}

impl Plan {
    /// Determines the upper tree and groups its stretches into buckets of at most `cap` points; a
    /// larger stretch gets its own bucket.
    pub(super) fn new(pyramid: Pyramid, cap: u64) -> Self {
        let own: Vec<Vec<u64>> = pyramid
            .counts
            .iter()
            .map(|level| level.iter().map(|c| c.load(std::sync::atomic::Ordering::Relaxed)).collect())
            .collect();
        let mut total = own.clone();
        for level in (0..pyramid.depth as usize).rev() {
            for index in 0..total[level].len() {
                total[level][index] += total[level + 1][8 * index..8 * index + 8].iter().sum::<u64>();
            }
        }
        let bucket_of = own.iter().map(|level| vec![0; level.len()]).collect();
        let mut plan = Self { pyramid, events: Vec::new(), buckets: Vec::new(), bucket_of };
        plan.visit(&own, &total, 0, 0, cap);
        plan
    }

    /// The bucket of a point.
    pub(super) fn bucket(&self, keys: &KeyMaker, record: &[u8]) -> u32 {
        let (level, index) = self.pyramid.slot(keys.key(record));
        self.bucket_of[level][index]
    }

    /// The number of points in each bucket, of those that some counters of a pyramid like this
    /// one's count, level by level.
    #[cfg(feature = "parts")]
    pub(super) fn counts_by_bucket(&self, counts: &[u64]) -> Vec<u64> {
        let mut by_bucket = vec![0; self.buckets.len()];
        for (count, &bucket) in counts.iter().zip(self.bucket_of.iter().flatten()).filter(|(c, _)| **c > 0) {
            by_bucket[bucket as usize] += count;
        }
        by_bucket
    }

    /// For each bucket the first event that takes points of it, and after these the number of
    /// events.
    pub(super) fn starts(&self) -> Vec<usize> {
        let mut starts = vec![self.events.len(); self.buckets.len() + 1];
        for (at, event) in self.events.iter().enumerate().rev() {
            if let Event::Own { bucket, .. } | Event::Subtree { bucket, .. } = event {
                starts[*bucket as usize] = at;
            }
        }
        starts
    }

    fn visit(&mut self, own: &[Vec<u64>], total: &[Vec<u64>], level: usize, index: usize, cap: u64) {
        let count = total[level][index];
        if count == 0 {
            return;
        }
        let base = self.pyramid.base;
        let cell =
            Cell { level: base.level + level as u32, number: (base.number << (3 * level)) + index as u64 };
        if count <= LEAF_POINTS || level == self.pyramid.depth as usize {
            let bucket = self.assign(count, cap);
            for below in level..=self.pyramid.depth as usize {
                let width = 8_usize.pow((below - level) as u32);
                self.bucket_of[below][index * width..(index + 1) * width].fill(bucket);
            }
            self.events.push(Event::Subtree { cell, count, bucket });
            return;
        }
        self.events.push(Event::Open(cell));
        if own[level][index] > 0 {
            let bucket = self.assign(own[level][index], cap);
            self.bucket_of[level][index] = bucket;
            self.events.push(Event::Own { count: own[level][index], bucket });
        }
        for octant in 0..8 {
            self.visit(own, total, level + 1, 8 * index + octant, cap);
        }
        self.events.push(Event::Close);
    }

    /// Puts a stretch into the current bucket, or into a new one if it does not fit.
    fn assign(&mut self, count: u64, cap: u64) -> u32 {
        match self.buckets.last_mut() {
            Some(bucket) if bucket.count + count <= cap => bucket.count += count,
            _ => self.buckets.push(Bucket { count }),
        }
        self.buckets.len() as u32 - 1
    }
}

//! Making the aggregates of a cloud: one pass over its nodes, in the order of the file.
//!
//! [`Maker::run`] is the overview. Threads take the own points of nodes and measure densities among
//! them; the caller's thread merges what they find, node by node, and hands the records of each
//! level on.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::cells::{Cells, OwnPoints};
use super::density::{CloudPages, Field};
use super::error::AggregateError;
use super::header::LEVELS;
use super::histogram::{Masses, half_octave};
use super::moments::Moments;
use super::near_points::NearPoints;
use super::options::AggregateOptions;
use super::places::{PLACES, UnitPlaces};
use super::points::{Decoder, Points};
use super::records::{RecordMaker, RecordSink, RecordsByLevel, move_children};
use crate::octree::file::Cloud;
use crate::octree::layout::RUN_POINTS;
use crate::octree::node::Node;
use crate::octree::pipeline::ordered;
use crate::octree::walk::{Visit, Visitor, Walk};
use rayset_store::working_set::{Object, PageClient};

/// Nodes that are handed out at a time.
const BATCH_NODES: usize = 128;
/// Own points of a node that are worked on together: those of a leaf at once.
const TOGETHER: usize = 4096;
/// If very many points reach a place, so many points of a leaf that follow each other are taken to
/// lie in one density.
const ALIKE_POINTS: usize = 16;
/// If a node's own runs have room for no more points than this, all are measured.
const MOST_ALL_MEASURED: u64 = 16_384;
/// Of more, so few that, if all reach each other, there are no more pairs of those that are
/// measured and others; but no fewer than a few.
const MOST_PAIRS: u64 = 1 << 24;
const LEAST_MEASURED: u64 = 64;

/// What is asked for, and whom to ask.
pub(super) struct Maker<'a> {
    pub(super) cloud: &'a Cloud,
    pub(super) client: &'a PageClient,
    pub(super) object: &'a Arc<Object>,
    pub(super) options: &'a AggregateOptions,
    pub(super) threads: usize,
    pub(super) records: RecordMaker,
    /// Those that no thread uses.
    pub(super) near: Mutex<Vec<NearPoints>>,
    pub(super) progress: &'a (dyn Fn(u64) + Sync),
}

/// What was found of a node's own points, of a leaf with its cells.
struct Own {
    points: u64,
    moments: Moments,
    cells: Cells,
    below: RecordsByLevel,
}

/// A node whose children are not yet complete.
struct OpenNode {
    node: Node,
    moments: Moments,
    /// The records of its children.
    siblings: Vec<u8>,
    child_mask: u8,
    /// Of a leaf, how many cells are below it.
    cells: u8,
    /// Of the records below a leaf.
    first_child: u32,
    /// How many of its children have been opened.
    children: u32,
}

impl Maker<'_> {
    /// Makes all records.
    pub(super) fn run(&self, sink: &mut dyn RecordSink) -> Result<(), AggregateError> {
        let mut tree = Tree { maker: self, open: Vec::new(), counts: [0; LEVELS], sink };
        let mut pages = self.pages(self.client);
        let mut order = FileOrder::default();
        let mut walk = Walk::new();
        walk.begin(&mut pages, &mut order)?;
        loop {
            walk.go_on(&mut pages, &mut order)?;
            let batch = std::mem::take(&mut order.batch);
            if batch.is_empty() {
                break;
            }
            let work = |index: usize| self.own(&batch[index]);
            ordered(batch.len(), self.threads, work, |index, own| tree.add(batch[index], own))?;
        }
        tree.finish()
    }

    fn pages<'t>(&'t self, client: &'t PageClient) -> CloudPages<'t> {
        CloudPages { cloud: self.cloud, client, object: self.object }
    }

    /// The moments of a node's own points, and the records of a leaf's cells.
    fn own(&self, node: &Node) -> Result<Own, AggregateError> {
        let AggregateOptions { kernel, normalised, few_points, .. } = *self.options;
        let client = self.client.for_thread();
        let normalisation = normalised.then(|| 1.0 / kernel.integral());
        let decoder = Decoder::new(self.cloud.header(), normalisation);
        let field = Field { pages: self.pages(&client), decoder: &decoder, kernel };
        let unit = UnitPlaces::new(kernel);
        // Those that are not divided any more may have any number of points.
        let divides = node.child_mask == 0 && node.points <= TOGETHER as u64;
        let mut all = Own {
            points: 0,
            moments: Moments::none(&self.records.carried),
            cells: Cells::default(),
            below: RecordsByLevel::default(),
        };
        let mut points = Points::default();
        let mut measured = Measured::of(node);
        let mut near = self.lock_near().pop().unwrap_or_default();
        let mut own = |points: &mut Points| -> Result<(), AggregateError> {
            let half_octaves = measured.half_octaves((&field, &mut near), &unit, points)?;
            let densities = masses(points, &half_octaves);
            let own = OwnPoints {
                points,
                half_octaves: &half_octaves,
                densities: &densities,
                variance: kernel.variance(),
                few: few_points as usize,
                maker: &self.records,
            };
            let moments = if divides {
                let (moments, cells, below) = own.divide(node.level.into());
                (all.cells, all.below) = (cells, below);
                moments
            } else {
                own.whole(node.level.into())
            };
            all.moments.merge(&moments);
            all.points += points.len() as u64;
            points.clear();
            Ok(())
        };
        field.pages.each_own_run(node, |page, index| {
            if points.len() + page.head(index).len() > TOGETHER {
                own(&mut points)?;
            }
            decoder.append(&page.run(index), &mut points);
            Ok(())
        })?;
        if points.len() > 0 {
            own(&mut points)?;
        }
        self.lock_near().push(near);
        Ok(all)
    }

    fn lock_near(&self) -> MutexGuard<'_, Vec<NearPoints>> {
        self.near.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The points of a node in which densities are measured: all, or one in so many if the node has
/// very many of its own, so that the work does not grow as their square.
struct Measured {
    every: usize,
    /// How many points were passed, and what was found in the last that was measured.
    passed: usize,
    last: [Option<i32>; PLACES],
    /// Of how many places one is measured, if very many points reach them.
    alike: usize,
}

impl Measured {
    fn of(node: &Node) -> Self {
        let most = u64::from(node.own.runs).saturating_mul(RUN_POINTS as u64);
        let every = if most <= MOST_ALL_MEASURED {
            1
        } else {
            (most.saturating_mul(most) / MOST_PAIRS).clamp(1, most / LEAST_MEASURED)
        };
        let alike = if node.child_mask == 0 && every == 1 { PLACES * ALIKE_POINTS } else { PLACES };
        let every = usize::try_from(every).unwrap_or(usize::MAX);
        Self { every, passed: 0, last: [None; PLACES], alike }
    }

    /// The half octaves of the densities at the places in the next points; of those that are not
    /// measured, as in the one before them.
    fn half_octaves(
        &mut self,
        (field, near): (&Field<'_>, &mut NearPoints),
        unit: &UnitPlaces,
        points: &Points,
    ) -> Result<Vec<Option<i32>>, AggregateError> {
        let is_measured = |index: usize| (self.passed + index).is_multiple_of(self.every);
        let mut places = Vec::with_capacity(PLACES * points.len());
        let chosen = (0..points.len()).filter(|&index| is_measured(index));
        chosen.for_each(|index| unit.append(points, index, &mut places));
        let mut densities = vec![0.0; places.len()];
        field.densities(&places, self.alike, near, &mut densities)?;
        let mut found = densities.chunks_exact(PLACES);
        let mut half_octaves = Vec::with_capacity(PLACES * points.len());
        for index in 0..points.len() {
            if is_measured(index)
                && let Some(densities) = found.next()
            {
                self.last = std::array::from_fn(|place| half_octave(densities[place]));
            }
            half_octaves.extend(self.last);
        }
        self.passed += points.len();
        Ok(half_octaves)
    }
}

/// The masses of points by density.
fn masses(points: &Points, half_octaves: &[Option<i32>]) -> Masses {
    let mut masses = Masses::default();
    for (index, half_octaves) in half_octaves.chunks_exact(PLACES).enumerate() {
        half_octaves.iter().flatten().for_each(|&at| masses.add(at, points.mass(index)));
    }
    masses
}

/// Nodes in the order of the file, a batch at a time.
#[derive(Default)]
struct FileOrder {
    /// The next is the last.
    waiting: Vec<Node>,
    /// Where the children of the node that was opened last begin.
    met: usize,
    batch: Vec<Node>,
}

impl<'a> Visitor<CloudPages<'a>> for FileOrder {
    fn meet(&mut self, node: Node) {
        self.waiting.push(node);
    }

    fn next(&mut self) -> Option<Node> {
        // The first of the children that were met comes first.
        self.waiting[self.met..].reverse();
        self.met = self.waiting.len();
        if self.batch.len() == BATCH_NODES {
            return None;
        }
        let next = self.waiting.pop();
        self.met = self.waiting.len();
        next
    }

    fn visit(
        &mut self,
        node: &Node,
        walk: &mut Walk,
        pages: &mut CloudPages<'a>,
    ) -> Result<Visit, AggregateError> {
        if !walk.may_look_at_runs_of(node, pages.cloud.header()) {
            return Err(pages.broken(node.own.first_page));
        }
        self.batch.push(*node);
        Ok(Visit::Open)
    }
}

/// The nodes as they are completed.
struct Tree<'a> {
    maker: &'a Maker<'a>,
    /// From the root down.
    open: Vec<OpenNode>,
    /// Records of each level so far.
    counts: [u32; LEVELS],
    sink: &'a mut dyn RecordSink,
}

impl Tree<'_> {
    /// Adds the next node, in the order of the file.
    fn add(&mut self, node: Node, own: Own) -> Result<(), AggregateError> {
        if self.maker.client.cancel_token().is_cancelled() {
            return Err(AggregateError::Cancelled);
        }
        while self.open.last().is_some_and(|open| open.node.level >= node.level) {
            self.close()?;
        }
        let Own { points, moments, cells, below } = own;
        let mut first_child = 0;
        let record_bytes = self.maker.records.record_bytes();
        for (depth, mut records) in below.levels.into_iter().enumerate() {
            let level = usize::from(node.level) + 1 + depth;
            // Those of the next level are not there yet.
            let next = self.counts.get(level + 1).copied().unwrap_or(0);
            move_children(&mut records, record_bytes, next);
            let first = self.append(level, records)?;
            if depth == 0 {
                first_child = first;
            }
        }
        (self.maker.progress)(points);
        let (siblings, child_mask, cells) = (Vec::new(), 0, cells.count);
        self.open.push(OpenNode { node, moments, siblings, child_mask, cells, first_child, children: 0 });
        Ok(())
    }

    /// Completes the last of the open nodes.
    fn close(&mut self) -> Result<(), AggregateError> {
        let Some(mut done) = self.open.pop() else { return Ok(()) };
        let level = usize::from(done.node.level);
        if !done.siblings.is_empty() {
            done.first_child = self.append(level + 1, std::mem::take(&mut done.siblings))?;
        }
        let mut record = Vec::new();
        if let Some(mut aggregate) = done.moments.aggregate(&Masses::default()) {
            (aggregate.child_mask, aggregate.first_child) = (done.child_mask, done.first_child);
            aggregate.cells = done.cells;
            self.maker.records.encode(&aggregate, &done.moments, level as u32, &mut record);
        }
        match self.open.last_mut() {
            Some(parent) => {
                let rank = nth_bit(parent.node.child_mask, parent.children);
                parent.children += 1;
                if !record.is_empty() {
                    parent.child_mask |= rank;
                    parent.siblings.extend(record);
                }
                parent.moments.merge(&done.moments);
                Ok(())
            }
            None => self.append(level, record).map(|_| ()),
        }
    }

    /// Adds records to a level; returns the number of the first.
    fn append(&mut self, level: usize, records: Vec<u8>) -> Result<u32, AggregateError> {
        let first = self.counts[level];
        let more = (records.len() / self.maker.records.record_bytes()) as u32;
        let too_many = || AggregateError::too_many(self.maker.cloud.path());
        self.counts[level] = first.checked_add(more).ok_or_else(too_many)?;
        self.sink.append(level, first, records)?;
        Ok(first)
    }

    fn finish(mut self) -> Result<(), AggregateError> {
        while !self.open.is_empty() {
            self.close()?;
        }
        Ok(())
    }
}

/// The bit of a mask that has so many below it.
fn nth_bit(mask: u8, below: u32) -> u8 {
    (0..8).map(|bit| 1 << bit).filter(|bit| mask & bit != 0).nth(below as usize).unwrap_or(0)
}

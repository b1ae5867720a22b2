//! How the octree is divided among the parts: from exact counts, which all parts have alike.
//!
//! The buckets of the plan that a local build would follow are dealt out, consecutive ones to each
//! part. So no leaf and no own list of a node is in two parts, and a part is as much work as the
//! same buckets in a local build.

use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};

use super::super::error::BuildError;
use super::super::partition::capacity;
use super::super::plan::{Cell, LEAF_POINTS, Plan, Pyramid};
use super::super::survey::Settled;
use super::exchange::Part;
use super::job::Job;
use super::step::BuildStep;

/// Buckets of a part, at least, if there are points enough: so that parts are about equal.
const BUCKETS_PER_PART: u64 = 8;
/// Largest number of buckets that are wanted for the sake of equal parts.
const MOST_BUCKETS: u64 = 2048;

/// The plan, and the buckets of each part.
pub(super) struct Division {
    pub(super) plan: Plan,
    pub(super) ranges: Vec<Range<usize>>,
}

/// An empty pyramid, the same for all parts.
pub(super) fn pyramid(job: &Job<'_>) -> Pyramid {
    Pyramid::new(Cell::ROOT, job.overview.survey.count, job.overview.memory_bytes / 8)
}

/// What was counted: records, the sum of their hashes, the range of their radii where these were
/// measured, and that of their weights where copies were merged.
#[derive(Clone, Copy, Debug)]
pub(super) struct Counted {
    pub(super) count: u64,
    pub(super) sum: u64,
    /// Radii and shapes, if they were settled in this step.
    pub(super) settled: Settled,
    pub(super) weight_range: (f32, f32),
}

/// Numbers of a [`Counted`] before the counters.
const FRONT: usize = 7;

impl Counted {
    /// The payload of a part that has counted.
    pub(super) fn encode(&self, pyramid: &Pyramid) -> Vec<u8> {
        let (radius, weight) = (self.settled.radius_range, self.weight_range);
        let ranges = [radius.0, radius.1, weight.0, weight.1].map(|v| v.to_bits().into());
        let shapes = u64::from(self.settled.has_shapes);
        let counters = pyramid.counters().map(|counter| counter.load(Ordering::Relaxed));
        encode([self.count, self.sum, shapes].into_iter().chain(ranges).chain(counters))
    }

    pub(super) fn of(part: &Part) -> Result<Self, BuildError> {
        let numbers = numbers(part, None)?;
        let Some((&[count, sum, shapes, ref ranges @ ..], _)) = numbers.split_first_chunk::<FRONT>() else {
            return Err(part.wrong("it has no counts"));
        };
        let [a, b, c, d] = [0, 1, 2, 3].map(|i| f32::from_bits(ranges[i] as u32));
        let settled = Settled { radius_range: (a, b), has_shapes: shapes != 0 };
        Ok(Self { count, sum, settled, weight_range: (c, d) })
    }
}

/// Numbers as a payload.
pub(super) fn encode(numbers: impl IntoIterator<Item = u64>) -> Vec<u8> {
    numbers.into_iter().flat_map(u64::to_le_bytes).collect()
}

/// The numbers of a payload, of which there must be `count` if that is known.
pub(super) fn numbers(part: &Part, count: Option<usize>) -> Result<Vec<u64>, BuildError> {
    let bytes = part.payload.len();
    if count.is_some_and(|count| bytes != 8 * count) || !bytes.is_multiple_of(8) {
        return Err(part.wrong(format!("it has {bytes} bytes of numbers, which are not those of this build")));
    }
    let number = |bytes: &[u8]| u64::from_le_bytes(std::array::from_fn(|i| bytes[i]));
    Ok(part.payload.chunks_exact(8).map(number).collect())
}

/// The counters of a part that has counted.
fn counters(part: &Part, cells: usize) -> Result<Vec<u64>, BuildError> {
    Ok(numbers(part, Some(FRONT + cells))?.split_off(FRONT))
}

impl Division {
    /// Divides the octree by the counts of all parts of `step`, which must be `count` records of
    /// `stride` bytes.
    pub(super) fn load(
        job: &Job<'_>,
        step: BuildStep,
        (count, stride): (u64, usize),
    ) -> Result<Self, BuildError> {
        let pyramid = pyramid(job);
        let cells = pyramid.counters().count();
        let mut counted = 0;
        job.all(step, |part| {
            let numbers = counters(&part, cells)?;
            counted += numbers.iter().sum::<u64>();
            let add = |(counter, number): (&AtomicU64, u64)| counter.fetch_add(number, Ordering::Relaxed);
            pyramid.counters().zip(numbers).map(add).for_each(drop);
            Ok(())
        })?;
        if counted != count {
            let what =
                format!("the parts of `{step}` have counted {counted} points, where there are {count}");
            return Err(BuildError::Part { path: job.exchange.folder.clone(), what });
        }
        let parts = job.exchange.parts;
        let even = (count / (BUCKETS_PER_PART * u64::from(parts))).max(count / MOST_BUCKETS).max(LEAF_POINTS);
        let plan =
            Plan::new(pyramid, capacity(job.overview.memory_bytes, job.overview.threads, stride).min(even));
        let ranges = deal(&plan, count, parts);
        Ok(Self { plan, ranges })
    }

    /// The number of points that a part of `step` has counted in each bucket.
    pub(super) fn counts(&self, part: &Part) -> Result<Vec<u64>, BuildError> {
        let cells = self.plan.pyramid.counters().count();
        Ok(self.plan.counts_by_bucket(&counters(part, cells)?))
    }
}

/// Deals out the buckets, so that each part has about the same number of points.
fn deal(plan: &Plan, count: u64, parts: u32) -> Vec<Range<usize>> {
    let (mut ranges, mut before, mut next) = (Vec::new(), 0, 0);
    for part in 1..=parts {
        let bound = (u128::from(count) * u128::from(part)).div_ceil(u128::from(parts)) as u64;
        let first = next;
        // A bucket belongs to the part in which its middle lies.
        while plan.buckets.get(next).is_some_and(|bucket| before + bucket.count / 2 < bound) {
            before += plan.buckets[next].count;
            next += 1;
        }
        ranges.push(first..next);
    }
    ranges
}

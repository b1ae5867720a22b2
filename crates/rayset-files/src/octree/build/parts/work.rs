//! Counting, scattering and ordering of the records of parts.

use std::fs::File;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};

use super::super::context::Context;
use super::super::control::Stage;
use super::super::error::BuildError;
use super::super::partition::{Partition, firsts};
use super::super::pieces::{Assemble, Pack};
use super::super::record::KeyMaker;
use super::super::region::Region;
use super::super::survey::{NO_RANGE, Settled};
use super::divide::{self, Counted, Division};
use super::exchange::{DataFile, Part};
use super::job::Job;
use super::step::BuildStep;
use rayset_store::container::record_hash;
use rayset_store::spill::{Joined, Spill};

/// An order of records, by which they are counted, divided among the parts, and sorted.
pub(super) struct Sorting {
    pub(super) keys: KeyMaker,
    /// Number of records, and the size of one in bytes.
    pub(super) records: u64,
    pub(super) stride: usize,
    pub(super) stage: Stage,
    /// The steps that count and scatter.
    pub(super) count: BuildStep,
    pub(super) scatter: BuildStep,
}

impl Sorting {
    fn partition<'a>(&self, context: &'a Context<'a>, records: u64) -> Partition<'a> {
        Partition::new(context, self.stride, self.keys, records, self.stage)
    }
}

/// The records of a part.
pub(super) struct Records {
    pub(super) spill: Spill,
    pub(super) count: u64,
    /// The sum of their hashes.
    pub(super) sum: u64,
}

impl Records {
    /// The records in the data of a part.
    pub(super) fn of(
        job: &Job<'_>,
        part: &Part,
        (count, sum): (u64, u64),
        stride: usize,
    ) -> Result<Self, BuildError> {
        let mut spill = Joined::new(vec![job.exchange.open_data(part)?]);
        let bytes = count.saturating_mul(stride as u64);
        if part.head.data_bytes != Some(bytes) {
            return Err(part.wrong(format!("it counts {count} records, which its data are not")));
        }
        spill.push(0, 0, bytes);
        Ok(Self { spill: Spill::Joined(spill), count, sum })
    }
}

/// Counts the records of a part; returns its payload.
pub(super) fn count(
    job: &Job<'_>,
    context: &Context<'_>,
    sorting: &Sorting,
    records: &Records,
) -> Result<Vec<u8>, BuildError> {
    let pyramid = divide::pyramid(job);
    sorting.partition(context, records.count).count(Region::all(&records.spill, records.count), &pyramid)?;
    let (count, sum) = (records.count, records.sum);
    Ok(Counted { count, sum, settled: Settled::NONE, weight_range: NO_RANGE }.encode(&pyramid))
}

/// Writes the records of a part, bucket by bucket, to `data`; returns its payload, the count and
/// sum of each bucket, and the size of the data.
pub(super) fn scatter(
    job: &Job<'_>,
    context: &Context<'_>,
    sorting: &Sorting,
    records: &Records,
    data: &DataFile,
) -> Result<(Vec<u8>, u64), BuildError> {
    let division = Division::load(job, sorting.count, (sorting.records, sorting.stride))?;
    let counted = job.own(sorting.count)?;
    let counts = division.counts(&counted)?;
    if counts.iter().sum::<u64>() != records.count {
        return Err(counted.wrong("it was made of other records; run that step again"));
    }
    let sums: Vec<AtomicU64> = counts.iter().map(|_| 0.into()).collect();
    let partition = sorting.partition(context, records.count);
    let bucket_of = |record: &[u8]| division.plan.bucket(&sorting.keys, record) as usize;
    let done = AtomicU64::new(0);
    let region = Region::all(&records.spill, records.count);
    partition.scatter_into(region, &firsts(&counts), bucket_of, |bucket, bytes, at| {
        let hashes = bytes.chunks_exact(sorting.stride).map(record_hash);
        sums[bucket].fetch_add(hashes.fold(0, u64::wrapping_add), Ordering::Relaxed);
        data.write_at(bytes, at)?;
        let more = (bytes.len() / sorting.stride) as u64;
        let done = done.fetch_add(more, Ordering::Relaxed) + more;
        context.progress(sorting.stage, done, records.count);
        Ok(())
    })?;
    let sums: Vec<u64> = sums.into_iter().map(AtomicU64::into_inner).collect();
    if sums.iter().fold(0, |all: u64, sum| all.wrapping_add(*sum)) != records.sum {
        let what = "the records that this step reads are damaged: begin again in another folder".to_owned();
        return Err(BuildError::Part { path: job.exchange.folder.clone(), what });
    }
    let payload = divide::encode(counts.iter().zip(&sums).flat_map(|(&count, &sum)| [count, sum]));
    Ok((payload, records.count * sorting.stride as u64))
}

/// The records of a part's buckets, from all parts.
struct Gathered {
    spill: Spill,
    /// The first record of each bucket, their number, and the sums of the hashes of each bucket.
    firsts: Vec<u64>,
    count: u64,
    sums: Vec<u64>,
}

/// What a part has scattered to some buckets: the byte of its data at which they begin, and their
/// counts.
struct Scattered {
    start: u64,
    counts: Vec<u64>,
}

impl Gathered {
    fn load(
        job: &Job<'_>,
        sorting: &Sorting,
        division: &Division,
        buckets: &Range<usize>,
    ) -> Result<Self, BuildError> {
        let stride = sorting.stride as u64;
        let (mut files, mut parts): (Vec<File>, Vec<Scattered>) = (Vec::new(), Vec::new());
        let mut sums = vec![0_u64; buckets.len()];
        job.all(sorting.scatter, |part| {
            let numbers = divide::numbers(&part, Some(2 * division.plan.buckets.len()))?;
            let count = |bucket: usize| numbers[2 * bucket];
            let start = (0..buckets.start).map(count).fold(0, u64::wrapping_add).wrapping_mul(stride);
            let counts: Vec<u64> = buckets.clone().map(count).collect();
            for (sum, bucket) in sums.iter_mut().zip(buckets.clone()) {
                *sum = sum.wrapping_add(numbers[2 * bucket + 1]);
            }
            if counts.iter().any(|&count| count > 0) {
                files.push(job.exchange.open_data(&part)?);
                parts.push(Scattered { start, counts });
            }
            Ok(())
        })?;
        let mut spill = Joined::new(files);
        let mut counts = vec![0; buckets.len()];
        for bucket in 0..buckets.len() {
            for (file, part) in parts.iter_mut().enumerate() {
                let bytes = part.counts[bucket].saturating_mul(stride);
                spill.push(file, part.start, bytes);
                part.start = part.start.saturating_add(bytes);
                counts[bucket] += part.counts[bucket];
            }
        }
        let planned = division.plan.buckets[buckets.clone()].iter().map(|bucket| bucket.count);
        if !planned.eq(counts.iter().copied()) {
            let what =
                format!("the parts of `{}` do not have what was counted: run it again", sorting.scatter);
            return Err(BuildError::Part { path: job.exchange.folder.clone(), what });
        }
        let count = counts.iter().sum();
        Ok(Self { spill: Spill::Joined(spill), firsts: firsts(&counts), count, sums })
    }
}

/// Sorts the records of a part's buckets, from all parts, and passes them through `pack` to `out`.
pub(super) fn order<P: Pack>(
    job: &Job<'_>,
    context: &Context<'_>,
    sorting: &Sorting,
    pack: &P,
    out: &mut impl Assemble<P::Piece>,
) -> Result<(), BuildError> {
    let division = Division::load(job, sorting.count, (sorting.records, sorting.stride))?;
    let buckets = division.ranges[job.part as usize - 1].clone();
    let gathered = Gathered::load(job, sorting, &division, &buckets)?;
    let partition = sorting.partition(context, gathered.count);
    let check = |bucket: usize, sum: u64| {
        if sum == gathered.sums[bucket - buckets.start] {
            return Ok(());
        }
        let what =
            format!("the data of a part of `{}` are damaged: begin again in another folder", sorting.scatter);
        Err(BuildError::Part { path: job.exchange.folder.clone(), what })
    };
    // Buckets that do not fit in memory are passed over more than once, and checked before.
    for bucket in buckets.clone() {
        let count = division.plan.buckets[bucket].count;
        if count > partition.cap() {
            let region = Region::of(&gathered.spill, gathered.firsts[bucket - buckets.start], count);
            check(bucket, partition.sum(region, record_hash)?)?;
        }
    }
    let check = |bucket: usize, bytes: &[u8]| {
        check(bucket, bytes.chunks_exact(sorting.stride).map(record_hash).fold(0, u64::wrapping_add))
    };
    let source = (&gathered.spill, gathered.firsts.as_slice());
    partition.follow(&division.plan, buckets.clone(), source, check, pack, out)
}

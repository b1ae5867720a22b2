//! What each part reads of the input.

use super::super::ingest::Stretch;
use crate::points::PointSource;
use rayset_store::storage::input_file::{self, Named};

/// Bytes of a record of a source that does not say how many it has, for an estimate of its size.
const TYPICAL_BYTES: u64 = 32;

/// The share of part `part` of `parts`, from 1, of the records of all sources: consecutive records
/// of those that can be entered in the middle, and others as a whole. The shares of all parts have
/// every record once.
///
/// Depends on nothing but what the sources say of themselves, so all parts divide them alike. Where
/// a source has more records than it says, the part that has the last of those which it says reads
/// them, too.
pub(super) fn share(sources: Vec<Box<dyn PointSource + '_>>, part: u32, parts: u32) -> Vec<Stretch<'_>> {
    let sizes: Vec<u64> = sources.iter().map(|source| size(&**source)).collect();
    let total: u128 = sizes.iter().map(|&size| u128::from(size)).sum();
    let bound = |part: u32| total * u128::from(part) / u128::from(parts);
    let (from, to) = (bound(part - 1), bound(part));
    let mut stretches = Vec::new();
    let mut start = 0;
    for ((input, source), size) in sources.into_iter().enumerate().zip(sizes) {
        let end = start + u128::from(size);
        if source.can_skip() && source.count_hint().is_some() {
            let (first, last) = (from.max(start), to.min(end));
            if first < last {
                let end = (last < end).then(|| (last - start) as u64);
                stretches.push(Stretch { input, source, first: (first - start) as u64, end });
            }
        } else if (from..to).contains(&(start + u128::from(size - 1) / 2)) {
            stretches.push(Stretch::whole((input, source)));
        }
        start = end;
    }
    stretches
}

/// The number of records that a source says it has, at least 1, or a guess.
fn size(source: &dyn PointSource) -> u64 {
    let guess = || match source.path().map(input_file::look) {
        Some(Ok(Named::File(bytes))) => bytes / TYPICAL_BYTES,
        _ => 1,
    };
    source.count_hint().unwrap_or_else(guess).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::{ArraySource, ColumnInfo, PointBatch, ReadError, Schema};

    /// A source that is read from its start to its end.
    struct Whole(ArraySource);

    impl PointSource for Whole {
        fn schema(&self) -> &Schema {
            self.0.schema()
        }
        fn count_hint(&self) -> Option<u64> {
            self.0.count_hint()
        }
        fn select(&mut self, columns: &[usize]) {
            self.0.select(columns);
        }
        fn fill(&mut self, batch: &mut PointBatch, limit: usize) -> Result<(), ReadError> {
            self.0.fill(batch, limit)
        }
    }

    #[test]
    fn shares_have_every_record_once_and_sources_that_cannot_be_entered_as_a_whole() {
        let counts = [10_u64, 0, 7, 1000, 3];
        for parts in [1, 2, 7, 40] {
            let mut seen = counts.map(|count| vec![0; count as usize]);
            for part in 1..=parts {
                let sources = counts.iter().enumerate().map(|(i, &count)| {
                    let array =
                        ArraySource::typed(vec![[0.0; 3]; count as usize], Vec::<(ColumnInfo, _)>::new());
                    let source: Box<dyn PointSource> =
                        if i == 2 { Box::new(Whole(array)) } else { Box::new(array) };
                    source
                });
                for stretch in share(sources.collect(), part, parts) {
                    let whole = (0, None);
                    assert!(stretch.input != 2 || (stretch.first, stretch.end) == whole);
                    let end = stretch.end.unwrap_or(counts[stretch.input]);
                    let records = &mut seen[stretch.input][stretch.first as usize..end as usize];
                    records.iter_mut().for_each(|times| *times += 1);
                }
            }
            assert!(seen.iter().flatten().all(|&times| times == 1), "{parts} parts");
        }
    }
}

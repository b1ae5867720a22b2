//! The records of all levels, as long as they are not in their file.

use super::error::AggregateError;
use super::header::{AggregateHeader, LEVELS};
use super::options::AggregateOptions;
use super::records::RecordSink;
use rayset_store::spill::Spill;

/// Bytes of records of a level that are kept before they are stored.
const KEPT_BYTES: usize = 64 << 10;

/// Records of all levels.
pub(super) struct StoredRecords {
    levels: Vec<LevelRecords>,
    pub(super) record_bytes: usize,
}

impl RecordSink for StoredRecords {
    fn append(&mut self, level: usize, _: u32, records: Vec<u8>) -> Result<(), AggregateError> {
        let level = &mut self.levels[level];
        level.kept.extend_from_slice(&records);
        if level.kept.len() >= KEPT_BYTES {
            let failed = AggregateError::temporary("write temporary files");
            level.spill.write_at(&level.kept, level.stored).map_err(failed)?;
            level.stored += level.kept.len() as u64;
            level.kept.clear();
        }
        Ok(())
    }
}

/// The records of a level, as they are made.
struct LevelRecords {
    spill: Spill,
    kept: Vec<u8>,
    stored: u64,
}

impl LevelRecords {
    fn new(spill: Spill) -> Self {
        Self { spill, kept: Vec::new(), stored: 0 }
    }
}

impl StoredRecords {
    /// None yet; `spill` makes a place for those of a level.
    pub(super) fn new(
        record_bytes: usize,
        mut spill: impl FnMut() -> Result<Spill, AggregateError>,
    ) -> Result<Self, AggregateError> {
        let levels: Result<Vec<_>, _> = (0..LEVELS).map(|_| spill().map(LevelRecords::new)).collect();
        Ok(Self { levels: levels?, record_bytes })
    }

    /// Whether there are no records.
    pub(super) fn is_empty(&self) -> bool {
        (0..LEVELS).all(|level| self.count(level) == 0)
    }

    /// Number of records of a level.
    pub(super) fn count(&self, level: usize) -> u64 {
        self.levels
            .get(level)
            .map_or(0, |level| (level.stored + level.kept.len() as u64) / self.record_bytes as u64)
    }

    /// Reads records of a level, from one on.
    pub(super) fn read(&self, level: usize, from: u64, records: &mut [u8]) -> Result<(), AggregateError> {
        let LevelRecords { spill, kept, stored } = &self.levels[level];
        let at = from * self.record_bytes as u64;
        let (in_spill, in_memory) =
            records.split_at_mut((stored.saturating_sub(at) as usize).min(records.len()));
        if !in_spill.is_empty() {
            spill.read_at(in_spill, at).map_err(AggregateError::temporary("read temporary files"))?;
        }
        let first = (at + in_spill.len() as u64 - stored.min(&(at + in_spill.len() as u64))) as usize;
        in_memory.copy_from_slice(&kept[first..first + in_memory.len()]);
        Ok(())
    }

    /// The numbers of the first records of all levels, and that of all; `None` if there are too
    /// many.
    pub(super) fn first_of_level(&self) -> Option<[u32; LEVELS + 1]> {
        let mut first = [0; LEVELS + 1];
        for level in 0..LEVELS {
            let next = u64::from(first[level]) + self.count(level);
            first[level + 1] = u32::try_from(next).ok()?;
        }
        Some(first)
    }

    /// The header, without its pages and the hash.
    pub(super) fn header(&self, options: &AggregateOptions) -> Option<AggregateHeader> {
        Some(AggregateHeader {
            pages: 0,
            record_bytes: self.record_bytes as u32,
            kernel: options.kernel,
            normalised: options.normalised,
            few_points: options.few_points,
            first_of_level: self.first_of_level()?,
            digest: [0; 16],
        })
    }
}

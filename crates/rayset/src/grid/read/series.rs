//! Series of volumes in one file: which of them is read, and volumes whose voxels are interleaved.

use std::io::{self, Read};
use std::path::Path;

use super::error::ReadError;

/// The volumes of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Series {
    /// At least one.
    pub(super) volumes: u64,
    /// The one that is read, from 0.
    pub(super) index: u64,
}

impl Series {
    /// The volume that is asked for of `volumes`, otherwise the first.
    ///
    /// # Errors
    /// If there are fewer.
    pub(super) fn new(path: &Path, volumes: u64, index: Option<u64>) -> Result<Self, ReadError> {
        let (volumes, index) = (volumes.max(1), index.unwrap_or(0));
        if index < volumes {
            return Ok(Self { volumes, index });
        }
        let there = match volumes {
            1 => "the file has one volume, of index 0".to_owned(),
            _ => format!("the file has {volumes} volumes, of indices 0 to {}", volumes - 1),
        };
        Err(ReadError::Format { path: path.to_owned(), what: format!("--volume-index {index}: {there}") })
    }

    /// What to say of a series; `None` if there is nothing to choose.
    pub(super) fn about(self) -> Option<String> {
        let Self { volumes, index } = self;
        (volumes > 1).then(|| {
            format!(
                "volume {index} of a series of {volumes} is read; --volume-index names another, from 0 to {}",
                volumes - 1
            )
        })
    }
}

/// The voxels of one volume of a series whose volumes are interleaved, voxel by voxel; behind its last voxel, all that
/// follows.
pub(super) struct Interleaved<R> {
    data: R,
    series: Series,
    /// Bytes of a voxel.
    width: usize,
    /// Voxels still to come.
    left: u64,
    /// Voxels that were read, and the part that was not yet delivered.
    voxels: Vec<u8>,
    at: usize,
}

/// Records that are read at a time.
const RECORDS: usize = 1024;

impl<R: Read> Interleaved<R> {
    pub(super) fn new(data: R, series: Series, width: usize, voxels: u64) -> Self {
        Self { data, series, width, left: voxels, voxels: Vec::new(), at: 0 }
    }

    fn refill(&mut self) -> io::Result<()> {
        let record = self.series.volumes as usize * self.width;
        let records =
            (RECORDS.min((1 << 20) / record)).max(1).min(usize::try_from(self.left).unwrap_or(RECORDS));
        let mut all = vec![0; records * record];
        self.data.read_exact(&mut all)?;
        let from = self.series.index as usize * self.width;
        self.voxels.clear();
        all.chunks_exact(record).for_each(|one| self.voxels.extend_from_slice(&one[from..from + self.width]));
        (self.at, self.left) = (0, self.left - records as u64);
        Ok(())
    }
}

impl<R: Read> Read for Interleaved<R> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        if self.at == self.voxels.len() {
            if self.left == 0 {
                return self.data.read(out);
            }
            self.refill()?;
        }
        let now = out.len().min(self.voxels.len() - self.at);
        out[..now].copy_from_slice(&self.voxels[self.at..self.at + now]);
        self.at += now;
        Ok(now)
    }
}

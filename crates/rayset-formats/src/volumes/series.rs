//! Series of volumes in one file: which of them is read, and volumes whose voxels are interleaved.

use std::io::{self, Read};
use std::path::Path;

use super::data::io_error;
use rayset_files::grid::{VolumeError, VolumeSource, Voxels};

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
    pub(super) fn new(path: &Path, volumes: u64, index: Option<u64>) -> Result<Self, VolumeError> {
        let (volumes, index) = (volumes.max(1), index.unwrap_or(0));
        if index < volumes {
            return Ok(Self { volumes, index });
        }
        let there = match volumes {
            1 => "the file has one volume, of index 0".to_owned(),
            _ => format!("the file has {volumes} volumes, of indices 0 to {}", volumes - 1),
        };
        Err(VolumeError::Format { path: path.to_owned(), what: format!("--volume-index {index}: {there}") })
    }

    /// The bytes of all volumes, of `bytes` each; `None` if no file has so many.
    pub(super) fn bytes(self, bytes: u64) -> Option<u64> {
        bytes.checked_mul(self.volumes)
    }

    /// Of `voxels`, those of all volumes one after another, those of the one that is read. `bytes`
    /// are those of a volume.
    pub(super) fn in_sequence(self, voxels: Voxels, bytes: u64) -> Result<Voxels, VolumeError> {
        let Voxels { path, mut data, rest } = voxels;
        let before = bytes * self.index;
        let passed = io::copy(&mut (&mut data).take(before), &mut io::sink());
        passed.map_err(io_error(&path))?;
        let behind = (self.volumes - self.index - 1) * bytes;
        Ok(Voxels { path, data, rest: rest.map(|rest| rest + behind) })
    }

    /// Of `voxels`, those of all volumes voxel by voxel, those of the one that is read. `bytes` are
    /// those of a volume, and `width` those of a voxel.
    pub(super) fn interleaved(self, voxels: Voxels, bytes: u64, width: usize) -> Result<Voxels, String> {
        if self.volumes > MOST_INTERLEAVED {
            return Err(format!("a series of more than {MOST_INTERLEAVED} volumes, voxel by voxel"));
        }
        let data = Box::new(Interleaved::new(voxels.data, self, width, bytes / width as u64));
        Ok(Voxels { data, ..voxels })
    }

    /// The same volume, which is the one that is read of this series, and says so.
    pub(super) fn said_by(self, source: VolumeSource) -> VolumeSource {
        match self.about() {
            Some(sentence) => source.with_about(sentence),
            None => source,
        }
    }

    /// What to say of a series; `None` if there is nothing to choose.
    fn about(self) -> Option<String> {
        let Self { volumes, index } = self;
        (volumes > 1).then(|| {
            format!(
                "volume {index} of a series of {volumes} is read; --volume-index names another, from 0 to {}",
                volumes - 1
            )
        })
    }
}

/// Most volumes of a series that are stored voxel by voxel.
const MOST_INTERLEAVED: u64 = 1 << 16;

/// The voxels of one volume of a series whose volumes are interleaved, voxel by voxel; behind its
/// last voxel, all that follows.
struct Interleaved<R> {
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
    fn new(data: R, series: Series, width: usize, voxels: u64) -> Self {
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

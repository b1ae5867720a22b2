//! Operating-system paging for real: the in-core structures in a memory map.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use memmap2::{Advice, Mmap};
use rayset::working_set::PageBuffer;
use rayset::working_set::read::{Read, ReadBackend};

use crate::memory::Flat;

/// What the system is told of accesses to come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Nothing: it reads ahead as it likes.
    Plain,
    /// That they are at random: it reads single pages.
    Random,
}

/// Maps a file.
///
/// # Errors
/// What the system says.
#[expect(unsafe_code, reason = "maps are what this baseline is made of")]
pub fn open(path: &Path, access: Access) -> io::Result<Flat<Mmap>> {
    let file = File::open(path)?;
    // SAFETY: files are written once, before they are mapped, and by this program alone.
    let map = unsafe { Mmap::map(&file)? };
    if access == Access::Random && !map.is_empty() {
        map.advise(Advice::Random)?;
    }
    Ok(Flat(map))
}

/// The working set's pages in a map of their file: what the operating system has of it is the only memory of them.
pub struct MappedBackend(Arc<Mmap>);

impl MappedBackend {
    /// Over one file, from which all pages come.
    ///
    /// # Errors
    /// What the system says.
    pub fn open(path: &Path, access: Access) -> io::Result<Self> {
        Ok(Self(Arc::new(open(path, access)?.0)))
    }
}

impl ReadBackend for MappedBackend {
    fn submit(&self, batch: Vec<Read>) {
        for Read { offset, buffer, done, .. } in batch {
            let from = usize::try_from(offset).unwrap_or(usize::MAX);
            let part = from..from.saturating_add(buffer.bytes().len());
            match PageBuffer::shared(self.0.clone(), part) {
                Some(page) => done(page, Ok(())),
                None => done(buffer, Err(io::ErrorKind::UnexpectedEof.into())),
            }
        }
    }

    fn brings_memory(&self) -> bool {
        true
    }

    fn name(&self) -> String {
        "map".into()
    }
}

/// Drives files out of the page cache, as far as nobody else uses them.
///
/// # Errors
/// What the system says.
pub fn make_cold(paths: &[PathBuf]) -> io::Result<()> {
    for path in paths {
        let file = File::open(path)?;
        file.sync_all()?;
        #[cfg(target_os = "linux")]
        rustix::fs::fadvise(&file, 0, None, rustix::fs::Advice::DontNeed)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use rayset::points::Workload;
    use rayset::trace::predict::NoPredictor;

    use super::*;
    use crate::experiments::Subject;

    #[test]
    fn the_engine_that_ships_makes_the_same_picture_from_a_map_of_its_file() {
        let folder = tempfile::tempdir().expect("a folder");
        let cloud = folder.path().join("c.rset");
        let workload: Workload = "sphere-30k".parse().expect("a workload");
        let subject = Subject::build(workload.source(), workload.radius(), 24, &cloud).expect("a cloud");
        let (picture, _) = subject.shipping().expect("a picture");
        for (access, page_bytes) in [(Access::Plain, 1 << 30), (Access::Random, 96 << 10)] {
            let backend = Arc::new(MappedBackend::open(&cloud, access).expect("a map"));
            let (mapped, _, statistics) =
                subject.shipping_by(page_bytes, backend, Arc::new(NoPredictor)).expect("a picture");
            assert!(mapped == picture, "{access:?}");
            let evictions: u64 = statistics.by_kind.iter().map(|kind| kind.evictions).sum();
            assert_eq!(evictions > 0, page_bytes < 1 << 20);
        }
    }
}

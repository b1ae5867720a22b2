//! Operating-system paging for real: the in-core structures in a memory map.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use memmap2::{Advice, Mmap};
use rayset::working_set::read::MemoryStorage;

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

/// A file in a map, for the engine that ships: it uses pages where they lie, and what the operating
/// system has of the map is the only memory of them.
///
/// # Errors
/// What the system says.
pub fn storage(path: &Path, access: Access) -> io::Result<MemoryStorage> {
    Ok(MemoryStorage::new(Arc::new(open(path, access)?.0)))
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

    use super::*;
    use crate::experiments::Subject;

    #[test]
    fn the_engine_that_ships_makes_the_same_picture_from_a_map_of_its_file() {
        let folder = tempfile::tempdir().expect("a folder");
        let cloud = folder.path().join("c.rset");
        let workload: Workload = "sphere-30k".parse().expect("a workload");
        let subject = Subject::build(workload.source(), workload.radius(), 24, &cloud).expect("a cloud");
        let (picture, _) = subject.shipping().expect("a picture");
        for access in [Access::Plain, Access::Random] {
            let (mapped, _, statistics) = subject.shipping_from_map(access).expect("a picture");
            assert!(mapped == picture, "{access:?}");
            assert_eq!(statistics.peak_bytes, 0, "pages are used where they lie");
        }
    }
}

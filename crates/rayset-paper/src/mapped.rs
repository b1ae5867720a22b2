//! Operating-system paging for real: the in-core structures in a memory map.

use std::fs::File;
use std::io;
use std::path::PathBuf;

use memmap2::{Advice, Mmap};

use crate::index::Index;
use crate::records::Whole;

/// What the system is told of accesses to come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Nothing: it reads ahead as it likes.
    Plain,
    /// That they are at random: it reads single pages.
    Random,
}

/// Nodes, secondary records and points in maps.
pub type Mapped = Whole<Mmap>;

/// Maps the files of an index.
///
/// # Errors
/// What the system says.
#[expect(unsafe_code, reason = "maps are what this baseline is made of")]
pub fn open(index: &Index, access: Access) -> io::Result<Mapped> {
    let map = |path: PathBuf| -> io::Result<Mmap> {
        let file = File::open(path)?;
        // SAFETY: the files of an index are written once, before it is opened, and by this program alone.
        let map = unsafe { Mmap::map(&file)? };
        if access == Access::Random && !map.is_empty() {
            map.advise(Advice::Random)?;
        }
        Ok(map)
    };
    let [nodes, secondary, points] = index.files();
    Ok(Mapped::new([map(nodes)?, map(secondary)?, map(points)?]))
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

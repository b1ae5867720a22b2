//! Operating-system paging for real: the in-core structures in a memory map.

use std::fs::File;
use std::io;
use std::path::PathBuf;

use memmap2::{Advice, Mmap};

use crate::cache::CacheError;
use crate::index::Index;
use crate::record::{
    Below, DIRECT, NODE_BYTES, Node, POINT_BYTES, Point, SECONDARY, direct, secondary, secondary_records,
};
use crate::records::{Hold, Records};

/// What the system is told of accesses to come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Nothing: it reads ahead as it likes.
    Plain,
    /// That they are at random: it reads single pages.
    Random,
}

/// Nodes, secondary records and points in maps.
pub struct Mapped {
    maps: [Mmap; 3],
}

impl Mapped {
    /// Maps the files of an index.
    ///
    /// # Errors
    /// What the system says.
    #[expect(unsafe_code, reason = "maps are what this baseline is made of")]
    pub fn open(index: &Index, access: Access) -> io::Result<Self> {
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
        Ok(Self { maps: [map(nodes)?, map(secondary)?, map(points)?] })
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

fn record(map: &Mmap, number: u64) -> &[u8] {
    let from = number as usize * NODE_BYTES;
    &map[from..from + NODE_BYTES]
}

impl Records for Mapped {
    fn retain(&mut self, number: u64, _priority: u8) -> Result<(Node, Hold), CacheError> {
        Ok((Node::decode(record(&self.maps[0], number)), number as Hold))
    }

    fn release(&mut self, _hold: Hold) {}

    fn list(
        &mut self,
        (leaf, hold): (&Node, Hold),
        _priority: u8,
        out: &mut Vec<u32>,
    ) -> Result<(), CacheError> {
        let Below::Points { count, secondary: first } = leaf.below else { return Ok(()) };
        out.extend(direct(record(&self.maps[0], u64::from(hold)), count));
        let mut left = (count as usize).saturating_sub(DIRECT);
        for number in 0..secondary_records(count) {
            out.extend(secondary(record(&self.maps[1], first + number), left));
            left = left.saturating_sub(SECONDARY);
        }
        Ok(())
    }

    fn point(&mut self, number: u32, _priority: u8) -> Result<Point, CacheError> {
        let from = number as usize * POINT_BYTES;
        Ok(Point::decode(&self.maps[2][from..from + POINT_BYTES]))
    }
}

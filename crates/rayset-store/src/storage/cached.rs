//! Reads of what the system has in memory anyway.

use std::fs::File;
use std::io;

/// Fills `buffer` from a file if the page cache has all of it, without waiting for the disk;
/// returns whether it did. `false` also for files that bypass the page cache.
#[cfg(target_os = "linux")]
pub(super) fn read_if_cached(file: &File, buffer: &mut [u8], offset: u64) -> bool {
    use rustix::io::{ReadWriteFlags, preadv2};
    // Without the page cache, the call would wait for the disk all the same.
    let bypasses = |flags: rustix::fs::OFlags| flags.contains(rustix::fs::OFlags::DIRECT);
    if rustix::fs::fcntl_getfl(file).map_or(true, bypasses) {
        return false;
    }
    let wanted = buffer.len();
    let read = preadv2(file, &mut [io::IoSliceMut::new(buffer)], offset, ReadWriteFlags::NOWAIT);
    read == Ok(wanted)
}

#[cfg(not(target_os = "linux"))]
pub(super) fn read_if_cached(_file: &File, _buffer: &mut [u8], _offset: u64) -> bool {
    false
}

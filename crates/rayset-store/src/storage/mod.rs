//! Sources of the bytes of cloud and grid files, and how they are read: a file on disk, bytes in
//! memory, a remote object, or a user's implementation.
//!
//! Local files share one [`Transport`](transport::Transport), whatever their number: a ring of
//! io_uring, or a pool of threads. A remote object brings its own ([`RemoteStorage`]). None
//! of this can change a picture.

pub mod address;
mod buffer;
mod cached;
mod delayed;
mod file;
pub mod input_file;
pub mod local;
mod memory;
mod pool;
mod remote;
mod shown;
pub mod transport;
#[cfg(target_os = "linux")]
#[expect(
    unsafe_code,
    reason = "requests handed to the kernel point into memory that this module keeps alive"
)]
mod uring;

pub use self::address::{Addresses, open_addresses_with};
pub use self::address::{address_of, beside, look_again, open};
pub use self::buffer::{OVERHEAD_BYTES, PageBuffer};
pub use self::file::FileStorage;
pub use self::input_file::{InputFile, Named, is_file, look};
pub use self::memory::MemoryStorage;
pub use self::remote::{
    RangeError, RangeReader, RangeSink, RemoteCounts, RemoteOptions, RemoteStorage, RequestLimit,
};
pub use self::remote::{copy_of_reading, is_of_reading};
pub use self::shown::{redacted, shown};
pub use self::transport::{BackendKind, Storage};

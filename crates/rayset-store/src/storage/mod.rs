//! Sources of the bytes of cloud and grid files, and how they are read: a file on disk, bytes in
//! memory, an object that is far away, or a user's implementation.
//!
//! Local files share one [`Transport`](transport::Transport), whatever their number: a ring of
//! io_uring, or a pool of threads. An object that is far away brings its own ([`FarStorage`]). None
//! of this can change a picture.

pub mod address;
mod buffer;
mod cached;
mod delayed;
mod far;
mod file;
pub mod input_file;
pub mod local;
mod memory;
mod pool;
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
pub use self::far::{Behaviour, Rate, SimulatedCounts, SimulatedObject};
pub use self::far::{FarCounts, FarOptions, FarStorage, RangeError, RangeReader, RangeSink, RequestLimit};
pub use self::far::{copy_of_reading, is_of_reading};
pub use self::file::FileStorage;
pub use self::input_file::{InputFile, Named, is_file, look};
pub use self::memory::MemoryStorage;
pub use self::shown::{redacted, shown};
pub use self::transport::{BackendKind, Storage};

//! Sources of the bytes of cloud and grid files, and how they are read: a file on disk, bytes in
//! memory, a remote object, or a user's implementation.
//!
//! Local files share one way of reading ([`BackendKind`]), whatever their number. A remote
//! object brings its own ([`RemoteStorage`]). None of this can change a picture.

#[cfg(feature = "internals")]
#[doc(hidden)]
pub use rayset_store::storage::*;
pub use rayset_store::storage::{
    Addresses, BackendKind, FileStorage, MemoryStorage, RangeError, RangeReader, RangeSink, RemoteCounts,
    RemoteOptions, RemoteStorage, RequestLimit, Storage, open_addresses_with,
};
#[doc(hidden)]
pub use rayset_store::storage::{
    InputFile, Named, OVERHEAD_BYTES, PageBuffer, address_of, beside, is_file, local, look, look_again, open,
    redacted, shown, transport,
};

//! Opens `s3://`, `gs://`, `az://` and `https://` for rayset, wherever it takes the path of a
//! cloud, a grid, a scene, points or an output.
//!
//! [`open_addresses`] does it for the whole process. What a protocol needs is done by
//! `object_store`; how many requests are in flight, what is tried again and for how long is decided
//! by [`rayset::storage::RemoteStorage`].
//!
//! An object is pinned when it is opened: by its entity tag, or by its date if the server gives
//! none. If another object takes its place, reads fail; a picture is never made of two.

mod cache;
#[cfg(feature = "stores")]
mod stores;
mod times;

use std::path::PathBuf;

pub use self::cache::{Cache, CacheError};
#[doc(hidden)]
pub use self::times::Times;

/// How remote objects are read by this process.
#[derive(Clone, Debug, Default)]
pub struct Settings {
    /// A folder that keeps what was read, and the most bytes that its files may take. `None` for no
    /// such folder.
    pub cache: Option<(PathBuf, u64)>,
    /// Bytes of the parts of an output that lie in memory while they are sent; one part, of 8 MiB
    /// in objects of up to 75 GB, always does. `None` for 64 MiB.
    pub sending_bytes: Option<u64>,
}

impl Settings {
    /// The cache's size if none is said.
    pub const USUAL_BYTES: u64 = 8 << 30;

    /// What the environment says: `RAYSET_REMOTE_CACHE`, a folder, and `RAYSET_REMOTE_CACHE_SIZE`,
    /// which `size` reads.
    ///
    /// # Errors
    /// What `size` says of a text that is no size.
    pub fn of_environment(size: impl Fn(&str) -> Result<u64, String>) -> Result<Self, String> {
        const SIZE: &str = "RAYSET_REMOTE_CACHE_SIZE";
        let set = |name| std::env::var_os(name).filter(|value| !value.is_empty());
        let bytes = match set(SIZE) {
            Some(text) => {
                size(&text.to_string_lossy()).map_err(|what| format!("the variable {SIZE}: {what}"))?
            }
            None => Self::USUAL_BYTES,
        };
        Ok(Self { cache: set("RAYSET_REMOTE_CACHE").map(|folder| (folder.into(), bytes)), ..Self::default() })
    }
}

/// Opens addresses in this process from now on. Does nothing if that has been said before, or the
/// feature `stores` is not compiled in: addresses are then errors that say so.
///
/// # Errors
/// [`CacheError`] if the folder of the cache cannot be used.
pub fn open_addresses(settings: &Settings) -> Result<(), CacheError> {
    open_addresses_within(settings, Times::default())
}

/// [`open_addresses`] with other times than the usual ones, for tests.
#[doc(hidden)]
pub fn open_addresses_within(settings: &Settings, times: Times) -> Result<(), CacheError> {
    #[cfg(feature = "stores")]
    stores::open_addresses(settings, times)?;
    #[cfg(not(feature = "stores"))]
    let _ = (settings, times);
    Ok(())
}

/// Most requests of this process that are in flight at a time, and bytes that they ask for
/// together.
#[cfg(feature = "stores")]
const IN_FLIGHT: (usize, u64) = (64, 8 << 20);

/// Memory that requests of this process take at most besides the buffers that they fill: 0 if no
/// addresses can be opened.
#[cfg(feature = "stores")]
pub const REQUESTS_BYTES: u64 = {
    /// What a connection takes; measured: 110 to 150 KiB, most of it for what has come and nobody
    /// has taken yet.
    const CONNECTION_BYTES: u64 = 160 << 10;
    /// Code that only addresses need, the threads, the clients; measured: 3 MiB.
    const CLIENT_BYTES: u64 = 4 << 20;
    CLIENT_BYTES + IN_FLIGHT.0 as u64 * CONNECTION_BYTES
};
/// Memory that requests of this process take at most besides the buffers that they fill: 0 if no
/// addresses can be opened.
#[cfg(not(feature = "stores"))]
pub const REQUESTS_BYTES: u64 = 0;

/// Whether addresses can be opened by this program.
#[must_use]
pub const fn is_available() -> bool {
    cfg!(feature = "stores")
}

//! Opens `s3://`, `gs://`, `az://` and `https://` for rayset, wherever it takes the path of a cloud, a grid, a scene, points or
//! an output.
//!
//! [`open_addresses`] does it for the whole process. What a protocol needs is done by `object_store`; how many requests are in
//! flight, what is tried again and for how long is decided by [`rayset::storage::FarStorage`].
//!
//! An object is pinned when it is opened: by its entity tag, or by its date if the server gives none. If another object takes
//! its place, reads fail; a picture is never made of two.

mod cache;
#[cfg(feature = "stores")]
mod stores;

use std::path::PathBuf;

pub use self::cache::{Cache, CacheError};

/// How far objects are read by this process.
#[derive(Clone, Debug, Default)]
pub struct Settings {
    /// A folder that keeps what was read, and the most bytes that its files may take. `None` for no such folder.
    pub cache: Option<(PathBuf, u64)>,
}

/// Opens addresses in this process from now on. Does nothing if that has been said before, or the feature `stores` is not
/// compiled in: addresses are then errors that say so.
///
/// # Errors
/// [`CacheError`] if the folder of the cache cannot be used.
pub fn open_addresses(settings: &Settings) -> Result<(), CacheError> {
    #[cfg(feature = "stores")]
    stores::open_addresses(settings)?;
    #[cfg(not(feature = "stores"))]
    let _ = settings;
    Ok(())
}

/// Whether addresses can be opened by this program.
#[must_use]
pub const fn is_available() -> bool {
    cfg!(feature = "stores")
}

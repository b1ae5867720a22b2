//! What commands take as their input: a scene, a cloud or grid that has been built, or any file of points or voxels, which
//! is built first and kept in the cache.

mod cache;
mod columns;
mod files;
mod kinds;
mod raw;
mod sources;

pub(crate) use self::cache::CacheArgs;
pub(crate) use self::columns::{customary as customary_columns, of_all as all_columns};
pub(crate) use self::files::expand;
pub(crate) use self::kinds::{Built, open_built};
pub(crate) use self::raw::{Input, Opened, Resources, open};
pub(crate) use self::sources::{has_volume, open_points, remark_about};

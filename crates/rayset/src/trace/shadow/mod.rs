//! How much of each light reaches each sample: by rays from the samples (`exact`), or from tables of the light's own rays
//! (`table`, looked up and made in `cached`), whichever the settings ask for (`shadows`).

mod cached;
mod exact;
mod map;
mod place;
mod shadows;
mod table;
mod transmittance;
mod world;

pub(super) use self::shadows::Shadows;
pub(super) use self::table::{DeepShadowMap, SHADOW_TILE_BYTES};
pub(super) use self::world::ShadowWorld;

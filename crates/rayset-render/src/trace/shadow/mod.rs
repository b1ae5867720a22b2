//! How much of each light reaches each sample: by shadow rays from the samples (`exact`) or from
//! deep shadow maps (`table`, looked up and computed in `cached`), depending on the settings
//! (`shadows`).

mod ahead;
mod cached;
mod exact;
mod map;
mod place;
mod shadows;
mod sharing;
mod sights;
mod table;
mod transmittance;
mod world;

pub(super) use self::ahead::{LitPlace, RaysToLight, TileOfLight};
pub(super) use self::shadows::Shadows;
pub(super) use self::table::{DeepShadowMap, SHADOW_TILE_BYTES};
pub(super) use self::world::ShadowWorld;

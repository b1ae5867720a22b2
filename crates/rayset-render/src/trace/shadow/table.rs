//! Deep shadow maps: which lights have them, and their tiles as pages of the working set.

use std::io;
use std::sync::Arc;

use super::map::LightMap;
use super::sights::LightSight;
use crate::scene::{Lighting, Scene, Shadows};
use rayset_store::working_set::read::Storage;
use rayset_store::working_set::{Kind, Object, PageSource, WorkingSet};

/// Bytes of a tile.
pub(in crate::trace) const SHADOW_TILE_BYTES: usize = 16 << 10;

/// The deep shadow map of one light.
pub(in crate::trace) struct DeepShadowMap {
    pub(super) map: LightMap,
    pub(super) tiles: Arc<Object>,
    /// How the rays of each tile see, by the number that the map has for it; none if nothing is
    /// seen from afar.
    sights: Vec<LightSight>,
    pages: WorkingSet,
}

impl DeepShadowMap {
    /// Total number of tiles of all maps of a scene.
    pub(in crate::trace) fn tiles_of(scene: &Scene, shadows: Shadows) -> u64 {
        Self::maps_of(scene, shadows).map(|map| u64::from(map.tiles())).sum()
    }

    /// Number of sights of all maps of a scene.
    pub(super) fn sights_of(scene: &Scene, shadows: Shadows) -> usize {
        Self::maps_of(scene, shadows).map(|map| map.sights().count()).sum()
    }

    fn maps_of(scene: &Scene, shadows: Shadows) -> impl Iterator<Item = LightMap> {
        let lights = if let Lighting::Lit(lights) = &scene.lighting { lights.as_slice() } else { &[] };
        let resolution = if let Shadows::Cached { resolution } = shadows { Some(resolution) } else { None };
        let bounds = scene.root.bounds();
        let maps = lights.iter().filter(|light| light.throws_shadows());
        maps.filter_map(move |light| LightMap::new(light, &bounds, resolution?))
    }

    /// Over a map, of whose sights these are.
    pub(super) fn new(map: LightMap, sights: Vec<LightSight>, pages: &WorkingSet) -> Self {
        let tiles = pages.add(Arc::new(TileSource { tiles: map.tiles() }));
        Self { map, tiles, sights, pages: pages.clone() }
    }

    /// How the rays of a tile see, if they see anything from afar.
    pub(super) fn sight(&self, tile: u32) -> Option<&LightSight> {
        self.sights.get(self.map.sight_of(tile))
    }
}

impl Drop for DeepShadowMap {
    fn drop(&mut self) {
        self.pages.forget(&self.tiles);
    }
}

/// Tiles as pages that are computed instead of read.
struct TileSource {
    tiles: u32,
}

impl Storage for TileSource {
    fn length(&self) -> io::Result<u64> {
        Ok(0)
    }

    fn read_exact_at(&self, _: &mut [u8], _: u64) -> io::Result<()> {
        Err(io::ErrorKind::Unsupported.into())
    }
}

impl PageSource for TileSource {
    fn pages(&self) -> u32 {
        self.tiles
    }

    fn page_bytes(&self) -> usize {
        SHADOW_TILE_BYTES
    }

    fn kind(&self, _: u32) -> Kind {
        Kind::Shadows
    }

    fn offset(&self, _: u32) -> u64 {
        0
    }

    fn storage(&self) -> Arc<dyn Storage> {
        Arc::new(Self { tiles: 0 })
    }

    fn check(&self, _: u32, _: &[u8]) -> Result<(), String> {
        Ok(())
    }

    fn name(&self) -> String {
        "shadows".into()
    }
}

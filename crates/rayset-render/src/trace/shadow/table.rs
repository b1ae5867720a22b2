//! Deep shadow maps: which lights have them, and their tiles as pages of the working set.

use std::io;
use std::sync::Arc;

use super::map::LightMap;
use crate::scene::{Light, Lighting, Scene, Shadows};
use rayset_base::geometry::Aabb;
use rayset_store::working_set::read::Storage;
use rayset_store::working_set::{Kind, Object, PageSource, WorkingSet};

/// Bytes of a tile.
pub(in crate::trace) const SHADOW_TILE_BYTES: usize = 16 << 10;

/// The deep shadow map of one light.
pub(in crate::trace) struct DeepShadowMap {
    pub(super) map: LightMap,
    pub(super) tiles: Arc<Object>,
    pages: WorkingSet,
}

impl DeepShadowMap {
    /// Total number of tiles of all maps of a scene.
    pub(in crate::trace) fn tiles_of(scene: &Scene, shadows: Shadows) -> u64 {
        let (Lighting::Lit(lights), Shadows::Cached { resolution }) = (&scene.lighting, shadows) else {
            return 0;
        };
        let bounds = scene.root.bounds();
        let maps = lights.iter().filter(|light| light.throws_shadows());
        maps.filter_map(|light| LightMap::new(light, &bounds, resolution))
            .map(|map| u64::from(map.tiles()))
            .sum()
    }

    /// The map of a light that casts shadows; `None` if the scene is empty or the light has no
    /// rays.
    pub(in crate::trace) fn new(
        light: &Light,
        bounds: &Aabb,
        resolution: u32,
        pages: &WorkingSet,
    ) -> Option<Self> {
        let map = LightMap::new(light, bounds, resolution)?;
        let tiles = pages.add(Arc::new(TileSource { tiles: map.tiles() }));
        Some(Self { map, tiles, pages: pages.clone() })
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

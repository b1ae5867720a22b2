//! What the engine does, made visible: which pages of the cloud are in memory, what was read, how
//! long rays waited.

use std::ops::Range;
use std::sync::Arc;

use rayset::memory::Kind;
use rayset::{Cloud, Session};
use serde::Serialize;

use crate::compose::Opened;
use crate::picking::clouds;

/// Most regions of a map.
const MOST_REGIONS: usize = 2048;

/// What is in memory, and what has been read since the program was started.
#[derive(Clone, Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct Report {
    /// Bytes that pages may take.
    pub(crate) budget: u64,
    pub(crate) kinds: Vec<KindReport>,
    /// Boxes of the map, world space: least and largest coordinates of each. Only if they were
    /// asked for.
    pub(crate) regions: Option<Vec<[[f64; 3]; 2]>>,
    /// Of each region, the part of its pages that is in memory, 0 to 1.
    pub(crate) resident: Vec<f32>,
}

/// Of one kind of page.
#[derive(Clone, Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct KindReport {
    pub(crate) name: &'static str,
    /// In memory now.
    pub(crate) bytes: u64,
    pub(crate) hits: u64,
    pub(crate) misses: u64,
    pub(crate) reads: u64,
    pub(crate) bytes_read: u64,
    pub(crate) bytes_unique: u64,
    pub(crate) evictions: u64,
    /// Of all threads together.
    pub(crate) waited_seconds: f64,
}

/// The map of a scene's first cloud.
pub(crate) struct Map {
    cloud: Arc<Cloud>,
    regions: Vec<Range<u32>>,
    boxes: Vec<[[f64; 3]; 2]>,
}

impl Map {
    /// `None` if the scene has no cloud. Reads all pages of nodes.
    ///
    /// # Errors
    /// Why the cloud cannot be read.
    pub(crate) fn new(opened: &Opened) -> Result<Option<Self>, String> {
        let clouds = clouds(&opened.file.scene.root);
        let Some((object, world_from_local)) = clouds.first() else { return Ok(None) };
        let found = object.cloud.page_regions(MOST_REGIONS).map_err(|error| error.to_string())?;
        let (regions, bounds): (Vec<_>, Vec<_>) = found.into_iter().unzip();
        let boxes = bounds.into_iter().map(|bounds| {
            let bounds = bounds.transformed(world_from_local);
            [bounds.min.to_array(), bounds.max.to_array()]
        });
        Ok(Some(Self { cloud: object.cloud.clone(), regions, boxes: boxes.collect() }))
    }
}

/// What there is to say now.
pub(crate) fn report(session: &Session, map: Option<&Map>, with_map: bool) -> Report {
    let statistics = session.statistics();
    let kinds = Kind::ALL.iter().map(|&kind| {
        let of = statistics.kind(kind);
        KindReport {
            name: kind.name(),
            bytes: of.resident_bytes,
            hits: of.hits,
            misses: of.misses,
            reads: of.reads,
            bytes_read: of.bytes_read,
            bytes_unique: of.bytes_unique,
            evictions: of.evictions,
            waited_seconds: of.stall_nanoseconds as f64 * 1e-9,
        }
    });
    let part = |map: &Map, pages: &Range<u32>| {
        session.resident_pages(&map.cloud, pages.clone()) as f32 / pages.len().max(1) as f32
    };
    let resident =
        map.map_or_else(Vec::new, |map| map.regions.iter().map(|pages| part(map, pages)).collect());
    let regions = map.filter(|_| with_map).map(|map| map.boxes.clone());
    Report { budget: session.page_budget_bytes(), kinds: kinds.collect(), regions, resident }
}

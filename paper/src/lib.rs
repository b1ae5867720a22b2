//! The engine of *Ray-Driven Dynamic Working Set Rendering for Complex Volume Scene Graphs
//! Involving Large Point Clouds* (Chisnall, Chen, Hansen), as its sections 3.4 and 4 describe it,
//! and its experiments, beside the engine that ships.
//!
//! An octree by influence ([`index`]) of records of the paper's sizes ([`record`]) lies on disk.
//! Record caches ([`cache`]) over a real or a simulated [`disk`] hold some of it; [`records`] are
//! what the [`engine`] asks for; [`predict`] looks ahead. Graph, light and compositing are those of
//! rayset's judge, a discrete ray tracer, so that both engines are asked for the same picture.

pub mod cache;
pub mod cap;
pub mod cells;
pub mod disk;
pub mod engine;
pub mod experiments;
pub mod file_cache;
pub mod index;
pub mod mapped;
pub mod memory;
pub mod predict;
pub mod record;
pub mod records;
pub mod report;
pub mod simulated;
pub mod structures;
pub mod swap;

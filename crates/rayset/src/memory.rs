//! Memory budgets, how much of one a scene needs, and how it was used.

pub use rayset_render::trace::memory::SceneNeeds;
pub use rayset_render::trace::memory_plan::MemoryPlan;
pub use rayset_store::working_set::{Kind, KindStatistics, Limits, PageFault, Statistics};

//! Budgets, what a scene needs of them, and what became of them.

pub use crate::trace::memory::{MemoryPlan, SceneNeeds, plan};
pub use crate::working_set::{Kind, KindStatistics, Limits, PageFault, Statistics};

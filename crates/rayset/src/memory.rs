//! Memory budgets, how much of one a scene needs, and how it was used.

pub use crate::trace::memory::{MemoryPlan, SceneNeeds, plan};
pub use crate::working_set::{Kind, KindStatistics, Limits, PageFault, Statistics};

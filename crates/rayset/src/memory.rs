//! Memory budgets, how much of one a scene needs, and how it was used.

pub use crate::trace::memory::SceneNeeds;
pub use crate::trace::memory_plan::{MemoryPlan, plan};
pub use crate::working_set::{Kind, KindStatistics, Limits, PageFault, Statistics};

//! Clouds as volume objects: where each is (`placement`), the octree ahead of a packet (`frontier`,
//! for the rays in `live_rays`; what is seen from afar ahead of many: `far_ahead`), the march of a
//! packet through it (`march`), what its field looks like (`shading`, `spread` from afar, in the
//! `measures` of opacity), and how little of a ray that may leave (`least_absorption`).

mod ahead;
mod cut;
mod far_ahead;
mod frontier;
mod gather;
mod leaf_cut;
mod least_absorption;
mod live_rays;
mod lod;
mod march;
mod measures;
mod nodes;
mod opening;
mod parts;
mod placement;
mod point_parts;
mod record_pages;
mod request;
mod shading;
mod spread;
mod volume;

pub(super) use self::ahead::{each_own_page, run_bounds};
pub(super) use self::far_ahead::{FarAhead, Opened};
pub(super) use self::lod::CloudLod;
pub(super) use self::march::{CloudMarch, CloudScratch};
pub(super) use self::nodes::{NodesInMemory, RetainedNodes};
pub(super) use self::parts::NodePart;
pub(super) use self::placement::CloudPlacement;
pub(super) use self::request::{Remaining, Request};
pub(super) use self::shading::CloudShading;
pub(super) use self::volume::CloudVolume;

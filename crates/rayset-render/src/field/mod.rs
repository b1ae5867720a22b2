//! The density field of a cloud, evaluated along rays: kernels, splatting of runs onto packets of
//! rays, and the brute-force reference that all of it is tested against.

mod batch;
mod columns;
mod counts;
mod far;
mod far_points;
mod gaussian_splat;
mod group;
mod harmonics;
mod kept_runs;
mod lane_kernels;
mod lane_ray;
mod packet;
mod pairs;
mod places;
mod plates;
mod ray_columns;
pub mod reference;
mod run;
mod samples;
mod shapes;
mod sight;
mod simd;
mod splat;
mod splat_filter;
mod splat_wide;
mod sums;
mod values;
mod widen;

pub use crate::math::linear_from_srgb;
pub use batch::{Appended, BATCH_BYTES, RunBatch};
pub use columns::AttributeColumns;
pub use counts::SplatCounts;
pub(crate) use far::{FarChannel, FarDecoder};
pub(crate) use far_points::PointParts;
pub use kept_runs::{KEPT_BYTES, RunKey, RunPart};
pub use packet::{BLOCK_SAMPLES, LANES, Packet, SLAB_SAMPLES, Slab};
pub use ray_columns::{ChosenRays, Crossing, Near, RayColumns};
pub use rayset_base::kernel::Kernel;
pub use run::{DecodedRun, RunDecoder};
pub use samples::{Channels, FieldSamples, LeastAbsorption, RayEnds, SampleRow};
pub use sight::{Eye, Sight};
pub use simd::SimdLevel;
pub(crate) use simd::dispatch;
pub use splat::Splatter;
pub use splat_filter::SplatFilter;

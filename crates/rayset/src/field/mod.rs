//! The density field of a cloud, evaluated along rays: kernels, the splatting of runs onto a packet of rays, and the
//! brute-force judge that all of it is measured against.

mod bare;
pub mod kernel;
mod packet;
mod ray_columns;
pub mod reference;
mod run;
mod simd;
mod splat;

pub use bare::{BARE_SAMPLES, bare_loop};
pub use kernel::Kernel;
pub use packet::{LANES, Packet, SLAB_SAMPLES, Slab};
pub use ray_columns::{Crossing, RayColumns};
pub use run::{AttributeColumns, DecodedRun, RunDecoder, linear_from_srgb};
pub use simd::SimdLevel;
pub use splat::{Channels, FieldSamples, SampleRow, SplatCounts, Splatter};

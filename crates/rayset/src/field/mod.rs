//! The density field of a cloud, evaluated along rays: kernels, the splatting of runs onto a packet of rays, and the
//! brute-force judge that all of it is measured against.

mod bare;
mod box_test;
pub mod judge;
pub mod kernel;
mod packet;
mod run;
mod simd;
mod splat;

pub use bare::{BARE_SAMPLES, bare_loop};
pub use box_test::{BoxTest, Crossing};
pub use kernel::Kernel;
pub use packet::{LANES, Packet, SLAB_SAMPLES, Slab};
pub use run::{AttributeSource, DecodedRun, RunDecoder, linear_from_srgb};
pub use simd::SimdLevel;
pub use splat::{Channels, FieldSamples, SampleRow, SplatCounts, Splatter};

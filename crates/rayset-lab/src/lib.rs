//! What exists for measurements alone: the commands `bench` and `figure`, the inner loop by itself,
//! remote objects that are only simulated, and logs of requests for pages. No picture needs any of
//! it.
#![forbid(unsafe_code)]

pub mod bare;
pub mod bench;
mod convergence;
mod features;
pub mod figure;
mod pictures;
#[cfg(feature = "internals")]
pub mod requests;
mod scenes;
pub mod simulated;
mod workloads;

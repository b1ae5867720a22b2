//! What all commands of the program share: messages and results on the terminal, progress, signals,
//! outputs, and the memory and the statistics of the process.
#![deny(unsafe_code)]

pub mod children;
pub mod interrupts;
pub mod memory;
pub mod outputs;
pub mod ply;
pub mod progress;
pub mod report;
pub mod statistics;

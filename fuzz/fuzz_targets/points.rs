//! See `rayset_fuzz::points`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| rayset_fuzz::points(data));

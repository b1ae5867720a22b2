//! See `rayset_fuzz::volumes`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| rayset_fuzz::volumes(data));

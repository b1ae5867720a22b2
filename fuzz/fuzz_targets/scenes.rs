//! See `rayset_fuzz::scenes`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| rayset_fuzz::scenes(data));

//! See `rayset_fuzz::files`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| rayset_fuzz::files(data));

//! See `rayset_view::hear_message`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| drop(rayset_view::hear_message(data)));

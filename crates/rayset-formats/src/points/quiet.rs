//! Converts panics of decoders to values, without output on standard error.
//!
//! Decoders that are not part of this library trust their input: damaged bytes may make them index
//! beyond tables, divide by zero or overflow. These panics are caught. Because a panic is reported
//! before it is caught, a panic hook that suppresses their reports is installed in front of the
//! program's own hook, once per process and only when such a decoder is used. It checks a
//! thread-local flag, so that every other panic is still reported.

use std::cell::Cell;
use std::panic::{self, AssertUnwindSafe};
use std::sync::Once;

thread_local! {
    static SILENT: Cell<bool> = const { Cell::new(false) };
}

/// The result of `call`, or `None` if it panics. The caller must then discard whatever `call` was
/// modifying.
pub(super) fn catch<T>(call: impl FnOnce() -> T) -> Option<T> {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let report = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            // A thread that is ending no longer has the flag, and is not in this function either.
            if !SILENT.try_with(Cell::get).unwrap_or(false) {
                report(info);
            }
        }));
    });
    let outer = SILENT.replace(true);
    let result = panic::catch_unwind(AssertUnwindSafe(call)).ok();
    SILENT.set(outer);
    result
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_panic_is_none_and_the_flag_goes_back() {
        assert_eq!(super::catch(|| 3), Some(3));
        assert_eq!(super::catch(|| -> u32 { panic!("this must not be printed") }), None);
        assert!(!super::SILENT.get());
    }
}

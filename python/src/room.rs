//! Memory for what a caller names the size of: refused by an exception of Python, where a failed
//! allocation would end the process.

use pyo3::exceptions::PyMemoryError;
use pyo3::prelude::*;

use crate::errors::bytes;

/// Why there is no memory for something.
#[derive(Debug)]
pub(crate) struct TooLarge(String);

impl From<TooLarge> for PyErr {
    fn from(error: TooLarge) -> Self {
        PyMemoryError::new_err(error.0)
    }
}

/// Checks that `count` things of `each` bytes fit. `what` says what they are, `advice` what to do
/// otherwise.
pub(crate) fn check(count: u64, each: u64, what: &str, advice: &str) -> Result<(), TooLarge> {
    let needed = count.saturating_mul(each);
    let free = free_bytes();
    // What the system promises is more than it has; what it does not even promise is out of the
    // question.
    let is_promised =
        usize::try_from(needed).is_ok_and(|needed| Vec::<u8>::new().try_reserve_exact(needed).is_ok());
    if is_promised && free.is_none_or(|free| needed <= free) {
        return Ok(());
    }
    let there_is = free.map_or_else(String::new, |free| format!(", and {} are free", bytes(free)));
    Err(TooLarge(format!("{what} takes {} of memory{there_is}; {advice}", bytes(needed))))
}

/// An empty vector with room for `count` elements.
pub(crate) fn vector<T>(count: usize, what: &str, advice: &str) -> Result<Vec<T>, TooLarge> {
    check(count as u64, size_of::<T>() as u64, what, advice)?;
    let mut vector = Vec::new();
    // Others may have taken it since.
    vector.try_reserve_exact(count).map_err(|error| TooLarge(format!("{what}: {error}; {advice}")))?;
    Ok(vector)
}

/// Memory that can still be had, swap included; `None` where the system does not say.
fn free_bytes() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let kibibytes = |name: &str| -> Option<u64> {
        let line = text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(':'))?;
        line.split_whitespace().next()?.parse().ok()
    };
    let all = (kibibytes("MemAvailable")? + kibibytes("SwapFree").unwrap_or(0)).saturating_mul(1024);
    // That of a container.
    let limit = std::fs::read_to_string("/sys/fs/cgroup/memory.max").ok();
    let limit = limit.and_then(|text| text.trim().parse::<u64>().ok());
    Some(limit.map_or(all, |limit| all.min(limit)))
}

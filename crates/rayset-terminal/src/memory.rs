//! The memory of this process, as the operating system counts it.

/// Memory that the program takes besides what the library accounts for: code, arguments, the
/// allocator's first pages. How much code is resident depends on what the system maps around each
/// page that is used: 8.5 to 9.5 MiB on Linux, and a mebibyte less if all of it was optimised at
/// once. The code of an unoptimised build is larger, by up to two mebibytes. So is that of a
/// program that opens addresses, though it opens none, by up to two; unoptimised, of which 14.3 MiB
/// were seen to be resident, by five. Of a program that was just written, systems that keep files
/// in large pieces (Linux 6.18) map one to two mebibytes more of one that is not optimised, and
/// half a one of one that is.
pub const PROCESS_BYTES: u64 = match (cfg!(debug_assertions), cfg!(feature = "remote")) {
    (false, false) => 20 << 19,
    (false, true) => 23 << 19,
    (true, false) => 26 << 19,
    (true, true) => 32 << 19,
};

/// Largest resident set so far in bytes, if the system reports it.
pub fn peak_rss() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with("VmHWM:"))?;
    line.split_ascii_whitespace().nth(1)?.parse::<u64>().ok().map(|kib| kib << 10)
}

/// Resets the peak to the present, if the system allows it.
pub fn reset_peak_rss() {
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}

/// Processor time that this process has taken so far, in all of its threads; not a number where the
/// system does not say.
pub fn process_cpu_seconds() -> f64 {
    #[cfg(unix)]
    {
        let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
        time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
    }
    #[cfg(not(unix))]
    f64::NAN
}

/// Keeps the allocator from retaining memory that was freed, which would count against the budget
/// although it is unused: one arena for all threads, and large blocks always returned to the
/// system.
#[expect(unsafe_code, reason = "the only way to the allocator's settings")]
pub fn tame_allocator() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        const LARGE_BLOCK_BYTES: i32 = 64 << 10;
        // SAFETY: called first thing in `main`, before there are threads; both parameters take any
        // positive number.
        unsafe {
            libc::mallopt(libc::M_ARENA_MAX, 1);
            libc::mallopt(libc::M_MMAP_THRESHOLD, LARGE_BLOCK_BYTES);
        }
    }
}

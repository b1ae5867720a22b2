//! Commands that work for this process, and end with it.

use std::process::{Command, ExitStatus};
use std::time::{Duration, Instant};

use crate::interrupts;

/// Runs a command to its end; a signal ends the command, too.
pub fn run(command: &mut Command) -> std::io::Result<ExitStatus> {
    let mut child = command.spawn()?;
    interrupts::watch_child(Some(child.id()));
    let status = child.wait();
    interrupts::watch_child(None);
    status
}

/// How a command ended that had a limit.
pub struct Ended {
    /// `None` if it was stopped at the limit.
    pub status: Option<ExitStatus>,
    /// From its start to its end.
    pub seconds: f64,
    /// Processor time of all its threads; not a number where the system does not say.
    pub cpu_seconds: f64,
}

/// Runs a command to its end, or stops it at a limit; a signal ends the command, too. Where the
/// system does not list processes in `/proc` it has no limit.
///
/// # Errors
/// If it cannot be started, or not be waited for.
pub fn run_within(command: &mut Command, limit: Duration) -> std::io::Result<Ended> {
    let mut child = command.spawn()?;
    interrupts::watch_child(Some(child.id()));
    let started = Instant::now();
    let (mut stopped, mut cpu_seconds) = (false, f64::NAN);
    // A process that has ended is listed until it is waited for, with the time that it took.
    while let Some((has_ended, so_far)) = listed(child.id()) {
        cpu_seconds = so_far;
        if has_ended {
            break;
        }
        if !stopped && started.elapsed() >= limit {
            child.kill()?;
            stopped = true;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    let status = child.wait();
    interrupts::watch_child(None);
    let status = status?;
    let seconds = started.elapsed().as_secs_f64();
    Ok(Ended { status: (!stopped).then_some(status), seconds, cpu_seconds })
}

/// Whether a child process has ended, and the processor time that it has taken; `None` if the
/// system does not say.
fn listed(id: u32) -> Option<(bool, f64)> {
    let text = std::fs::read_to_string(format!("/proc/{id}/stat")).ok()?;
    // The name, in brackets, may have any characters.
    let fields: Vec<&str> = text.rsplit_once(") ")?.1.split_ascii_whitespace().collect();
    let ticks = fields.get(11)?.parse::<f64>().ok()? + fields.get(12)?.parse::<f64>().ok()?;
    Some((matches!(fields[0], "Z" | "X"), ticks / ticks_per_second()))
}

#[cfg(unix)]
fn ticks_per_second() -> f64 {
    rustix::param::clock_ticks_per_second() as f64
}

#[cfg(not(unix))]
fn ticks_per_second() -> f64 {
    f64::NAN
}

//! Signals: unfinished output is removed, then the process ends with status 128 plus the number of
//! the signal, as in a shell. A second signal of the same kind ends it at once.
//!
//! This state is global to the process, as signals are.

use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use rayset::output::Destination;
use rayset_inputs::OwnFolder;

/// What has to be cleaned up when a signal arrives.
#[derive(Default)]
struct Watched {
    /// Outputs, with the folder of their temporary files if it differs from their own.
    outputs: Vec<(Destination, Option<PathBuf>)>,
    folders: Vec<PathBuf>,
    /// Id of a child process that works for this one.
    child: Option<u32>,
}

static WATCHED: Mutex<Watched> =
    Mutex::new(Watched { outputs: Vec::new(), folders: Vec::new(), child: None });

fn watched() -> MutexGuard<'static, Watched> {
    WATCHED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Makes signals remove what is being written for an output.
pub fn watch(output: &Destination, temp_dir: Option<&Path>) {
    watched().outputs.push((output.clone(), temp_dir.map(Path::to_owned)));
}

/// Runs a command to its end; a signal ends the command, too.
pub fn run(command: &mut Command) -> std::io::Result<ExitStatus> {
    let mut child = command.spawn()?;
    watched().child = Some(child.id());
    let status = child.wait();
    watched().child = None;
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
    watched().child = Some(child.id());
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
    watched().child = None;
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

/// A temporary folder. It is removed when dropped, when a signal arrives, and by the next run if
/// this one is killed.
pub struct TemporaryFolder(OwnFolder);

impl TemporaryFolder {
    /// Creates one in the system's folder for temporary files.
    pub fn new(purpose: &str) -> Result<Self> {
        Self::within(&std::env::temp_dir(), purpose)
    }

    /// Creates one in another folder.
    pub fn within(all: &Path, purpose: &str) -> Result<Self> {
        // Locked while the folder is created, so that no signal finds it created but not
        // registered.
        let mut watched = watched();
        let folder = OwnFolder::create(all, purpose)
            .with_context(|| format!("cannot create a temporary folder in {}", all.display()))?;
        watched.folders.push(folder.path().to_owned());
        Ok(Self(folder))
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.0.path()
    }
}

impl rayset_inputs::TemporaryFolder for TemporaryFolder {
    fn path(&self) -> &Path {
        self.path()
    }
}

impl Drop for TemporaryFolder {
    fn drop(&mut self) {
        // Once it is not registered any more, nothing else removes it.
        let _ = std::fs::remove_dir_all(self.0.path());
        watched().folders.retain(|path| path != self.0.path());
    }
}

#[cfg(unix)]
pub use self::unix::{install, wait_if_ending};

#[cfg(unix)]
mod unix {
    use std::path::PathBuf;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::time::Duration;

    use anyhow::{Context, Result};
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM, SIGXFSZ};
    use signal_hook::{flag, iterator::Signals};

    use super::{Watched, watched};
    use crate::report;

    const SIGNALS: [(i32, &str); 3] = [(SIGINT, "SIGINT"), (SIGTERM, "SIGTERM"), (SIGHUP, "SIGHUP")];

    /// Set when the process begins to end because of a signal.
    static ENDING: AtomicBool = AtomicBool::new(false);

    /// Starts to listen to signals. Signals that were ignored when this process was started, as by
    /// `nohup`, stay ignored.
    pub fn install() -> Result<()> {
        let doing = "cannot listen to signals";
        let ignored = ignored_signals();
        let wanted: Vec<(i32, &str)> =
            SIGNALS.into_iter().filter(|(signal, _)| ignored & (1 << (signal - 1)) == 0).collect();
        for &(signal, _) in &wanted {
            let came = Arc::new(AtomicBool::new(false));
            // Handlers run in this order, so the first signal finds the flag unset.
            flag::register_conditional_shutdown(signal, 128 + signal, came.clone()).context(doing)?;
            flag::register(signal, came).context(doing)?;
        }
        // A write at the limit of file sizes then fails with an error instead, which is reported.
        flag::register(SIGXFSZ, Arc::default()).context(doing)?;
        let mut signals = Signals::new(wanted.iter().map(|(signal, _)| signal)).context(doing)?;
        let listen = move || {
            if let Some(signal) = signals.forever().next() {
                let name = wanted.iter().find(|(known, _)| *known == signal).map_or("a signal", |(_, n)| n);
                end(signal, name);
            }
        };
        std::thread::Builder::new()
            .name("rayset-signals".into())
            .stack_size(128 << 10)
            .spawn(listen)
            .context(doing)?;
        Ok(())
    }

    /// Bit n − 1 stands for signal n; 0 if the system does not report them.
    fn ignored_signals() -> u64 {
        let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
        let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
        mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0)
    }

    fn end(signal: i32, name: &str) -> ! {
        ENDING.store(true, Ordering::SeqCst);
        // Never unlocked again, so that no further output is begun.
        let watched = watched();
        if let Some(child) = watched.child.and_then(|child| rustix::process::Pid::from_raw(child as i32)) {
            let _ = rustix::process::kill_process(child, rustix::process::Signal::TERM);
        }
        remove(&watched);
        report::remark(format_args!("ended by {name}; nothing unfinished is left behind"));
        // Other threads have continued meanwhile.
        remove(&watched);
        std::process::exit(128 + signal);
    }

    fn remove(watched: &Watched) {
        for (output, temp_dir) in &watched.outputs {
            output.remove_own_partials(temp_dir.as_deref());
        }
        watched.folders.iter().for_each(remove_folder);
    }

    /// Tries repeatedly, because other threads may put files into the folder until the process
    /// ends.
    fn remove_folder(path: &PathBuf) {
        for _ in 0..50 {
            if std::fs::remove_dir_all(path).is_ok() || !path.exists() {
                return;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// If a signal has been received, waits for the thread that handles signals to end the process:
    /// a command may have failed only because its files were removed.
    pub fn wait_if_ending() {
        while ENDING.load(Ordering::SeqCst) {
            std::thread::park();
        }
    }
}

#[cfg(not(unix))]
pub fn install() -> Result<()> {
    Ok(())
}

#[cfg(not(unix))]
pub fn wait_if_ending() {}

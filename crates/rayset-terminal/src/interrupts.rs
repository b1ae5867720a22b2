//! Signals: unfinished output is removed, then the process ends with status 128 plus the number of
//! the signal, as in a shell. A second signal of the same kind ends it at once.
//!
//! This state is global to the process, as signals are.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use anyhow::{Context, Result};
use rayset::CancelToken;
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
    /// What the first signal cancels instead.
    work: Option<Work>,
}

/// Work that a signal cancels.
struct Work {
    cancel: CancelToken,
    /// The signal that has.
    signal: Option<Signal>,
}

static WATCHED: Mutex<Watched> =
    Mutex::new(Watched { outputs: Vec::new(), folders: Vec::new(), child: None, work: None });

fn watched() -> MutexGuard<'static, Watched> {
    WATCHED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Makes signals remove what is being written for an output.
pub fn watch(output: &Destination, temp_dir: Option<&Path>) {
    watched().outputs.push((output.clone(), temp_dir.map(Path::to_owned)));
}

/// The child process that works for this one, if there is one: a signal ends it, too.
pub(crate) fn watch_child(id: Option<u32>) {
    watched().child = id;
}

/// Until this is dropped, the first signal cancels work instead of ending the process.
pub struct Stopping(());

/// Makes the first signal cancel work; who does the work ends the process then, with what is
/// finished. A second signal ends the process at once.
#[must_use]
pub fn stop_work(cancel: &CancelToken) -> Stopping {
    watched().work = Some(Work { cancel: cancel.clone(), signal: None });
    Stopping(())
}

impl Stopping {
    /// The signal that has cancelled the work.
    #[must_use]
    pub fn signal(&self) -> Option<Signal> {
        watched().work.as_ref().and_then(|work| work.signal)
    }
}

impl Drop for Stopping {
    fn drop(&mut self) {
        watched().work = None;
    }
}

/// A signal that ends the process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Signal {
    number: i32,
    /// As in `SIGINT`.
    pub name: &'static str,
}

/// The error that a signal has ended the work, and what is left of it.
#[derive(Debug)]
pub struct Stopped {
    /// The signal.
    pub signal: Signal,
    /// What is finished, and how to go on with it.
    pub left: String,
}

impl Stopped {
    /// The status that the process ends with, as in a shell.
    #[must_use]
    pub fn status(&self) -> u8 {
        (128 + self.signal.number) as u8
    }
}

impl std::fmt::Display for Stopped {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "ended by {}; {}", self.signal.name, self.left)
    }
}

impl std::error::Error for Stopped {}

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

    use super::{Signal, Watched, watched};
    use crate::report;

    const SIGNALS: [Signal; 3] = [
        Signal { number: SIGINT, name: "SIGINT" },
        Signal { number: SIGTERM, name: "SIGTERM" },
        Signal { number: SIGHUP, name: "SIGHUP" },
    ];

    /// Set when the process begins to end because of a signal.
    static ENDING: AtomicBool = AtomicBool::new(false);

    /// Starts to listen to signals. Signals that were ignored when this process was started, as by
    /// `nohup`, stay ignored.
    pub fn install() -> Result<()> {
        let doing = "cannot listen to signals";
        let ignored = ignored_signals();
        let is_ignored = |signal: &Signal| ignored & (1 << (signal.number - 1)) != 0;
        let wanted: Vec<Signal> = SIGNALS.into_iter().filter(|signal| !is_ignored(signal)).collect();
        for &Signal { number, .. } in &wanted {
            let came = Arc::new(AtomicBool::new(false));
            // Handlers run in this order, so the first signal finds the flag unset.
            flag::register_conditional_shutdown(number, 128 + number, came.clone()).context(doing)?;
            flag::register(number, came).context(doing)?;
        }
        // A write at the limit of file sizes then fails with an error instead, which is reported.
        flag::register(SIGXFSZ, Arc::default()).context(doing)?;
        let mut signals = Signals::new(wanted.iter().map(|signal| signal.number)).context(doing)?;
        let listen = move || {
            for number in signals.forever() {
                let known = wanted.iter().find(|signal| signal.number == number).copied();
                let signal = known.unwrap_or(Signal { number, name: "a signal" });
                if !cancels_work(signal) {
                    end(signal);
                }
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

    /// Whether a signal has cancelled work instead of ending the process.
    fn cancels_work(signal: Signal) -> bool {
        let mut watched = watched();
        let Some(work) = watched.work.as_mut().filter(|work| work.signal.is_none()) else { return false };
        work.signal = Some(signal);
        let cancel = work.cancel.clone();
        drop(watched);
        report::remark(format_args!(
            "{}: what is finished is written; a second one ends this at once",
            signal.name
        ));
        cancel.cancel();
        true
    }

    fn end(signal: Signal) -> ! {
        ENDING.store(true, Ordering::SeqCst);
        // Never unlocked again, so that no further output is begun.
        let watched = watched();
        if let Some(child) = watched.child.and_then(|child| rustix::process::Pid::from_raw(child as i32)) {
            let _ = rustix::process::kill_process(child, rustix::process::Signal::TERM);
        }
        remove(&watched);
        report::remark(format_args!("ended by {}; nothing unfinished is left behind", signal.name));
        // Other threads have continued meanwhile.
        remove(&watched);
        std::process::exit(128 + signal.number);
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

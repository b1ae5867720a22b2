//! Runs the program as a debugger would (`ptrace`), and disturbs one of its file operations.
//!
//! This stands between the program and the kernel, so every operation is met as it is made, whether
//! by rayset, the standard library or an encoder, in the program that ships: nothing is compiled in
//! for it.

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use nix::errno::Errno;
use nix::sys::ptrace::{self, Options};
use nix::sys::signal::{Signal, kill};
use nix::sys::wait::{WaitPidFlag, WaitStatus, waitpid};
use nix::unistd::Pid;

/// What is done to an operation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Disturbance {
    /// It is not carried out, and fails so.
    Fail(Errno),
    /// Half of the bytes are read or written.
    Short,
    /// The process is killed before it.
    Kill,
}

/// A file operation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Operation {
    Open,
    Create,
    Read,
    Write,
    Seek,
    Sync,
    Rename,
    Remove,
    Lock,
    Look,
    List,
}

impl Operation {
    /// What can happen to it.
    pub(crate) fn disturbances(self) -> &'static [Disturbance] {
        use Disturbance::{Fail, Short};
        match self {
            Self::Open => &[Fail(Errno::EIO), Fail(Errno::EINTR)],
            Self::Create => &[Fail(Errno::ENOSPC), Fail(Errno::EINTR)],
            Self::Read => &[Fail(Errno::EIO), Fail(Errno::EINTR), Short],
            Self::Write => &[Fail(Errno::EIO), Fail(Errno::ENOSPC), Fail(Errno::EINTR), Short],
            Self::Sync | Self::Lock => &[Fail(Errno::EIO), Fail(Errno::EINTR)],
            Self::Rename => &[Fail(Errno::EIO), Fail(Errno::ENOSPC)],
            Self::Seek | Self::Remove | Self::Look | Self::List => &[Fail(Errno::EIO)],
        }
    }
}

/// How a traced process ended.
#[derive(Debug)]
pub(crate) struct Traced {
    /// `None` if by a signal.
    pub(crate) code: Option<i32>,
    /// What it wrote to standard error.
    pub(crate) said: String,
    /// Its operations on files in the watched folder, in order.
    pub(crate) operations: Vec<Operation>,
}

/// Whether processes may be traced here; some containers forbid it.
pub(crate) fn can_trace(folder: &Path) -> bool {
    let can =
        Tracer::start(folder, folder, &["--version"]).is_ok_and(|tracer| tracer.run(None).code == Some(0));
    if !can {
        eprintln!("skipped: this system lets no process be traced");
    }
    can
}

/// Runs the program in a folder; `disturbed` names an operation by its number, from 0.
pub(crate) fn run(folder: &Path, arguments: &[&str], disturbed: Option<(usize, Disturbance)>) -> Traced {
    run_watching(folder, folder, arguments, disturbed)
}

/// The same, of whose operations those on files in the folder `watched` are met alone.
pub(crate) fn run_watching(
    folder: &Path,
    watched: &Path,
    arguments: &[&str],
    disturbed: Option<(usize, Disturbance)>,
) -> Traced {
    Tracer::start(folder, watched, arguments).expect("the program can be traced").run(disturbed)
}

struct Tracer {
    main: Pid,
    folder: PathBuf,
    watched: PathBuf,
    said: File,
    operations: Vec<Operation>,
    /// The thread whose operation has been replaced by none, and what it is to fail with.
    failing: Option<(Pid, Errno)>,
}

impl Tracer {
    fn start(folder: &Path, watched: &Path, arguments: &[&str]) -> nix::Result<Self> {
        let said = tempfile::tempfile().expect("a temporary file");
        // A shell that stops itself can be taken hold of before it becomes the program.
        let mut command = Command::new("/bin/sh");
        command.args(["-c", "kill -STOP $$; exec \"$0\" \"$@\"", env!("CARGO_BIN_EXE_rayset")]);
        command.args(arguments).current_dir(folder).stdin(Stdio::null()).stdout(Stdio::null());
        command.stderr(said.try_clone().expect("a second handle"));
        #[allow(clippy::zombie_processes, reason = "it is waited for below, by its number")]
        let child = command.spawn().expect("a shell");
        let main = Pid::from_raw(child.id() as i32);
        wait(Some(main), WaitPidFlag::WUNTRACED)?;
        let options = Options::PTRACE_O_TRACESYSGOOD
            | Options::PTRACE_O_TRACECLONE
            | Options::PTRACE_O_TRACEEXEC
            | Options::PTRACE_O_EXITKILL;
        let [folder, watched] = [folder, watched].map(|f| f.canonicalize().expect("the folder has a path"));
        if let Err(error) = ptrace::seize(main, options) {
            let _ = kill(main, Signal::SIGKILL);
            let _ = wait(Some(main), WaitPidFlag::empty());
            return Err(error);
        }
        kill(main, Signal::SIGCONT)?;
        Ok(Self { main, folder, watched, said, operations: Vec::new(), failing: None })
    }

    fn run(mut self, disturbed: Option<(usize, Disturbance)>) -> Traced {
        // Until then the shell runs.
        let mut is_program = false;
        let code = loop {
            let Ok(status) = wait(None, WaitPidFlag::empty()) else { break None };
            let (thread, signal) = match status {
                WaitStatus::Exited(thread, code) if thread == self.main => break Some(code),
                WaitStatus::Signaled(thread, ..) if thread == self.main => break None,
                WaitStatus::PtraceSyscall(thread) => {
                    if is_program {
                        self.system_call(thread, disturbed);
                    }
                    (thread, None)
                }
                WaitStatus::PtraceEvent(thread, _, event) => {
                    is_program |= event == nix::libc::PTRACE_EVENT_EXEC;
                    (thread, None)
                }
                WaitStatus::Stopped(thread, signal) => (thread, Some(signal)),
                _ => continue,
            };
            // A thread that has just been killed cannot go on.
            let _ = ptrace::syscall(thread, signal);
        };
        let length = self.said.metadata().expect("a length").len();
        let mut said = vec![0; length as usize];
        self.said.read_exact_at(&mut said, 0).expect("what was said");
        Traced { code, said: String::from_utf8_lossy(&said).into_owned(), operations: self.operations }
    }

    /// A thread enters or leaves the kernel.
    fn system_call(&mut self, thread: Pid, disturbed: Option<(usize, Disturbance)>) {
        let (Ok(info), Ok(mut registers)) = (ptrace::syscall_info(thread), ptrace::getregs(thread)) else {
            return;
        };
        if info.op != nix::libc::PTRACE_SYSCALL_INFO_ENTRY {
            if let Some((_, errno)) = self.failing.take_if(|(failing, _)| *failing == thread) {
                registers.rax = i64::from(-(errno as i32)) as u64;
                let _ = ptrace::setregs(thread, registers);
            }
            return;
        }
        let Some(operation) = self.operation(&registers) else { return };
        let number = self.operations.len();
        self.operations.push(operation);
        match disturbed {
            Some((chosen, disturbance)) if chosen == number => match disturbance {
                Disturbance::Fail(errno) => {
                    // No such call: the kernel does nothing.
                    registers.orig_rax = u64::MAX;
                    self.failing = Some((thread, errno));
                }
                Disturbance::Short => registers.rdx = (registers.rdx / 2).max(1),
                Disturbance::Kill => drop(kill(self.main, Signal::SIGKILL)),
            },
            _ => return,
        }
        let _ = ptrace::setregs(thread, registers);
    }

    /// What a system call does to files in the watched folder, if anything.
    fn operation(&self, registers: &nix::libc::user_regs_struct) -> Option<Operation> {
        use nix::libc as c;
        let nix::libc::user_regs_struct { rdi, rsi, rdx, .. } = *registers;
        let open = |flags: u64| {
            let creates = flags & c::O_CREAT as u64 != 0;
            if creates { Operation::Create } else { Operation::Open }
        };
        let (operation, is_here) = match registers.orig_rax as i64 {
            c::SYS_read | c::SYS_readv | c::SYS_pread64 => (Operation::Read, self.has_open(rdi)),
            c::SYS_write | c::SYS_writev | c::SYS_pwrite64 => (Operation::Write, self.has_open(rdi)),
            c::SYS_lseek => (Operation::Seek, self.has_open(rdi)),
            c::SYS_fsync | c::SYS_fdatasync => (Operation::Sync, self.has_open(rdi)),
            c::SYS_flock => (Operation::Lock, self.has_open(rdi)),
            c::SYS_fstat => (Operation::Look, self.has_open(rdi)),
            c::SYS_getdents64 => (Operation::List, self.has_open(rdi)),
            c::SYS_open => (open(rsi), self.is_named(rdi)),
            c::SYS_openat => (open(rdx), self.is_named(rsi)),
            c::SYS_rename => (Operation::Rename, self.is_named(rdi)),
            c::SYS_renameat | c::SYS_renameat2 => (Operation::Rename, self.is_named(rsi)),
            c::SYS_unlink => (Operation::Remove, self.is_named(rdi)),
            c::SYS_unlinkat => (Operation::Remove, self.is_named(rsi)),
            c::SYS_stat | c::SYS_lstat | c::SYS_readlink => (Operation::Look, self.is_named(rdi)),
            c::SYS_statx | c::SYS_newfstatat => (
                Operation::Look,
                self.is_named(rsi) || (self.text(rsi) == Some(vec![]) && self.has_open(rdi)),
            ),
            _ => return None,
        };
        is_here.then_some(operation)
    }

    /// Whether a descriptor of the program is one of a file in the watched folder, named or not.
    fn has_open(&self, descriptor: u64) -> bool {
        let link = format!("/proc/{}/fd/{}", self.main, descriptor as i32);
        std::fs::read_link(link).is_ok_and(|path| path.starts_with(&self.watched))
    }

    /// Whether a path in the program's memory leads into the watched folder.
    fn is_named(&self, address: u64) -> bool {
        use std::os::unix::ffi::OsStringExt;
        self.text(address).is_some_and(|text| {
            !text.is_empty()
                && self.folder.join(std::ffi::OsString::from_vec(text)).starts_with(&self.watched)
        })
    }

    /// A text in the program's memory, up to its zero.
    fn text(&self, address: u64) -> Option<Vec<u8>> {
        let memory = File::open(format!("/proc/{}/mem", self.main)).ok()?;
        let (mut text, mut byte) = (Vec::new(), [0]);
        while text.len() < 4096 {
            memory.read_exact_at(&mut byte, address + text.len() as u64).ok()?;
            match byte[0] {
                0 => return Some(text),
                other => text.push(other),
            }
        }
        None
    }
}

/// Waits for a process, or for any that this thread has started or traces: other tests have theirs.
fn wait(process: Option<Pid>, more: WaitPidFlag) -> nix::Result<WaitStatus> {
    loop {
        match waitpid(process, Some(WaitPidFlag::__WALL | WaitPidFlag::__WNOTHREAD | more)) {
            Err(Errno::EINTR) => {}
            result => return result,
        }
    }
}

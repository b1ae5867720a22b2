//! A hard cap on the memory of a process, page cache included: a control group of Linux, version 1 or 2.

use std::fs;
use std::io;
use std::path::PathBuf;
use std::process::{Command, Output};

/// A control group with a limit; gone when dropped.
pub struct Cap {
    folder: PathBuf,
    version: u8,
}

impl Cap {
    /// Makes one below that of this process. Nothing where the system has no such groups, or they are not ours to write.
    #[must_use]
    pub fn new(bytes: u64) -> Option<Self> {
        let own = fs::read_to_string("/proc/self/cgroup").ok()?;
        let path_of = |controller: &str| {
            own.lines().find_map(|line| {
                let mut parts = line.splitn(3, ':');
                let (_, name, path) = (parts.next()?, parts.next()?, parts.next()?);
                name.split(',').any(|n| n == controller).then(|| path.trim_start_matches('/').to_owned())
            })
        };
        let name = format!("rayset-paper-{}", std::process::id());
        let limits: &[&str];
        let (folder, version) = if let Some(path) = path_of("memory") {
            limits = &["memory.limit_in_bytes", "memory.memsw.limit_in_bytes"];
            (PathBuf::from("/sys/fs/cgroup/memory").join(path).join(name), 1)
        } else {
            limits = &["memory.max", "memory.swap.max"];
            (PathBuf::from("/sys/fs/cgroup").join(path_of("")?).join(name), 2)
        };
        fs::create_dir(&folder).ok()?;
        let cap = Self { folder, version };
        let values = if version == 1 { [bytes, bytes] } else { [bytes, 0] };
        for (place, (file, value)) in limits.iter().zip(values).enumerate() {
            let written = fs::write(cap.folder.join(file), value.to_string());
            // Without swap there is nothing to limit in the second place.
            if place == 0 && written.is_err() {
                return None;
            }
        }
        Some(cap)
    }

    /// Runs a command in the group.
    ///
    /// # Errors
    /// What the system says.
    pub fn run(&self, command: &Command) -> io::Result<Output> {
        let mut shell = Command::new("sh");
        let join = format!("echo $$ > '{}/cgroup.procs'; exec \"$@\"", self.folder.display());
        shell.args(["-c", &join, "sh"]).arg(command.get_program()).args(command.get_args());
        shell.output()
    }

    /// The most memory that was used in it, where the system says.
    #[must_use]
    pub fn peak_bytes(&self) -> Option<u64> {
        let file = if self.version == 1 { "memory.max_usage_in_bytes" } else { "memory.peak" };
        fs::read_to_string(self.folder.join(file)).ok()?.trim().parse().ok()
    }
}

impl Drop for Cap {
    fn drop(&mut self) {
        let _ = fs::remove_dir(&self.folder);
    }
}

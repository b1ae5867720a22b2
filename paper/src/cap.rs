//! A hard cap on the memory of a process, page cache included: a control group of Linux, version 1
//! or 2.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A control group with a limit; gone when dropped.
pub struct Cap {
    folder: PathBuf,
    version: u8,
}

impl Cap {
    /// Makes one below that of this process. Nothing where the system has no such groups, or they
    /// are not ours to write.
    #[must_use]
    pub fn new(bytes: u64) -> Option<Self> {
        let own = fs::read_to_string("/proc/self/cgroup").ok()?;
        let (above, version) = group_of(&own)?;
        let folder =
            Path::new("/sys/fs/cgroup").join(above).join(format!("rayset-paper-{}", std::process::id()));
        let limits: &[&str] = if version == 1 {
            &["memory.limit_in_bytes", "memory.memsw.limit_in_bytes"]
        } else {
            &["memory.max", "memory.swap.max"]
        };
        if version == 2
            && let Some(parent) = folder.parent()
        {
            // Groups of the second version have only the controllers that the one above hands down.
            let _ = fs::write(parent.join("cgroup.subtree_control"), "+memory");
        }
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

/// The group that limits the memory of a process, below where the system has its groups, and the
/// version of these: from what `/proc/self/cgroup` says.
fn group_of(own: &str) -> Option<(String, u8)> {
    let path_of = |controller: &str| {
        own.lines().find_map(|line| {
            let mut parts = line.splitn(3, ':');
            let (_, name, path) = (parts.next()?, parts.next()?, parts.next()?);
            name.split(',').any(|n| n == controller).then(|| path.trim_start_matches('/').to_owned())
        })
    };
    path_of("memory").map(|path| (format!("memory/{path}"), 1)).or_else(|| Some((path_of("")?, 2)))
}

impl Drop for Cap {
    fn drop(&mut self) {
        let _ = fs::remove_dir(&self.folder);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_group_of_a_process_is_found_in_both_versions() {
        let first = "5:cpu,cpuacct:/jobs\n4:memory:/jobs/7\n1:name=systemd:/\n";
        assert_eq!(group_of(first), Some(("memory/jobs/7".into(), 1)));
        let second = "0::/user.slice/session.scope\n";
        assert_eq!(group_of(second), Some(("user.slice/session.scope".into(), 2)));
        assert_eq!(group_of(""), None);
    }

    #[test]
    fn a_process_in_a_group_is_held_to_its_limit() {
        // Where the system lets nobody make groups there is nothing to hold.
        let Some(cap) = Cap::new(24 << 20) else { return };
        let allocate = |megabytes: u32| {
            let mut command = Command::new("dd");
            let block = format!("bs={megabytes}M");
            command.args(["if=/dev/zero", "of=/dev/null", &block, "count=1", "status=none"]);
            cap.run(&command).expect("a shell").status.success()
        };
        assert!(allocate(4) && !allocate(64));
        // Not every kernel of the second version says.
        assert!(cap.peak_bytes().is_none_or(|peak| peak > 4 << 20));
    }
}

//! Work in a process of its own: with folders, an environment and times of its own, so that all
//! that it leaves behind is seen.

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::Arc;
use std::time::Duration;

use rayset::Grid;
use rayset_remote::{Settings, Times};
use xxhash_rust::xxh3::xxh3_64;

use crate::common::{build_cloud, build_grid, open, render, render_grid};

/// The variables of the environment that say what a process is to do.
const WORK: &str = "RAYSET_REMOTE_TEST_WORK";
const TIMES: &str = "RAYSET_REMOTE_TEST_TIMES";
const CACHE: &str = "RAYSET_REMOTE_TEST_CACHE";
/// What stands before what it says.
const RIGHT: &str = "said: ";
const WRONG: &str = "complained: ";

/// A process that is to do something, and its folders, which are removed with it.
pub(crate) struct Child {
    folder: tempfile::TempDir,
    command: Command,
}

impl Child {
    /// `words`: `open ADDRESS`; `read ADDRESS`, which says a digest of all of its bytes;
    /// `cloud ADDRESS BUDGET` and `grid ADDRESS BUDGET`, which render and say the [`digest`] of the
    /// picture; `points INPUT OUTPUT` and `volume INPUT OUTPUT`, which build;
    /// `rewritten FIRST SECOND OUTPUT`, which builds one after the other at one place and says how
    /// many points are there each time.
    pub(crate) fn new(words: &[&str]) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let mut command = Command::new(std::env::current_exe().expect("this program"));
        command.args(["--exact", "child::a_process_does_what_another_test_asks_of_it", "--nocapture"]);
        for (key, _) in std::env::vars_os() {
            if key.to_string_lossy().starts_with("AWS_") {
                command.env_remove(key);
            }
        }
        let temporary = folder.path().join("temporary");
        std::fs::create_dir(&temporary).expect("a folder");
        command.env("TMPDIR", temporary).env("HOME", folder.path()).env(WORK, words.join("\n"));
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        Self { folder, command }
    }

    pub(crate) fn env(mut self, key: &str, value: &str) -> Self {
        self.command.env(key, value);
        self
    }

    /// Buckets of S3 are those of a server, with keys and a session token.
    pub(crate) fn with_s3(self, server: &crate::range_server::RangeServer, token: &str) -> Self {
        self.env("AWS_ENDPOINT_URL", &format!("http://{}", server.address))
            .env("AWS_ACCESS_KEY_ID", "key")
            .env("AWS_SECRET_ACCESS_KEY", "secret")
            .env("AWS_SESSION_TOKEN", token)
    }

    /// Attempts end after `attempt` milliseconds, and all of them after `all`.
    pub(crate) fn within(self, attempt: u64, all: u64) -> Self {
        self.env(TIMES, &format!("{attempt} {all}"))
    }

    /// Keeps what is read in a folder of at most so many bytes.
    pub(crate) fn keeping(self, folder: &Path, bytes: u64) -> Self {
        self.env(CACHE, &format!("{bytes} {}", folder.display()))
    }

    pub(crate) fn spawn(&mut self) -> std::process::Child {
        self.command.spawn().expect("a process")
    }

    /// What it says, or complains of.
    pub(crate) fn run(&mut self) -> Result<String, String> {
        heard(&self.command.output().expect("a process"))
    }

    /// The files in its folder for temporary files.
    pub(crate) fn left(&self) -> Vec<PathBuf> {
        files(&self.folder.path().join("temporary"))
    }
}

/// What a process said, or complained of.
pub(crate) fn heard(output: &Output) -> Result<String, String> {
    let text = String::from_utf8_lossy(&output.stdout);
    let after =
        |mark: &str| text.lines().find_map(|line| line.split_once(mark)).map(|(_, rest)| rest.to_owned());
    match (after(RIGHT), after(WRONG)) {
        (Some(said), None) => Ok(said),
        (None, Some(complaint)) => Err(complaint),
        _ => panic!("{text}{}", String::from_utf8_lossy(&output.stderr)),
    }
}

/// All files of a folder.
pub(crate) fn files(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let paths = entries.map(|entry| entry.expect("a file").path());
    paths.flat_map(|path| if path.is_dir() { files(&path) } else { vec![path] }).collect()
}

/// A picture as a number.
pub(crate) fn digest(pixels: &[[f32; 4]]) -> String {
    let bytes: Vec<u8> = pixels.iter().flatten().flat_map(|value| value.to_bits().to_le_bytes()).collect();
    format!("{:016x}", xxh3_64(&bytes))
}

fn work(words: &[&str]) -> Result<String, String> {
    let budget = |text: &str| text.parse().expect("a number");
    match words {
        ["open", address] => open(address).map(|_| "opened".to_owned()),
        ["read", address] => {
            let said = |error: std::io::Error| error.to_string();
            let object = rayset::storage::open(Path::new(address), false).map_err(said)?;
            let mut bytes = vec![0; object.length().map_err(said)? as usize];
            object.read_exact_at(&mut bytes, 0).map_err(said)?;
            Ok(format!("{:016x}", xxh3_64(&bytes)))
        }
        ["cloud", address, bytes] => render(&open(address)?, budget(bytes)).map(|picture| digest(&picture)),
        ["grid", address, bytes] => {
            let grid = Grid::open(Path::new(address)).map_err(|error| error.to_string())?;
            render_grid(&Arc::new(grid), budget(bytes)).map(|picture| digest(&picture))
        }
        ["points", input, output] => build_cloud(Path::new(input), Path::new(output)).map(|()| String::new()),
        ["rewritten", first, second, output] => {
            let points = [first, second].map(|input| {
                build_cloud(Path::new(input), Path::new(output))?;
                open(output).map(|cloud| cloud.header().points)
            });
            let [before, after] = points;
            Ok(format!("{} {}", before?, after?))
        }
        ["volume", input, output] => build_grid(Path::new(input), Path::new(output)).map(|()| String::new()),
        _ => panic!("{words:?}"),
    }
}

/// Nothing, unless this process was started by [`Child`].
#[test]
fn a_process_does_what_another_test_asks_of_it() {
    let Ok(words) = std::env::var(WORK) else { return };
    let mut times = Times::default();
    if let Ok(text) = std::env::var(TIMES) {
        let mut numbers =
            text.split(' ').map(|number| Duration::from_millis(number.parse().expect("a number")));
        times.attempt = numbers.next().expect("a time");
        times.all = numbers.next().expect("a time");
        times.slowest_sending = u64::MAX;
    }
    let cache = std::env::var(CACHE).ok().map(|text| {
        let (bytes, folder) = text.split_once(' ').expect("a size and a folder");
        (PathBuf::from(folder), bytes.parse().expect("a number"))
    });
    rayset_remote::open_addresses_within(&Settings { cache, ..Settings::default() }, times).expect("a cache");
    let words: Vec<&str> = words.split('\n').collect();
    let said = match work(&words) {
        Ok(said) => format!("{RIGHT}{said}"),
        Err(complaint) => format!("{WRONG}{}", complaint.replace('\n', " ")),
    };
    // Past the harness, which has its own words for tests.
    let _ = std::io::Write::write_all(&mut std::io::stdout(), format!("\n{said}\n").as_bytes());
}

//! `rayset view`

use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::Args;
use rayset::Session;
use rayset::points::Workload;
use rayset_view::{Options, SECRET_BYTES, Server, Subject, secret};
use serde_json::Value;

use crate::input::{self, CacheArgs, Input, Opened, Resources};
use crate::interrupts::TemporaryFolder;
use crate::look::{self, CameraArgs, LookArgs};
use crate::memory::PROCESS_BYTES;
use crate::report::{bytes, remark, say};
use crate::{demo, values};

/// Memory for the whole process if nothing else is said.
const DEFAULT_MEMORY: u64 = 256 << 20;
/// Memory of the server, besides the pictures of pages.
const SERVER_BYTES: u64 = 4 << 20;
/// The least and the most for pictures of pages, which may otherwise take a quarter of the memory.
const PICTURE_BYTES: std::ops::RangeInclusive<u64> = 16 << 20..=256 << 20;
/// The least that a session is of use with.
const LEAST_SESSION_BYTES: u64 = 8 << 20;
/// Size for which a look is chosen; the page then asks for its own.
const SIZE: (u32, u32) = (1280, 720);

/// Look around in a scene, a cloud, a grid, or any file of points or voxels, in a browser.
///
/// The program serves a page on this machine, traces what it looks at within --memory, and ends on Ctrl-C. Without a file it
/// makes a cloud to look at.
#[derive(Args)]
pub(crate) struct ViewArgs {
    /// Scene file (.json), cloud or grid file, one volume, or files of points: several, folders and patterns make one cloud
    inputs: Vec<PathBuf>,
    /// Memory for the whole process
    #[arg(long, value_parser = values::size, default_value = "256MiB")]
    memory: u64,
    /// Threads; as many as there are processors by default
    #[arg(long)]
    threads: Option<usize>,
    /// Port on 127.0.0.1; 0 for any that is free
    #[arg(long, default_value_t = 0)]
    port: u16,
    /// Only print the address
    #[arg(long)]
    no_open: bool,
    /// A name, with or without a port, under which a proxy in front may be reached; may be given several times
    #[arg(long, value_name = "NAME")]
    allow_host: Vec<String>,
    #[command(flatten)]
    cache: CacheArgs,
    #[command(flatten)]
    look: LookArgs,
    #[command(flatten)]
    camera: CameraArgs,
}

pub(crate) fn run(args: &ViewArgs) -> Result<()> {
    let least = PROCESS_BYTES + SERVER_BYTES + PICTURE_BYTES.start() + LEAST_SESSION_BYTES;
    ensure!(
        args.memory >= least,
        "--memory {} is too small to look around; at least {} will do",
        bytes(args.memory),
        bytes(least)
    );
    // Both keep what was made for as long as it is looked at.
    let made = args.inputs.is_empty().then(|| made_cloud(args.memory)).transpose()?;
    let inputs = made.as_ref().map_or_else(|| args.inputs.clone(), |(_, cloud)| vec![cloud.clone()]);
    let opened = input::open(&inputs, &args.cache, Resources { memory: args.memory, threads: args.threads })?;
    let subject = subject(args, &inputs, &opened)?;

    let picture_bytes = (args.memory / 4).clamp(*PICTURE_BYTES.start(), *PICTURE_BYTES.end());
    let mut session = Session::builder().memory(args.memory - PROCESS_BYTES - SERVER_BYTES - picture_bytes);
    if let Some(threads) = args.threads {
        session = session.threads(threads);
    }
    let mut options = Options::new(key(), args.port);
    options.allowed_hosts.clone_from(&args.allow_host);
    options.picture_bytes = picture_bytes;
    let server = Server::start(subject, session.build()?, options, |line| remark(line))?;
    let invitation = server.invitation()?;
    say(&invitation);
    remark("the address opens once; Enter prints another, Ctrl-C ends");
    if !args.no_open {
        open_browser(&invitation);
    }
    if hears_the_terminal() {
        let invite = server.inviter();
        std::thread::spawn(move || {
            for _ in std::io::stdin().lines().map_while(Result::ok) {
                match invite() {
                    Ok(address) => say(address),
                    Err(error) => remark(format_args!("no address: {error}")),
                }
            }
        });
    }
    Ok(server.run()?)
}

/// The scene to look at: a scene file, or what is chosen for a cloud or grid.
fn subject(args: &ViewArgs, inputs: &[PathBuf], opened: &Opened) -> Result<Subject> {
    let name = inputs[0].file_name().unwrap_or(inputs[0].as_os_str()).to_string_lossy();
    let title = if args.inputs.is_empty() { "a knot of points".into() } else { name.into_owned() };
    let (path, scene) = match &opened.input {
        Input::Scene(path) => {
            if let Some(option) = args.look.given() {
                anyhow::bail!(
                    "{option} is for clouds and grids; {} says itself what it looks like",
                    path.display()
                );
            }
            (path.clone(), scene_of_file(path)?)
        }
        Input::Cloud(cloud) => {
            let chosen = look::of_cloud(cloud, &args.look, &args.camera, SIZE)?;
            remark(&chosen.line);
            (cloud.path().to_owned(), chosen.scene)
        }
        Input::Grid(grid) => {
            let chosen = look::of_grid(grid, &args.look, &args.camera, SIZE)?;
            remark(&chosen.line);
            (grid.path().to_owned(), chosen.scene)
        }
    };
    Ok(Subject { title, path, scene })
}

/// The text of a scene file, once the strict reader has found it good.
fn scene_of_file(path: &Path) -> Result<Value> {
    rayset::scene_file::SceneFile::load(path)?;
    let text = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    serde_json::from_slice(&text).with_context(|| format!("{} is not JSON", path.display()))
}

/// Makes a cloud to look at, in a temporary folder.
fn made_cloud(memory: u64) -> Result<(TemporaryFolder, PathBuf)> {
    let folder = TemporaryFolder::new("view")?;
    let workload: Workload = "knot-1m".parse()?;
    let cloud = demo::make_cloud(&workload, memory.min(DEFAULT_MEMORY), folder.path())?;
    Ok((folder, cloud))
}

/// The key that cookies are signed with, kept in the user's state folder so that pages connect again after a restart; one for this
/// run alone if there is no such folder.
fn key() -> [u8; SECRET_BYTES] {
    match kept_key() {
        Ok(key) => key,
        Err(error) => {
            remark(format_args!("pages will not connect again after a restart: {error:#}"));
            // Without random numbers the server issues no invitation either, and says so.
            secret().unwrap_or_default()
        }
    }
}

fn kept_key() -> Result<[u8; SECRET_BYTES]> {
    let path = state_folder()?.join("view-key");
    if let Ok(bytes) = std::fs::read(&path)
        && let Ok(key) = bytes.try_into()
        && is_private(&path)
    {
        return Ok(key);
    }
    let key = secret()?;
    write_private(&path, &key)?;
    Ok(key)
}

/// The folder for what the program remembers between runs.
fn state_folder() -> Result<PathBuf> {
    let state = std::env::var_os("XDG_STATE_HOME").map(PathBuf::from).filter(|path| path.is_absolute());
    let home = || std::env::home_dir().map(|home| home.join(".local/state"));
    let folder = state.or_else(home).context("there is no home folder")?.join("rayset");
    std::fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
    Ok(folder)
}

/// Writes a file that nobody else can read. It has its name only when it is whole, so that no other run reads half of it.
fn write_private(path: &Path, bytes: &[u8]) -> Result<()> {
    let beside = path.with_extension(std::process::id().to_string());
    let mut options = std::fs::File::options();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let written = options.open(&beside).and_then(|mut file| file.write_all(bytes));
    written
        .and_then(|()| std::fs::rename(&beside, path))
        .with_context(|| format!("cannot write {}", path.display()))
}

/// Whether nobody else may read a file.
fn is_private(path: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        std::fs::metadata(path).is_ok_and(|metadata| metadata.mode() & 0o077 == 0)
    }
    #[cfg(not(unix))]
    path.exists()
}

/// Whether lines of the terminal are for this program. One in the background that asked for them would be stopped.
fn hears_the_terminal() -> bool {
    let stdin = std::io::stdin();
    #[cfg(unix)]
    let is_in_front =
        rustix::termios::tcgetpgrp(&stdin).is_ok_and(|group| group == rustix::process::getpgrp());
    #[cfg(not(unix))]
    let is_in_front = true;
    stdin.is_terminal() && is_in_front
}

/// Opens the user's browser, if there is one. What is handed over is a file that only the user can read, which leads to the address:
/// others on the machine see the arguments of programs.
fn open_browser(address: &str) {
    let page = format!(
        "<!doctype html><meta charset=utf-8><meta http-equiv=refresh content=\"0; url={address}\">\
         <a href=\"{address}\">Open the viewer</a>\n"
    );
    let opened = state_folder().and_then(|folder| {
        let path = folder.join("view-open.html");
        write_private(&path, page.as_bytes())?;
        start_browser(&path)
    });
    if opened.is_err() {
        remark("no browser was found; open the address in one");
    }
}

fn start_browser(page: &Path) -> Result<()> {
    let opener = if cfg!(target_os = "macos") { "open" } else { "xdg-open" };
    let quiet = std::process::Stdio::null;
    let mut command = std::process::Command::new(opener);
    command.arg(page).stdin(quiet()).stdout(quiet()).stderr(quiet()).spawn()?;
    Ok(())
}

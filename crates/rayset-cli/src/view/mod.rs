//! `rayset view`

mod looks;
mod state;

use std::io::{IsTerminal, Read};
use std::net::{IpAddr, Ipv4Addr};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, Once, PoisonError};

use anyhow::{Context, Result, ensure};
use clap::Args;
use rayset::Session;
use rayset::geometry::DVec3;
use rayset::points::Workload;
use rayset::scene_file::SceneFile;
use rayset::storage::InputFile;
use rayset_view::{Options, Server, Stance, Subject};
use serde_json::Value;

use self::looks::LooksOfFile;

use rayset_inputs::Input;

use crate::annotate::Space;
use crate::demo;
use crate::input::{self, Resources};
use crate::input_args::InputArgs;
use crate::option_args::{StyleArgs, WithoutPicture};
use rayset_inputs::look::{Chosen, Looks};
use rayset_inputs::style::Group;
use rayset_inputs::values;
use rayset_terminal::interrupts::TemporaryFolder;
use rayset_terminal::memory::PROCESS_BYTES;
use rayset_terminal::report::{bytes, name_of, remark, say_invitation};

/// Memory for the whole process if nothing else is said.
const DEFAULT_MEMORY: u64 = 256 << 20;
/// Memory of the server, besides the pictures of pages: connections, a sample of the points, scenes
/// as text.
const SERVER_BYTES: u64 = 8 << 20;
/// The least and the most for pictures of pages, which may otherwise take a quarter of the memory.
const PICTURE_BYTES: std::ops::RangeInclusive<u64> = 16 << 20..=256 << 20;
/// The part of the memory that they take, as one by this number.
const PICTURE_SHARE: u64 = 4;
/// The least that a session is of use with.
const LEAST_SESSION_BYTES: u64 = 8 << 20;

/// Look around in a scene, a cloud, a grid, or any file of points or voxels, in a browser.
///
/// The program serves a page on this machine, traces what it looks at within --memory, and ends on
/// Ctrl-C. Without a file it makes a cloud to look at.
#[derive(Args)]
pub(crate) struct ViewArgs {
    /// Scene file (.json), cloud or grid file, one volume, or files of points: several, folders and
    /// patterns make one cloud
    inputs: Vec<PathBuf>,
    /// Memory for the whole process
    #[arg(long, value_parser = values::size, default_value = "256MiB")]
    memory: u64,
    /// Threads; as many as there are processors by default
    #[arg(long)]
    threads: Option<usize>,
    /// Port; 0 for any that is free
    #[arg(long, default_value_t = 0)]
    port: u16,
    /// Address to listen on. Beyond this machine, as with 0.0.0.0, whoever knows the password sees
    /// the pictures and steers, and the line is not encrypted: `ssh -L`, or a proxy with TLS in
    /// front, is safer
    #[arg(long, value_name = "ADDRESS", default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST))]
    listen: IpAddr,
    /// File whose first line is the password that lets in whoever comes without a token; at least 8
    /// characters
    #[arg(long, value_name = "FILE")]
    password_file: Option<PathBuf>,
    /// Only print the address
    #[arg(long)]
    no_open: bool,
    /// A name, with or without a port, under which a proxy in front may be reached; may be given
    /// several times
    #[arg(long, value_name = "NAME")]
    allow_host: Vec<String>,
    #[command(flatten)]
    input: InputArgs,
    #[command(flatten)]
    style: StyleArgs<WithoutPicture>,
}

pub(crate) fn run(args: &ViewArgs) -> Result<()> {
    let least = PROCESS_BYTES + SERVER_BYTES + PICTURE_BYTES.start() + LEAST_SESSION_BYTES;
    ensure!(
        args.memory >= least,
        "--memory {} is too small to look around; at least {} will do",
        bytes(args.memory),
        bytes(least)
    );
    let picture_bytes = (args.memory / PICTURE_SHARE).clamp(*PICTURE_BYTES.start(), *PICTURE_BYTES.end());
    let mut options = Options::new(state::key(), args.port);
    options.address = args.listen;
    options.password = args.password_file.as_deref().map(password).transpose()?;
    options.allowed_hosts.clone_from(&args.allow_host);
    options.picture_bytes = picture_bytes;
    (options.most_picture_bytes, options.picture_share) = (*PICTURE_BYTES.end(), PICTURE_SHARE);
    let server = Server::start(options, |line| remark(line))?;
    let door = Door::new(&server, args)?;
    answer_the_terminal(server.inviter());
    let opener = server.opener();
    let serving = std::thread::spawn(move || server.run());

    let told = |what: &str, done: u64, total: u64| {
        door.open();
        opener.progress(what, done as f64 / total.max(done).max(1) as f64);
    };
    // Both keep what was made for as long as it is looked at.
    let made = args.inputs.is_empty().then(|| made_cloud(args.memory, &told)).transpose()?;
    let inputs = made.as_ref().map_or_else(|| args.inputs.clone(), |(_, cloud)| vec![cloud.clone()]);
    let resources =
        Resources { memory: args.memory - SERVER_BYTES, threads: args.threads, told: Some(&told) };
    let remarks = Mutex::new(Vec::new());
    let heard = |text: &str| remarks.lock().unwrap_or_else(PoisonError::into_inner).push(text.to_owned());
    let opened = input::open_hearing(&inputs, &args.input.cache(), resources, Some(&heard))?;
    let mut session = Session::builder().memory(args.memory - PROCESS_BYTES - SERVER_BYTES - picture_bytes);
    if let Some(threads) = args.threads {
        session = session.threads(threads);
    }
    let remarks = remarks.into_inner().unwrap_or_else(PoisonError::into_inner);
    let subject = Subject { remarks, ..subject(args, &inputs, opened.input)? };
    opener.open(subject, session.build()?)?;
    door.open();
    match serving.join() {
        Ok(ended) => Ok(ended?),
        Err(_) => anyhow::bail!("the server has stopped"),
    }
}

/// How people get in. It opens once: when it is clear that there is something to see, or that it
/// will take a while.
struct Door {
    once: Once,
    invitation: String,
    opens_browser: bool,
}

impl Door {
    fn new(server: &Server, args: &ViewArgs) -> Result<Self> {
        let (once, invitation) = (Once::new(), server.invitation()?);
        if !args.listen.is_loopback() {
            remark(format_args!(
                "listening on {}: whoever can reach it and knows the password sees the pictures and steers; what goes over \
                 the line is not encrypted",
                server.address()
            ));
        }
        Ok(Self { once, invitation, opens_browser: !args.no_open })
    }

    fn open(&self) {
        self.once.call_once(|| {
            say_invitation(&self.invitation);
            remark("the address opens once; Enter prints another, Ctrl-C ends");
            if self.opens_browser {
                state::open_browser(&self.invitation);
            }
        });
    }
}

/// Prints another address whenever somebody presses Enter, if the terminal is this program's.
fn answer_the_terminal(invite: impl Fn() -> std::io::Result<String> + Send + 'static) {
    if !hears_the_terminal() {
        return;
    }
    std::thread::spawn(move || {
        for _ in std::io::stdin().lines().map_while(Result::ok) {
            match invite() {
                Ok(address) => say_invitation(&address),
                Err(error) => remark(format_args!("no address: {error}")),
            }
        }
    });
}

/// The first line of a file.
fn password(path: &Path) -> Result<String> {
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    Ok(text.lines().next().unwrap_or_default().to_owned())
}

/// The scene to look at: a scene file, or what is chosen for a cloud or grid.
fn subject(args: &ViewArgs, inputs: &[PathBuf], input: Input) -> Result<Subject> {
    let title = if args.inputs.is_empty() { "a knot of points".into() } else { name_of(&inputs[0]) };
    let (path, looks) = match input {
        Input::Scene(path) => {
            if let Some(option) = args.style.0.given(Group::Look) {
                let (name, path) = (option.name, path.display());
                anyhow::bail!("--{name} is for clouds and grids; {path} says itself what it looks like");
            }
            let unit = Space::of(&SceneFile::load(&path)?.scene).unit;
            let scene = json_of_file(&path)?;
            return Ok(Subject { unit, ..Subject::scene(title, path, scene) });
        }
        Input::Cloud(cloud) => (cloud.path().to_owned(), Looks::of_cloud(cloud)?),
        Input::Grid(grid) => (grid.path().to_owned(), Looks::of_grid(grid, &args.style.0)?),
    };
    let looks = LooksOfFile::new(looks, args.style.0.clone(), args.input.cache().words(), inputs);
    let Chosen { scene, line, stance, .. } = looks.first()?;
    remark(&line);
    let file = SceneFile::parse(&path, &scene.to_string()).map_err(|error| anyhow::anyhow!(error.what))?;
    let unit = Space::of(&file.scene).unit;
    let vector = |v: DVec3| v.to_array();
    let stance = Stance {
        up: vector(stance.up),
        facing: vector(stance.facing),
        framed: stance.framed.map(vector),
        outline: stance.outline.into_iter().map(vector).collect(),
        is_framed: args.style.0.position.is_none() && args.style.0.height.is_none(),
    };
    Ok(Subject {
        looks: Some(Box::new(looks)),
        stance: Some(stance),
        unit,
        ..Subject::scene(title, path, scene)
    })
}

/// The text of a scene file, which the strict reader has found good.
fn json_of_file(path: &Path) -> Result<Value> {
    let reading = || format!("cannot read {}", path.display());
    let mut text = Vec::new();
    InputFile::open(path).with_context(reading)?.read_to_end(&mut text).with_context(reading)?;
    serde_json::from_slice(&text).with_context(|| format!("{} is not JSON", path.display()))
}

/// Makes a cloud to look at, in a temporary folder.
fn made_cloud(memory: u64, told: &dyn Fn(&str, u64, u64)) -> Result<(TemporaryFolder, PathBuf)> {
    told("making a cloud", 0, 1);
    let folder = TemporaryFolder::new("view")?;
    let workload: Workload = "knot-1m".parse()?;
    let cloud = demo::make_cloud(&workload, memory.min(DEFAULT_MEMORY), folder.path())?;
    Ok((folder, cloud))
}

/// Whether lines of the terminal are for this program. One in the background that asked for them
/// would be stopped.
fn hears_the_terminal() -> bool {
    let stdin = std::io::stdin();
    #[cfg(unix)]
    let is_in_front =
        rustix::termios::tcgetpgrp(&stdin).is_ok_and(|group| group == rustix::process::getpgrp());
    #[cfg(not(unix))]
    let is_in_front = true;
    stdin.is_terminal() && is_in_front
}

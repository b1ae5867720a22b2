//! What an address grants access with stands in nothing that a run leaves or says, but for the
//! scene that is to open it again.

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::common::{folder, program};

/// A password, a signature and a token.
const SECRET: &[u8] = b"hunter2";
/// The user and the password of the addresses, as a header has them.
const ENCODED: &[u8] = b"dXNlcjpodW50ZXIy";

/// Serves the files of a folder, whole or in ranges, until the process ends.
fn serve(folder: &Path) -> u16 {
    let listener = TcpListener::bind(("127.0.0.1", 0)).expect("a port");
    let port = listener.local_addr().expect("an address").port();
    let folder: Arc<Path> = folder.into();
    std::thread::spawn(move || {
        for stream in listener.incoming().map_while(Result::ok) {
            let folder = folder.clone();
            std::thread::spawn(move || answer(stream, &folder));
        }
    });
    port
}

/// Answers one request. That the other end has gone is no matter.
fn answer(mut stream: TcpStream, folder: &Path) {
    let mut lines = BufReader::new(stream.try_clone().expect("a stream")).lines().map_while(Result::ok);
    let first = lines.next().unwrap_or_default();
    let head: Vec<String> = lines.take_while(|line| !line.is_empty()).collect();
    let name = first.split([' ', '?']).nth(1).unwrap_or_default();
    let Ok(bytes) = fs::read(folder.join(name.trim_start_matches('/'))) else {
        let _ = stream.write_all(b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\nConnection: close\r\n\r\n");
        return;
    };
    let range =
        head.iter().find_map(|line| line.to_lowercase().strip_prefix("range: bytes=").map(str::to_owned));
    let (from, to) = match range.as_deref().and_then(|range| range.split_once('-')) {
        Some((from, to)) => {
            (from.parse().unwrap_or(0), to.parse().map_or(bytes.len(), |last: usize| last + 1))
        }
        None => (0, bytes.len()),
    };
    let to = to.min(bytes.len());
    let said = format!(
        "HTTP/1.1 {}\r\nContent-Length: {}\r\nContent-Range: bytes {from}-{}/{}\r\nETag: \"1\"\r\n\
         Connection: close\r\n\r\n",
        if range.is_some() { "206 Partial Content" } else { "200 OK" },
        to - from,
        to - 1,
        bytes.len()
    );
    let body: &[u8] = if first.starts_with("HEAD") { &[] } else { &bytes[from..to] };
    let _ = stream.write_all(said.as_bytes()).and_then(|()| stream.write_all(body));
}

/// A folder in which the program runs, and what it has said there.
struct Runs {
    folder: PathBuf,
    said: Vec<(String, Vec<u8>)>,
}

impl Runs {
    /// Runs the program; it ends well where addresses can be opened at all.
    fn good(&mut self, arguments: &[&str]) {
        let well = self.run(arguments);
        let said = String::from_utf8_lossy(&self.said.last().expect("it ran").1).into_owned();
        assert!(well || !cfg!(feature = "remote"), "{arguments:?}: {said}");
    }

    fn bad(&mut self, arguments: &[&str]) {
        assert!(!self.run(arguments), "{arguments:?}");
    }

    fn run(&mut self, arguments: &[&str]) -> bool {
        let mut command = program();
        command.current_dir(&self.folder).args(arguments);
        for (name, folder) in
            [("XDG_CACHE_HOME", "home"), ("XDG_STATE_HOME", "state"), ("TMPDIR", "temporary")]
        {
            command.env(name, self.folder.join(folder));
        }
        let output = command.output().expect("the program runs");
        let said = [output.stdout, output.stderr].concat();
        self.said.push((format!("{arguments:?}"), said));
        output.status.success()
    }
}

fn has_secret(bytes: &[u8]) -> bool {
    [SECRET, ENCODED].iter().any(|secret| bytes.windows(secret.len()).any(|found| found == *secret))
}

/// All that is in a folder: names and contents.
fn everything(folder: &Path, found: &mut Vec<(PathBuf, Vec<u8>)>) {
    for entry in fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            found.push((path.clone(), Vec::new()));
            everything(&path, found);
        } else {
            let bytes = fs::read(&path).expect("a file");
            found.push((path, bytes));
        }
    }
}

#[cfg(feature = "remote")]
#[test]
fn an_object_that_is_signed_anew_is_the_one_that_was_built_before_and_one_that_has_changed_is_not() {
    let (served, here) = (folder(), folder());
    let points = |x: u32| (0..400).map(|i| format!("{} {} {x}\n", i % 20, i / 20)).collect::<String>();
    fs::write(served.path().join("a.xyz"), points(10)).expect("a write");
    fs::create_dir(here.path().join("temporary")).expect("a folder");
    let port = serve(served.path());
    let mut runs = Runs { folder: here.path().to_owned(), said: Vec::new() };
    let mut info = |user: &str, signature: &str| {
        let address = format!("http://{user}127.0.0.1:{port}/a.xyz?{signature}");
        runs.good(&["info", &address, "--cache", "kept"]);
        String::from_utf8_lossy(&runs.said.last().expect("it ran").1).into_owned()
    };
    assert!(info("me:hunter2@", "X-Amz-Signature=1").contains("used again until"));
    for (user, signature) in [("me:hunter2@", "X-Amz-Signature=2"), ("you:hunter3@", "sig=3"), ("", "")] {
        let said = info(user, signature);
        assert!(said.contains("built before"), "{user}{signature}: {said}");
    }
    fs::write(served.path().join("a.xyz"), points(1000)).expect("a write");
    let said = info("me:hunter2@", "X-Amz-Signature=1");
    assert!(said.contains("used again until"), "{said}");
}

#[test]
fn nothing_that_a_run_leaves_or_says_has_the_secrets_of_its_addresses() {
    let (served, here) = (folder(), folder());
    let make = |arguments: &[&str]| {
        let output = program().current_dir(served.path()).args(arguments).output().expect("the program runs");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    };
    make(&["generate", "sphere-10k", "-o", "points.ply"]);
    make(&["build", "points.ply", "-o", "cloud.rset", "--radius", "0.05"]);
    fs::write(served.path().join("text.xyz"), "0 0 0\n1 1 1\n2 0 1\n0 2 1\n").expect("a write");
    let port = serve(served.path());
    let at = |name: &str| {
        format!("http://user:hunter2@127.0.0.1:{port}/{name}?X-Amz-Signature=hunter2.rset&sig=hunter2")
    };
    let (points, cloud, text, none) = (at("points.ply"), at("cloud.rset"), at("text.xyz"), at("none.rset"));
    fs::create_dir(here.path().join("temporary")).expect("a folder");
    let mut runs = Runs { folder: here.path().to_owned(), said: Vec::new() };
    let small = ["--size", "48x32"];

    runs.good(&["info", &cloud]);
    runs.good(&["info", &cloud, "--json"]);
    runs.good(&["info", &points, "--cache", "kept"]);
    runs.good(&["verify", &cloud]);
    for (output, input) in [("a.png", &points), ("b.exr", &cloud), ("c.png", &text)] {
        let words = [
            "render",
            input,
            "-o",
            output,
            "--cache",
            "kept",
            "--stats",
            "stats.json",
            "--remote-cache",
            "remote",
        ];
        // Without what opens addresses, the option is none.
        let words = if cfg!(feature = "remote") { &words[..] } else { &words[..8] };
        runs.good(&[words, &small].concat());
    }
    runs.good(&[&["render", &cloud, "-o", "d.png", "--write-scene", "written.json"], &small[..]].concat());
    // Words in a picture are those of an address without secrets.
    let plain = format!("http://127.0.0.1:{port}/cloud.rset");
    for (output, input) in [("i.png", &cloud), ("j.png", &plain)] {
        runs.good(&["render", input, "-o", output, "--size", "400x300", "--annotate"]);
    }
    let [named, plainly] = ["i.png", "j.png"].map(|name| fs::read(here.path().join(name)).ok());
    assert!(named == plainly, "the picture shows the address");
    for part in ["1", "2"] {
        let (share, output) = (format!("{part}/2"), format!("e.{part}.part"));
        runs.good(&[&["render", &cloud, "-o", &output, "--part", &share], &small[..]].concat());
    }
    runs.good(&["merge", "e.1.part", "e.2.part", "-o", "e.png"]);
    runs.good(&["build", &points, "-o", "f.rset", "--json"]);

    runs.bad(&["info", &none]);
    runs.bad(&["verify", &none]);
    runs.bad(&["check", &none]);
    runs.bad(&["check", &cloud]);
    runs.bad(&["render", &none, "-o", "g.png"]);
    runs.bad(&["render", &cloud, "-o", &none]);
    runs.bad(&["render", &cloud, "-o", &at("g.png")]);
    runs.bad(&["render", &cloud, "-o", &at("g.part"), "--part", "1/2"]);
    runs.bad(&["render", &cloud, &none, "-o", "g.png"]);
    runs.bad(&["render", &cloud, "-o", "g.png", "--sise", &none]);
    runs.bad(&["render", &cloud, "-o", "g.png", "--size", &none]);
    runs.bad(&["build", &none, "-o", "g.rset"]);
    runs.bad(&["build", &points, "-o", &none]);
    runs.bad(&["build", &points, "-o", &none, "--part", "1/2"]);
    runs.bad(&["merge", &none, "-o", "g.png"]);
    runs.bad(&["merge", &cloud, &none, "-o", "g.png"]);
    runs.bad(&["generate", "sphere-10k", "-o", &none]);
    runs.bad(&["render", &format!("http:/user:hunter2@127.0.0.1:{port}/a.rset?sig=hunter2"), "-o", "g.png"]);
    let scene = format!(r#"{{"rayset": 1, "root": {{"type": "cloud", "file": {none:?}, "hunter": 2}}}}"#);
    fs::write(here.path().join("wrong.json"), scene).expect("a write");
    runs.bad(&["check", "wrong.json"]);
    runs.bad(&["render", "wrong.json", "-o", "g.png"]);
    fs::remove_file(here.path().join("wrong.json")).expect("a file");

    if cfg!(feature = "remote") {
        // A scene that is written opens its data again, and says so.
        let written = here.path().join("written.json");
        let text = fs::read_to_string(&written).expect("a scene");
        assert!(text.contains(&cloud), "{text}");
        let warned = |(_, said): &(String, Vec<u8>)| {
            String::from_utf8_lossy(said)
                .contains("written.json names its data by addresses that grant access")
        };
        assert!(runs.said.iter().any(warned), "nobody says that the scene grants access");
        runs.good(&["render", "written.json", "-o", "h.png"]);
        assert_eq!(fs::read(here.path().join("h.png")).ok(), fs::read(here.path().join("d.png")).ok());
        fs::remove_file(written).expect("a file");
    }
    for (arguments, said) in &runs.said {
        assert!(!has_secret(said), "{arguments}: {}", String::from_utf8_lossy(said));
    }
    let mut found = Vec::new();
    everything(here.path(), &mut found);
    if cfg!(feature = "remote") {
        for name in ["a.png", "b.exr", "e.1.part", "e.png", "f.rset", "stats.json", "kept", "remote"] {
            assert!(found.iter().any(|(path, _)| path.ends_with(name)), "there is no {name}");
        }
    }
    for (path, bytes) in found {
        assert!(!has_secret(path.as_os_str().as_encoded_bytes()), "{}", path.display());
        assert!(!has_secret(&bytes), "{} has a secret in it", path.display());
    }
}

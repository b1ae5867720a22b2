//! Credentials that expire: renewed where somebody can, and otherwise a clear error within seconds.

use std::path::Path;
use std::time::{Duration, Instant};

use crate::child::{Child, digest};
use crate::common::{cloud, near, server};
use crate::range_server::{Behaviour, Event, RangeServer};

/// Credentials with this token have expired.
fn expired(token: &str) -> Behaviour {
    Behaviour { expired: Some(token.to_owned()), ..Behaviour::default() }
}

/// A picture that takes more than twelve requests.
const PICTURE: [&str; 3] = ["cloud", "s3://bucket/sphere.rset", "200000"];

/// A server with the cloud of [`PICTURE`], and what the picture is.
fn bucket() -> (RangeServer, String) {
    let (server, file) = (server(), cloud("sphere-100k"));
    let expected = digest(&near(&file));
    server.put("bucket/sphere.rset", file);
    (server, expected)
}

fn complaint_of_expiry(child: &mut Child) {
    let started = Instant::now();
    let complaint = child.run().expect_err("the credentials have expired");
    assert!(complaint.contains("s3://bucket/"), "{complaint}");
    assert!(complaint.contains("the credentials have expired: renew them"), "{complaint}");
    assert!(started.elapsed() < Duration::from_secs(30), "{:?}", started.elapsed());
    assert!(child.left().is_empty(), "{:?}", child.left());
}

#[test]
fn credentials_that_have_expired_are_told_at_once_whenever_it_happens() {
    let (server, _) = bucket();
    // From the beginning, and when the picture is half made.
    for requests in [0, 12] {
        server.behave(Behaviour::default());
        server.after(requests, Event::Behave(expired("old")));
        complaint_of_expiry(&mut Child::new(&PICTURE).with_s3(&server, "old"));
    }
    // An output: before any work, and while it is sent.
    let folder = tempfile::tempdir().expect("a folder");
    let input = folder.path().join("a.npy");
    std::fs::write(&input, crate::inputs::npy(crate::inputs::OF_TWO_PARTS)).expect("a write");
    for requests in [0, 6] {
        server.behave(Behaviour::default());
        server.after(requests, Event::Behave(expired("old")));
        let words = ["points", &input.display().to_string(), "s3://bucket/out.rset"];
        complaint_of_expiry(&mut Child::new(&words).with_s3(&server, "old"));
    }
}

/// A process that makes [`PICTURE`] and whose credentials a command says, which counts its runs:
/// the token is their number.
fn by_command(server: &RangeServer, folder: &Path, more: &str) -> Child {
    let runs = folder.join("runs").display().to_string();
    let said = format!(
        r#"{{"Version":1,"AccessKeyId":"A","SecretAccessKey":"B","SessionToken":"token-'$(wc -l < {runs} | tr -d " ")'"{more}}}"#
    );
    let script = folder.join("script");
    std::fs::write(&script, format!("echo >> {runs}\necho '{said}'\n")).expect("a write");
    let config = folder.join("config");
    let profile = format!("[default]\ncredential_process = sh {}\n", script.display());
    std::fs::write(&config, profile).expect("a write");
    Child::new(&PICTURE)
        .env("AWS_ENDPOINT_URL", &format!("http://{}", server.address))
        .env("AWS_CONFIG_FILE", &config.display().to_string())
}

fn runs(folder: &Path) -> usize {
    std::fs::read_to_string(folder.join("runs")).expect("it ran").lines().count()
}

#[cfg(unix)]
#[test]
fn a_command_is_asked_for_other_credentials_once_when_those_in_use_have_expired() {
    let (server, expected) = bucket();
    for requests in [0, 12] {
        let folder = tempfile::tempdir().expect("a folder");
        server.behave(Behaviour::default());
        server.after(requests, Event::Behave(expired("token-1")));
        let said = by_command(&server, folder.path(), "").run().expect("a picture");
        assert_eq!(said, expected);
        assert_eq!(runs(folder.path()), 2, "{requests}");
    }
    // A command that has nothing better to say: whoever asked it says so, after a second run at
    // most for each that is waiting.
    let folder = tempfile::tempdir().expect("a folder");
    server.behave(expired("token-1"));
    let mut child = by_command(&server, folder.path(), "");
    std::fs::write(folder.path().join("script"), script_that_says("token-1")).expect("a write");
    complaint_of_expiry(&mut child);
}

fn script_that_says(token: &str) -> String {
    format!(r#"echo '{{"Version":1,"AccessKeyId":"A","SecretAccessKey":"B","SessionToken":"{token}"}}'"#)
}

// `date -d` is that of GNU.
#[cfg(target_os = "linux")]
#[test]
fn a_command_is_asked_again_before_its_credentials_expire() {
    let (server, expected) = bucket();
    // Slow enough that the picture takes longer than the credentials hold.
    server.behave(Behaviour { latency: Duration::from_millis(60), ..Behaviour::default() });
    let folder = tempfile::tempdir().expect("a folder");
    let mut child = by_command(&server, folder.path(), "");
    let script = folder.path().join("script");
    let text = std::fs::read_to_string(&script).expect("the script");
    let end = r#""Expiration":"'$(date -u -d "+2 seconds" +%Y-%m-%dT%H:%M:%SZ)'","Version""#;
    std::fs::write(&script, text.replace(r#""Version""#, end)).expect("a write");
    assert_eq!(child.run().expect("a picture"), expected);
    assert!(runs(folder.path()) > 1, "asked once");
    // What it says has expired already is not even tried.
    let requests = server.objects.requests.load(std::sync::atomic::Ordering::Relaxed);
    let ended = r#","Expiration":"2001-02-03T04:05:06+00:00""#;
    let complaint = by_command(&server, folder.path(), ended).run().expect_err("they have expired");
    assert!(
        complaint.contains("printed credentials that have expired at 2001-02-03T04:05:06"),
        "{complaint}"
    );
    assert_eq!(server.objects.requests.load(std::sync::atomic::Ordering::Relaxed), requests);
}

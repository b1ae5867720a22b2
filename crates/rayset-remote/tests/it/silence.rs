//! Servers that take requests and never answer: everything ends when its time is over, and says so.

use std::time::{Duration, Instant};

use crate::child::Child;
use crate::common::{cloud, odd, server};
use crate::range_server::{Behaviour, Event};

/// Times of attempts, in milliseconds: one, and all.
const TIMES: (u64, u64) = (400, 1500);
/// What a test allows for them, on a machine that does other things beside.
const SOON: Duration = Duration::from_secs(60);

#[test]
fn whoever_opens_or_writes_where_nobody_answers_is_told_so_in_time() {
    let server = server();
    server.behave(odd("silent"));
    let folder = tempfile::tempdir().expect("a folder");
    let (input, large) = (folder.path().join("a.xyz"), folder.path().join("b.npy"));
    std::fs::write(&input, "0 0 0\n1 1 1\n").expect("a write");
    std::fs::write(&large, crate::inputs::npy(400_000)).expect("a write");
    let address = server.address_of("a.rset");
    for words in [
        ["open", &address].as_slice(),
        &["open", "s3://bucket/a.rset"],
        &["points", &server.address_of("a.laz"), "out.rset"],
        &["points", &input.display().to_string(), "s3://bucket/a.rset"],
        &["points", &large.display().to_string(), "s3://bucket/a.rset"],
    ] {
        let mut child = Child::new(words).within(TIMES.0, TIMES.1).with_s3(&server, "token");
        let started = Instant::now();
        let complaint = child.run().expect_err("nobody answers");
        assert!(complaint.contains("no answer within"), "{words:?}: {complaint}");
        assert!(started.elapsed() < SOON, "{words:?}: {:?}", started.elapsed());
        assert!(child.left().is_empty(), "{words:?}: {:?}", child.left());
    }
}

#[test]
fn whoever_reads_or_sends_when_the_server_falls_silent_is_told_so_in_time() {
    let (server, file) = (server(), cloud("sphere-100k"));
    server.put("sphere.rset", file);
    let folder = tempfile::tempdir().expect("a folder");
    let large = folder.path().join("a.npy");
    // Its cloud is sent in two parts.
    std::fs::write(&large, crate::inputs::npy(crate::inputs::OF_TWO_PARTS)).expect("a write");
    let address = server.address_of("sphere.rset");
    for (words, requests) in [
        (["cloud", &address, "200000"], 12),
        // The note is looked for, written and removed; it is written again, an upload is begun, and
        // noted: then come the parts.
        (["points", &large.display().to_string(), "s3://bucket/a.rset"], 6),
        (["points", &large.display().to_string(), "s3://bucket/b.rset"], 8),
    ] {
        server.behave(Behaviour::default());
        server.after(requests, Event::Behave(odd("silent")));
        let mut child = Child::new(&words).within(TIMES.0, TIMES.1).with_s3(&server, "token");
        let started = Instant::now();
        let complaint = child.run().expect_err("nobody answers");
        assert!(complaint.contains("no answer within"), "{words:?}: {complaint}");
        assert!(started.elapsed() < SOON, "{words:?}: {:?}", started.elapsed());
        assert!(child.left().is_empty(), "{words:?}: {:?}", child.left());
    }
    // What the server was not asked to remove while it was silent is removed by the next runs to
    // the same outputs.
    server.behave(Behaviour::default());
    for name in ["a", "b"] {
        let output = format!("s3://bucket/{name}.rset");
        Child::new(&["points", &large.display().to_string(), &output])
            .with_s3(&server, "token")
            .run()
            .expect("a cloud");
    }
    let (names, uploads) = server.held();
    assert_eq!(names, ["bucket/a.rset", "bucket/b.rset", "sphere.rset"]);
    assert_eq!(uploads, 0);
}

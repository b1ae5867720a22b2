//! Clouds on a web server: pictures, faults, objects that change, refusals.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use crate::child::Child;
use crate::common::{cloud, near, odd, open, render, server};
use crate::range_server::Behaviour;

#[test]
fn a_picture_from_a_web_server_is_the_same_whatever_fails_on_the_way() {
    let (server, file) = (server(), cloud("sphere-100k"));
    let expected = near(&file);
    server.put("a b/sphere.rset", file);
    let address = server.address_of("a%20b/sphere.rset");
    let faults = Behaviour {
        latency: Duration::from_millis(2),
        jitter: 0.2,
        failing: 0.02,
        slow: (0.05, Duration::from_millis(100)),
        cut: 0.02,
        ..Behaviour::default()
    };
    for behaviour in [Behaviour::default(), odd("weak-tags"), odd("no-tags"), odd("no-head"), faults] {
        server.behave(behaviour.clone());
        let cloud = open(&address).expect("a cloud");
        for budget in [12 << 14, 1 << 30] {
            assert!(render(&cloud, budget).expect("a picture") == expected, "{behaviour:?}, {budget} bytes");
        }
        drop(cloud);
        // What was looked at a moment ago is not looked at again; here it has to be.
        std::thread::sleep(Duration::from_millis(2100));
    }
}

#[test]
fn an_object_that_is_replaced_is_an_error_and_never_half_of_a_picture() {
    for behaviour in [Behaviour::default(), odd("weak-tags")] {
        let (server, file) = (server(), cloud("sphere-10k"));
        server.behave(behaviour);
        server.put("sphere.rset", file);
        let opened = open(&server.address_of("sphere.rset")).expect("a cloud");
        // Another cloud of the same number of points, as long as the first.
        server.put("sphere.rset", cloud("sphere-10k"));
        let said = render(&opened, 1 << 30).expect_err("it is another object");
        assert!(said.contains("another object has taken its place"), "{said}");
        drop(opened);
        std::thread::sleep(Duration::from_millis(2100));
        let again = open(&server.address_of("sphere.rset")).expect("the new one opens");
        render(&again, 1 << 30).expect("a picture");
    }
}

#[test]
fn refusals_and_wrong_answers_are_said_soon_and_clearly() {
    let (server, file) = (server(), cloud("sphere-10k"));
    server.put("sphere.rset", file);
    let refused = |code| Behaviour { refuses: Some(code), ..Behaviour::default() };
    for (behaviour, words) in [
        (refused(403), "access is denied"),
        (refused(401), "access is denied"),
        (refused(404), "there is no such object"),
        (odd("no-ranges"), "sends whole files only"),
        (odd("other-range"), "Requested"),
    ] {
        server.behave(Behaviour::default());
        let started = Instant::now();
        server.behave(behaviour.clone());
        let address = server.address_of(&format!("sphere.rset?token=secret{words}").replace(' ', "+"));
        let said = open(&address).expect_err("it does not open");
        assert!(said.contains(words) && !said.contains("secret"), "{behaviour:?}: {said}");
        assert!(started.elapsed() < Duration::from_secs(60), "{behaviour:?}: {:?}", started.elapsed());
    }
    server.behave(Behaviour::default());
    let said = open(&server.address_of("missing.rset")).expect_err("it is not there");
    assert!(said.contains("missing.rset: there is no such object"), "{said}");
    let said = open("http://127.0.0.1:1/none.rset").expect_err("nobody listens");
    assert!(said.contains("127.0.0.1:1"), "{said}");
}

#[test]
fn a_server_that_sends_another_length_than_it_says_is_never_believed() {
    let (server, file) = (server(), cloud("sphere-10k"));
    let expected = near(&file);
    server.put("sphere.rset", file);
    let address = server.address_of("sphere.rset");
    let opened = open(&address).expect("a cloud");
    // More than was asked for: the rest is not used.
    server.behave(odd("long"));
    match render(&opened, 1 << 30) {
        Ok(picture) => assert!(picture == expected),
        Err(said) => assert!(said.contains("sphere.rset"), "{said}"),
    }
    server.behave(odd("short"));
    let started = Instant::now();
    let said = render(&opened, 1 << 30).expect_err("half of every answer is missing");
    assert!(said.contains("sphere.rset") && said.contains("tried"), "{said}");
    assert!(started.elapsed() < Duration::from_secs(60), "{:?}", started.elapsed());
}

#[test]
fn what_opens_twice_is_read_once_and_only_as_far_as_needed() {
    let (server, file) = (server(), cloud("sphere-100k"));
    server.put("sphere.rset", file);
    let address = server.address_of("sphere.rset");
    let (first, second) = (open(&address).expect("a cloud"), open(&address).expect("a cloud"));
    assert!(Arc::ptr_eq(first.storage().expect("remote"), second.storage().expect("remote")));
    let read = server.objects.bytes.load(Ordering::Relaxed);
    // Its head, its foot and its descriptions, each with what is read ahead of them.
    assert!(read < 256 << 10, "{read} bytes were read to open it");
}

#[test]
fn what_a_process_has_just_written_is_what_it_opens() {
    let (server, folder) = (server(), tempfile::tempdir().expect("a folder"));
    let inputs = [1000, 2000].map(|points| {
        let path = folder.path().join(format!("{points}.npy"));
        std::fs::write(&path, crate::inputs::npy(points)).expect("a write");
        path.display().to_string()
    });
    let words = ["rewritten", &inputs[0], &inputs[1], "s3://bucket/cloud.rset"];
    assert_eq!(Child::new(&words).with_s3(&server, "token").run(), Ok("1000 2000".to_owned()));
}

//! What pages say: the messages of this folder, which fuzzers begin with, too.

use std::path::Path;

use serde_json::Value;

fn messages() -> Vec<(String, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/messages");
    let files = std::fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path());
    let read = |path: std::path::PathBuf| (path.display().to_string(), std::fs::read(&path).expect("a file"));
    files.map(read).collect()
}

#[test]
fn every_kind_of_message_is_heard() {
    let all = messages();
    assert_eq!(all.len(), 10);
    for (name, bytes) in all {
        if let Err(what) = rayset_view::hear_message(&bytes) {
            panic!("{name}: {what}");
        }
    }
}

#[test]
fn messages_with_a_key_too_many_or_one_that_is_missing_are_errors() {
    for (name, bytes) in messages() {
        let Value::Object(whole) = serde_json::from_slice(&bytes).expect("JSON") else { panic!("{name}") };
        let heard = |message: &serde_json::Map<String, Value>| {
            rayset_view::hear_message(&serde_json::to_vec(message).expect("text"))
        };
        let mut more = whole.clone();
        more.insert("file".into(), "/etc/passwd".into());
        assert!(heard(&more).is_err(), "{name} with a file");
        for key in whole.keys().filter(|key| !["changes", "withMap"].contains(&key.as_str())) {
            let mut less = whole.clone();
            less.remove(key);
            assert!(heard(&less).is_err(), "{name} without {key}");
        }
    }
}

//! A process that is being ended: a binary of its own, because nothing is created in it afterwards.

use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

use rayset_store::output::{Destination, OutputFile};

#[test]
fn whoever_begins_an_output_of_a_process_that_is_being_ended_waits_for_its_end() {
    let folder = tempfile::tempdir().expect("a folder");
    let destination = Destination::new(folder.path().join("out")).expect("a destination");
    let (asks, answers) = channel();
    let begin = {
        let destination = destination.clone();
        move || asks.send(OutputFile::create(&destination).is_ok())
    };
    let before = OutputFile::create(&destination).expect("an output");
    destination.remove_own_partials(None);
    std::thread::spawn(begin);
    assert_eq!(answers.recv_timeout(Duration::from_millis(200)), Err(RecvTimeoutError::Timeout));
    assert_eq!(std::fs::read_dir(folder.path()).expect("a list").count(), 0);
    drop(before);
}

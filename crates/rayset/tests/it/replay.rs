//! What the fuzzers begin with, and what a few random changes make of it, goes through them on
//! every change. Coverage leads them further, in `.ci/deep`.

use crate::common::Random;
use crate::corpus;

#[allow(dead_code, unreachable_pub, reason = "the fuzzers use the rest")]
#[path = "../../../../fuzz/src/lib.rs"]
mod fuzz;

/// Changed copies of each input.
const CHANGED: usize = 12;

/// A copy with a few bytes changed, cut off, or doubled.
fn changed(bytes: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    let mut below = |end: usize| (random.unit() * end.max(1) as f64) as usize;
    for _ in 0..=below(4) {
        let (at, kind) = (below(bytes.len()), below(6));
        // The first byte chooses the kind of file.
        let Some(byte) = bytes.get_mut(at.max(1)) else { continue };
        match kind {
            0 => *byte ^= 1 << below(8),
            1 => *byte = 0,
            2 => *byte = 255,
            3 => *byte = b'9',
            4 => bytes.truncate(at.max(1)),
            _ => {
                let end = bytes.len().min(at + 1 + below(40));
                let again = bytes[at..end].to_vec();
                bytes.splice(at..at, again);
            }
        }
    }
    bytes
}

#[test]
fn the_fuzzers_find_nothing_in_what_they_begin_with_nor_in_a_few_changes_of_it() {
    let mut random = Random(32);
    for (target, bytes) in corpus::inputs() {
        let run = match target {
            "points" => fuzz::points,
            "volumes" => fuzz::volumes,
            "scenes" => fuzz::scenes,
            "files" => fuzz::files,
            other => panic!("no fuzzer is called {other}"),
        };
        run(&bytes);
        for _ in 0..CHANGED {
            run(&changed(&bytes, &mut random));
        }
    }
    std::fs::remove_dir_all(fuzz::folder()).expect("the folder of the fuzzers");
}

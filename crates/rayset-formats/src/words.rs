//! Words of text between white space, which are passed without being read.

use std::io::{self, BufRead};

use rayset_base::regular_file::held;

/// What was passed of a text.
pub(crate) struct Passed {
    pub(crate) bytes: u64,
    /// Ends of lines among them.
    pub(crate) lines: u64,
    /// Words that the text has too few.
    pub(crate) missing: u64,
}

/// Goes on right behind the last letter of a number of words.
pub(crate) fn pass(input: &mut impl BufRead, words: u64) -> io::Result<Passed> {
    let (mut passed, mut within) = (Passed { bytes: 0, lines: 0, missing: words }, false);
    while passed.missing > 0 {
        let held = held(input)?;
        if held.is_empty() {
            passed.missing -= u64::from(within);
            break;
        }
        let mut used = 0;
        for byte in held {
            let space = byte.is_ascii_whitespace();
            passed.missing -= u64::from(space && within);
            within = !space;
            if passed.missing == 0 {
                break;
            }
            passed.lines += u64::from(*byte == b'\n');
            used += 1;
        }
        input.consume(used);
        passed.bytes += used as u64;
    }
    Ok(passed)
}

//! Why parts are refused.

use std::io;

use super::share::Share;
use crate::trace::{RenderError, SinkError};

/// Why a part cannot be rendered or read, or parts cannot be joined.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PartError {
    /// The render failed.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// The system refused to read a part.
    #[error("cannot read {part}: {source}")]
    Read {
        /// The part.
        part: String,
        /// The system's reason.
        r#source: io::Error,
    },
    /// The part could not be written.
    #[error("the part could not be written: {0}")]
    Write(io::Error),
    /// A picture is too large to be rendered in parts.
    #[error(
        "{pixels} pixels are too many for parts, which are of pictures of up to {most} in squares of 32x32"
    )]
    TooLarge {
        /// Pixels, with those around that ambient occlusion looks at.
        pixels: u64,
        /// Most pixels.
        most: u64,
    },
    /// The file is no part.
    #[error("{part}: byte 0: not a part of a picture, which `rayset render --part` writes")]
    Magic {
        /// The file.
        part: String,
    },
    /// The part was written in another version of the format.
    #[error(
        "{part}: byte 8: version {found} of parts, and this program reads version {expected}: render all parts and \
         merge them with one program"
    )]
    Version {
        /// The part.
        part: String,
        /// The version found.
        found: u32,
        /// The version that is read.
        expected: u32,
    },
    /// The part is damaged or incomplete.
    #[error("{part}: byte {at}: {what}: the part is damaged or incomplete; render it again")]
    Damaged {
        /// The part.
        part: String,
        /// Where.
        at: u64,
        /// What is wrong, and what was expected.
        what: String,
    },
    /// No parts are given.
    #[error("there are no parts to join")]
    None,
    /// Parts are missing.
    #[error("of {of} parts {} {} missing: {}; render {} again", missing.len(), are(missing), ranges(missing, *of), them(missing))]
    Missing {
        /// Their numbers, from 1.
        missing: Vec<u32>,
        /// The number of parts of the picture.
        of: u32,
    },
    /// A part is unfinished, because its render was interrupted.
    #[error(
        "{part}: its render was interrupted, and {finished} of its {pixels} pixels are there: go on with it, or \
         render it again"
    )]
    Unfinished {
        /// The part.
        part: String,
        /// Pixels that it has.
        finished: u64,
        /// Pixels of its share.
        pixels: u64,
    },
    /// An unfinished part is not of what is to be rendered.
    #[error(
        "{part} is of another render: {what}; go on with its input and options, or begin anew without it"
    )]
    OtherRender {
        /// The part.
        part: String,
        /// What differs from what is to be rendered, and how.
        what: String,
    },
    /// Two parts are the same share.
    #[error("{first} and {second} are both part {share}: leave one of them out")]
    Double {
        /// One of them.
        first: String,
        /// The other.
        second: String,
        /// Their share.
        share: Share,
    },
    /// A part is of another picture.
    #[error("{part} is of another picture than {first}: {what}; {advice}")]
    Foreign {
        /// The part.
        part: String,
        /// The part that it is compared with.
        first: String,
        /// What differs, and how.
        what: String,
        /// What to do.
        advice: &'static str,
    },
    /// The memory is too small to join the parts.
    #[error("{given} bytes of memory are too few to join these parts: at least {needed} are needed")]
    Memory {
        /// The memory given.
        given: u64,
        /// The least.
        needed: u64,
    },
    /// The sink refused a part of the picture.
    #[error("the picture could not be written: {0}")]
    Sink(SinkError),
}

impl PartError {
    /// The system's error of reading a part.
    pub(super) fn read(part: &str, source: io::Error) -> Self {
        Self::Read { part: part.to_owned(), source }
    }

    pub(super) fn damaged(part: &str, at: u64, what: impl Into<String>) -> Self {
        Self::Damaged { part: part.to_owned(), at, what: what.into() }
    }
}

fn are(missing: &[u32]) -> &'static str {
    if missing.len() == 1 { "is" } else { "are" }
}

fn them(missing: &[u32]) -> &'static str {
    if missing.len() == 1 { "it" } else { "them" }
}

/// `2/8, 5/8 to 7/8`, the first of them.
fn ranges(missing: &[u32], of: u32) -> String {
    /// Most ranges that are named.
    const NAMED: usize = 12;
    let mut ranges: Vec<(u32, u32)> = Vec::new();
    for &number in missing {
        match ranges.last_mut() {
            Some((_, last)) if *last + 1 == number => *last = number,
            _ => ranges.push((number, number)),
        }
    }
    let mut named: Vec<String> = ranges
        .iter()
        .take(NAMED)
        .map(|&(a, b)| if a == b { format!("{a}/{of}") } else { format!("{a}/{of} to {b}/{of}") })
        .collect();
    if ranges.len() > NAMED {
        named.push("and more".into());
    }
    named.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_parts_are_named_in_ranges() {
        let said = |missing: &[u32]| PartError::Missing { missing: missing.to_vec(), of: 9 }.to_string();
        assert_eq!(said(&[4]), "of 9 parts 1 is missing: 4/9; render it again");
        assert_eq!(said(&[1, 2, 3, 7]), "of 9 parts 4 are missing: 1/9 to 3/9, 7/9; render them again");
    }
}

//! A picture of its parts.

use anyhow::{Context, Result};
use rayset::CancelToken;
use rayset::output::Destination;
use rayset::parts::Joined;

use super::sanity::Census;
use super::sink::PictureSink;
use crate::part_note::Note;

/// How a picture is made of its parts.
pub(crate) struct Joining<'a> {
    /// What is being done, in a word.
    pub(crate) doing: &'static str,
    /// Who looks at its pixels.
    pub(crate) census: Option<Census>,
    /// A comment in its file, unless it is empty.
    pub(crate) comment: &'a str,
}

/// Writes the picture of some parts. Returns who has looked at its pixels.
pub(crate) fn write_joined(
    joined: &Joined,
    output: &Destination,
    joining: Joining<'_>,
) -> Result<Option<Census>> {
    let note = Note::decode(joined.note()).with_context(|| {
        format!("cannot write {}: its parts are of no render by this program", output.path().display())
    })?;
    let mut sink = PictureSink::create(output, &joined.region(), joined.size(), note, joining.comment)?
        .doing(joining.doing);
    if let Some(census) = joining.census {
        sink = sink.seen_by(census);
    }
    joined.bands(&CancelToken::new(), &mut sink)?;
    sink.finish()
}

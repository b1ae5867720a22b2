//! An array of a file.

use std::io::{self, Read};
use std::path::Path;

use super::fault::Fault;
use super::header::{Header, MOST_HEADER_BYTES, text_place};
use super::zip::{Member, arrays};
use rayset_store::storage::is_of_reading;

/// Largest number of arrays of an archive that are looked at.
const MOST_ARRAYS: usize = 256;

/// An array with its header, which is known to be whole.
#[derive(Clone, Debug)]
pub(crate) struct Array {
    pub(crate) member: Member,
    pub(crate) header: Header,
}

impl Array {
    /// Reads the header of an array.
    pub(crate) fn open(path: &Path, member: Member) -> Result<Self, Fault> {
        let fail = |at: u64, what: &str| {
            let name =
                if member.name.is_empty() { String::new() } else { format!("the array {}: ", member.name) };
            Fault::Wrong { at: member.start + at, what: format!("{name}{what}") }
        };
        // What the system says is not that the header is cut off; nor is what a decompressor says.
        let early = |error: io::Error| match is_of_reading(&error) {
            true => Fault::Io(error),
            false => fail(0, "the header of the array is cut off"),
        };
        let mut data = member.open(path, 0)?;
        let mut head = vec![0; member.bytes.min(12) as usize];
        data.read_exact(&mut head).map_err(early)?;
        let (start, length) = text_place(&head)
            .ok_or_else(|| fail(0, "expected the header of NumPy's format, version 1 to 3"))?;
        if length > MOST_HEADER_BYTES || start as u64 + length > member.bytes {
            return Err(fail(8, &format!("a header of {length} bytes is too long, or cut off")));
        }
        // Of the first version two bytes of the text have been read.
        let mut text = head[start..].to_vec();
        data.take(length.saturating_sub(text.len() as u64)).read_to_end(&mut text).map_err(early)?;
        text.truncate(length as usize);
        if (text.len() as u64) < length {
            return Err(fail(8, "the header of the array is cut off"));
        }
        let header = Header::parse(&text, start).map_err(|(at, what)| fail(at, &what))?;
        let needed =
            header.count().checked_mul(header.element_bytes as u64).and_then(|n| n.checked_add(header.bytes));
        if needed.is_none_or(|needed| needed > member.bytes) {
            let what = format!(
                "an array of {} elements of {} bytes, and {} bytes follow its header; it is cut off",
                header.shape_text(),
                header.element_bytes,
                member.bytes - header.bytes
            );
            return Err(fail(header.bytes, &what));
        }
        Ok(Self { member, header })
    }

    /// All arrays of an archive, up to a number that is large for one.
    pub(crate) fn all(path: &Path) -> Result<Vec<Self>, Fault> {
        let members = arrays(path)?.into_iter().take(MOST_ARRAYS);
        members.map(|member| Self::open(path, member)).collect()
    }
}

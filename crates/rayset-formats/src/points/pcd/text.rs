//! The points of an ASCII file: lines of numbers, which become records as binary files have them.

use super::header::Field;
use crate::points::roles;
use rayset_base::text_numbers::TextNumber;

/// Appends the record of a line to `record`.
pub(super) fn parse(line: &[u8], fields: &[Field], record: &mut Vec<u8>) -> Result<(), String> {
    let text = std::str::from_utf8(line).map_err(|_| "not text, in a file that says it is ASCII")?;
    let mut words = text.split_ascii_whitespace();
    let wanted = || fields.iter().map(|field| field.count).sum::<usize>();
    for field in fields {
        for _ in 0..field.count {
            let word =
                words.next().ok_or_else(|| format!("fewer numbers than the {} of a point", wanted()))?;
            let (bytes, count) = TextNumber::parse(&field.kind, word)
                .ok_or_else(|| format!("`{}` is no number of type {}", roles::excerpt(word), field.kind))?;
            record.extend_from_slice(&bytes[..count]);
        }
    }
    match words.count() {
        0 => Ok(()),
        more => Err(format!("{more} numbers more than the {} of a point", wanted())),
    }
}

//! The points of an ASCII file: lines of numbers, which become records as binary files have them.

use super::header::Field;
use crate::points::{ColumnType, roles};

/// Appends the record of a line to `record`.
pub(super) fn parse(line: &[u8], fields: &[Field], record: &mut Vec<u8>) -> Result<(), String> {
    let text = std::str::from_utf8(line).map_err(|_| "not text, in a file that says it is ASCII")?;
    let mut words = text.split_ascii_whitespace();
    let wanted = || fields.iter().map(|field| field.count).sum::<usize>();
    for field in fields {
        for _ in 0..field.count {
            let word =
                words.next().ok_or_else(|| format!("fewer numbers than the {} of a point", wanted()))?;
            number(word, field.kind, record)
                .ok_or_else(|| format!("`{}` is no number of type {}", roles::excerpt(word), field.kind))?;
        }
    }
    match words.count() {
        0 => Ok(()),
        more => Err(format!("{more} numbers more than the {} of a point", wanted())),
    }
}

/// Appends the bytes of a number; `None` if it is none of its type.
fn number(word: &str, kind: ColumnType, record: &mut Vec<u8>) -> Option<()> {
    macro_rules! put {
        ($t:ty) => {
            record.extend_from_slice(&word.parse::<$t>().ok()?.to_le_bytes())
        };
    }
    match kind {
        ColumnType::U8 => put!(u8),
        ColumnType::I8 => put!(i8),
        ColumnType::U16 => put!(u16),
        ColumnType::I16 => put!(i16),
        ColumnType::U32 => put!(u32),
        ColumnType::I32 => put!(i32),
        ColumnType::U64 => put!(u64),
        ColumnType::I64 => put!(i64),
        ColumnType::F32 => put!(f32),
        ColumnType::F64 => put!(f64),
    }
    Some(())
}

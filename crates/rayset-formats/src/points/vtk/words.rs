//! Types and names as legacy files of VTK write them.

use crate::points::ColumnType;

/// A type of numbers: its column type, and its bytes in a binary file. `None` in place of a type
/// that columns do not have.
pub(super) fn type_of(name: &str) -> Option<(Option<ColumnType>, u64)> {
    let kind = match name.to_ascii_lowercase().as_str() {
        "unsigned_char" | "vtktypeuint8" => ColumnType::U8,
        "char" | "signed_char" | "vtktypeint8" => ColumnType::I8,
        "unsigned_short" | "vtktypeuint16" => ColumnType::U16,
        "short" | "vtktypeint16" => ColumnType::I16,
        "unsigned_int" | "vtktypeuint32" => ColumnType::U32,
        // Identifiers are written as integers of 32 bits.
        "int" | "vtktypeint32" | "vtkidtype" => ColumnType::I32,
        "unsigned_long" | "vtktypeuint64" => ColumnType::U64,
        "long" | "vtktypeint64" => ColumnType::I64,
        "float" => ColumnType::F32,
        "double" => ColumnType::F64,
        "bit" => return Some((None, 0)),
        _ => return None,
    };
    Some((Some(kind), kind.bytes() as u64))
}

/// A name whose special characters are written as `%20`.
pub(super) fn decoded(name: &str) -> String {
    let mut bytes = Vec::new();
    let mut rest = name.as_bytes();
    while let Some((&first, after)) = rest.split_first() {
        let code = after.get(..2).filter(|_| first == b'%').and_then(|hex| std::str::from_utf8(hex).ok());
        match code.and_then(|hex| u8::from_str_radix(hex, 16).ok()) {
            Some(byte) => (bytes.push(byte), rest = &after[2..]).1,
            None => (bytes.push(first), rest = after).1,
        }
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

//! Types, names and numbers as legacy files of VTK write them.

use std::io::{self, BufRead, Read};

use super::part;
use crate::points::ColumnType;

/// Longest number in text.
const MOST_NUMBER_BYTES: usize = 64;

/// A type of numbers: its column type, and its bytes in a binary file. `None` in place of a type that columns do not have.
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

/// Numbers in text, separated by white space, as little-endian bytes.
pub(super) struct Numbers<R> {
    pub(super) text: R,
    pub(super) kind: ColumnType,
    pub(super) ready: Vec<u8>,
    pub(super) done: u64,
}

impl<R: BufRead> Numbers<R> {
    fn word(&mut self) -> io::Result<Vec<u8>> {
        let mut word = Vec::new();
        loop {
            let held = self.text.fill_buf()?;
            let Some(&byte) = held.first() else { break };
            if byte.is_ascii_whitespace() && !word.is_empty() {
                break;
            }
            self.text.consume(1);
            if !byte.is_ascii_whitespace() {
                word.push(byte);
            }
            if word.len() > MOST_NUMBER_BYTES {
                break;
            }
        }
        Ok(word)
    }
}

impl<R: BufRead> Read for Numbers<R> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        if self.ready.is_empty() {
            let word = self.word()?;
            if word.is_empty() {
                return Ok(0);
            }
            self.done += 1;
            let number = std::str::from_utf8(&word).ok().and_then(|word| part::parse(self.kind, word));
            self.ready = number.ok_or_else(|| {
                let what = format!("number {}: `{}` is no {}", self.done, word.escape_ascii(), self.kind);
                io::Error::new(io::ErrorKind::InvalidData, what)
            })?;
        }
        let now = self.ready.len().min(out.len());
        out[..now].copy_from_slice(&self.ready[..now]);
        self.ready.drain(..now);
        Ok(now)
    }
}

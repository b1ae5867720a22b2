//! The header of a PLY file: elements and their properties, checked but not yet interpreted.
//!
//! Format: Greg Turk, *The PLY Polygon File Format* (1994), with the size-suffixed type names in later use.

use std::io::BufRead;
use std::path::Path;

use super::{ColumnType, Place, ReadError};

/// Longest header accepted, so that a file of another kind is not searched to its end.
const HEADER_LIMIT: u64 = 1 << 20;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    Ascii,
    LittleEndian,
    BigEndian,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn from_name(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    /// The type of a column of such numbers.
    pub(super) fn column_type(self) -> ColumnType {
        match self {
            Self::I8 => ColumnType::I8,
            Self::U8 => ColumnType::U8,
            Self::I16 => ColumnType::I16,
            Self::U16 => ColumnType::U16,
            Self::I32 => ColumnType::I32,
            Self::U32 => ColumnType::U32,
            Self::F32 => ColumnType::F32,
            Self::F64 => ColumnType::F64,
        }
    }

    pub(super) fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The value at the start of `bytes`, which must hold at least [`size`](Self::size) bytes.
    #[inline]
    pub(super) fn decode(self, bytes: &[u8], big: bool) -> f64 {
        macro_rules! number {
            ($t:ty, $n:literal) => {{
                let mut b = [0_u8; $n];
                b.copy_from_slice(&bytes[..$n]);
                if big {
                    b.reverse();
                }
                <$t>::from_le_bytes(b) as f64
            }};
        }
        match self {
            Self::I8 => number!(i8, 1),
            Self::U8 => number!(u8, 1),
            Self::I16 => number!(i16, 2),
            Self::U16 => number!(u16, 2),
            Self::I32 => number!(i32, 4),
            Self::U32 => number!(u32, 4),
            Self::F32 => number!(f32, 4),
            Self::F64 => number!(f64, 8),
        }
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Property {
    Scalar { name: String, kind: Scalar },
    List { count: Scalar, item: Scalar },
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Element {
    pub(super) name: String,
    pub(super) count: u64,
    pub(super) properties: Vec<Property>,
}

impl Element {
    /// Bytes of one record, or `None` where a list makes them vary.
    pub(super) fn stride(&self) -> Option<usize> {
        self.properties.iter().try_fold(0, |sum, p| match p {
            Property::Scalar { kind, .. } => Some(sum + kind.size()),
            Property::List { .. } => None,
        })
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Header {
    pub(super) encoding: Encoding,
    pub(super) elements: Vec<Element>,
    /// Bytes and lines that the header takes, its last line included.
    pub(super) bytes: u64,
    pub(super) lines: u64,
}

impl Header {
    pub(super) fn read(path: &Path, input: &mut impl BufRead) -> Result<Self, ReadError> {
        let mut header = Self { encoding: Encoding::Ascii, elements: Vec::new(), bytes: 0, lines: 0 };
        let mut format_seen = false;
        let mut line = Vec::new();
        loop {
            let place = Place::Line(header.lines + 1);
            let fail = |what: String| ReadError::malformed(path, place, what);
            line.clear();
            let mut limited = std::io::Read::take(&mut *input, HEADER_LIMIT - header.bytes);
            let read = limited
                .read_until(b'\n', &mut line)
                .map_err(|source| ReadError::Io { path: path.to_owned(), source })?;
            if read == 0 {
                return Err(fail("the header ends without `end_header`".into()));
            }
            header.bytes += read as u64;
            header.lines += 1;
            let text = std::str::from_utf8(&line).map_err(|_| fail("the header is not text".into()))?;
            let words: Vec<&str> = text.split_ascii_whitespace().collect();
            if header.lines == 1 {
                if words != ["ply"] {
                    return Err(fail("not a PLY file: expected `ply`".into()));
                }
                continue;
            }
            match words.as_slice() {
                [] | ["comment" | "obj_info", ..] => {}
                ["format", encoding, _version] => {
                    format_seen = true;
                    header.encoding = match *encoding {
                        "ascii" => Encoding::Ascii,
                        "binary_little_endian" => Encoding::LittleEndian,
                        "binary_big_endian" => Encoding::BigEndian,
                        other => return Err(fail(format!("unknown format `{other}`"))),
                    };
                }
                ["element", name, count] => {
                    let count =
                        count.parse().map_err(|_| fail(format!("`{count}` is not a number of records")))?;
                    header.elements.push(Element { name: (*name).into(), count, properties: Vec::new() });
                }
                ["property", rest @ ..] => {
                    let element = header
                        .elements
                        .last_mut()
                        .ok_or_else(|| fail("`property` before any `element`".into()))?;
                    let kind = |name: &str| {
                        Scalar::from_name(name).ok_or_else(|| fail(format!("unknown type `{name}`")))
                    };
                    element.properties.push(match rest {
                        ["list", count, item, _name] => {
                            Property::List { count: kind(count)?, item: kind(item)? }
                        }
                        [scalar, name] => Property::Scalar { name: (*name).into(), kind: kind(scalar)? },
                        _ => return Err(fail("expected `property TYPE NAME`".into())),
                    });
                }
                ["end_header"] => break,
                [word, ..] => return Err(fail(format!("unknown keyword `{word}`"))),
            }
        }
        if !format_seen {
            return Err(ReadError::malformed(path, Place::Line(header.lines), "no `format` line"));
        }
        Ok(header)
    }
}

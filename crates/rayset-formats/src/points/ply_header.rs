//! The header of a PLY file: elements and their properties, checked but not yet interpreted.
//!
//! Format: Greg Turk, *The PLY Polygon File Format* (1994), with the size-suffixed type names in
//! later use. `comment` and `obj_info` lines are limited only by the length of the whole header.

use std::io::{self, BufRead, Read};
use std::path::Path;

use super::{ColumnType, Place, ReadError, roles};
use rayset_base::regular_file::held;

/// Longest header accepted, in bytes, so that a file of another kind is not searched to its end.
const HEADER_LIMIT: u64 = 64 << 20;
/// Longest line of a declaration in bytes, and the part of a comment that is examined.
const LINE_LIMIT: u64 = 1 << 10;
/// Largest total number of elements and properties.
const DECLARATION_LIMIT: usize = 4096;
/// Longest description made from comments, in bytes.
const DESCRIPTION_LIMIT: usize = 512;

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

    /// The column type for these numbers.
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

    /// Whether this type can represent `value`; always true for floats, which are rounded.
    pub(super) fn holds(self, value: f64) -> bool {
        let within = |min: f64, max: f64| value >= min && value <= max && value.fract() == 0.0;
        match self {
            Self::I8 => within(i8::MIN.into(), i8::MAX.into()),
            Self::U8 => within(0.0, u8::MAX.into()),
            Self::I16 => within(i16::MIN.into(), i16::MAX.into()),
            Self::U16 => within(0.0, u16::MAX.into()),
            Self::I32 => within(i32::MIN.into(), i32::MAX.into()),
            Self::U32 => within(0.0, u32::MAX.into()),
            Self::F32 | Self::F64 => true,
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
    List { name: String, count: Scalar, item: Scalar },
}

impl Property {
    pub(super) fn name(&self) -> &str {
        match self {
            Self::Scalar { name, .. } | Self::List { name, .. } => name,
        }
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Element {
    pub(super) name: String,
    pub(super) count: u64,
    pub(super) properties: Vec<Property>,
}

impl Element {
    /// Whether vertices have what COLMAP writes: positions, normals and colours, in this order.
    pub(super) fn has_layout_of_colmap(&self) -> bool {
        const NAMES: [&str; 9] = ["x", "y", "z", "nx", "ny", "nz", "red", "green", "blue"];
        self.properties.len() == NAMES.len()
            && self.properties.iter().zip(NAMES).enumerate().all(|(place, (property, name))| {
                let wanted = if place < 6 { Scalar::F32 } else { Scalar::U8 };
                matches!(property, Property::Scalar { name: found, kind } if found == name && *kind == wanted)
            })
    }

    /// Bytes of a record, or `None` if lists make the length vary.
    pub(super) fn stride(&self) -> Option<usize> {
        self.properties.iter().try_fold(0, |sum, p| match p {
            Property::Scalar { kind, .. } => Some(sum + kind.size()),
            Property::List { .. } => None,
        })
    }

    /// The indices of the properties x, y and z, or what is wrong with them.
    pub(super) fn axes(&self) -> Result<[usize; 3], String> {
        // A list cannot be a coordinate, whatever its name.
        let name = |p: &Property| match p {
            Property::Scalar { name, .. } => name.clone(),
            Property::List { .. } => String::new(),
        };
        let names: Vec<String> = self.properties.iter().map(name).collect();
        let [Some(x), Some(y), Some(z)] = roles::axes(&names) else {
            let found: Vec<&str> = self.properties.iter().map(Property::name).take(8).collect();
            let found = if found.is_empty() { "nothing".to_owned() } else { found.join(", ") };
            return Err(format!("the `{}` element lacks x, y or z; it has {found}", self.name));
        };
        for axis in [x, y, z] {
            if names.iter().filter(|n| **n == names[axis]).count() > 1 {
                return Err(format!(
                    "the `{}` element has two properties called `{}`",
                    self.name, names[axis]
                ));
            }
        }
        Ok([x, y, z])
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Header {
    pub(super) encoding: Encoding,
    pub(super) elements: Vec<Element>,
    /// Format and comments, in at most 512 bytes.
    pub(super) description: String,
    /// Length of the header in bytes and in lines, including its last line.
    pub(super) bytes: u64,
    pub(super) lines: u64,
    /// The byte that ends a line: a carriage return if nothing follows that of the first line.
    pub(super) line_end: u8,
}

impl Header {
    pub(super) fn read(path: &Path, input: &mut impl BufRead) -> Result<Self, ReadError> {
        let mut header = Self {
            encoding: Encoding::Ascii,
            elements: Vec::new(),
            description: String::new(),
            bytes: 0,
            lines: 0,
            line_end: b'\n',
        };
        let start = held(input).map_err(ReadError::io(path))?;
        if start.starts_with(b"ply\r") && start.get(4).is_some_and(|&byte| byte != b'\n') {
            header.line_end = b'\r';
        }
        let mut format = None;
        let mut comments = String::new();
        let mut declared = 0;
        let mut line = Vec::new();
        loop {
            let place = Place::Line(header.lines + 1);
            let fail = |what: String| ReadError::malformed(path, place, what);
            header.bytes += read_line(input, &mut line, HEADER_LIMIT - header.bytes, header.line_end)
                .map_err(ReadError::io(path))?;
            header.lines += 1;
            let text = String::from_utf8_lossy(&line);
            let words: Vec<&str> = text.split_ascii_whitespace().collect();
            if header.lines == 1 {
                if words != ["ply"] {
                    return Err(fail("not a PLY file: expected `ply` on the first line".into()));
                }
                continue;
            }
            let is_whole = line.last() == Some(&header.line_end);
            if header.bytes == HEADER_LIMIT && !is_whole {
                return Err(fail(format!("a header of more than {HEADER_LIMIT} bytes")));
            }
            if line.is_empty() {
                return Err(fail("the file ends before `end_header`".into()));
            }
            let is_comment = matches!(words.as_slice(), ["comment" | "obj_info", ..]);
            if line.len() as u64 == LINE_LIMIT && !is_whole && !is_comment {
                return Err(fail(format!("a line of more than {LINE_LIMIT} bytes that is no comment")));
            }
            match words.as_slice() {
                [] => {}
                ["comment" | "obj_info", rest @ ..] => add_comment(&mut comments, rest),
                ["format", encoding, version] => {
                    header.encoding = match *encoding {
                        "ascii" => Encoding::Ascii,
                        "binary_little_endian" => Encoding::LittleEndian,
                        "binary_big_endian" => Encoding::BigEndian,
                        other => {
                            let other = roles::excerpt(other);
                            return Err(fail(format!(
                                "unknown format `{other}`; expected ascii, binary_little_endian or binary_big_endian"
                            )));
                        }
                    };
                    format = Some(format!("PLY {} {encoding}", roles::excerpt(version)));
                }
                ["element", name, count] => {
                    let count = count.parse().map_err(|_| {
                        let count = roles::excerpt(count);
                        fail(format!("`{count}` is not a number of records; expected a whole number, as in `element vertex 1000`"))
                    })?;
                    if header.elements.iter().any(|e| e.name == *name) {
                        return Err(fail(format!("a second element called `{}`", roles::excerpt(name))));
                    }
                    header.elements.push(Element { name: (*name).into(), count, properties: Vec::new() });
                    declared += 1;
                }
                ["property", rest @ ..] => {
                    let element = header
                        .elements
                        .last_mut()
                        .ok_or_else(|| fail("`property` before any `element`".into()))?;
                    element.properties.push(property(rest).map_err(fail)?);
                    declared += 1;
                }
                ["end_header"] => break,
                [word, ..] => {
                    return Err(fail(format!(
                        "`{}` where format, comment, obj_info, element, property or end_header was expected",
                        roles::excerpt(word)
                    )));
                }
            }
            if declared > DECLARATION_LIMIT {
                return Err(fail(format!("more than {DECLARATION_LIMIT} elements and properties")));
            }
        }
        header.description = format.ok_or_else(|| {
            ReadError::malformed(path, Place::Line(header.lines), "no `format` line before `end_header`")
        })?;
        header.description.push_str(&comments);
        header.description.truncate(header.description.floor_char_boundary(DESCRIPTION_LIMIT));
        Ok(header)
    }
}

fn property(words: &[&str]) -> Result<Property, String> {
    let kind = |name: &str| {
        Scalar::from_name(name).ok_or_else(|| {
            format!(
                "unknown type `{}`; expected char, uchar, short, ushort, int, uint, float, double, or int8 to float64",
                roles::excerpt(name)
            )
        })
    };
    match words {
        ["list", count, item, name] => {
            Ok(Property::List { name: (*name).into(), count: kind(count)?, item: kind(item)? })
        }
        [scalar, name] => Ok(Property::Scalar { name: (*name).into(), kind: kind(scalar)? }),
        _ => Err("expected `property TYPE NAME` or `property list TYPE TYPE NAME`".into()),
    }
}

/// Reads a line; of long comments, only the start is kept. Returns the number of bytes read, at
/// most `limit`.
fn read_line(input: &mut impl BufRead, line: &mut Vec<u8>, limit: u64, last: u8) -> io::Result<u64> {
    line.clear();
    let mut read = input.take(LINE_LIMIT.min(limit)).read_until(last, line)? as u64;
    let is_comment =
        [&b"comment"[..], b"obj_info"].iter().any(|word| line.trim_ascii_start().starts_with(word));
    while is_comment && line.last() != Some(&last) && read < limit {
        let buffer = match input.fill_buf() {
            Ok(buffer) => buffer,
            Err(e) if e.kind() == io::ErrorKind::Interrupted => continue,
            Err(e) => return Err(e),
        };
        let end = buffer.iter().position(|&b| b == last);
        let most = usize::try_from(limit - read).unwrap_or(usize::MAX);
        let part = end.map_or(buffer.len(), |at| at + 1).min(most);
        if part == 0 {
            break;
        }
        if end.is_some_and(|at| at < part) {
            line.push(last);
        }
        input.consume(part);
        read += part as u64;
    }
    Ok(read)
}

/// Adds a comment to a description, unless it may contain a path.
fn add_comment(comments: &mut String, words: &[&str]) {
    let text = words.join(" ").replace(char::is_control, " ");
    if !text.is_empty() && !text.contains(['/', '\\']) && comments.len() < DESCRIPTION_LIMIT {
        comments.push_str("; ");
        comments.push_str(&text);
    }
}

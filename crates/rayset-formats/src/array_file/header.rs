//! The header of an array: its shape, and what its elements are.
//!
//! The layout is that of `numpy.lib.format`, versions 1 to 3.

use super::literal::{self, Literal};
use rayset_base::numbers::Stored;

pub(crate) const MAGIC: &[u8] = b"\x93NUMPY";
/// Longest header in bytes, and largest element.
pub(crate) const MOST_HEADER_BYTES: u64 = 1 << 20;
const MOST_ELEMENT_BYTES: u64 = 1 << 16;
/// Largest number of numbers of an element.
const MOST_FIELDS: usize = 4096;

/// The type of a number: `f` and 4 of `<f4`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Scalar {
    /// Truths are [`Stored::U8`].
    pub(crate) stored: Stored,
    pub(crate) big_endian: bool,
}

/// A number, or several in a row, of each element.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Field {
    /// Empty if the array is not structured.
    pub(crate) name: String,
    /// Its byte in the element.
    pub(crate) offset: usize,
    pub(crate) scalar: Scalar,
    pub(crate) components: usize,
}

/// What an array consists of.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Header {
    /// Bytes before the array.
    pub(crate) bytes: u64,
    pub(crate) shape: Vec<u64>,
    pub(crate) fortran: bool,
    pub(crate) element_bytes: usize,
    pub(crate) is_structured: bool,
    /// Of the elements, those that are numbers.
    pub(crate) fields: Vec<Field>,
    /// What an element is as it is written, `<U5`; empty if the array is structured.
    pub(crate) descr: String,
}

/// Where the text of a header begins and how long it is: from the magic number on. `None` if it is
/// none.
pub(crate) fn text_place(head: &[u8]) -> Option<(usize, u64)> {
    let rest = head.strip_prefix(MAGIC)?;
    match *rest {
        [1, _, a, b, ..] => Some((10, u64::from(u16::from_le_bytes([a, b])))),
        [2 | 3, _, a, b, c, d, ..] => Some((12, u64::from(u32::from_le_bytes([a, b, c, d])))),
        _ => None,
    }
}

impl Header {
    /// Parses the text of a header that begins at byte `start` of the array's file.
    pub(crate) fn parse(text: &[u8], start: usize) -> Result<Self, (u64, String)> {
        let bytes = (start + text.len()) as u64;
        let text = String::from_utf8_lossy(text);
        let literal = literal::parse(&text)
            .map_err(|(at, what)| ((start + at) as u64, format!("the header: {what}")))?;
        let fail = |what: &str| (start as u64, format!("the header: {what}"));
        let shape = literal
            .get("shape")
            .and_then(Literal::numbers)
            .ok_or_else(|| fail("expected a `shape` of numbers"))?;
        let Some(Literal::Bool(fortran)) = literal.get("fortran_order") else {
            return Err(fail("expected `fortran_order`, True or False"));
        };
        let descr = literal.get("descr").ok_or_else(|| fail("expected `descr`, the type of the elements"))?;
        let mut fields = Vec::new();
        let element_bytes = element(descr, "", 0, 1, &mut fields).map_err(|what| fail(&what))?;
        Ok(Self {
            bytes,
            shape,
            fortran: *fortran,
            element_bytes: element_bytes as usize,
            is_structured: descr.list().is_some(),
            fields,
            descr: descr.text().map(excerpt).unwrap_or_default(),
        })
    }

    /// Number of elements.
    pub(crate) fn count(&self) -> u64 {
        self.shape.iter().fold(1, |all, &n| all.saturating_mul(n))
    }

    /// `1065` or `32314 × 3`.
    pub(crate) fn shape_text(&self) -> String {
        self.shape.iter().map(u64::to_string).collect::<Vec<_>>().join(" × ")
    }
}

/// Notes the numbers of `count` elements of a type, from byte `offset` on. Returns their bytes.
fn element(
    descr: &Literal,
    name: &str,
    offset: u64,
    count: u64,
    fields: &mut Vec<Field>,
) -> Result<u64, String> {
    let size = match descr {
        Literal::Text(code) => {
            let (size, scalar) = scalar(code)?;
            if let Some(scalar) = scalar {
                if fields.len() == MOST_FIELDS {
                    return Err(format!("more than {MOST_FIELDS} numbers an element"));
                }
                fields.push(Field {
                    name: name.to_owned(),
                    offset: offset.min(MOST_ELEMENT_BYTES) as usize,
                    scalar,
                    components: count.min(MOST_ELEMENT_BYTES) as usize,
                });
            }
            size
        }
        Literal::List(members) => {
            let mut at = offset;
            for member in members {
                let fail = || "expected a name and a type for each part of an element".to_owned();
                let (own, kind, shape) = match member.list().ok_or_else(fail)? {
                    [own, kind] => (own, kind, Vec::new()),
                    [own, kind, shape] => (own, kind, shape.numbers().ok_or_else(fail)?),
                    _ => return Err(fail()),
                };
                // A part may have a title and a name.
                let own = own.text().or_else(|| own.list()?.last()?.text()).ok_or_else(fail)?;
                let own = if name.is_empty() { own.to_owned() } else { format!("{name}_{own}") };
                let parts = shape.iter().fold(1_u64, |all, &n| all.saturating_mul(n));
                at = at.saturating_add(element(kind, &own, at, parts, fields)?);
            }
            // The parts of further elements are not named.
            at - offset
        }
        _ => return Err("expected a type such as '<f8', or a list of names and types".into()),
    };
    let bytes = size.saturating_mul(count);
    if offset.saturating_add(bytes) > MOST_ELEMENT_BYTES {
        return Err(format!("elements of more than {MOST_ELEMENT_BYTES} bytes"));
    }
    Ok(bytes)
}

/// The bytes of a value of a type such as `<f8`, and what number it is; `None` if it is none.
fn scalar(code: &str) -> Result<(u64, Option<Scalar>), String> {
    let fail = || format!("`{}` is no type of elements", excerpt(code));
    let kind = code.trim_start_matches(['<', '>', '|', '=']);
    let letter = kind.chars().next().ok_or_else(fail)?;
    // Of dates the unit follows: `<M8[ns]`.
    let digits = kind[letter.len_utf8()..].split('[').next().unwrap_or_default();
    let size = if digits.is_empty() { None } else { Some(digits.parse::<u64>().map_err(|_| fail())?) };
    let number = |stored: Stored| {
        let scalar = Scalar { stored, big_endian: code.starts_with('>') };
        Ok((stored.bytes() as u64, Some(scalar)))
    };
    match (letter, size) {
        ('f', Some(2)) => number(Stored::F16),
        ('f', Some(4)) => number(Stored::F32),
        ('f', Some(8)) => number(Stored::F64),
        ('u' | 'b', Some(1)) => number(Stored::U8),
        ('u', Some(2)) => number(Stored::U16),
        ('u', Some(4)) => number(Stored::U32),
        ('u', Some(8)) => number(Stored::U64),
        ('i', Some(1)) => number(Stored::I8),
        ('i', Some(2)) => number(Stored::I16),
        ('i', Some(4)) => number(Stored::I32),
        ('i', Some(8)) => number(Stored::I64),
        ('O', _) => Err("its elements are objects of Python, which are not read; save numbers".into()),
        ('U', Some(size)) => Ok((size.saturating_mul(4), None)),
        ('S' | 'a' | 'V' | 'f' | 'c' | 'M' | 'm', Some(size)) => Ok((size, None)),
        _ => Err(fail()),
    }
}

/// The start of a text from a file, shortened for a message and without control characters.
fn excerpt(text: &str) -> String {
    let short: String = text.trim().chars().map(|c| if c.is_control() { ' ' } else { c }).take(40).collect();
    if short.len() < text.trim().len() { short + "…" } else { short }
}

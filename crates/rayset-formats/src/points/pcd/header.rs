//! The header of a PCD file: its fields, the number of points, and how they are stored.

use std::io::{BufRead, Read};

use crate::points::lines::first_line_end;
use crate::points::stream::Stream;
use crate::points::{ColumnType, Place, ReadError, roles};
use rayset_base::regular_file::held;

/// Longest header in bytes.
const HEADER_LIMIT: u64 = 256 << 10;
/// Most fields, and most numbers of a point.
const FIELD_LIMIT: usize = 1024;
const NUMBER_LIMIT: usize = 8192;

/// How points are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Data {
    /// A line for each.
    Ascii,
    /// Records, one after another.
    Binary,
    /// One block of LZF: all numbers of the first field, then all of the second, and so on.
    Compressed,
}

/// A field of a point: one number or several.
#[derive(Clone, Debug)]
pub(super) struct Field {
    pub(super) name: String,
    pub(super) kind: ColumnType,
    pub(super) count: usize,
}

impl Field {
    pub(super) fn bytes(&self) -> usize {
        self.kind.bytes() * self.count
    }
}

pub(super) struct Header {
    pub(super) version: String,
    pub(super) fields: Vec<Field>,
    pub(super) points: u64,
    pub(super) data: Data,
    /// Place and orientation of the sensor as written; empty if it is the origin, or nothing is
    /// said.
    pub(super) viewpoint: String,
    /// Length of the header in bytes and in lines.
    pub(super) bytes: u64,
    pub(super) lines: u64,
    /// The byte that ends its lines, and those of points as text.
    pub(super) line_end: u8,
}

/// The lines of a header by their first words; `None` if there is none.
#[derive(Default)]
struct Lines {
    version: Option<String>,
    fields: Option<Vec<String>>,
    size: Option<Vec<String>>,
    kind: Option<Vec<String>>,
    count: Option<Vec<String>>,
    width: Option<u64>,
    height: Option<u64>,
    points: Option<u64>,
    viewpoint: Option<String>,
}

impl Header {
    /// Reads the header, up to the end of its last line, which begins with `DATA`.
    pub(super) fn read(input: &mut Stream) -> Result<Self, ReadError> {
        let path = input.path().to_owned();
        let (mut bytes, mut number) = (0, 0);
        let mut lines = Lines::default();
        let mut line = Vec::new();
        // What follows the header may be binary, so its first line decides.
        let start = held(input).map_err(ReadError::io(&path))?;
        let line_end = first_line_end(start);
        loop {
            line.clear();
            let read = input.by_ref().take(HEADER_LIMIT - bytes).read_until(line_end, &mut line);
            bytes += read.map_err(ReadError::io(&path))? as u64;
            number += 1;
            let fail = |what: String| ReadError::malformed(&path, Place::Line(number), what);
            if line.last() != Some(&line_end) {
                return Err(fail(if bytes == HEADER_LIMIT {
                    format!("a header of more than {HEADER_LIMIT} bytes")
                } else {
                    "the file ends before a line that begins with `DATA`".into()
                }));
            }
            let text = String::from_utf8_lossy(&line);
            let words: Vec<&str> = text.split_ascii_whitespace().collect();
            let Some(data) = lines.take(&words).map_err(fail)? else { continue };
            let (fields, points) = lines.fields().and_then(|f| Ok((f, lines.points()?))).map_err(fail)?;
            let viewpoint = lines.viewpoint.unwrap_or_default();
            let is_origin = viewpoint
                .split(' ')
                .filter_map(|w| w.parse::<f64>().ok())
                .eq([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]);
            return Ok(Self {
                version: lines.version.unwrap_or_default(),
                fields,
                points,
                data,
                viewpoint: if is_origin { String::new() } else { viewpoint },
                bytes,
                lines: number,
                line_end,
            });
        }
    }
}

impl Lines {
    /// Takes in a line. Returns how points are stored if it is the last.
    fn take(&mut self, words: &[&str]) -> Result<Option<Data>, String> {
        let Some((&key, rest)) = words.split_first().filter(|(key, _)| !key.starts_with('#')) else {
            return Ok(None);
        };
        let list = || Some(rest.iter().map(|word| (*word).to_owned()).collect());
        match key {
            "VERSION" => self.version = Some(roles::excerpt(&rest.join(" "))),
            "FIELDS" | "COLUMNS" => self.fields = list(),
            "SIZE" => self.size = list(),
            "TYPE" => self.kind = list(),
            "COUNT" => self.count = list(),
            "WIDTH" => self.width = Some(whole(key, rest)?),
            "HEIGHT" => self.height = Some(whole(key, rest)?),
            "POINTS" => self.points = Some(whole(key, rest)?),
            "VIEWPOINT" => self.viewpoint = Some(roles::excerpt(&rest.join(" "))),
            "DATA" => {
                return match rest {
                    ["ascii"] => Ok(Some(Data::Ascii)),
                    ["binary"] => Ok(Some(Data::Binary)),
                    ["binary_compressed"] => Ok(Some(Data::Compressed)),
                    _ => Err(format!(
                        "`{}` where ascii, binary or binary_compressed was expected after `DATA`",
                        roles::excerpt(&rest.join(" "))
                    )),
                };
            }
            other => {
                let other = roles::excerpt(other);
                return Err(format!(
                    "`{other}` where VERSION, FIELDS, SIZE, TYPE, COUNT, WIDTH, HEIGHT, VIEWPOINT, POINTS or DATA was \
                     expected"
                ));
            }
        }
        Ok(None)
    }

    fn fields(&self) -> Result<Vec<Field>, String> {
        let names = self.fields.as_ref().ok_or("no line `FIELDS` before `DATA`")?;
        if names.len() > FIELD_LIMIT {
            return Err(format!("{} fields; up to {FIELD_LIMIT} are read", names.len()));
        }
        let count = names.len();
        // What is not said is a single number of four bytes.
        let or = |given: &Option<Vec<String>>, key: &str, usual: &str| match given {
            None => Ok(vec![usual.to_owned(); count]),
            Some(words) if words.len() == count => Ok(words.clone()),
            Some(words) => Err(format!("{key} has {} words for {count} fields", words.len())),
        };
        let (sizes, kinds) = (or(&self.size, "SIZE", "4")?, or(&self.kind, "TYPE", "F")?);
        let counts = or(&self.count, "COUNT", "1")?;
        let mut fields = Vec::new();
        let mut numbers = 0_usize;
        for (i, name) in names.iter().enumerate() {
            let kind = column_type(&kinds[i], &sizes[i]).ok_or_else(|| {
                format!(
                    "field `{}` of type {} and size {}; expected F of 4 or 8 bytes, or I or U of 1, 2, 4 or 8",
                    roles::excerpt(name),
                    roles::excerpt(&kinds[i]),
                    roles::excerpt(&sizes[i])
                )
            })?;
            let count = whole("COUNT", &[&counts[i]])?;
            numbers = numbers.saturating_add(usize::try_from(count).unwrap_or(usize::MAX));
            if numbers > NUMBER_LIMIT {
                return Err(format!("a point of more than {NUMBER_LIMIT} numbers"));
            }
            fields.push(Field { name: name.clone(), kind, count: count as usize });
        }
        Ok(fields)
    }

    /// The number of points, of which there must be a grid if its size is said.
    fn points(&self) -> Result<u64, String> {
        let grid = match (self.width, self.height) {
            (Some(width), height) => {
                let height = height.unwrap_or(1);
                let all = width.checked_mul(height);
                Some(all.ok_or_else(|| format!("a grid of {width} × {height} points, which no file has"))?)
            }
            _ => None,
        };
        match (self.points, grid) {
            (Some(points), Some(grid)) if points != grid => {
                Err(format!("POINTS is {points}, where WIDTH and HEIGHT make {grid}"))
            }
            (Some(points), _) | (None, Some(points)) => Ok(points),
            (None, None) => Err("neither `POINTS` nor `WIDTH` before `DATA`".into()),
        }
    }
}

fn whole(key: &str, words: &[&str]) -> Result<u64, String> {
    let text = words.join(" ");
    text.parse().map_err(|_| format!("`{}` where {key} has a whole number", roles::excerpt(&text)))
}

fn column_type(kind: &str, size: &str) -> Option<ColumnType> {
    Some(match (kind, size) {
        ("F", "4") => ColumnType::F32,
        ("F", "8") => ColumnType::F64,
        ("U", "1") => ColumnType::U8,
        ("U", "2") => ColumnType::U16,
        ("U", "4") => ColumnType::U32,
        ("U", "8") => ColumnType::U64,
        ("I", "1") => ColumnType::I8,
        ("I", "2") => ColumnType::I16,
        ("I", "4") => ColumnType::I32,
        ("I", "8") => ColumnType::I64,
        _ => return None,
    })
}

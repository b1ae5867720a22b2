//! XYZ, TXT, CSV, ASC, PTS: one point a line, separators and header detected, columns nameable.
//!
//! The first line that holds data decides the separator (`;`, `,`, tab or blanks). A first line with a word that is
//! no number is a header; a first line with a lone integer is the count of a PTS file. Without a header, four
//! columns are x y z intensity, six x y z red green blue, seven x y z intensity red green blue. Lines that start
//! with `#` or `//` are comments, save that a first one may hold the column names. An empty field is a missing
//! value (NaN); any other field that is no number is an error.

use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use super::{ColorDepth, ColumnInfo, ColumnType, Place, PointBatch, PointSource, ReadError, Schema};

const LINE_LIMIT: u64 = 1 << 16;

/// The points of a text file.
#[derive(Debug)]
pub struct TextSource {
    path: PathBuf,
    input: BufReader<File>,
    separator: Separator,
    /// For each column of the file: axis (0–2), or 3 + index of the attribute, or nothing.
    columns: Vec<Option<usize>>,
    schema: Schema,
    selected: Vec<usize>,
    /// For each column of the schema, the selected column that it goes to.
    targets: Vec<Option<usize>>,
    line_number: u64,
    line: Vec<u8>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Separator {
    Blank,
    Char(char),
}

impl Separator {
    fn detect(line: &str) -> Self {
        match [';', ',', '\t'].into_iter().find(|&c| line.contains(c)) {
            Some(c) => Self::Char(c),
            None => Self::Blank,
        }
    }

    fn fields(self, line: &str) -> impl Iterator<Item = &str> {
        let (blank, char) = match self {
            Self::Blank => (Some(line.split_ascii_whitespace()), None),
            Self::Char(c) => (None, Some(line.split(c).map(str::trim))),
        };
        blank.into_iter().flatten().chain(char.into_iter().flatten())
    }
}

impl TextSource {
    /// Opens a file and settles its columns, from `names` if given.
    ///
    /// # Errors
    /// [`ReadError`] where the file cannot be read, holds no data, or its columns do not include x, y and z.
    pub fn open(path: &Path, names: Option<&[String]>) -> Result<Self, ReadError> {
        let io = |source| ReadError::Io { path: path.to_owned(), source };
        let mut source = Self {
            path: path.to_owned(),
            input: BufReader::with_capacity(256 << 10, File::open(path).map_err(io)?),
            separator: Separator::Blank,
            columns: Vec::new(),
            schema: Schema::new(Vec::new(), ColorDepth::Guess),
            selected: Vec::new(),
            targets: Vec::new(),
            line_number: 0,
            line: Vec::new(),
        };
        let mut found_names = source.find_data()?;
        if let Some(names) = names {
            found_names = names.to_vec();
        }
        source.settle_columns(&found_names)?;
        Ok(source)
    }

    /// Moves to the first line of data and returns the names of its columns.
    fn find_data(&mut self) -> Result<Vec<String>, ReadError> {
        let mut header: Option<Vec<String>> = None;
        let mut position = 0;
        loop {
            let read = self.next_line()?;
            if read == 0 {
                let what = "no line of numbers found";
                return Err(ReadError::malformed(&self.path, Place::Line(self.line_number), what));
            }
            let start = position;
            position += read;
            let text = self.text()?.trim().trim_start_matches('\u{feff}');
            let comment = text.starts_with('#') || text.starts_with("//");
            let content = text.trim_start_matches(['#', '/']).trim();
            if content.is_empty() {
                continue;
            }
            let separator = Separator::detect(content);
            let fields: Vec<&str> = separator.fields(content).map(|f| f.trim_matches('"')).collect();
            let numbers = fields.iter().filter(|f| f.parse::<f64>().is_ok()).count();
            if !comment && fields.len() == 1 && numbers == 1 {
                continue; // the count of a PTS file
            }
            if !comment && fields.len() >= 3 && fields[..3].iter().all(|f| f.parse::<f64>().is_ok()) {
                let columns = fields.len();
                let names = header.filter(|h| h.len() == columns).unwrap_or_else(|| default_names(columns));
                self.separator = separator;
                let io = |source| ReadError::Io { path: self.path.clone(), source };
                self.input.seek(SeekFrom::Start(start as u64)).map_err(io)?;
                self.line_number -= 1;
                return Ok(names);
            }
            let lower: Vec<String> = fields.iter().map(|f| canonical(&f.to_ascii_lowercase())).collect();
            let is_header = ["x", "y", "z"].iter().all(|axis| lower.iter().any(|f| f == axis));
            if is_header {
                header = Some(lower);
            } else if !comment {
                let what =
                    format!("expected numbers or a header with x, y and z, found `{}`", excerpt(content));
                return Err(ReadError::malformed(&self.path, Place::Line(self.line_number), what));
            }
        }
    }

    fn settle_columns(&mut self, names: &[String]) -> Result<(), ReadError> {
        for name in names {
            let name = canonical(&name.to_ascii_lowercase());
            self.columns.push(match ["x", "y", "z"].iter().position(|axis| *axis == name) {
                Some(axis) => Some(axis),
                None if name.is_empty() || name == "-" => None,
                None => {
                    self.schema.columns.push(ColumnInfo::new(name, ColumnType::F64));
                    Some(2 + self.schema.columns.len())
                }
            });
        }
        for (axis, name) in ["x", "y", "z"].iter().enumerate() {
            if !self.columns.contains(&Some(axis)) {
                let what =
                    format!("no column called {name}; name the columns, as in `--columns x,y,z,intensity`");
                return Err(ReadError::malformed(&self.path, Place::Line(self.line_number), what));
            }
        }
        self.targets = vec![None; self.schema.columns.len()];
        Ok(())
    }

    /// Reads a line into `self.line`; returns its bytes, 0 at the end.
    fn next_line(&mut self) -> Result<usize, ReadError> {
        self.line.clear();
        let read = (&mut self.input)
            .take(LINE_LIMIT)
            .read_until(b'\n', &mut self.line)
            .map_err(|source| ReadError::Io { path: self.path.clone(), source })?;
        self.line_number += u64::from(read > 0);
        if read as u64 == LINE_LIMIT {
            let what = format!("a line of more than {LINE_LIMIT} bytes");
            return Err(ReadError::malformed(&self.path, Place::Line(self.line_number), what));
        }
        Ok(read)
    }

    fn text(&self) -> Result<&str, ReadError> {
        std::str::from_utf8(&self.line)
            .map_err(|_| ReadError::malformed(&self.path, Place::Line(self.line_number), "not text"))
    }
}

impl PointSource for TextSource {
    fn schema(&self) -> &Schema {
        &self.schema
    }

    fn count_hint(&self) -> Option<u64> {
        None
    }

    fn path(&self) -> Option<&Path> {
        Some(&self.path)
    }

    fn select(&mut self, columns: &[usize]) {
        self.targets.fill(None);
        for (target, &column) in columns.iter().enumerate() {
            self.targets[column] = Some(target);
        }
        self.selected = columns.to_vec();
    }

    fn fill(&mut self, batch: &mut PointBatch, limit: usize) -> Result<(), ReadError> {
        batch.reset(&self.schema, &self.selected);
        while batch.len() < limit {
            if self.next_line()? == 0 {
                break;
            }
            let text = self.text()?.trim();
            if text.is_empty() || text.starts_with('#') || text.starts_with("//") {
                continue;
            }
            let fail = |what: String| ReadError::malformed(&self.path, Place::Line(self.line_number), what);
            let mut fields = self.separator.fields(text);
            let mut position = [0.0; 3];
            for (index, column) in self.columns.iter().enumerate() {
                let field = fields.next().ok_or_else(|| {
                    fail(format!("{index} values where {} were expected", self.columns.len()))
                })?;
                let target = match *column {
                    None => continue,
                    Some(axis @ 0..3) => Ok(axis),
                    Some(attribute) => match self.targets[attribute - 3] {
                        None => continue,
                        Some(target) => Err(target),
                    },
                };
                let value = if field.is_empty() {
                    f64::NAN
                } else {
                    field.parse().map_err(|_| fail(format!("`{}` is not a number", excerpt(field))))?
                };
                match target {
                    Ok(axis) => position[axis] = value,
                    Err(target) => batch.columns[target].push(value),
                }
            }
            batch.position.push(position);
        }
        Ok(())
    }
}

fn default_names(columns: usize) -> Vec<String> {
    let names: &[&str] = match columns {
        4 => &["x", "y", "z", "intensity"],
        6 => &["x", "y", "z", "red", "green", "blue"],
        7 => &["x", "y", "z", "intensity", "red", "green", "blue"],
        _ => &["x", "y", "z"],
    };
    (0..columns)
        .map(|i| names.get(i).map_or_else(|| format!("column{}", i + 1), |n| (*n).to_owned()))
        .collect()
}

fn canonical(name: &str) -> String {
    match name {
        "r" => "red",
        "g" => "green",
        "b" => "blue",
        "easting" => "x",
        "northing" => "y",
        "elevation" | "height" => "z",
        other => other,
    }
    .to_owned()
}

/// The start of a text, short enough for a message.
fn excerpt(text: &str) -> String {
    let mut short: String = text.chars().filter(|c| !c.is_control()).take(40).collect();
    if short.len() < text.len() {
        short.push('…');
    }
    short
}

//! Legacy files of VTK: where their points are, and the arrays that go with them.
//!
//! A file is a sequence of sections, each a line with a keyword and numbers, in text or in
//! big-endian binary. Nothing says where a section is, so all before it are passed.

use std::io::{self, BufRead, BufReader, Read};
use std::path::Path;

use super::part::{Part, Stored, VtkArray};
use super::words::{decoded, type_of};
use crate::points::roles::excerpt;
use crate::points::{Place, ReadError};
use crate::words;
use rayset_store::storage::input_file::InputFile;

pub(super) const MAGIC: &[u8] = b"# vtk DataFile";
/// Longest line with a keyword.
const MOST_LINE_BYTES: u64 = 64 << 10;
/// Largest number of arrays of points, and of all arrays, each of which takes some time.
const MOST_ARRAYS: usize = 4096;
const MOST_SEEN: usize = 1 << 16;

/// Whose data the arrays that follow are.
#[derive(Clone, Copy, PartialEq)]
enum Of {
    /// Nobody's: they stand before.
    File,
    Points(u64),
    Cells(u64),
}

struct Scanner<'a> {
    path: &'a Path,
    input: BufReader<InputFile>,
    at: u64,
    bytes: u64,
    is_text: bool,
    of: Of,
    points: Option<VtkArray>,
    rows: u64,
    arrays: Vec<VtkArray>,
    /// All arrays so far, of points or not.
    seen: usize,
}

/// Finds the points of a file and their arrays.
pub(super) fn scan(path: &Path) -> Result<(Part, String), ReadError> {
    let file = InputFile::open(path).map_err(ReadError::io(path))?;
    let bytes = file.length().map_err(ReadError::io(path))?;
    let input = BufReader::with_capacity(1 << 16, file);
    let mut scanner = Scanner {
        path,
        input,
        at: 0,
        bytes,
        is_text: false,
        of: Of::File,
        points: None,
        rows: 0,
        arrays: Vec::new(),
        seen: 0,
    };
    let title = scanner.head()?;
    while let Some(line) = scanner.line()? {
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        if let Some((keyword, words)) = words.split_first() {
            scanner.section(&keyword.to_ascii_uppercase(), words)?;
        }
    }
    let Some(positions) = scanner.points.take() else {
        return Err(scanner.wrong("there is no section POINTS in this file"));
    };
    Ok((Part { rows: scanner.rows, positions, arrays: scanner.arrays }, title))
}

impl Scanner<'_> {
    fn wrong(&self, what: impl Into<String>) -> ReadError {
        ReadError::malformed(self.path, Place::Byte(self.at), what)
    }

    /// Reads the first lines. Returns the title.
    fn head(&mut self) -> Result<String, ReadError> {
        let first = self.line()?.unwrap_or_default();
        if !first.as_bytes().starts_with(MAGIC) {
            return Err(self.wrong("expected `# vtk DataFile Version` in the first line"));
        }
        let title = self.line()?.unwrap_or_default();
        let encoding = self.line()?.unwrap_or_default();
        self.is_text = match encoding.trim().to_ascii_uppercase().as_str() {
            "ASCII" => true,
            "BINARY" => false,
            other => {
                return Err(
                    self.wrong(format!("`{}` in the third line; expected ASCII or BINARY", excerpt(other)))
                );
            }
        };
        Ok(format!("{}, {}", excerpt(&first[2..]), excerpt(&title)))
    }

    /// The next line, without its end. `None` at the end of the file.
    fn line(&mut self) -> Result<Option<String>, ReadError> {
        let mut line = Vec::new();
        let read = (&mut self.input).take(MOST_LINE_BYTES).read_until(b'\n', &mut line);
        let read = read.map_err(ReadError::io(self.path))? as u64;
        if read == MOST_LINE_BYTES && line.last() != Some(&b'\n') {
            return Err(self.wrong(format!(
                "a line of more than {MOST_LINE_BYTES} bytes, where a section should begin"
            )));
        }
        self.at += read;
        Ok((read > 0).then(|| String::from_utf8_lossy(&line).trim_end().to_owned()))
    }

    /// A line that must be there.
    fn next_line(&mut self) -> Result<String, ReadError> {
        loop {
            match self.line()? {
                None => return Err(self.wrong("the file ends within a section")),
                Some(line) if line.trim().is_empty() => {}
                Some(line) => return Ok(line),
            }
        }
    }

    fn number(&self, words: &[&str], place: usize, what: &str) -> Result<u64, ReadError> {
        let word = words.get(place).copied().unwrap_or_default();
        word.parse().map_err(|_| self.wrong(format!("`{}` is not {what}", excerpt(word))))
    }

    fn section(&mut self, keyword: &str, words: &[&str]) -> Result<(), ReadError> {
        match keyword {
            "DATASET" => self.dataset(words),
            "POINTS" => {
                let rows = self.number(words, 0, "the number of points")?;
                let positions = self.array("points", words.get(1).copied().unwrap_or("float"), 3, rows)?;
                let positions = positions.filter(|array| !array.kind.is_integer());
                self.points =
                    Some(positions.ok_or_else(|| self.wrong("points of another type than float or double"))?);
                self.rows = rows;
                Ok(())
            }
            "VERTICES" | "LINES" | "POLYGONS" | "TRIANGLE_STRIPS" | "CELLS" => self.cells(words),
            "CELL_TYPES" => {
                let count = self.number(words, 0, "the number of cells")?;
                self.array("", "int", 1, count).map(|_| ())
            }
            "POINT_DATA" | "CELL_DATA" => {
                let count = self.number(words, 0, "a number of points or cells")?;
                self.of = if keyword == "POINT_DATA" { Of::Points(count) } else { Of::Cells(count) };
                if self.of == Of::Points(count) && count != self.rows {
                    return Err(
                        self.wrong(format!("POINT_DATA of {count} points, where there are {}", self.rows))
                    );
                }
                Ok(())
            }
            "FIELD" => self.field(words),
            "METADATA" => self.metadata(),
            _ => self.attribute(keyword, words),
        }
    }

    /// Passes what is told of the array before, up to an empty line.
    fn metadata(&mut self) -> Result<(), ReadError> {
        while self.line()?.is_some_and(|line| !line.trim().is_empty()) {}
        Ok(())
    }

    fn dataset(&self, words: &[&str]) -> Result<(), ReadError> {
        let kind = words.first().map(|word| word.to_ascii_uppercase()).unwrap_or_default();
        match kind.as_str() {
            "POLYDATA" | "UNSTRUCTURED_GRID" => Ok(()),
            "STRUCTURED_POINTS" | "RECTILINEAR_GRID" | "STRUCTURED_GRID" => Err(self.wrong(format!(
                "the data set is {kind}, a grid and no points; ParaView's filter Resample To Image and Save Data as .vti \
                 make a volume of it that opens"
            ))),
            _ => Err(self.wrong(format!(
                "the data set is `{}`; expected POLYDATA or UNSTRUCTURED_GRID, as ParaView's Save Data writes points",
                excerpt(&kind)
            ))),
        }
    }

    /// Passes cells: their numbers in one list or, since version 5.1, in two with names and types.
    fn cells(&mut self, words: &[&str]) -> Result<(), ReadError> {
        let [first, second] =
            [0, 1].map(|place| self.number(words, place, "a number of cells or of their points"));
        let (first, second) = (first?, second?);
        if let Some(line) = self.peek_offsets()? {
            for (count, line) in [(first, Some(line)), (second, None)] {
                let line = line.map_or_else(|| self.next_line(), Ok)?;
                let kind = line.split_ascii_whitespace().nth(1).unwrap_or_default().to_owned();
                self.array("", &kind, 1, count)?;
            }
            return Ok(());
        }
        self.array("", "int", 1, second).map(|_| ())
    }

    /// The next line if it begins with OFFSETS; otherwise nothing is read.
    fn peek_offsets(&mut self) -> Result<Option<String>, ReadError> {
        const WORD: &[u8] = b"OFFSETS";
        let (start, mut word) = (self.at, Vec::new());
        let read = (&mut self.input).take(WORD.len() as u64).read_to_end(&mut word);
        self.at += read.map_err(ReadError::io(self.path))? as u64;
        self.go_to(start)?;
        if word == WORD { self.line() } else { Ok(None) }
    }

    /// Arrays with names: `FIELD name count`, then `name components rows type` for each.
    fn field(&mut self, words: &[&str]) -> Result<(), ReadError> {
        let count = self.number(words, 1, "the number of arrays")?;
        for _ in 0..count {
            let mut line = self.next_line()?;
            while line.starts_with("METADATA") {
                self.metadata()?;
                line = self.next_line()?;
            }
            let words: Vec<&str> = line.split_ascii_whitespace().collect();
            let (width, rows) = (
                self.number(&words, 1, "a number of components")?,
                self.number(&words, 2, "a number of rows")?,
            );
            let kind = words.get(3).copied().unwrap_or_default();
            let name = decoded(words.first().copied().unwrap_or_default());
            let array = self.array(&name, kind, width, rows)?;
            self.keep(array.filter(|_| Of::Points(rows) == self.of));
        }
        Ok(())
    }

    /// An array of points or of cells, or a table of colours.
    fn attribute(&mut self, keyword: &str, words: &[&str]) -> Result<(), ReadError> {
        let name = decoded(words.first().copied().unwrap_or_default());
        let last = words.last().copied().unwrap_or_default();
        let (kind, width) = match keyword {
            "SCALARS" => {
                let width =
                    if words.len() > 2 { self.number(words, 2, "a number of components")? } else { 1 };
                let (at, line) = (self.at, self.next_line()?);
                if !line.to_ascii_uppercase().starts_with("LOOKUP_TABLE") {
                    // It may be left out before text and is the first line of the numbers then.
                    self.go_to(at)?;
                }
                (words.get(1).copied().unwrap_or_default(), width)
            }
            "COLOR_SCALARS" => (
                if self.is_text { "float" } else { "unsigned_char" },
                self.number(words, 1, "a number of components")?,
            ),
            "LOOKUP_TABLE" => {
                let rows = self.number(words, 1, "a number of colours")?;
                let kind = if self.is_text { "float" } else { "unsigned_char" };
                return self.array("", kind, 4, rows).map(|_| ());
            }
            "VECTORS" | "NORMALS" => (last, 3),
            "TEXTURE_COORDINATES" => (last, self.number(words, 1, "a number of components")?),
            "TENSORS" => (last, 9),
            "TENSORS6" => (last, 6),
            "GLOBAL_IDS" | "PEDIGREE_IDS" | "EDGE_FLAGS" => (last, 1),
            _ => {
                let what = format!(
                    "`{}` is no section of a VTK file; the one before may have another length than it says",
                    excerpt(keyword)
                );
                return Err(self.wrong(what));
            }
        };
        let (Of::Points(rows) | Of::Cells(rows)) = self.of else {
            return Err(self.wrong(format!("{keyword} before POINT_DATA or CELL_DATA")));
        };
        let array = self.array(&name, kind, width, rows)?;
        self.keep(array.filter(|_| self.of == Of::Points(rows)));
        Ok(())
    }

    fn keep(&mut self, array: Option<VtkArray>) {
        if self.arrays.len() < MOST_ARRAYS {
            let array = array.filter(|array| !self.arrays.iter().any(|known| known.name == array.name));
            self.arrays.extend(array);
        }
    }

    /// Goes to a byte of the file. What is in the buffer already is not read again.
    fn go_to(&mut self, at: u64) -> Result<(), ReadError> {
        self.input.seek_relative(at as i64 - self.at as i64).map_err(ReadError::io(self.path))?;
        self.at = at;
        Ok(())
    }

    /// Passes the numbers of an array. `None` if they are of a type that columns do not have.
    fn array(
        &mut self,
        name: &str,
        kind: &str,
        width: u64,
        rows: u64,
    ) -> Result<Option<VtkArray>, ReadError> {
        self.seen += 1;
        if self.seen > MOST_SEEN {
            return Err(self.wrong(format!("more than {MOST_SEEN} arrays")));
        }
        let start = self.at;
        let count = width.saturating_mul(rows);
        if kind.eq_ignore_ascii_case("string") {
            return self.pass_texts(count).map(|()| None);
        }
        let Some((column, size)) = type_of(kind) else {
            return Err(self.wrong(format!("`{}` is no type of numbers that is known", excerpt(kind))));
        };
        let name = excerpt(name);
        if self.is_text {
            self.pass_numbers(count)?;
        } else {
            let bytes = if size == 0 { count.div_ceil(8) } else { count.saturating_mul(size) };
            let end = start.checked_add(bytes).filter(|end| *end <= self.bytes);
            let end = end.ok_or_else(|| {
                self.wrong(format!("{rows} × {width} numbers of the type {} are said to follow, and the file ends at byte {}", excerpt(kind), self.bytes))
            })?;
            self.go_to(end)?;
        }
        let stored =
            if self.is_text { Stored::Text(start) } else { Stored::Plain { start, big_endian: true } };
        let width = usize::try_from(width).ok().filter(|width| (1..=64).contains(width));
        Ok(column.zip(width).map(|(kind, width)| VtkArray { name, kind, width, stored }))
    }

    /// Passes numbers in text.
    fn pass_numbers(&mut self, count: u64) -> Result<(), ReadError> {
        let passed = words::pass(&mut self.input, count).map_err(ReadError::io(self.path))?;
        self.at += passed.bytes;
        if passed.missing > 0 {
            let there = count - passed.missing;
            return Err(self.wrong(format!("the file ends after {there} numbers of {count}")));
        }
        Ok(())
    }

    /// Passes texts: lines or, in binary, texts with their lengths before them, of which the first
    /// two bits say how many bytes they have.
    fn pass_texts(&mut self, count: u64) -> Result<(), ReadError> {
        for _ in 0..count {
            if self.is_text {
                if self.line()?.is_none() {
                    return Err(self.wrong("the file ends within an array of texts"));
                }
                continue;
            }
            let mut bytes = [0; 8];
            self.fill(&mut bytes[..1])?;
            let more = [7, 3, 1, 0][usize::from(bytes[0] >> 6)];
            self.fill(&mut bytes[1..1 + more])?;
            bytes[0] &= 0x3f;
            let length = bytes[..1 + more].iter().fold(0_u64, |n, &byte| n << 8 | u64::from(byte));
            let end = self.at.checked_add(length).filter(|end| *end <= self.bytes);
            let end = end.ok_or_else(|| self.wrong("a text that goes on beyond the end of the file"))?;
            self.go_to(end)?;
        }
        Ok(())
    }

    /// Reads bytes of an array of texts.
    fn fill(&mut self, bytes: &mut [u8]) -> Result<(), ReadError> {
        self.input.read_exact(bytes).map_err(|source| match source.kind() {
            io::ErrorKind::UnexpectedEof => self.wrong("the file ends within an array of texts"),
            _ => ReadError::io(self.path)(source),
        })?;
        self.at += bytes.len() as u64;
        Ok(())
    }
}

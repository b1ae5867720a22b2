//! Detects the layout of a text file: what precedes its points, and how its rows are read.

use super::number::DecimalMark;
use super::rows::{Separator, Splitter};
use crate::points::lines::Lines;
use crate::points::{ReadError, roles};

/// How the rows of a file are read, determined from its header and its first row.
pub(super) struct Layout {
    pub(super) separator: Separator,
    /// A name for each column; empty or `-` for columns that are skipped.
    pub(super) names: Vec<String>,
    pub(super) axes: [usize; 3],
    /// Line of the header, if the names come from one.
    pub(super) header_line: Option<u64>,
    /// The number of points stated before them, and its line.
    pub(super) count: Option<(u64, u64)>,
    /// The first row and the line on which it begins.
    pub(super) first: Vec<u8>,
    pub(super) first_line: u64,
}

pub(super) const CARRIAGE_RETURN: &str = "a carriage return within a line; lines must end with \\n or \\r\\n";

/// A line of names.
struct Header {
    line: u64,
    text: Vec<u8>,
    is_comment: bool,
}

/// The text of a comment; `None` if the line is not a comment.
pub(super) fn comment(line: &[u8]) -> Option<&[u8]> {
    let line = line.trim_ascii_start();
    if line.starts_with(b"#") || line.starts_with(b"//") {
        let from = line.iter().position(|b| !b"#/ \t".contains(b)).unwrap_or(line.len());
        return Some(&line[from..]);
    }
    None
}

/// The count on a line that contains nothing else; `None` for other lines.
pub(super) fn lone_count(line: &[u8]) -> Option<u64> {
    let digits = line.trim_ascii();
    let is_number = !digits.is_empty() && digits.iter().all(u8::is_ascii_digit);
    is_number.then(|| std::str::from_utf8(digits).ok()?.parse().ok()).flatten()
}

impl Layout {
    /// Reads up to the first row of numbers. `names` overrides the column names of the file.
    pub(super) fn find(lines: &mut Lines, names: Option<&[String]>) -> Result<Self, ReadError> {
        if let Some(names) = names {
            whole_axes(names).map_err(|axis| lines.fail(no_column(axis)))?;
        }
        let mut header: Option<Header> = None;
        let mut count = None;
        let mut record = Vec::new();
        loop {
            record.clear();
            if !lines.append(&mut record)? {
                return Err(lines.fail(match count {
                    Some((claimed, _)) => {
                        format!("no line of numbers found after the count of {claimed} points")
                    }
                    None => "no line of numbers found".to_owned(),
                }));
            }
            let line = lines.number();
            if record.trim_ascii().is_empty() {
                continue;
            }
            if let Some(content) = comment(&record) {
                let replaces = header.as_ref().is_none_or(|h| h.is_comment);
                if names.is_none() && replaces && is_header(content, true) {
                    header = Some(Header { line, text: content.to_vec(), is_comment: true });
                }
                continue;
            }
            // Which quotes open a value is unknown before the separator is; a whole record has an even number of them.
            let quotes = |part: &[u8]| part.iter().filter(|&&b| b == b'"').count();
            let mut open = quotes(&record);
            while open % 2 == 1 {
                let start = record.len();
                record.push(b'\n');
                if !lines.append(&mut record)? {
                    return Err(lines.fail_at(line, "a quote that is not closed"));
                }
                open += quotes(&record[start..]);
            }
            let has_header = header.as_ref().is_some_and(|h| !h.is_comment);
            if let (None, false, Some(claimed)) = (count, has_header, lone_count(&record)) {
                count = Some((claimed, line));
                continue;
            }
            if let Some((separator, found)) = settle(&record, names, header.as_ref()) {
                let header_line = header.filter(|_| names.is_none()).map(|h| h.line);
                let first = std::mem::take(&mut record);
                let layout = Self::checked(lines, separator, found, header_line, first, line)?;
                return Ok(Self { count, ..layout });
            }
            let may_be_header = if names.is_some() { header.is_none() } else { is_header(&record, false) };
            if has_header || !may_be_header {
                let wanted = match (&header, names) {
                    (Some(h), _) => {
                        format!("expected numbers under x, y and z of the header on line {}", h.line)
                    }
                    (None, Some(_)) => "expected numbers in the columns named x, y and z".to_owned(),
                    (None, None) => {
                        "expected numbers or a header with x, y and z (other columns can be named, as in \
                         `--columns x,y,z,intensity`)"
                            .to_owned()
                    }
                };
                if record.contains(&b'\r') {
                    return Err(lines.fail_at(line, CARRIAGE_RETURN));
                }
                let found = roles::excerpt(&String::from_utf8_lossy(&record));
                return Err(lines.fail_at(line, format!("{wanted}, found `{found}`")));
            }
            header = Some(Header { line, text: record.clone(), is_comment: false });
        }
    }

    /// Checks the first row against the names of its columns.
    fn checked(
        lines: &Lines,
        separator: Separator,
        names: Option<Vec<String>>,
        header_line: Option<u64>,
        first: Vec<u8>,
        first_line: u64,
    ) -> Result<Self, ReadError> {
        let row = Splitter::whole(separator, &first);
        let row = row.ok_or_else(|| lines.fail_at(first_line, "a quote that is not closed"))?;
        let mut names = names.unwrap_or_else(|| default_names(row.len() - usize::from(row.ends_empty())));
        // A header may end with a separator, as rows may.
        if header_line.is_some() && names.last().is_some_and(String::is_empty) {
            names.pop();
        }
        if !is_as_wide(&row, names.len()) {
            let by = header_line.map_or_else(
                || "--columns names".to_owned(),
                |line| format!("the header on line {line} names"),
            );
            let what = format!(
                "{} values where {by} {}; name every column, as in `--columns x,y,z,-,intensity`, with - for those \
                 of no interest",
                row.len(),
                names.len()
            );
            return Err(lines.fail_at(first_line, what));
        }
        for (index, name) in names.iter().enumerate() {
            if !is_skipped(name) && names[..index].contains(name) {
                let what = format!(
                    "two columns are called `{}`; name the columns, as in `--columns x,y,z,intensity,-`",
                    roles::excerpt(name)
                );
                return Err(lines.fail_at(header_line.unwrap_or(first_line), what));
            }
        }
        let axes = whole_axes(&names).map_err(|axis| lines.fail_at(first_line, no_column(axis)))?;
        Ok(Self { separator, names, axes, header_line, count: None, first, first_line })
    }
}

/// Whether a row has `columns` values; a separator may follow the last value.
#[inline]
pub(super) fn is_as_wide(row: &Splitter, columns: usize) -> bool {
    row.len() == columns || (row.len() == columns + 1 && row.ends_empty())
}

pub(super) fn is_skipped(name: &str) -> bool {
    name.is_empty() || name == "-"
}

fn no_column(axis: &str) -> String {
    format!("no column called {axis}; name the columns, as in `--columns x,y,z,intensity`")
}

fn whole_axes(names: &[String]) -> Result<[usize; 3], &'static str> {
    let [x, y, z] = roles::axes(names);
    Ok([x.ok_or("x")?, y.ok_or("y")?, z.ok_or("z")?])
}

/// Whether a line names x, y and z. The first word of a comment must be one of them, because a comment may be a sentence.
fn is_header(line: &[u8], is_comment: bool) -> bool {
    Separator::ALL.into_iter().any(|separator| {
        let names = Splitter::whole(separator, line).map(|row| row.names()).unwrap_or_default();
        whole_axes(&names).is_ok_and(|axes| !is_comment || axes.contains(&0))
    })
}

/// The separator with which `record` has numbers for x, y and z, and the names of the columns, if given.
///
/// The header and the rows may have different separators, but a common one is preferred. No row can be read both as
/// separated by commas and as separated by blanks with decimal commas: in numbers separated by commas, every blank is next
/// to a comma, whereas a decimal comma has a digit on either side.
fn settle(
    record: &[u8],
    names: Option<&[String]>,
    header: Option<&Header>,
) -> Option<(Separator, Option<Vec<String>>)> {
    let rows = Separator::ALL.into_iter().filter_map(|s| Some((s, Splitter::whole(s, record)?)));
    let rows: Vec<(Separator, Splitter)> = rows.filter(|(_, row)| row.len() >= 3).collect();
    if let Some(names) = names {
        let axes = whole_axes(names).ok()?;
        let fits = rows.iter().find(|(separator, row)| are_numbers(*separator, row, axes, true))?;
        return Some((fits.0, Some(names.to_vec())));
    }
    let Some(header) = header else {
        let fits = rows.iter().find(|(separator, row)| are_numbers(*separator, row, [0, 1, 2], false))?;
        return Some((fits.0, None));
    };
    let named = |separator| {
        let names = Splitter::whole(separator, &header.text)?.names();
        Some((whole_axes(&names).ok()?, names))
    };
    for (separator, row) in &rows {
        if let Some((axes, names)) = named(*separator)
            && are_numbers(*separator, row, axes, true)
        {
            return Some((*separator, Some(names)));
        }
    }
    let (axes, names) = Separator::ALL.into_iter().find_map(named)?;
    let fits = rows.iter().find(|(separator, row)| are_numbers(*separator, row, axes, true))?;
    Some((fits.0, Some(names)))
}

/// Whether the values at `axes` are numbers with the same decimal mark, or markers of missing values. An empty value counts
/// as missing only if the columns have names.
fn are_numbers(separator: Separator, row: &Splitter, axes: [usize; 3], may_be_empty: bool) -> bool {
    let mut mark = first_mark(separator);
    axes.into_iter().all(|axis| {
        axis < row.len() && {
            let field = row.field(axis);
            mark.parse(&field).is_ok() && (may_be_empty || !field.is_empty())
        }
    })
}

/// The decimal mark before any number has been read: if commas separate values, it is a point.
pub(super) fn first_mark(separator: Separator) -> DecimalMark {
    if separator == Separator::Comma { DecimalMark::Point } else { DecimalMark::Open }
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

//! Detects the layout of a text file: what precedes its points, and how its rows are read.

use super::rows::{Separator, Splitter};
use crate::points::decimal_mark::{DecimalMark, NotANumber, are_decimals};
use crate::points::lines::Lines;
use crate::points::{ReadError, roles, unnamed};

/// How the rows of a file are read, determined from its header and its first row.
pub(super) struct Layout {
    pub(super) separator: Separator,
    pub(super) mark: DecimalMark,
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
    /// Whether rows may have more values than there are names.
    pub(super) is_open_ended: bool,
    /// The step of the coordinates, if the first rows write each with the same number of decimals.
    pub(super) step: Option<[f64; 3]>,
}

/// Longest name of a column of a header that is a comment.
const LONGEST_NAME: usize = 24;
/// Most lines before the header, or the first row, that are neither.
const MOST_PREAMBLE: usize = 32;
/// Bytes of the rows that are looked at.
const SAMPLE_BYTES: usize = 64 << 10;
/// Fewer rows may have the same number of decimals by chance.
const FEWEST_ROWS_OF_A_STEP: usize = 8;

/// The columns of COLMAP's sparse points, as a comment of theirs names them; any number of others
/// follows.
const COLMAP: &[u8] = b"POINT3D_ID, X, Y, Z, R, G, B, ERROR, ";

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
        let mut is_open_ended = false;
        let mut record = Vec::new();
        // Lines of a title, which are neither a header nor a row; the first is said to be wrong if
        // nothing follows.
        let mut preamble: Vec<(u64, Vec<u8>)> = Vec::new();
        loop {
            record.clear();
            if !lines.append(&mut record)? {
                if let Some((line, first)) = preamble.first() {
                    return Err(lines.fail_at(*line, no_row(None, names, first)));
                }
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
                if names.is_none() && replaces && content.starts_with(COLMAP) {
                    let text = COLMAP.trim_ascii_end().to_vec();
                    header = Some(Header { line, text, is_comment: true });
                    is_open_ended = true;
                } else if names.is_none() && replaces && is_header(content, true) {
                    header = Some(Header { line, text: content.to_vec(), is_comment: true });
                }
                continue;
            }
            // Which quotes open a value is unknown before the separator is; a whole record has an
            // even number of them.
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
                // A line as wide as the first row names its columns, by names that are not known.
                let width = |line: &[u8]| Splitter::whole(separator, line).map(|row| row.len());
                let as_wide = |(_, line): &&(u64, Vec<u8>)| width(line) == width(&record);
                if let (None, Some((line, text))) = (&header, preamble.iter().find(as_wide)) {
                    return Err(lines.fail_at(*line, no_row(None, names, text)));
                }
                let header_line = header.filter(|_| names.is_none()).map(|h| h.line);
                let first = std::mem::take(&mut record);
                let layout = Self::checked(lines, separator, found, header_line, first, line)?;
                return Ok(Self { count, is_open_ended, ..layout });
            }
            let may_be_header = if names.is_some() { header.is_none() } else { is_header(&record, false) };
            if has_header || !may_be_header {
                if record.contains(&b'\r') {
                    return Err(lines.fail_at(line, CARRIAGE_RETURN));
                }
                if !has_header && names.is_none() && preamble.len() < MOST_PREAMBLE {
                    preamble.push((line, record.clone()));
                    continue;
                }
                let (line, text) = preamble.first().map_or((line, &record), |(line, text)| (*line, text));
                return Err(lines.fail_at(line, no_row(header.as_ref(), names, text)));
            }
            header = Some(Header { line, text: record.clone(), is_comment: false });
        }
    }

    /// Checks the first row against the names of its columns.
    fn checked(
        lines: &mut Lines,
        separator: Separator,
        names: Option<Vec<String>>,
        header_line: Option<u64>,
        first: Vec<u8>,
        first_line: u64,
    ) -> Result<Self, ReadError> {
        let row = Splitter::whole(separator, &first);
        let row = row.ok_or_else(|| lines.fail_at(first_line, "a quote that is not closed"))?;
        let texts = fields(lines, separator, &row)?;
        let mark = decimal_mark(separator, &texts);
        let mut names = match names {
            Some(names) => names,
            None => {
                let width = row.len() - usize::from(row.ends_empty());
                unnamed::names(width, &sample(mark, &texts))
            }
        };
        // A header may end with a separator, as rows may.
        if header_line.is_some() && names.last().is_some_and(String::is_empty) {
            names.pop();
        }
        let is_colmap = names.iter().any(|name| name == "POINT3D_ID") && row.len() > names.len();
        if !is_as_wide(&row, names.len()) && !is_colmap {
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
        if header_line.is_some() {
            // Of a header not every column needs to be of numbers: dates and names of things are
            // passed over.
            for (place, name) in names.iter_mut().enumerate() {
                let mut texts = texts.iter().filter_map(|row| row.get(place));
                if !axes.contains(&place) && texts.all(|text| is_word(mark, text)) {
                    *name = "-".to_owned();
                }
            }
        }
        Ok(Self {
            separator,
            mark,
            names,
            axes,
            header_line,
            count: None,
            first,
            first_line,
            is_open_ended: false,
            step: step(&texts, axes),
        })
    }
}

/// What is wrong with a line that is neither a header nor a row.
fn no_row(header: Option<&Header>, names: Option<&[String]>, line: &[u8]) -> String {
    let wanted = match (header, names) {
        (Some(h), _) => format!("expected numbers under x, y and z of the header on line {}", h.line),
        (None, Some(_)) => "expected numbers in the columns named x, y and z".to_owned(),
        (None, None) => "expected numbers or a header with x, y and z (other columns can be named, as in \
                         `--columns x,y,z,intensity`)"
            .to_owned(),
    };
    format!("{wanted}, found `{}`", roles::excerpt(&String::from_utf8_lossy(line)))
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

/// Whether a line names x, y and z. The first word of a comment must be one of them, because a
/// comment may be a sentence, unless it consists of names between separators.
fn is_header(line: &[u8], is_comment: bool) -> bool {
    Separator::ALL.into_iter().any(|separator| {
        let names = Splitter::whole(separator, line).map(|row| row.names()).unwrap_or_default();
        let is_sentence =
            || separator == Separator::Blank || names.iter().any(|name| name.len() > LONGEST_NAME);
        whole_axes(&names).is_ok_and(|axes| !is_comment || axes.contains(&0) || !is_sentence())
    })
}

/// The separator with which `record` has numbers for x, y and z, and the names of the columns, if
/// given.
///
/// The header and the rows may have different separators, but a common one is preferred. No row can
/// be read both as separated by commas and as separated by blanks with decimal commas: in numbers
/// separated by commas, every blank is next to a comma, whereas a decimal comma has a digit on
/// either side.
fn settle(
    record: &[u8],
    names: Option<&[String]>,
    header: Option<&Header>,
) -> Option<(Separator, Option<Vec<String>>)> {
    let rows = Separator::ALL.into_iter().filter_map(|s| Some((s, Splitter::whole(s, record)?)));
    let rows: Vec<(Separator, Splitter)> = rows.filter(|(_, row)| row.len() >= 3).collect();
    if let Some(names) = names {
        let axes = whole_axes(names).ok()?;
        let fits = rows.iter().find(|(_, row)| are_numbers(row, axes, true))?;
        return Some((fits.0, Some(names.to_vec())));
    }
    let Some(header) = header else {
        let fits = rows.iter().find(|(_, row)| are_numbers(row, [0, 1, 2], false))?;
        return Some((fits.0, None));
    };
    let named = |separator| {
        let names = Splitter::whole(separator, &header.text)?.names();
        Some((whole_axes(&names).ok()?, names))
    };
    for (separator, row) in &rows {
        if let Some((axes, names)) = named(*separator)
            && are_numbers(row, axes, true)
        {
            return Some((*separator, Some(names)));
        }
    }
    let (axes, names) = Separator::ALL.into_iter().find_map(named)?;
    let fits = rows.iter().find(|(_, row)| are_numbers(row, axes, true))?;
    Some((fits.0, Some(names)))
}

/// Whether the values at `axes` are numbers with the same decimal mark, or markers of missing
/// values. An empty value counts as missing only if the columns have names.
fn are_numbers(row: &Splitter, axes: [usize; 3], may_be_empty: bool) -> bool {
    // Between commas, another comma can only be quoted.
    let mut mark = DecimalMark::Open;
    axes.into_iter().all(|axis| {
        axis < row.len() && {
            let field = row.field(axis);
            mark.parse(&field).is_ok() && (may_be_empty || !field.is_empty())
        }
    })
}

/// The decimal mark before any number has been read: if commas separate values, it is a point,
/// unless quoted values of the first rows show that it is a comma.
fn decimal_mark(separator: Separator, rows: &[Vec<String>]) -> DecimalMark {
    let is_open = separator != Separator::Comma || are_decimals(rows.iter().flatten().map(String::as_str));
    if is_open { DecimalMark::Open } else { DecimalMark::Point }
}

/// The values of the first rows, of which `first` has been read.
fn fields(lines: &mut Lines, separator: Separator, first: &Splitter) -> Result<Vec<Vec<String>>, ReadError> {
    let texts = |row: &Splitter| (0..row.len()).map(|place| row.field(place).into_owned()).collect();
    let mut rows: Vec<Vec<String>> = vec![texts(first)];
    for line in lines.look_ahead(unnamed::ROWS, SAMPLE_BYTES)? {
        let row = Splitter::whole(separator, line).filter(|_| comment(line).is_none());
        rows.extend(row.filter(|row| row.len() == first.len()).map(|row| texts(&row)));
    }
    Ok(rows)
}

/// The numbers of the first rows; what is none is NaN.
fn sample(mut mark: DecimalMark, rows: &[Vec<String>]) -> Vec<Vec<f64>> {
    let mut number = |text: &String| mark.parse(text).unwrap_or(f64::NAN);
    rows.iter().map(|row| row.iter().map(&mut number).collect()).collect()
}

/// The step of the coordinates of some rows, if each axis has the same number of decimals in all of
/// them: a program that writes whole digits leaves trailing zeros out, and says nothing of a step.
fn step(rows: &[Vec<String>], axes: [usize; 3]) -> Option<[f64; 3]> {
    let mut steps = [0.0; 3];
    for (step, axis) in steps.iter_mut().zip(axes) {
        let mut decimals = rows.iter().map(|row| decimals(row.get(axis)?));
        let first = decimals.next()??;
        if rows.len() < FEWEST_ROWS_OF_A_STEP || !decimals.all(|count| count == Some(first)) {
            return None;
        }
        *step = 10_f64.powi(-(first as i32));
    }
    Some(steps)
}

/// The number of decimals of a number without exponent; `None` if there are none.
fn decimals(text: &str) -> Option<usize> {
    let (whole, fraction) = text.trim().split_once(['.', ','])?;
    let are_digits = |text: &str| text.bytes().all(|b| b.is_ascii_digit());
    let is_fixed = are_digits(whole.trim_start_matches(['+', '-'])) && are_digits(fraction);
    (is_fixed && (1..=12).contains(&fraction.len())).then_some(fraction.len())
}

/// Whether a value is neither a number, whatever its decimal mark, nor missing.
fn is_word(mut mark: DecimalMark, text: &str) -> bool {
    matches!(mark.parse(text), Err(NotANumber::Word))
}

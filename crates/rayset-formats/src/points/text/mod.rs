//! XYZ, TXT, CSV, ASC, PTS: one point per record; separators and header are detected, and columns
//! can be named.
//!
//! **Rows.** Values are separated by `;`, tabs, commas, or blanks (any number of blanks and tabs):
//! the first of these with which the first row has numbers for x, y and z. The layout of the first
//! row applies to the whole file, and a row with another number of values is an error. A separator
//! may follow the last value. Values may be quoted: within quotes, `""` is a quote, and separators
//! and line breaks are part of the value. A record is at most 64 KiB long. Lines end with `\n` or
//! `\r\n`, or in files without these with `\r`. Bytes of 0 behind the last line are passed over.
//! Empty lines, and lines that start with `#` or `//`, are skipped.
//!
//! **Numbers** are what Rust parses as `f64`, or have Fortran exponents, `1.0D+05`. If values are
//! not separated by commas, or the values of the first rows are quoted and show that a comma
//! separates no thousands, the decimal mark may be a comma between digits; a file has a single
//! decimal mark, that of the first number that has one. `1,5,2,5,3,5` is six values. An empty
//! value, `NaN`, `NA`, `N/A` and `null` are missing values and become NaN. Values of columns that
//! are not selected are not parsed, and may be any text.
//!
//! **Names** come from the caller, otherwise from a header, otherwise from the values of the first
//! rows (see [`unnamed`](super::unnamed)). A header is a line before the first row that names x, y
//! and z (see [`roles`](super::roles)), or a comment that does so and whose first name is one of
//! the three. It has a name for each value of a row; columns with an empty name are skipped.
//! COLMAP's `points3D.txt` names its columns in a comment, and has any number of values behind
//! them.
//!
//! **Counts.** A whole number alone on a line before the first row, as in PTS files, is the number
//! of points that follow, and must be correct. After them, another count and its points may follow,
//! and so on: all belong to the same cloud.

mod layout;
mod rows;

use std::path::Path;

use self::layout::Layout;
use self::rows::{Progress, Separator, Splitter};
use super::decimal_mark::{DecimalMark, NotANumber};
use super::file_source::{FileSource, RecordReader, Request};
use super::lines::Lines;
use super::stream::Stream;
use super::{ColorDepth, ColumnInfo, ColumnType, PointBatch, ReadError, Schema, reading, roles};
use rayset_base::geometry::DVec3;

/// The points of a text file.
pub(super) struct TextReader {
    lines: Lines,
    separator: Separator,
    mark: DecimalMark,
    /// Number of values in a row.
    width: usize,
    /// Whether a row may have more.
    is_open_ended: bool,
    axes: [usize; 3],
    /// The index in a row of each column of the schema.
    places: Vec<usize>,
    scan: Option<Scan>,
    /// The line read last, and whether it has yet to be used.
    line: Vec<u8>,
    is_held: bool,
    row: Splitter,
    /// Lines on which the current row and the first row begin.
    row_line: u64,
    first_line: u64,
}

/// A count in the file, and the points that follow it.
#[derive(Debug)]
struct Scan {
    claimed: u64,
    found: u64,
    line: u64,
}

impl TextReader {
    /// Opens a file and determines its columns, from `names` if given.
    ///
    /// # Errors
    /// [`ReadError`] if the file cannot be read, contains no data, or its columns do not include x,
    /// y and z.
    pub(super) fn open(path: &Path, names: Option<&[String]>) -> Result<FileSource<Self>, ReadError> {
        Self::of(Stream::open(path)?, names)
    }

    /// The points of a stream.
    pub(super) fn of(input: Stream, names: Option<&[String]>) -> Result<FileSource<Self>, ReadError> {
        let path = input.path().to_owned();
        let mut lines = Lines::of(input)?;
        let layout = Layout::find(&mut lines, names)?;
        let mut schema = Schema::new(Vec::new(), ColorDepth::Guess);
        let mut places = Vec::new();
        for (place, name) in layout.names.iter().enumerate() {
            if !layout.axes.contains(&place) && !layout::is_skipped(name) {
                let column = ColumnInfo::new(name, ColumnType::F64);
                schema.columns.push(if roles::is_class(name) { column.of_classes() } else { column });
                places.push(place);
            }
        }
        schema.roles = roles::colors(&schema.columns);
        schema.description = describe(&layout);
        schema.step = layout.step;
        let by = match (layout.header_line, names) {
            (_, Some(_)) => reading::BY_OPTION.to_owned(),
            (Some(line), None) => format!("the header on line {line}"),
            (None, None) => "the values of the first rows".to_owned(),
        };
        reading::note(&mut schema, &layout.names, layout.axes, &by);
        let x = &layout.names[layout.axes[0]];
        if layout.header_line.is_some() && roles::is_longitude(x) {
            schema.crs = "EPSG:4326".into();
        }
        if layout.is_open_ended {
            // Of COLMAP, whose cameras have y down.
            schema.up = Some(DVec3::NEG_Y);
        }
        let reader = Self {
            lines,
            separator: layout.separator,
            mark: layout.mark,
            width: layout.names.len(),
            is_open_ended: layout.is_open_ended,
            axes: layout.axes,
            places,
            scan: layout.count.map(|(claimed, line)| Scan { claimed, found: 0, line }),
            line: layout.first,
            is_held: true,
            row: Splitter::new(layout.separator),
            row_line: layout.first_line,
            first_line: layout.first_line,
        };
        Ok(FileSource::new(&path, schema, None, reader))
    }

    /// Reads and splits the next row. Returns false at the end of the file.
    fn next_row(&mut self) -> Result<bool, ReadError> {
        loop {
            if !std::mem::take(&mut self.is_held) {
                self.line.clear();
                if !self.lines.append(&mut self.line)? {
                    return self.finish_scan().map(|()| false);
                }
                self.row_line = self.lines.number();
            }
            if self.line.trim_ascii().is_empty() || layout::comment(&self.line).is_some() {
                continue;
            }
            let mut progress = self.row.start(&self.line);
            while progress == Progress::QuoteOpen {
                let start = self.line.len();
                if !self.lines.append(&mut self.line)? {
                    return Err(self.fail("a quote that is not closed"));
                }
                progress = self.row.go_on(&self.line[start..]);
            }
            if progress == Progress::CarriageReturn {
                return Err(self.fail(layout::CARRIAGE_RETURN));
            }
            if let Some(scan) = &mut self.scan {
                if let Some(claimed) = layout::lone_count(&self.line) {
                    self.finish_scan()?;
                    self.scan = Some(Scan { claimed, found: 0, line: self.row_line });
                    continue;
                }
                if scan.found == scan.claimed {
                    let what = format!(
                        "a point beyond the {} that the count on line {} claims; correct or remove the count",
                        scan.claimed, scan.line
                    );
                    return Err(self.fail(what));
                }
                scan.found += 1;
            }
            let is_longer = self.is_open_ended && self.row.len() > self.width;
            if !layout::is_as_wide(&self.row, self.width) && !is_longer {
                let (found, width, first) = (self.row.len(), self.width, self.first_line);
                return Err(
                    self.fail(format!("{found} values where {width} were expected, as on line {first}"))
                );
            }
            return Ok(true);
        }
    }

    /// Checks that as many points were found as the last count claims.
    fn finish_scan(&self) -> Result<(), ReadError> {
        match &self.scan {
            Some(scan) if scan.found < scan.claimed => Err(self.lines.fail_at(
                scan.line,
                format!(
                    "the count claims {} points and {} follow, up to line {}; the file is not whole, or the count \
                     wrong",
                    scan.claimed,
                    scan.found,
                    self.lines.number()
                ),
            )),
            _ => Ok(()),
        }
    }

    fn fail(&self, what: impl Into<String>) -> ReadError {
        self.lines.fail_at(self.row_line, what)
    }

    /// Parses value `place` of the row.
    #[inline]
    fn number(&mut self, place: usize) -> Result<f64, ReadError> {
        let text = std::str::from_utf8(self.row.bytes(place));
        let why = match text.map_or(Err(NotANumber::Word), |text| self.mark.parse(text)) {
            Ok(value) => return Ok(value),
            Err(why) => why,
        };
        let field = roles::excerpt(&self.row.field(place));
        Err(self.fail(match why {
            NotANumber::Word => format!("`{field}` is not a number"),
            NotANumber::OtherMark if self.separator == Separator::Comma => format!(
                "`{field}`: where commas separate values the decimal mark is a point, or a comma in quotes if the first rows \
                 show that it separates no thousands; thousands have no mark"
            ),
            NotANumber::OtherMark => format!(
                "`{field}` has two decimal marks, or another than the numbers before it; a file has one, and \
                 thousands have none"
            ),
        }))
    }
}

impl RecordReader for TextReader {
    fn memory_needed(&self) -> u64 {
        self.lines.memory_needed()
    }

    fn read(&mut self, request: &Request<'_>, batch: &mut PointBatch) -> Result<(), ReadError> {
        for _ in 0..request.most {
            if !self.next_row()? {
                break;
            }
            let [x, y, z] = self.axes;
            let position = [self.number(x)?, self.number(y)?, self.number(z)?];
            for (column, &index) in batch.columns.iter_mut().zip(request.selected) {
                column.push(self.number(self.places[index])?);
            }
            batch.position.push(position);
        }
        Ok(())
    }
}

fn describe(layout: &Layout) -> String {
    let kind = match (layout.separator, layout.count) {
        (_, Some(_)) => "PTS",
        (Separator::Comma, None) => "CSV",
        (Separator::Semicolon, None) => "text separated by semicolons",
        (Separator::Tab, None) => "text separated by tabs",
        (Separator::Blank, None) => "text separated by blanks",
    };
    let header = if layout.header_line.is_some() { "with header" } else { "without header" };
    format!("{kind} {header}")
}

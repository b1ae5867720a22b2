//! PTX (Leica Cyclone): scans as text, each a grid of points with the pose of the instrument.
//!
//! A scan begins with its numbers of columns and of rows, the place of the instrument and its three
//! axes, and a matrix of four by four, all on lines of their own; a line for each point of the grid
//! follows, with x, y, z, and perhaps intensity and red, green and blue. The matrix is applied to
//! points as rows, so its last row is the translation. The place and the axes say the same once
//! more, and are not used. Points at 0 0 0 are directions in which nothing was found: they are
//! delivered as NaN, so that they are counted as invalid.
//!
//! The column `scan` has the numbers of the scans, from 0. Points of a scan without colours or
//! intensities, among others that have them, have NaN there. If the first point lacks either, the
//! file is read through once more, to find whether others have it; a pipe cannot be, so there the
//! first scan must have what the others have.

use std::path::Path;

use super::file_source::{FileSource, RecordReader, Request};
use super::lines::Lines;
use super::stream::Stream;
use super::{ColorDepth, ColumnInfo, ColumnType, PointBatch, ReadError, Schema, roles};

/// Numbers on each of the lines that a scan begins with.
const HEADER: [usize; 10] = [1, 1, 3, 3, 3, 3, 4, 4, 4, 4];
/// Line of the header on which the matrix begins.
const MATRIX: usize = 6;
/// Most numbers of a point: its place, an intensity and a colour.
const MOST: usize = 7;

/// What points have beside their places.
#[derive(Clone, Copy, Default, PartialEq, Eq)]
struct Has {
    intensity: bool,
    color: bool,
}

impl Has {
    /// What a point of so many numbers has; `None` if no point has so many.
    fn of(numbers: usize) -> Option<Self> {
        match numbers {
            3 => Some(Self { intensity: false, color: false }),
            4 => Some(Self { intensity: true, color: false }),
            6 => Some(Self { intensity: false, color: true }),
            MOST => Some(Self { intensity: true, color: true }),
            _ => None,
        }
    }

    fn and(self, other: Self) -> Self {
        Self { intensity: self.intensity || other.intensity, color: self.color || other.color }
    }
}

/// Whether a file that begins with these bytes is PTX: its first lines have as many numbers as a
/// header has.
pub(super) fn begins(head: &[u8]) -> bool {
    let head = head.strip_prefix(b"\xef\xbb\xbf").unwrap_or(head);
    let mut lines = head.split(|&byte| byte == b'\n').filter(|line| !line.trim_ascii().is_empty());
    HEADER.iter().enumerate().all(|(i, &wanted)| {
        let words = lines.next().and_then(|line| std::str::from_utf8(line).ok()).unwrap_or_default();
        let mut count = 0;
        let are_numbers = words.split_ascii_whitespace().all(|word| {
            count += 1;
            if i < 2 { word.parse::<u32>().is_ok() } else { word.parse::<f64>().is_ok() }
        });
        are_numbers && count == wanted
    })
}

/// The points of a PTX file.
pub(super) struct PtxReader {
    lines: Lines,
    line: Vec<u8>,
    /// What some points of the file have.
    has: Has,
    /// Columns of the schema: of the intensity, and of red.
    intensity_at: Option<usize>,
    color_at: Option<usize>,
    /// The first point was read for its width, and is still to be used.
    is_held: bool,
    /// Number of the current scan, from 0; the line on which it begins, the number of its points,
    /// and how many are left.
    scan: u16,
    scan_line: u64,
    points: u64,
    left: u64,
    /// Rows of the matrix.
    pose: [[f64; 3]; 4],
}

impl PtxReader {
    /// Opens a file, and reads up to its first point.
    ///
    /// # Errors
    /// [`ReadError`] if the file cannot be read, or does not begin as a scan does.
    pub(super) fn open(path: &Path) -> Result<FileSource<Self>, ReadError> {
        Self::of(Stream::open(path)?)
    }

    /// The points of a stream.
    pub(super) fn of(input: Stream) -> Result<FileSource<Self>, ReadError> {
        // What is read through twice: not a pipe.
        let again = input.is_file().then(|| input.path().to_owned());
        let mut reader = Self::first(input)?;
        if reader.left > 0 {
            if !reader.next_line()? {
                return Err(reader.ends_early());
            }
            reader.is_held = true;
            // A point of a wrong number of words is an error when it is read.
            reader.has = Has::of(reader.words()).unwrap_or(Has { intensity: true, color: false });
            if let Some(path) = again.filter(|_| reader.has != Has { intensity: true, color: true }) {
                reader.has = reader.has.and(Self::of_all(&path));
            }
        }
        let mut columns = Vec::new();
        if reader.has.intensity {
            reader.intensity_at = Some(columns.len());
            columns.push(ColumnInfo::new("intensity", ColumnType::F32));
        }
        if reader.has.color {
            reader.color_at = Some(columns.len());
            // Some scans may have no colours, which is NaN.
            let color = |name: &str| ColumnInfo::new(name, ColumnType::F32);
            columns.extend(["red", "green", "blue"].map(color));
        }
        columns.push(ColumnInfo::new("scan", ColumnType::U16).of_classes());
        let mut schema = Schema::new(columns, ColorDepth::Byte);
        schema.description = "PTX".to_owned();
        let path = reader.lines.path().to_owned();
        Ok(FileSource::new(&path, schema, None, reader))
    }

    /// A stream, read up to the header of the first scan that has points.
    fn first(input: Stream) -> Result<Self, ReadError> {
        let mut source = Self {
            lines: Lines::of(input)?,
            line: Vec::new(),
            has: Has::default(),
            intensity_at: None,
            color_at: None,
            is_held: false,
            scan: 0,
            scan_line: 0,
            points: 0,
            left: 0,
            pose: [[0.0; 3]; 4],
        };
        if !source.next_line()? {
            return Err(source.lines.fail("the file is empty, where a number of columns was expected"));
        }
        source.read_header()?;
        // Scans that found nothing have no points that say what they have.
        while source.left == 0 && source.next_line()? {
            source.next_scan()?;
        }
        Ok(source)
    }

    /// What any point of a file has. Reads up to the first error, which is found again when the
    /// points are read.
    fn of_all(path: &Path) -> Has {
        let mut has = Has::default();
        let Ok(mut source) = Stream::open(path).and_then(Self::first) else { return has };
        while has != (Has { intensity: true, color: true }) && source.next_line().is_ok_and(|found| found) {
            if source.left == 0 {
                if source.next_scan().is_err() {
                    break;
                }
                continue;
            }
            source.left -= 1;
            has = has.and(Has::of(source.words()).unwrap_or_default());
        }
        has
    }

    /// The number of words on the current line, at most one more than a point has.
    fn words(&self) -> usize {
        let words = self.line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty());
        words.take(MOST + 1).count()
    }

    /// Reads the next line that is not empty. Returns false at the end of the file.
    fn next_line(&mut self) -> Result<bool, ReadError> {
        loop {
            self.line.clear();
            if !self.lines.append(&mut self.line)? {
                return Ok(false);
            }
            if !self.line.trim_ascii().is_empty() {
                return Ok(true);
            }
        }
    }

    /// Begins the next scan, of which the current line is the first.
    fn next_scan(&mut self) -> Result<(), ReadError> {
        self.scan = self.scan.checked_add(1).ok_or_else(|| {
            self.lines.fail("more than 65536 scans; write them to several files, which are one cloud, too")
        })?;
        self.read_header()
    }

    /// Reads a header, of which the current line is the first.
    fn read_header(&mut self) -> Result<(), ReadError> {
        self.scan_line = self.lines.number();
        let columns = self.size("columns")?;
        let mut rows = 0;
        for (i, &wanted) in HEADER.iter().enumerate().skip(1) {
            if !self.next_line()? {
                let line = self.scan_line;
                return Err(self
                    .lines
                    .fail(format!("the file ends within the header of a scan, on line {line}")));
            }
            if i == 1 {
                rows = self.size("rows")?;
                continue;
            }
            let mut numbers = [0.0; MOST];
            let found = self.numbers(&mut numbers)?;
            if found != wanted {
                let what = format!(
                    "{found} numbers where {wanted} were expected, in line {} of the header of the scan on line {}",
                    i + 1,
                    self.scan_line
                );
                return Err(self.lines.fail(what));
            }
            if i >= MATRIX {
                self.pose[i - MATRIX].copy_from_slice(&numbers[..3]);
                let last = if i == HEADER.len() - 1 { 1.0 } else { 0.0 };
                if !numbers[..4].iter().all(|v| v.is_finite()) || (numbers[3] - last).abs() > 1e-6 {
                    let what = format!(
                        "row {} of the matrix is no row of a rotation and a translation: its numbers must be finite, \
                         and the last {last}",
                        i - MATRIX + 1
                    );
                    return Err(self.lines.fail(what));
                }
            }
        }
        self.points = u64::from(columns) * u64::from(rows);
        self.left = self.points;
        Ok(())
    }

    /// The number of columns or rows on the current line.
    fn size(&self, of: &str) -> Result<u32, ReadError> {
        let text = String::from_utf8_lossy(&self.line);
        text.trim().parse().map_err(|_| {
            let found = roles::excerpt(&text);
            let what = match self.points {
                0 => format!("`{found}` where a number of {of} was expected, as PTX has before each scan"),
                points => format!(
                    "`{found}` where a number of {of} was expected: the scan on line {} has its {points} points",
                    self.scan_line
                ),
            };
            self.lines.fail(what)
        })
    }

    /// Parses the current line into `numbers`, and returns how many there are.
    fn numbers(&self, numbers: &mut [f64; MOST]) -> Result<usize, ReadError> {
        let text = std::str::from_utf8(&self.line)
            .map_err(|_| self.lines.fail("not text; expected numbers separated by blanks"))?;
        let mut count = 0;
        for word in text.split_ascii_whitespace() {
            let Some(number) = numbers.get_mut(count) else {
                return Ok(count + 1);
            };
            *number = word.parse().map_err(|_| {
                let found = roles::excerpt(word);
                self.lines.fail(format!("`{found}` is not a number"))
            })?;
            count += 1;
        }
        Ok(count)
    }

    fn ends_early(&self) -> ReadError {
        let (points, read) = (self.points, self.points - self.left);
        let what = format!("the scan has {points} points, and {read} follow; the file is cut off or damaged");
        self.lines.fail_at(self.scan_line, what)
    }

    /// Reads the point on the current line.
    fn append(&mut self, selected: &[usize], batch: &mut PointBatch) -> Result<(), ReadError> {
        let mut numbers = [0.0; MOST];
        let found = self.numbers(&mut numbers)?;
        let Some(has) = Has::of(found) else {
            let what = "numbers where 3, 4, 6 or 7 were expected: x y z, perhaps intensity, and perhaps red green blue";
            return Err(self.lines.fail(format!("{found} {what}")));
        };
        for (more, what) in [
            (has.color && !self.has.color, "a colour"),
            (has.intensity && !self.has.intensity, "an intensity"),
        ] {
            if more {
                let what = format!(
                    "a point with {what} behind points without, in a pipe, which is read once; write it to a file"
                );
                return Err(self.lines.fail(what));
            }
        }
        let [x, y, z, ..] = numbers;
        let mut intensity = f64::NAN;
        let mut color = [f64::NAN; 3];
        if has.intensity {
            intensity = numbers[3];
        }
        if has.color {
            color.copy_from_slice(&numbers[found - 3..found]);
            if !color.iter().all(|v| (0.0..=255.0).contains(v) && v.fract() == 0.0) {
                let what = format!("a colour of {color:?}; expected whole numbers from 0 to 255");
                return Err(self.lines.fail(what));
            }
        }
        let m = &self.pose;
        let place = |axis: usize| x * m[0][axis] + y * m[1][axis] + z * m[2][axis] + m[3][axis];
        let is_nothing = [x, y, z] == [0.0; 3];
        batch.position.push(if is_nothing { [f64::NAN; 3] } else { [0, 1, 2].map(place) });
        for (column, &index) in batch.columns.iter_mut().zip(selected) {
            let of_color = self.color_at.and_then(|red| color.get(index.checked_sub(red)?));
            column.push(match of_color {
                Some(color) => *color,
                None if self.intensity_at == Some(index) => intensity,
                None => self.scan.into(),
            });
        }
        Ok(())
    }
}

impl RecordReader for PtxReader {
    fn memory_needed(&self) -> u64 {
        self.lines.memory_needed()
    }

    fn read(&mut self, request: &Request<'_>, batch: &mut PointBatch) -> Result<(), ReadError> {
        loop {
            if !std::mem::take(&mut self.is_held) && !self.next_line()? {
                return if self.left > 0 { Err(self.ends_early()) } else { Ok(()) };
            }
            if self.left > 0 {
                self.append(request.selected, batch)?;
                self.left -= 1;
                return Ok(());
            }
            self.next_scan()?;
        }
    }
}

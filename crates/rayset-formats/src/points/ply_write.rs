//! Writing binary little-endian PLY, for generated points.

use std::io::{self, BufWriter, Seek, SeekFrom, Write};

use super::PointBatch;
use rayset_store::output::{Destination, OutputError, OutputFile, OutputWriter};

/// Digits reserved in the header for the number of points.
const COUNT_WIDTH: usize = 20;

/// Writes points as `float x, y, z` and one `float` (colours: `uchar`) per column. The file gets
/// its name once it is complete.
#[derive(Debug)]
pub struct PlyWriter {
    buffer: BufWriter<OutputWriter>,
    file: OutputFile,
    count_at: u64,
    /// The number of points that the header states at first.
    expected: u64,
    count: u64,
    is_color: Vec<bool>,
}

impl PlyWriter {
    /// Creates the file and writes its header. Colour columns (`red`, `green`, `blue`) take values
    /// from 0 to 1.
    ///
    /// The header contains the number of points. It is rewritten at the end if it differs from
    /// `expected`; a pipe cannot seek, so for a pipe `expected` must be right.
    ///
    /// # Errors
    /// [`OutputError::Io`].
    pub fn create(to: &Destination, attributes: &[String], expected: u64) -> Result<Self, OutputError> {
        let file = OutputFile::create(to)?;
        let buffer = BufWriter::with_capacity(1 << 20, file.writer());
        let is_color: Vec<bool> =
            attributes.iter().map(|a| matches!(a.as_str(), "red" | "green" | "blue")).collect();
        let mut writer = Self { buffer, file, count_at: 0, expected, count: 0, is_color };
        match writer.header(attributes) {
            Ok(()) => Ok(writer),
            Err(source) => Err(writer.failed(source)),
        }
    }

    fn header(&mut self, attributes: &[String]) -> io::Result<()> {
        let start = "ply\nformat binary_little_endian 1.0\nelement vertex ";
        self.count_at = start.len() as u64;
        let output = &mut self.buffer;
        writeln!(output, "{start}{:>COUNT_WIDTH$}", self.expected)?;
        for axis in ["x", "y", "z"] {
            writeln!(output, "property float {axis}")?;
        }
        for (name, color) in attributes.iter().zip(&self.is_color) {
            writeln!(output, "property {} {name}", if *color { "uchar" } else { "float" })?;
        }
        writeln!(output, "end_header")
    }

    /// Appends a batch whose columns are those of [`create`](Self::create).
    ///
    /// # Errors
    /// [`OutputError::Io`].
    pub fn write(&mut self, batch: &PointBatch) -> Result<(), OutputError> {
        self.records(batch).map_err(|source| self.failed(source))
    }

    fn records(&mut self, batch: &PointBatch) -> io::Result<()> {
        let output = &mut self.buffer;
        for (i, p) in batch.position.iter().enumerate() {
            for axis in p {
                output.write_all(&(*axis as f32).to_le_bytes())?;
            }
            for (column, color) in batch.columns.iter().zip(&self.is_color) {
                if *color {
                    output.write_all(&[(column.get(i).clamp(0.0, 1.0) * 255.0).round() as u8])?;
                } else {
                    output.write_all(&(column.get(i) as f32).to_le_bytes())?;
                }
            }
        }
        self.count += batch.len() as u64;
        Ok(())
    }

    /// Corrects the number of points in the header, and gives the file its name. Returns the number
    /// of points.
    ///
    /// # Errors
    /// [`OutputError::Io`].
    pub fn finish(mut self) -> Result<u64, OutputError> {
        self.end().map_err(|source| self.failed(source))?;
        self.file.publish()?;
        Ok(self.count)
    }

    fn end(&mut self) -> io::Result<()> {
        if self.count != self.expected {
            self.buffer.seek(SeekFrom::Start(self.count_at))?;
            write!(self.buffer, "{:>COUNT_WIDTH$}", self.count)?;
        }
        self.buffer.flush()
    }

    fn failed(&self, source: io::Error) -> OutputError {
        OutputError::Io { action: "write", path: self.file.destination().path().to_owned(), source }
    }
}

//! Binary little-endian PLY out, for generated points.

use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::Path;

use super::PointBatch;

/// Digits reserved in the header for the number of points, which is known only at the end.
const COUNT_WIDTH: usize = 20;

/// Writes points as `float x, y, z` and one `float` (colours: `uchar`) a column.
#[derive(Debug)]
pub struct PlyWriter {
    output: BufWriter<File>,
    count_at: u64,
    count: u64,
    is_color: Vec<bool>,
}

impl PlyWriter {
    /// Creates the file and writes its header. Colour columns (`red`, `green`, `blue`) take values from 0 to 1.
    ///
    /// # Errors
    /// What the system says.
    pub fn create(path: &Path, attributes: &[String]) -> io::Result<Self> {
        let mut output = BufWriter::with_capacity(1 << 20, File::create(path)?);
        let start = "ply\nformat binary_little_endian 1.0\nelement vertex ";
        writeln!(output, "{start}{:>COUNT_WIDTH$}", 0)?;
        let is_color: Vec<bool> =
            attributes.iter().map(|a| matches!(a.as_str(), "red" | "green" | "blue")).collect();
        for axis in ["x", "y", "z"] {
            writeln!(output, "property float {axis}")?;
        }
        for (name, color) in attributes.iter().zip(&is_color) {
            writeln!(output, "property {} {name}", if *color { "uchar" } else { "float" })?;
        }
        writeln!(output, "end_header")?;
        Ok(Self { output, count_at: start.len() as u64, count: 0, is_color })
    }

    /// Appends a batch whose columns are those of [`create`](Self::create).
    ///
    /// # Errors
    /// What the system says.
    pub fn write(&mut self, batch: &PointBatch) -> io::Result<()> {
        for (i, p) in batch.position.iter().enumerate() {
            for axis in p {
                self.output.write_all(&(*axis as f32).to_le_bytes())?;
            }
            for (column, color) in batch.columns.iter().zip(&self.is_color) {
                if *color {
                    self.output.write_all(&[(column.get(i).clamp(0.0, 1.0) * 255.0).round() as u8])?;
                } else {
                    self.output.write_all(&(column.get(i) as f32).to_le_bytes())?;
                }
            }
        }
        self.count += batch.len() as u64;
        Ok(())
    }

    /// Writes the number of points into the header and flushes.
    ///
    /// # Errors
    /// What the system says.
    pub fn finish(mut self) -> io::Result<u64> {
        self.output.seek(SeekFrom::Start(self.count_at))?;
        write!(self.output, "{:>COUNT_WIDTH$}", self.count)?;
        self.output.flush()?;
        Ok(self.count)
    }
}

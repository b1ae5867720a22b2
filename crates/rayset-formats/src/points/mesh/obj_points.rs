//! Wavefront OBJ files without faces: their vertices are the points.

use std::path::Path;

use super::obj_reader::{ObjReader, Statement};
use crate::points::file_source::{FileSource, RecordReader, Request};
use crate::points::{ColorDepth, ColumnInfo, ColumnType, PointBatch, ReadError, Schema};

/// The vertices of an OBJ file.
pub(in crate::points) struct ObjPointReader {
    statements: ObjReader,
}

impl ObjPointReader {
    /// Opens a file of `count` vertices, which all have colours, or may not.
    ///
    /// # Errors
    /// [`ReadError`] if it cannot be read.
    pub(in crate::points) fn open(
        path: &Path,
        count: u64,
        has_colors: bool,
    ) -> Result<FileSource<Self>, ReadError> {
        let colors = ["red", "green", "blue"].map(|name| ColumnInfo::new(name, ColumnType::F32));
        let columns = if has_colors { colors.to_vec() } else { Vec::new() };
        let mut schema = Schema::new(columns, ColorDepth::Guess);
        schema.description = "OBJ".into();
        Ok(FileSource::new(path, schema, Some(count), Self { statements: ObjReader::open(path)? }))
    }
}

impl RecordReader for ObjPointReader {
    fn memory_needed(&self) -> u64 {
        // The read buffer and a line.
        384 << 10
    }

    fn read(&mut self, request: &Request<'_>, batch: &mut PointBatch) -> Result<(), ReadError> {
        while let Some(statement) = self.statements.next()? {
            if let Statement::Vertex { position, color } = statement {
                batch.position.push(position);
                let color = color.unwrap_or_default();
                for (column, &channel) in batch.columns.iter_mut().zip(request.selected) {
                    column.push(color[channel].into());
                }
                break;
            }
        }
        Ok(())
    }
}

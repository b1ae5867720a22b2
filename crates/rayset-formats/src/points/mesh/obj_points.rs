//! Wavefront OBJ files without faces: their vertices are the points.

use std::path::Path;

use super::obj_reader::{ObjReader, Statement};
use crate::points::{ColorDepth, ColumnInfo, ColumnType, PointBatch, PointSource, ReadError, Schema};

/// The vertices of an OBJ file.
#[derive(Debug)]
pub(in crate::points) struct ObjSource {
    reader: ObjReader,
    schema: Schema,
    selected: Vec<usize>,
    count: u64,
}

impl ObjSource {
    /// Opens a file of `count` vertices, which all have colours, or may not.
    ///
    /// # Errors
    /// [`ReadError`] if it cannot be read.
    pub(in crate::points) fn open(path: &Path, count: u64, has_colors: bool) -> Result<Self, ReadError> {
        let colors = ["red", "green", "blue"].map(|name| ColumnInfo::new(name, ColumnType::F32));
        let columns = if has_colors { colors.to_vec() } else { Vec::new() };
        let mut schema = Schema::new(columns, ColorDepth::Guess);
        schema.description = "OBJ".into();
        Ok(Self { reader: ObjReader::open(path)?, schema, selected: Vec::new(), count })
    }
}

impl PointSource for ObjSource {
    fn schema(&self) -> &Schema {
        &self.schema
    }

    fn count_hint(&self) -> Option<u64> {
        Some(self.count)
    }

    fn path(&self) -> Option<&Path> {
        Some(self.reader.path())
    }

    fn memory_needed(&self) -> u64 {
        // The read buffer and a line.
        384 << 10
    }

    fn select(&mut self, columns: &[usize]) {
        self.selected = columns.to_vec();
    }

    fn fill(&mut self, batch: &mut PointBatch, limit: usize) -> Result<(), ReadError> {
        batch.reset(&self.schema, &self.selected);
        while batch.len() < limit {
            let Some(statement) = self.reader.next()? else { break };
            if let Statement::Vertex { position, color } = statement {
                batch.position.push(position);
                let color = color.unwrap_or_default();
                for (column, &channel) in batch.columns.iter_mut().zip(&self.selected) {
                    column.push(color[channel].into());
                }
            }
        }
        Ok(())
    }
}

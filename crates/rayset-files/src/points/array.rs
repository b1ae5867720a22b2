//! Points that are already in memory.

use super::{ColorDepth, ColumnInfo, PointBatch, PointSource, ReadError, Schema, Values};

/// A stream over points in memory.
#[derive(Clone, Debug)]
pub struct ArraySource {
    schema: Schema,
    points: PointBatch,
    selected: Vec<usize>,
    next: usize,
}

impl ArraySource {
    /// Points with named columns, each as long as the positions. Colours are `red`, `green` and
    /// `blue`, from 0 to 1.
    ///
    /// Panics if a column is shorter or longer than the positions.
    #[must_use]
    pub fn new(position: Vec<[f64; 3]>, columns: Vec<(&str, Vec<f32>)>) -> Self {
        let typed = columns.into_iter().map(|(name, values)| {
            let values = Values::from(values);
            (ColumnInfo::new(name, values.kind()), values)
        });
        Self::typed(position, typed.collect())
    }

    /// Points with columns of any type, each as long as the positions.
    ///
    /// Panics if a column is shorter or longer than the positions, or if its values are not of the
    /// type that its description states.
    #[must_use]
    pub fn typed(position: Vec<[f64; 3]>, columns: Vec<(ColumnInfo, Values)>) -> Self {
        for (info, values) in &columns {
            assert_eq!(values.len(), position.len(), "values of column {}", info.name);
            assert_eq!(values.kind(), info.kind, "type of column {}", info.name);
        }
        let (infos, columns) = columns.into_iter().unzip();
        Self {
            schema: Schema::new(infos, ColorDepth::Unit),
            points: PointBatch { position, columns },
            selected: Vec::new(),
            next: 0,
        }
    }
}

impl PointSource for ArraySource {
    fn schema(&self) -> &Schema {
        &self.schema
    }

    fn count_hint(&self) -> Option<u64> {
        Some(self.points.len() as u64)
    }

    fn select(&mut self, columns: &[usize]) {
        self.selected = columns.to_vec();
    }

    fn can_skip(&self) -> bool {
        true
    }

    fn skip(&mut self, count: u64) -> Result<(), ReadError> {
        let left = self.points.len() - self.next;
        self.next += usize::try_from(count).unwrap_or(left).min(left);
        Ok(())
    }

    fn fill(&mut self, batch: &mut PointBatch, limit: usize) -> Result<(), ReadError> {
        batch.reset(&self.schema, &self.selected);
        let range = self.next..self.points.len().min(self.next + limit);
        batch.position.extend_from_slice(&self.points.position[range.clone()]);
        for (column, &index) in batch.columns.iter_mut().zip(&self.selected) {
            column.extend_from(&self.points.columns[index], range.clone());
        }
        self.next = range.end;
        Ok(())
    }
}

//! Points from an iterator of Python, a chunk at a time, so that what does not fit in memory can be
//! built.

use std::path::PathBuf;
use std::sync::{Arc, Mutex};

use numpy::{PyUntypedArray, PyUntypedArrayMethods};
use pyo3::prelude::*;
use rayset::points::{PointBatch, PointSource, ReadError, Schema};

use crate::arrays::{self, HeldColumn, HeldPositions, Named};
use crate::errors;
use crate::wait::lock;

/// What an iterator raised, for whoever started the build.
pub(crate) type Raised = Arc<Mutex<Option<PyErr>>>;

/// A chunk: positions, and columns in the order of the schema. All chunks have the types of the
/// first.
#[derive(FromPyObject)]
pub(crate) struct Chunk(Py<PyUntypedArray>, Vec<Py<PyUntypedArray>>);

/// Points of chunks.
pub(crate) struct ChunkSource {
    schema: Schema,
    chunks: Py<PyAny>,
    now: Option<Chunk>,
    /// Points of the present chunk that were handed out.
    next: usize,
    selected: Vec<usize>,
    raised: Raised,
}

impl ChunkSource {
    /// `first` is an example of what `chunks`, an iterator, yields.
    pub(crate) fn new(
        py: Python<'_>,
        first: &Chunk,
        names: Vec<Named>,
        chunks: Py<PyAny>,
        raised: Raised,
    ) -> PyResult<Self> {
        let mut columns = Vec::new();
        for (named, array) in names.into_iter().zip(&first.1) {
            let kind = HeldColumn::new(&named.name, array.bind(py))?.view().kind();
            columns.push((named, kind));
        }
        let schema = arrays::schema(columns.into_iter());
        Ok(Self { schema, chunks, now: None, next: 0, selected: Vec::new(), raised })
    }

    /// Fills a batch from the present chunk, or from the next ones if it has none left.
    fn take(&mut self, py: Python<'_>, batch: &mut PointBatch, limit: usize) -> PyResult<()> {
        loop {
            if self.now.is_none() {
                let Some(chunk) = self.chunks.bind(py).try_iter()?.next() else { return Ok(()) };
                self.now = Some(chunk?.extract()?);
                self.next = 0;
            }
            let Some(Chunk(positions, columns)) = &self.now else { return Ok(()) };
            let held = HeldPositions::new(positions.bind(py))?;
            let end = held.view().len().min(self.next.saturating_add(limit));
            if self.next < end {
                held.view().append_to(&mut batch.position, self.next, end);
                for (&column, to) in self.selected.iter().zip(&mut batch.columns) {
                    let array = columns[column].bind(py);
                    let held = HeldColumn::new(&self.schema.columns[column].name, array)?;
                    if held.view().kind() != to.kind() || array.shape() != [positions.bind(py).shape()[0]] {
                        let name = &self.schema.columns[column].name;
                        return Err(errors::value(format!("{name}: chunks differ in type or length")));
                    }
                    held.view().append_to(to, self.next, end);
                }
                self.next = end;
                return Ok(());
            }
            self.now = None;
        }
    }
}

impl PointSource for ChunkSource {
    fn schema(&self) -> &Schema {
        &self.schema
    }

    fn count_hint(&self) -> Option<u64> {
        None
    }

    fn select(&mut self, columns: &[usize]) {
        self.selected = columns.to_vec();
    }

    fn fill(&mut self, batch: &mut PointBatch, limit: usize) -> Result<(), ReadError> {
        batch.reset(&self.schema, &self.selected);
        Python::attach(|py| self.take(py, batch, limit)).map_err(|error| {
            *lock(&self.raised) = Some(error);
            // Never seen: what was raised is raised again.
            let source = std::io::Error::other("the iterator raised");
            ReadError::Io { path: PathBuf::from("the iterator of chunks"), source }
        })
    }
}

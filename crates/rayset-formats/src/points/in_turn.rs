//! Many files as sources, each of which is open only while it is read.
//!
//! A survey in ten thousand tiles would otherwise hold ten thousand open files and as many
//! decoders. Here a file is opened to learn its schema, closed, and opened again when its points
//! are read; files with one schema share it.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::{Place, PointBatch, PointSource, ReadError, ReadOptions, Schema, formats};
use rayset_base::cancel::CancelToken;
use rayset_store::storage::input_file::is_file;

/// Schemas that are compared with the next file's: tiles of a survey have one, or few that
/// alternate.
const MOST_COMPARED: usize = 16;

/// Opens files one at a time.
#[derive(Debug, Default)]
pub struct InTurn {
    options: Arc<ReadOptions>,
    /// Schemas of files before, the latest last.
    schemas: Vec<Arc<Schema>>,
}

impl InTurn {
    /// Files that are read with these options.
    #[must_use]
    pub fn new(options: &ReadOptions) -> Self {
        Self { options: Arc::new(options.clone()), schemas: Vec::new() }
    }

    /// The options.
    #[must_use]
    pub fn options(&self) -> &ReadOptions {
        &self.options
    }

    /// The points of a file, which is closed until they are read. A pipe stays open, because it can
    /// be read only once.
    ///
    /// # Errors
    /// [`ReadError`] as [`open`](super::open); later, if the file is another by then.
    pub fn open(&mut self, path: &Path) -> Result<Box<dyn PointSource>, ReadError> {
        let source = formats::open(path, &self.options)?;
        if !is_file(path) {
            return Ok(source);
        }
        let (schema, is_shared) = self.shared(source.schema());
        Ok(Box::new(Closed {
            path: path.to_owned(),
            options: self.options.clone(),
            own_bytes: if is_shared { 0 } else { bytes_of(&schema) },
            schema,
            count: source.count_hint(),
            memory_needed: source.memory_needed(),
            can_skip: source.can_skip(),
            files: source.files(),
            selected: Vec::new(),
            cancel: CancelToken::new(),
            state: State::Before,
        }))
    }

    /// A schema, that of an earlier file if it is the same; and whether it is.
    fn shared(&mut self, schema: &Schema) -> (Arc<Schema>, bool) {
        if let Some(known) = self.schemas.iter().rev().find(|known| ***known == *schema) {
            return (known.clone(), true);
        }
        let schema = Arc::new(schema.clone());
        if self.schemas.len() == MOST_COMPARED {
            self.schemas.remove(0);
        }
        self.schemas.push(schema.clone());
        (schema, false)
    }
}

/// Bytes of a schema, for the budget of a build.
fn bytes_of(schema: &Schema) -> u64 {
    let texts = schema.crs.len() + schema.description.len();
    let warnings: usize = schema.warnings.iter().map(|text| text.len() + size_of::<String>()).sum();
    let columns: usize = schema
        .columns
        .iter()
        .map(|column| column.name.len() + column.unit.len() + size_of_val(column))
        .chain(schema.roles.iter().map(|role| role.0.len() + size_of_val(role)))
        .sum();
    (size_of::<Schema>() + texts + warnings + columns) as u64
}

/// A file that is open only while it is read.
struct Closed {
    path: PathBuf,
    options: Arc<ReadOptions>,
    schema: Arc<Schema>,
    /// Bytes of the schema, if no other file shares it.
    own_bytes: u64,
    count: Option<u64>,
    memory_needed: u64,
    can_skip: bool,
    files: Vec<PathBuf>,
    selected: Vec<usize>,
    cancel: CancelToken,
    state: State,
}

enum State {
    Before,
    Open(Box<dyn PointSource>),
    After,
}

impl Closed {
    /// The file, opened if it is not; `None` once it has been read to its end.
    fn opened(&mut self) -> Result<Option<&mut Box<dyn PointSource>>, ReadError> {
        if matches!(self.state, State::Before) {
            let mut source = formats::open(&self.path, &self.options)?;
            if *source.schema() != *self.schema {
                let what = "its columns are others than when it was looked at: it was replaced while this run was reading; \
                            run again once it is finished";
                return Err(ReadError::malformed(&self.path, Place::Byte(0), what));
            }
            source.select(&self.selected);
            source.watch(&self.cancel);
            self.state = State::Open(source);
        }
        Ok(match &mut self.state {
            State::Open(source) => Some(source),
            _ => None,
        })
    }
}

impl PointSource for Closed {
    fn schema(&self) -> &Schema {
        &self.schema
    }

    fn count_hint(&self) -> Option<u64> {
        self.count
    }

    fn path(&self) -> Option<&Path> {
        Some(&self.path)
    }

    fn files(&self) -> Vec<PathBuf> {
        self.files.clone()
    }

    fn select(&mut self, columns: &[usize]) {
        self.selected = columns.to_vec();
        if let State::Open(source) = &mut self.state {
            source.select(columns);
        }
    }

    fn memory_needed(&self) -> u64 {
        self.memory_idle() + self.memory_needed
    }

    fn memory_idle(&self) -> u64 {
        let paths: usize = self.files.iter().map(|file| file.as_os_str().len() + size_of::<PathBuf>()).sum();
        (size_of::<Self>() + self.path.as_os_str().len() + paths) as u64 + self.own_bytes
    }

    fn can_skip(&self) -> bool {
        self.can_skip
    }

    fn skip(&mut self, count: u64) -> Result<(), ReadError> {
        self.opened()?.map_or(Ok(()), |source| source.skip(count))
    }

    fn watch(&mut self, cancel: &CancelToken) {
        self.cancel = cancel.clone();
        if let State::Open(source) = &mut self.state {
            source.watch(cancel);
        }
    }

    fn fill(&mut self, batch: &mut PointBatch, limit: usize) -> Result<(), ReadError> {
        let Some(source) = self.opened()? else {
            batch.reset(&self.schema, &self.selected);
            return Ok(());
        };
        source.fill(batch, limit)?;
        if batch.is_empty() && limit > 0 {
            self.state = State::After;
        }
        Ok(())
    }
}

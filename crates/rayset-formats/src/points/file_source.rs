//! What every source of points does beside its format: its files, its schema, the selected columns,
//! the points that are left, and the end. A format adds a [`RecordReader`], which makes columns of
//! its records.

use std::io;
use std::path::{Path, PathBuf};

use super::{Place, PointBatch, PointSource, ReadError, Schema};
use rayset_base::cancel::CancelToken;

/// The points that a reader is asked for.
pub(super) struct Request<'a> {
    /// The files of the source, at least one.
    pub(super) files: &'a [PathBuf],
    /// The columns of the batch, by their indices in the schema.
    pub(super) selected: &'a [usize],
    /// Number of points before these.
    pub(super) first: u64,
    /// Number of points that the source claims to hold; `u64::MAX` if only its end tells.
    pub(super) count: u64,
    /// Most points that are wanted, at least one and never beyond `count`.
    pub(super) most: usize,
}

impl Request<'_> {
    /// The file, or the first of several.
    pub(super) fn path(&self) -> &Path {
        first_of(self.files)
    }
}

fn first_of(files: &[PathBuf]) -> &Path {
    files.first().map_or(Path::new(""), PathBuf::as_path)
}

/// How the records of a format become points.
pub(super) trait RecordReader: Send {
    /// As [`PointSource::memory_needed`].
    fn memory_needed(&self) -> u64;
    /// Prepares to read these columns.
    fn select(&mut self, _columns: &[usize]) {}
    /// As [`PointSource::watch`].
    fn watch(&mut self, _cancel: &CancelToken) {}
    /// Appends the next points, and the selected columns of each: none if there are no more,
    /// otherwise at least one and at most `request.most`.
    fn read(&mut self, request: &Request<'_>, batch: &mut PointBatch) -> Result<(), ReadError>;
    /// Checks what is behind the last point of a source that knows how many it has.
    fn finish(&mut self) -> Result<(), ReadError> {
        Ok(())
    }
    /// As [`PointSource::can_skip`].
    fn can_skip(&self) -> bool {
        false
    }
    /// Passes over `request.most` points without making columns of them. False if it cannot.
    fn skip(&mut self, _request: &Request<'_>) -> Result<bool, ReadError> {
        Ok(false)
    }
}

/// The points of a file, or of several that belong together.
pub(super) struct FileSource<R> {
    reader: R,
    files: Vec<PathBuf>,
    schema: Schema,
    count: Option<u64>,
    /// Points that were delivered or passed over.
    next: u64,
    selected: Vec<usize>,
    is_finished: bool,
}

impl<R: RecordReader> FileSource<R> {
    /// The points of a file; `count` is how many it claims to hold, if it says so.
    pub(super) fn new(path: &Path, schema: Schema, count: Option<u64>, reader: R) -> Self {
        Self::of_files(vec![path.to_owned()], schema, count, reader)
    }

    /// The points of several files.
    pub(super) fn of_files(files: Vec<PathBuf>, schema: Schema, count: Option<u64>, mut reader: R) -> Self {
        reader.select(&[]);
        Self { reader, files, schema, count, next: 0, selected: Vec::new(), is_finished: false }
    }

    /// The same points, with a sentence about what of the file is not read.
    pub(super) fn with_warning(mut self, sentence: String) -> Self {
        self.schema.warnings.push(sentence);
        self
    }

    /// The reader, and a request for up to `most` points; `None` if none are left, or wanted.
    fn ask(&mut self, most: u64) -> Option<(&mut R, Request<'_>)> {
        let count = self.count.unwrap_or(u64::MAX);
        let most = usize::try_from(count.saturating_sub(self.next).min(most)).unwrap_or(usize::MAX);
        let (files, selected, first) = (&self.files, &self.selected, self.next);
        (most > 0).then_some((&mut self.reader, Request { files, selected, first, count, most }))
    }
}

impl<R: RecordReader> PointSource for FileSource<R> {
    fn schema(&self) -> &Schema {
        &self.schema
    }

    fn count_hint(&self) -> Option<u64> {
        self.count
    }

    fn path(&self) -> Option<&Path> {
        Some(first_of(&self.files))
    }

    fn files(&self) -> Vec<PathBuf> {
        self.files.clone()
    }

    fn select(&mut self, columns: &[usize]) {
        self.selected = columns.to_vec();
        self.reader.select(columns);
    }

    fn memory_needed(&self) -> u64 {
        self.reader.memory_needed()
    }

    fn watch(&mut self, cancel: &CancelToken) {
        self.reader.watch(cancel);
    }

    fn can_skip(&self) -> bool {
        self.reader.can_skip()
    }

    fn skip(&mut self, count: u64) -> Result<(), ReadError> {
        let end = self.next.saturating_add(count);
        let mut batch = PointBatch::default();
        while let Some((reader, request)) = self.ask(end - self.next) {
            let most = request.most as u64;
            if reader.skip(&request)? {
                self.next += most;
                continue;
            }
            self.fill(&mut batch, most.min(1 << 14) as usize)?;
            if batch.is_empty() {
                break;
            }
        }
        Ok(())
    }

    fn fill(&mut self, batch: &mut PointBatch, limit: usize) -> Result<(), ReadError> {
        batch.reset(&self.schema, &self.selected);
        while let Some((reader, request)) = self.ask(limit.saturating_sub(batch.len()) as u64) {
            let before = batch.len();
            reader.read(&request, batch)?;
            let read = batch.len() - before;
            if read == 0 {
                break;
            }
            self.next += read as u64;
        }
        if self.count == Some(self.next) && !self.is_finished {
            self.is_finished = true;
            self.reader.finish()?;
        }
        Ok(())
    }
}

/// An error in reading a file that was whole when it was opened: `at` is the byte of what is
/// missing if it has become shorter since.
pub(super) fn unreadable(path: &Path, at: u64, source: io::Error) -> ReadError {
    if source.kind() == io::ErrorKind::UnexpectedEof {
        let what = "the file has become shorter than it was when it was opened";
        return ReadError::malformed(path, Place::Byte(at), what);
    }
    ReadError::Io { path: path.to_owned(), source }
}

/// Sets a coordinate of the positions of a batch from the one at `first` on.
pub(super) fn set_axis(
    batch: &mut PointBatch,
    first: usize,
    axis: usize,
    numbers: impl Iterator<Item = f64>,
) {
    batch.position[first..].iter_mut().zip(numbers).for_each(|(position, number)| position[axis] = number);
}

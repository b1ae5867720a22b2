//! Streams of points: sources, their schemas, and batches.

use std::path::{Path, PathBuf};

use super::column::{ColumnInfo, Values};
use super::error::ReadError;
use super::roles;
use rayset_base::cancel::CancelToken;
use rayset_base::geometry::DVec3;

/// The value range of the colour columns of a source.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ColorDepth {
    /// 0 to 1.
    Unit,
    /// 0 to 255.
    Byte,
    /// 0 to 65535.
    Word,
    /// Not stated by the format: decided from the largest value of the source (≤ 1, ≤ 255, or
    /// larger).
    Guess,
}

/// The data that a source offers besides positions.
#[derive(Clone, Debug, PartialEq)]
pub struct Schema {
    /// All columns that can be selected. Colours are `red`, `green` and `blue`, as names or as
    /// roles.
    pub columns: Vec<ColumnInfo>,
    /// Roles of columns that have other names, such as `red` for the column `r`: the role and the
    /// index of the column.
    pub roles: Vec<(String, usize)>,
    /// The value range of the colour columns, if there are any.
    pub color_depth: ColorDepth,
    /// The coordinate reference system from the file (WKT, or `EPSG:` and a code); empty if it has
    /// none.
    pub crs: String,
    /// A description of the file: format, version, the program that wrote it. May be empty.
    pub description: String,
    /// What of the file is lost or was decided without asking, in sentences for the person who
    /// reads it.
    pub warnings: Vec<String>,
    /// How the columns of a table were read, in one line for the person who reads it: their names
    /// in their order, and where these come from. Empty for formats that say themselves what their
    /// columns are.
    pub reading: String,
    /// The direction that is up in files of this kind; `None` if they have no convention.
    pub up: Option<DVec3>,
    /// The step of the file's coordinates along each axis: they are multiples of it, apart from a
    /// constant. `None` if the file does not say.
    pub step: Option<[f64; 3]>,
    /// Whether points that are equal in every column are the same as one with the sum of their
    /// weights. They are not where weights are opacities: two splats of opacity α let (1 − α)² of
    /// the light pass, and one of twice the opacity 1 − 2α. A build merges copies only if this is
    /// true of all of its sources.
    pub weights_add: bool,
}

impl Schema {
    /// A schema with columns only.
    #[must_use]
    pub fn new(columns: Vec<ColumnInfo>, color_depth: ColorDepth) -> Self {
        Self {
            columns,
            roles: Vec::new(),
            color_depth,
            crs: String::new(),
            description: String::new(),
            warnings: Vec::new(),
            reading: String::new(),
            up: None,
            step: None,
            weights_add: true,
        }
    }

    /// Index of the column that `name` refers to: the one of that name, otherwise the one with that
    /// role, otherwise the one of that name ignoring case. Several names may refer to the same
    /// column.
    #[must_use]
    pub fn find(&self, name: &str) -> Option<usize> {
        roles::find(&self.columns, &self.roles, name)
    }

    /// Names of all columns.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.columns.iter().map(|c| c.name.as_str())
    }
}

/// A batch of points in columns; buffers are reused from one fill to the next.
#[derive(Clone, Debug, Default)]
pub struct PointBatch {
    /// Positions in the coordinates of the file. They may not be finite: readers do not validate
    /// them.
    pub position: Vec<[f64; 3]>,
    /// One column for each selected column of the schema, of the same type, with as many values as
    /// `position`.
    pub columns: Vec<Values>,
}

impl PointBatch {
    /// Empties the batch and gives it the `selected` columns of a schema, keeping the buffers if
    /// the types agree.
    ///
    /// Panics if an index is not one of the schema's.
    pub fn reset(&mut self, schema: &Schema, selected: &[usize]) {
        self.position.clear();
        self.columns.truncate(selected.len());
        for (place, &index) in selected.iter().enumerate() {
            let kind = schema.columns[index].kind;
            match self.columns.get_mut(place) {
                Some(column) if column.kind() == kind => column.clear(),
                Some(column) => *column = Values::empty(kind),
                None => self.columns.push(Values::empty(kind)),
            }
        }
    }

    /// Number of points.
    #[must_use]
    pub fn len(&self) -> usize {
        self.position.len()
    }

    /// Whether there are no points.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.position.is_empty()
    }
}

/// A stream of points. Implement it for points from elsewhere; for points in memory there is
/// [`SliceSource`](super::SliceSource).
pub trait PointSource: Send {
    /// What the source offers.
    fn schema(&self) -> &Schema;
    /// Number of points that the source claims to hold, if known; never trusted for an allocation.
    fn count_hint(&self) -> Option<u64>;
    /// The file that is read, if the source is a file; the first of several.
    fn path(&self) -> Option<&Path> {
        None
    }
    /// Every file that is read: an output never replaces one of them.
    fn files(&self) -> Vec<PathBuf> {
        self.path().map(Path::to_owned).into_iter().collect()
    }
    /// Chooses the columns that [`fill`](Self::fill) delivers, by their index in the schema; one
    /// may be chosen more than once. Initially, none are chosen.
    fn select(&mut self, columns: &[usize]);
    /// Upper bound on the memory in bytes that reading needs besides the batch. Sources that need
    /// almost none return 0.
    fn memory_needed(&self) -> u64 {
        0
    }
    /// Upper bound on the memory in bytes that the source takes before its first
    /// [`fill`](Self::fill). A source that opens its file only then needs little until its turn
    /// comes.
    fn memory_idle(&self) -> u64 {
        self.memory_needed()
    }
    /// Whether [`skip`](Self::skip) takes about as long for many points as for few. Builds in parts
    /// divide such sources among the parts, and give others to one part as a whole.
    fn can_skip(&self) -> bool {
        false
    }
    /// Passes over the next `count` points, or those that there are.
    ///
    /// # Errors
    /// As [`fill`](Self::fill).
    fn skip(&mut self, count: u64) -> Result<(), ReadError> {
        let (mut batch, mut left) = (PointBatch::default(), count);
        while left > 0 {
            self.fill(&mut batch, left.min(1 << 14) as usize)?;
            if batch.is_empty() {
                break;
            }
            left = left.saturating_sub(batch.len() as u64);
        }
        Ok(())
    }
    /// Hands over a token that stops long reads: after it is cancelled, [`fill`](Self::fill) may
    /// fail with [`ReadError::Cancelled`]. Sources whose every `fill` is short need not look at it;
    /// a build looks between two.
    fn watch(&mut self, _cancel: &CancelToken) {}
    /// Replaces the contents of `batch` by up to `limit` further points; the batch is empty at the
    /// end.
    ///
    /// # Errors
    /// [`ReadError`] if the file cannot be read or violates its format.
    fn fill(&mut self, batch: &mut PointBatch, limit: usize) -> Result<(), ReadError>;
}

//! Points as a stream: what a source offers, and batches of it.

use std::path::Path;

use super::column::{ColumnInfo, Values};
use super::error::ReadError;
use super::roles;

/// How the numbers of the colour columns of a source are to be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ColorDepth {
    /// 0 to 1.
    Unit,
    /// 0 to 255.
    Byte,
    /// 0 to 65535.
    Word,
    /// Not stated by the format: decided from the largest value of the whole input (≤ 1, ≤ 255, or larger).
    Guess,
}

/// What a source offers besides positions.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Schema {
    /// Columns, in the order of [`PointBatch::columns`] before any selection. Colours are `red`, `green`, `blue`, as
    /// names or as roles.
    pub columns: Vec<ColumnInfo>,
    /// What columns are for that have other names: `red` of the column `r`. Each a role and the index of a column.
    pub roles: Vec<(String, usize)>,
    /// How to read the colour columns, if there are any.
    pub color_depth: ColorDepth,
    /// The coordinate reference system as the file has it (WKT, or GeoTIFF keys in words); empty where it has none.
    pub crs: String,
    /// What the file says of itself: format, version, the program that wrote it. Empty where it says nothing.
    pub description: String,
}

impl Schema {
    /// Columns alone.
    #[must_use]
    pub fn new(columns: Vec<ColumnInfo>, color_depth: ColorDepth) -> Self {
        Self { columns, roles: Vec::new(), color_depth, crs: String::new(), description: String::new() }
    }

    /// Index of the column that `name` means: the one of that name, else the one that has it as its role, else the one of
    /// that name in other letter case. Several names may mean one column.
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
    /// Positions in the coordinates of the file, possibly not finite: readers pass on what they find.
    pub position: Vec<[f64; 3]>,
    /// One column for each selected column of the schema, of its type, and as long as `position`.
    pub columns: Vec<Values>,
}

impl PointBatch {
    /// Empties the batch and gives it the `selected` columns of a schema, keeping the buffers where types agree.
    ///
    /// Panics where an index is not one of the schema's.
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

/// A stream of points. Anything that has points can be one: see [`SliceSource`](super::SliceSource) for a short example.
pub trait PointSource: Send {
    /// What the source offers.
    fn schema(&self) -> &Schema;
    /// Number of points that the file claims to hold; a claim, never trusted for an allocation.
    fn count_hint(&self) -> Option<u64>;
    /// The file that is read, if it is one: an output never replaces it.
    fn path(&self) -> Option<&Path> {
        None
    }
    /// Chooses the columns that [`fill`](Self::fill) delivers, by their index in the schema; one may be chosen more than
    /// once. Initially none.
    fn select(&mut self, columns: &[usize]);
    /// Bytes that reading holds at once besides the batch, at most. Sources that hold next to nothing say 0.
    fn memory_needed(&self) -> u64 {
        0
    }
    /// Replaces the contents of `batch` by up to `limit` further points; leaves it empty at the end.
    ///
    /// # Errors
    /// [`ReadError`] where the file cannot be read or breaks its format.
    fn fill(&mut self, batch: &mut PointBatch, limit: usize) -> Result<(), ReadError>;
}

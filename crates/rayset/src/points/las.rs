//! LAS and LAZ through the `las` crate, in batches; scale and offset stay `f64`.

use std::path::{Path, PathBuf};

use las::{PointData, Reader};

use super::{ColorDepth, ColumnInfo, ColumnType, PointBatch, PointSource, ReadError, Schema};

/// The scalar columns that every point format has.
const COMMON: [(&str, ColumnType); 6] = [
    ("intensity", ColumnType::U16),
    ("classification", ColumnType::U8),
    ("return_number", ColumnType::U8),
    ("number_of_returns", ColumnType::U8),
    ("user_data", ColumnType::U8),
    ("point_source_id", ColumnType::U16),
];

/// The points of a LAS or LAZ file.
pub struct LasSource {
    path: PathBuf,
    reader: Reader,
    data: PointData,
    schema: Schema,
    selected: Vec<usize>,
    next: u64,
}

impl LasSource {
    /// Opens a file and reads its header.
    ///
    /// # Errors
    /// [`ReadError`] where the file cannot be opened or its header is refused.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        std::fs::File::open(path).map_err(|source| ReadError::Io { path: path.to_owned(), source })?;
        let reader = guarded(path, 0, || Reader::from_path(path))?;
        let header = reader.header();
        let mut columns: Vec<ColumnInfo> = COMMON
            .map(|(name, kind)| ColumnInfo {
                is_class: name == "classification",
                ..ColumnInfo::new(name, kind)
            })
            .to_vec();
        if header.point_format().has_color {
            columns.extend(["red", "green", "blue"].map(|name| ColumnInfo::new(name, ColumnType::U16)));
        }
        let data = las::PointDataBuilder::new().for_header(header).build();
        // The specification wants 16-bit colours, and many writers store 8-bit ones.
        let schema = Schema::new(columns, ColorDepth::Guess);
        Ok(Self { path: path.to_owned(), reader, data, schema, selected: Vec::new(), next: 0 })
    }
}

/// Calls the decoder, which panics on some damaged files where it should return an error. What it was working on is
/// given up, so nothing half-changed is ever used again.
fn guarded<T>(path: &Path, point: u64, call: impl FnOnce() -> Result<T, las::Error>) -> Result<T, ReadError> {
    match std::panic::catch_unwind(std::panic::AssertUnwindSafe(call)) {
        Ok(Ok(value)) => Ok(value),
        Ok(Err(e)) => Err(ReadError::Las { path: path.to_owned(), point, source: Box::new(e) }),
        Err(_) => Err(ReadError::LasDamaged { path: path.to_owned(), point }),
    }
}

impl PointSource for LasSource {
    fn schema(&self) -> &Schema {
        &self.schema
    }

    fn count_hint(&self) -> Option<u64> {
        Some(self.reader.header().number_of_points())
    }

    fn path(&self) -> Option<&Path> {
        Some(&self.path)
    }

    fn select(&mut self, columns: &[usize]) {
        self.selected = columns.to_vec();
    }

    fn fill(&mut self, batch: &mut PointBatch, limit: usize) -> Result<(), ReadError> {
        batch.reset(&self.schema, &self.selected);
        let left = self.reader.header().number_of_points().saturating_sub(self.next);
        if left == 0 {
            return Ok(());
        }
        guarded(&self.path, self.next, || self.reader.fill_points(left.min(limit as u64), &mut self.data))?;
        let data = &self.data;
        self.next += data.len() as u64;
        batch.position.extend(data.x().zip(data.y()).zip(data.z()).map(|((x, y), z)| [x, y, z]));
        for (column, &attribute) in batch.columns.iter_mut().zip(&self.selected) {
            match attribute {
                0 => data.intensity().for_each(|v| column.push(v.into())),
                1 => data.classification().for_each(|v| column.push(v.into())),
                2 => data.return_number().for_each(|v| column.push(v.into())),
                3 => data.number_of_returns().for_each(|v| column.push(v.into())),
                4 => data.user_data().for_each(|v| column.push(v.into())),
                5 => data.point_source_id().for_each(|v| column.push(v.into())),
                channel => {
                    let rgb = data.rgb().into_iter().flatten();
                    rgb.for_each(|(r, g, b)| column.push([r, g, b][(channel - 6).min(2)].into()));
                }
            }
        }
        Ok(())
    }
}

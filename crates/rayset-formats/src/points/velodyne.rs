//! Scans of turning LiDARs as KITTI and nuScenes have them: records of four or five floats (x, y,
//! z, intensity, and the number of the laser), and nothing else.

use std::path::Path;
use std::sync::Arc;

use super::file_source::{FileSource, RecordReader, Request, unreadable};
use super::plain::Plain;
use super::{ColorDepth, ColumnInfo, ColumnType, Place, PointBatch, ReadError, Schema};
use rayset_base::geometry::DVec3;
use rayset_store::storage::Storage;
use rayset_store::storage::input_file::InputFile;

/// Rows that are read at once.
const ROWS: u64 = 1 << 14;
/// Rows by which a file is taken for a scan.
const EXAMINED: u64 = 256;
/// Farthest return in metres.
const FARTHEST: f64 = 1000.0;
/// Names of the floats behind the positions.
const NAMES: [&str; 2] = ["intensity", "ring"];

/// The points of a scan.
pub(super) struct VelodyneReader {
    file: Arc<dyn Storage>,
    table: Plain,
    bytes: Vec<u8>,
}

impl VelodyneReader {
    /// Opens a file.
    ///
    /// # Errors
    /// [`ReadError`] if it cannot be read, or neither its size nor its first records are those of a
    /// scan.
    pub(super) fn open(path: &Path) -> Result<FileSource<Self>, ReadError> {
        let file = InputFile::open(path).map_err(ReadError::io(path))?;
        let length = file.length().map_err(ReadError::io(path))?;
        let file = file.into_storage();
        let mut bytes = Vec::new();
        for width in [4, 5] {
            let table = Plain { start: 0, kind: ColumnType::F32, width, big_endian: false };
            let rows = length / table.bytes(1);
            if rows == 0 || length % table.bytes(1) != 0 {
                continue;
            }
            table.load(&*file, 0, rows.min(EXAMINED) as usize, &mut bytes).map_err(ReadError::io(path))?;
            if is_scan(&table, &bytes) {
                let columns = NAMES[..width - 3].iter().map(|name| ColumnInfo::new(*name, ColumnType::F32));
                let mut schema = Schema::new(columns.collect(), ColorDepth::Guess);
                schema.description = format!("LiDAR scan of {width} floats a point, as of KITTI");
                schema.up = Some(DVec3::Z);
                return Ok(FileSource::new(path, schema, Some(rows), Self { file, table, bytes }));
            }
        }
        let what = format!(
            "{length} bytes of an unknown kind: expected a scan as KITTI or nuScenes have them, records of 4 or 5 floats \
             (x, y, z in metres, intensity, laser). Write others as an array, as in `numpy.save(\"points.npy\", \
             numpy.fromfile(\"FILE\", \"f4\").reshape(-1, COLUMNS))`"
        );
        Err(ReadError::malformed(path, Place::Byte(0), what))
    }
}

/// Whether rows are those of a scan: in reach of a sensor, with intensities and, if there are five,
/// numbers of lasers.
fn is_scan(table: &Plain, bytes: &[u8]) -> bool {
    let rows = bytes.len() / (table.width * table.kind.bytes());
    let of_scan = |row: usize| {
        let get = |component| table.get(bytes, row, component);
        (0..3).all(|axis| get(axis).abs() < FARTHEST && (get(axis) == 0.0 || get(axis).abs() > 1e-9))
            && (0.0..=65535.0).contains(&get(3))
            && (table.width == 4 || get(4).fract() == 0.0 && (0.0..=255.0).contains(&get(4)))
    };
    let apart = (0..rows).filter(|&row| table.get(bytes, row, 0) != table.get(bytes, 0, 0)).count();
    (0..rows).all(of_scan) && (apart > rows / 2 || rows == 1)
}

impl RecordReader for VelodyneReader {
    fn memory_needed(&self) -> u64 {
        self.table.bytes(ROWS)
    }

    fn read(&mut self, request: &Request<'_>, batch: &mut PointBatch) -> Result<(), ReadError> {
        let count = request.most.min(ROWS as usize);
        let read = self.table.load(&*self.file, request.first, count, &mut self.bytes);
        read.map_err(|e| unreadable(request.path(), self.table.bytes(request.first), e))?;
        let of_row = |row| [0, 1, 2].map(|axis| self.table.get(&self.bytes, row, axis));
        batch.position.extend((0..count).map(of_row));
        for (column, &index) in batch.columns.iter_mut().zip(request.selected) {
            self.table.append(&self.bytes, 3 + index, column);
        }
        Ok(())
    }
}

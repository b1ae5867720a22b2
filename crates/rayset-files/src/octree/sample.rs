//! A few points of a cloud, evenly spaced along its file: enough to know what it looks like,
//! whatever its size.

use super::file::Cloud;
use super::page::{PointPage, Run};
use crate::paged_file::HasPages;
use crate::points::{ColorDepth, ColumnInfo, ColumnType, PointBatch, Schema};
use rayset_store::container::{ScanError, SectionKind};

/// Most pages that are read for a sample.
const MOST_PAGES: u64 = 256;

/// Columns of a sample before the attributes: radius, weight, and the three colours if there are
/// any.
const OWN: [&str; 5] = ["radius", "weight", "red", "green", "blue"];

impl Cloud {
    /// About `most` points, or all if there are fewer, from pages evenly spaced along the file;
    /// pages follow a curve through space, so the points are spread over the whole cloud. A
    /// function of the file alone.
    ///
    /// The columns are `radius`, `weight`, `red`, `green` and `blue` (0 to 255) if the cloud has
    /// colours, and all stored attributes in their order, as [`sample_schema`](Self::sample_schema)
    /// says.
    ///
    /// # Errors
    /// [`ScanError`] if a page cannot be read or is damaged.
    pub fn sample(&self, most: usize) -> Result<PointBatch, ScanError> {
        let mut batch = self.empty_batch();
        let header = self.header();
        let (pages, points) = (u64::from(header.point_pages), header.points);
        if pages == 0 || points == 0 || most == 0 {
            return Ok(batch);
        }
        let read = pages.min(MOST_PAGES);
        let stride = self.sample_stride(most) as usize;
        let file = self.stored_file().reopened()?;
        let chosen: Vec<u32> = (0..read).map(|at| ((2 * at + 1) * pages / (2 * read)) as u32).collect();
        file.each_of(SectionKind::POINTS, &chosen, |page, offset, bytes| {
            self.stored_file().check(page, offset, bytes)?;
            let runs = PointPage::trusted(bytes, header);
            let mut before = 0;
            for run in (0..runs.len()).map(|index| runs.run(index)) {
                let chosen: Vec<usize> =
                    (0..run.head.len()).filter(|i| (before + i).is_multiple_of(stride)).collect();
                self.take(&run, &chosen, &mut batch);
                before += run.head.len();
            }
            Ok::<(), ScanError>(())
        })?;
        Ok(batch)
    }

    /// A batch without points, with the columns of [`sample_schema`](Self::sample_schema).
    pub(super) fn empty_batch(&self) -> PointBatch {
        let schema = self.sample_schema();
        let mut batch = PointBatch::default();
        batch.reset(&schema, &(0..schema.columns.len()).collect::<Vec<_>>());
        batch
    }

    /// Of the points of those pages that [`sample`](Self::sample) reads, every how many it has: by
    /// what the density of a sample has to be multiplied.
    #[must_use]
    pub fn sample_stride(&self, most: usize) -> u64 {
        let (pages, points) = (u64::from(self.header().point_pages).max(1), self.header().points);
        let read = u128::from(points) * u128::from(pages.min(MOST_PAGES)) / u128::from(pages);
        (read as u64).div_ceil(most.max(1) as u64).max(1)
    }

    /// The columns of a [`sample`](Self::sample).
    #[must_use]
    pub fn sample_schema(&self) -> Schema {
        let header = self.header();
        let own = OWN.iter().take(if header.has_color { 5 } else { 2 });
        let mut columns: Vec<ColumnInfo> = own
            .enumerate()
            .map(|(i, name)| ColumnInfo::new(*name, if i < 2 { ColumnType::F32 } else { ColumnType::U8 }))
            .collect();
        columns.extend(header.attributes.iter().map(|a| ColumnInfo {
            name: a.name.clone(),
            kind: a.kind,
            unit: a.unit.clone(),
            is_class: a.is_class,
        }));
        Schema::new(columns, ColorDepth::Byte)
    }

    /// Adds some of a run's points to a batch with the columns of
    /// [`sample_schema`](Self::sample_schema).
    pub(super) fn take(&self, run: &Run<'_>, chosen: &[usize], batch: &mut PointBatch) {
        let header = self.header();
        if chosen.is_empty() {
            return;
        }
        let positions = run.positions(header.root_cell());
        let radii: Option<Vec<f32>> = run.radii(header).map(Iterator::collect);
        let weights: Option<Vec<f32>> = run.weights(header).map(Iterator::collect);
        let colors: Option<Vec<[u8; 3]>> = run.colors(header).map(Iterator::collect);
        let first_attribute = if header.has_color { OWN.len() } else { 2 };
        for &i in chosen {
            batch.position.push(positions[i].to_array());
            let radius = radii.as_ref().map_or(header.radius.min(), |radii| radii[i]);
            let weight = weights.as_ref().map_or(header.weight.min(), |weights| weights[i]);
            batch.columns[0].push(f64::from(radius));
            batch.columns[1].push(f64::from(weight));
            for (channel, column) in (2..first_attribute).enumerate() {
                let value = colors.as_ref().map_or(0, |colors| colors[i][channel]);
                batch.columns[column].push(f64::from(value));
            }
        }
        for (index, attribute) in header.attributes.iter().enumerate() {
            let bytes = run.attribute_bytes(header, index);
            for &i in chosen {
                batch.columns[first_attribute + index].push_le_bytes(&bytes[i * attribute.kind.bytes()..]);
            }
        }
    }
}

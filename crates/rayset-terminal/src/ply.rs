//! Writing generated points as PLY.

use anyhow::Result;
use rayset::output::Destination;
use rayset::points::{PlyWriter, PointBatch, PointSource};

/// Writes points with all their columns; returns their number.
pub fn write_source(source: &mut dyn PointSource, to: &Destination) -> Result<u64> {
    let attributes = source.schema().names().map(str::to_owned).collect::<Vec<_>>();
    source.select(&(0..attributes.len()).collect::<Vec<_>>());
    let mut writer = PlyWriter::create(to, &attributes, source.count_hint().unwrap_or(0))?;
    let mut batch = PointBatch::default();
    loop {
        source.fill(&mut batch, 1 << 14)?;
        if batch.is_empty() {
            return Ok(writer.finish()?);
        }
        writer.write(&batch)?;
    }
}

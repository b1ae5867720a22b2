//! Opens files of points, and says what is lost of them.

use std::path::PathBuf;

use anyhow::Result;
use rayset::points::{self, PointSource, ReadOptions};

use crate::report;

/// Opens files of points as the sources of one cloud.
pub(crate) fn open_points(files: &[PathBuf], options: &ReadOptions) -> Result<Vec<Box<dyn PointSource>>> {
    let mut sources = Vec::new();
    for file in files {
        let source = points::open(file, options)?;
        for warning in &source.schema().warnings {
            report::remark(format_args!("{}: {warning}", file.display()));
        }
        sources.push(source);
    }
    Ok(sources)
}

//! Opens files of points, and says what is lost of them, and what of volumes is read.

use std::path::{Path, PathBuf};

use anyhow::Result;
use rayset::points::{self, PointSource, ReadOptions};
use rayset::volumes::VolumeSource;

use crate::columns;
use crate::host::Host;

/// Opens files of points as the sources of one cloud.
pub fn open_points(
    files: &[PathBuf],
    options: &ReadOptions,
    host: &dyn Host,
) -> Result<Vec<Box<dyn PointSource>>> {
    let mut sources = Vec::new();
    for file in files {
        let source = points::open(file, options)?;
        for warning in &source.schema().warnings {
            host.remark(&format!("{}: {warning}", file.display()));
        }
        if options.mesh_points.is_some_and(|points| source.count_hint() != Some(points)) {
            let name = file.display();
            host.remark(&format!(
                "{name}: --mesh-points is for the faces of PLY, OBJ, OFF and STL; its points are read"
            ));
        }
        sources.push(source);
    }
    columns::remark_on_readings(files, &sources, host);
    remark_on_systems(&sources, host);
    Ok(sources)
}

/// Says so if sources have different reference systems, whose coordinates do not belong together.
fn remark_on_systems(sources: &[Box<dyn PointSource>], host: &dyn Host) {
    let mut systems: Vec<&str> = sources.iter().map(|source| &*source.schema().crs).collect();
    systems.retain(|system| !system.is_empty());
    systems.sort_unstable();
    systems.dedup();
    if let [first, second, ..] = systems[..] {
        let name = |system: &str| system.chars().take(60).collect::<String>();
        host.remark(&format!(
            "the inputs have {} reference systems, {} and {} among them, and are put together as they are; `pdal translate` \
             with filters.reprojection brings them into one",
            systems.len(),
            name(first),
            name(second)
        ));
    }
}

/// Whether one of some files is a volume.
pub fn has_volume(files: &[PathBuf]) -> Result<bool> {
    for file in files {
        if VolumeSource::is_volume(file)? {
            return Ok(true);
        }
    }
    Ok(false)
}

/// Says what the reader of a volume chose, and what it knows of the volume.
pub fn remark_about(file: &Path, source: &VolumeSource, host: &dyn Host) {
    for sentence in &source.about {
        host.remark(&format!("{}: {sentence}", file.display()));
    }
}

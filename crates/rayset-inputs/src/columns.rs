//! Which columns of points are kept if nobody names them: all, as long as they cost little.

use std::path::Path;

use rayset::points::{ColumnInfo, PointSource};

use crate::host::Host;

/// Most bytes that attributes add to a point if nobody asked for them.
const MOST_BYTES: usize = 16;
/// Most attributes of a cloud.
const MOST: usize = 32;
/// What looks are chosen by comes first, in this order.
const FIRST: [&str; 4] = ["classification", "intensity", "reflectance", "temperature"];
/// Columns that a cloud keeps by itself, or that say nothing of a point.
const OWN: [&str; 8] = ["radius", "weight", "red", "green", "blue", "nx", "ny", "nz"];

/// Columns that are kept, and those left out because of what they cost.
pub struct Columns {
    /// Names of those that are kept.
    pub kept: Vec<String>,
    left_out: Vec<String>,
}

impl Columns {
    /// What to say of columns that are left out; `None` if none is.
    pub fn remark(&self) -> Option<String> {
        let left_out = &self.left_out;
        (!left_out.is_empty()).then(|| {
            format!(
                "left out {}: attributes take up to {MOST_BYTES} bytes a point unless `build --attributes` names them",
                left_out.join(", ")
            )
        })
    }
}

/// Most lines about how columns were read; files of one kind share a line.
const MOST_READINGS: usize = 4;

/// Says how the columns of tables were read, in one line for all files that were read alike.
pub(crate) fn remark_on_readings<S: PointSource + ?Sized>(sources: &[Box<S>], host: &dyn Host) {
    let mut readings: Vec<(&str, &Path, usize)> = Vec::new();
    for source in sources {
        let file = source.path().unwrap_or(Path::new("the input"));
        let reading = source.schema().reading.as_str();
        match readings.iter_mut().find(|(known, ..)| *known == reading) {
            Some((.., files)) => *files += 1,
            None if reading.is_empty() => {}
            None => readings.push((reading, file, 1)),
        }
    }
    for (reading, file, files) in readings.iter().take(MOST_READINGS) {
        let more = if *files > 1 { format!(" and {} more", files - 1) } else { String::new() };
        host.remark(&format!("{}{more}: {reading}", file.display()));
    }
    if let Some(others) = readings.get(MOST_READINGS..).filter(|others| !others.is_empty()) {
        let files: usize = others.iter().map(|(.., files)| files).sum();
        host.remark(&format!("{files} more files have other columns; `rayset info` lists how each was read"));
    }
}

/// The columns that all sources have, those by which looks are chosen first, up to a bounded number of bytes a point.
pub fn customary<S: PointSource + ?Sized>(sources: &[Box<S>]) -> Columns {
    chosen(sources, MOST_BYTES)
}

/// The columns that all sources have.
pub fn of_all<S: PointSource + ?Sized>(sources: &[Box<S>]) -> Columns {
    chosen(sources, usize::MAX)
}

fn chosen<S: PointSource + ?Sized>(sources: &[Box<S>], most_bytes: usize) -> Columns {
    let mut columns = Columns { kept: Vec::new(), left_out: Vec::new() };
    let Some((first, others)) = sources.split_first() else { return columns };
    let schema = first.schema();
    let is_own = |index: usize, column: &ColumnInfo| {
        let plays = |role: &&str| schema.find(role) == Some(index);
        OWN.iter().any(|own| own.eq_ignore_ascii_case(&column.name)) || OWN.iter().any(plays)
    };
    let mut found: Vec<&ColumnInfo> = (schema.columns.iter().enumerate())
        .filter(|(index, column)| !is_own(*index, column))
        .map(|(_, column)| column)
        .filter(|column| others.iter().all(|other| other.schema().names().any(|name| name == column.name)))
        .collect();
    let place = |column: &ColumnInfo| {
        FIRST.iter().position(|first| first.eq_ignore_ascii_case(&column.name)).unwrap_or(FIRST.len())
    };
    found.sort_by_key(|column| place(column));
    let mut bytes = 0;
    for column in found {
        let fits = bytes + column.kind.bytes() <= most_bytes && columns.kept.len() < MOST;
        if fits && !columns.kept.contains(&column.name) {
            bytes += column.kind.bytes();
            columns.kept.push(column.name.clone());
        } else if !fits {
            columns.left_out.push(column.name.clone());
        }
    }
    columns
}

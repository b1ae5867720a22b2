//! Snapshots and initial conditions in GADGET's own binary format, SnapFormat 1 and 2, in both byte
//! orders, in one file or several.
//!
//! A file is a header and blocks, each between two marks with its length: positions, velocities,
//! identifiers, masses, and of gas the internal energy, the density and the smoothing length, in
//! this order; in format 2 blocks have names instead. A smoothing length is the radius of compact
//! support. Positions are left where they are: a box that is periodic is not wrapped.

mod blocks;

use std::path::{Path, PathBuf};

use self::blocks::{Block, GadgetFile, Header, TYPES};
use super::file_source::{FileSource, RecordReader, Request};
use super::particles::{self, Census, Supply};
use super::{ColorDepth, ColumnInfo, ColumnType, PointBatch, ReadError, Schema, Values, roles, siblings};

/// Rows that are read at once.
const ROWS: u64 = 1 << 14;

/// Whether a file is a snapshot of GADGET.
pub(super) fn begins(head: &[u8]) -> bool {
    blocks::byte_order(head).is_some()
}

/// The particles of a snapshot.
pub(super) struct GadgetReader {
    types: Vec<usize>,
    supplies: Vec<Supply>,
    /// The file and the type that are read next: indices of the files and of `types`.
    next: (usize, usize),
    open: Option<GadgetFile>,
    /// Rows of the current type that were delivered.
    row: u64,
    scratch: Vec<u8>,
    second: Vec<u8>,
}

impl GadgetReader {
    /// Opens all files of the snapshot to which a file belongs.
    pub(super) fn open(path: &Path, wanted: Option<&[String]>) -> Result<FileSource<Self>, ReadError> {
        let first = GadgetFile::open(path)?;
        let files = siblings::of(path, first.header.files, "")?;
        let census = Census::take(&files, |path| Ok(GadgetFile::open(path)?.header.counts))?;
        let types = particles::chosen(path, wanted, &census.counts)?;
        let mut seen: Vec<(usize, GadgetFile)> = Vec::new();
        for &kind in &types {
            seen.push((kind, GadgetFile::open(census.sample(&files, kind))?));
        }
        let (columns, supplies): (Vec<ColumnInfo>, Vec<Supply>) = columns(&seen).into_iter().unzip();
        let mut schema = Schema::new(columns, ColorDepth::Guess);
        schema.description = description(&first, &types, &census.counts, supplies.contains(&Supply::Radius));
        let count = census.total(&types);
        let reader = Self {
            supplies,
            types,
            next: (0, 0),
            open: None,
            row: 0,
            scratch: Vec::new(),
            second: Vec::new(),
        };
        Ok(FileSource::of_files(files, schema, Some(count), reader))
    }

    /// Goes to the next type with particles that have not been delivered. Returns it with the
    /// number of its rows. `None` at the end.
    fn advance(&mut self, files: &[PathBuf]) -> Result<Option<(usize, u64)>, ReadError> {
        loop {
            let (file, place) = self.next;
            let Some(path) = files.get(file) else { return Ok(None) };
            let Some(&kind) = self.types.get(place) else {
                (self.next, self.open, self.row) = ((file + 1, 0), None, 0);
                continue;
            };
            if self.open.is_none() {
                self.open = Some(GadgetFile::open(path)?);
            }
            let rows = self.open.as_ref().map_or(0, |file| file.header.counts[kind]);
            if self.row < rows {
                return Ok(Some((kind, rows)));
            }
            (self.next.1, self.row) = (place + 1, 0);
        }
    }

    /// Appends `count` rows of a type to the batch.
    fn append(
        &mut self,
        selected: &[usize],
        kind: usize,
        count: usize,
        batch: &mut PointBatch,
    ) -> Result<(), ReadError> {
        let Some(file) = &self.open else { return Ok(()) };
        let row = self.row;
        let load = |block: &Block, bytes: &mut Vec<u8>| {
            let first = block.first[kind].unwrap_or(0) + row;
            let read = block.plain.load(&*file.file, first, count, bytes);
            read.map_err(ReadError::io(&file.path))
        };
        if let Some(block) = find(file, "POS", kind) {
            load(block, &mut self.scratch)?;
            let (plain, bytes) = (block.plain, &self.scratch);
            batch.position.extend((0..count).map(|i| [0, 1, 2].map(|axis| plain.get(bytes, i, axis))));
        }
        for (out, &index) in batch.columns.iter_mut().zip(selected) {
            let supply = &self.supplies[index];
            let (mut masses, mut radii) = (None, None);
            if matches!(supply, Supply::Mass | Supply::Weight)
                && let Some(block) = find(file, "MASS", kind)
            {
                load(block, &mut self.scratch)?;
                masses = Some(block.plain);
            }
            if matches!(supply, Supply::Radius | Supply::Weight)
                && let Some(block) = find(file, "HSML", kind)
            {
                load(block, &mut self.second)?;
                radii = Some(block.plain);
            }
            let mass = |i| masses.map_or(file.header.masses[kind], |plain| plain.get(&self.scratch, i, 0));
            let radius = |i| radii.map_or(f64::NAN, |plain| plain.get(&self.second, i, 0));
            match supply {
                Supply::Stored(name, component) => match find(file, name, kind) {
                    Some(block) => {
                        load(block, &mut self.scratch)?;
                        block.plain.append(&self.scratch, *component, out);
                    }
                    None => push(out, (0..count).map(|_| f64::NAN)),
                },
                Supply::Mass => push(out, (0..count).map(mass)),
                Supply::Radius => push(out, (0..count).map(radius)),
                Supply::Weight => push(out, (0..count).map(|i| particles::weight(mass(i), radius(i)))),
                Supply::Kind => push(out, (0..count).map(|_| kind as f64)),
            }
        }
        self.row += count as u64;
        Ok(())
    }
}

fn push(out: &mut Values, numbers: impl Iterator<Item = f64>) {
    numbers.for_each(|number| out.push(number));
}

/// The block of this name, if it has rows for the type.
fn find<'a>(file: &'a GadgetFile, name: &str, kind: usize) -> Option<&'a Block> {
    file.blocks.iter().find(|block| block.name == name).filter(|block| block.first[kind].is_some())
}

/// The columns of the types that are read, each type with a file that has it. Of numbers that some
/// of the types do not have these are NaN; identifiers are left out unless all have them.
fn columns(seen: &[(usize, GadgetFile)]) -> Vec<(ColumnInfo, Supply)> {
    let all_have = |name: &str| seen.iter().all(|(kind, file)| find(file, name, *kind).is_some());
    let kind_of = |name: &str| {
        let kinds =
            seen.iter().filter_map(|(kind, file)| find(file, name, *kind)).map(|block| block.plain.kind);
        kinds.reduce(ColumnType::common).unwrap_or(ColumnType::F64)
    };
    let mut columns = Vec::new();
    if seen.is_empty() {
        return columns;
    }
    let has_mass = |(kind, file): &(usize, GadgetFile)| {
        file.header.masses[*kind] > 0.0 || find(file, "MASS", *kind).is_some()
    };
    let with_mass = seen.iter().all(has_mass);
    if all_have("HSML") {
        columns.push((ColumnInfo::new("radius", kind_of("HSML")), Supply::Radius));
        if with_mass {
            columns.push((ColumnInfo::new("weight", ColumnType::F64), Supply::Weight));
        }
    }
    if with_mass {
        let kind = if all_have("MASS") { kind_of("MASS") } else { ColumnType::F64 };
        columns.push((ColumnInfo::new("mass", kind), Supply::Mass));
    }
    if seen.len() > 1 {
        columns.push((ColumnInfo::new("type", ColumnType::U8).of_classes(), Supply::Kind));
    }
    let mut names: Vec<(&str, usize)> = Vec::new();
    for (kind, file) in seen {
        for block in file.blocks.iter().filter(|block| block.first[*kind].is_some()) {
            if block.name != "POS"
                && block.name != "MASS"
                && !names.iter().any(|(name, _)| *name == block.name)
            {
                names.push((&block.name, block.plain.width));
            }
        }
    }
    for (name, width) in names {
        let kind = kind_of(name);
        if kind.is_integer() && !all_have(name) {
            continue;
        }
        for (component, full) in roles::plain_components(name, width).into_iter().enumerate() {
            columns.push((ColumnInfo::new(full, kind), Supply::Stored(name.to_owned(), component)));
        }
    }
    columns
}

fn description(file: &GadgetFile, types: &[usize], counts: &[u64; TYPES], with_radius: bool) -> String {
    let Header { time, redshift, files, box_size, hubble, .. } = file.header;
    let mut words = format!(
        "snapshot of a simulation in GADGET's format {}, redshift {redshift}, time {time}, box size {box_size}, h {hubble}",
        if file.named { 2 } else { 1 }
    );
    if files > 1 {
        words.push_str(&format!(", {files} files"));
    }
    for &kind in types {
        words.push_str(&format!("; {} particles of type {}", counts[kind], particles::name(kind)));
    }
    if with_radius {
        words.push_str(
            "; radius = HSML, which is the radius of compact support, weight = mass / (π/8 radius³)",
        );
    }
    words
}

impl RecordReader for GadgetReader {
    fn memory_needed(&self) -> u64 {
        // Rows of up to three doubles, of two blocks.
        2 * 24 * ROWS
    }

    fn read(&mut self, request: &Request<'_>, batch: &mut PointBatch) -> Result<(), ReadError> {
        let Some((kind, rows)) = self.advance(request.files)? else { return Ok(()) };
        let count = (rows - self.row).min(ROWS).min(request.most as u64);
        self.append(request.selected, kind, count as usize, batch)
    }
}

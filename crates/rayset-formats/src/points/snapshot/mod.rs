//! Snapshots of simulations in HDF5: GADGET-2, -3 and -4, SWIFT, AREPO, EAGLE, Illustris and
//! IllustrisTNG, in one file or several.
//!
//! Their common layout is a group for each type of particle, `PartType0` for gas and so on, with a
//! dataset for each quantity. Positions are left where they are: a box that is periodic is not
//! wrapped.

mod bits;
mod hdf5;
mod header;
mod layout;
mod other;
mod table;
mod units;

use std::path::Path;

use self::hdf5::File;
use self::header::Header;
use self::layout::{Radius, TypeLayout};
use self::table::{Blocks, Table};
use super::file_source::{FileSource, RecordReader, Request};
use super::particles::{self, Census, Supply};
use super::{ColorDepth, Place, PointBatch, ReadError, Schema, Values, reading, siblings};

/// Memory in bytes for blocks of datasets. Where their chunks are larger together, they are decoded
/// more than once.
const BLOCKS_BYTES: u64 = 48 << 20;
/// How often a chunk is in memory at most while it is decoded: as it is stored, between filters,
/// and as numbers.
const COPIES_OF_A_CHUNK: u64 = 3;

/// The particles of a snapshot.
pub(super) struct SnapshotReader {
    types: Vec<TypeLayout>,
    supplies: Vec<Supply>,
    /// Which of the three coordinates are x, y and z.
    axes: [usize; 3],
    memory: u64,
    /// The file and the type that are read next: indices of the files and of `types`.
    next: (usize, usize),
    open: Option<Part>,
}

/// The particles of one type in one file.
struct Part {
    file: File,
    kind: usize,
    positions: Blocks,
    /// The other datasets that are needed.
    blocks: Vec<(String, Blocks)>,
    rows: u64,
    row: u64,
}

impl SnapshotReader {
    /// Opens all files of the snapshot to which a file belongs. `names` are those of positions and
    /// all columns.
    pub(super) fn open(
        path: &Path,
        wanted: Option<&[String]>,
        names: Option<&[String]>,
    ) -> Result<FileSource<Self>, ReadError> {
        let file = File::open(path)?;
        let header = Header::read(&file)?;
        if header.is_virtual {
            return Err(other::of_other_files(&file));
        }
        if layout::counts(&file)?.is_none() {
            return Err(other::refused(&file));
        }
        drop(file);
        let extension = path.extension().map_or_else(String::new, |e| format!(".{}", e.to_string_lossy()));
        let files = siblings::of(path, header.files, &extension)?;
        let census =
            Census::take(&files, |path| Ok(layout::counts(&File::open(path)?)?.unwrap_or_default()))?;
        let chosen = particles::chosen(path, wanted, &census.counts)?;
        let mut types = Vec::new();
        for &kind in &chosen {
            let file = File::open(census.sample(&files, kind))?;
            types.push(TypeLayout::read(&file, &header, kind)?);
        }
        let named = layout::renamed(layout::columns(&types), names);
        let named = named.map_err(|what| ReadError::malformed(path, Place::Byte(0), what))?;
        let (columns, supplies) = named.columns.into_iter().unzip();
        let mut schema = Schema::new(columns, ColorDepth::Guess);
        schema.description = layout::description(&header, &types, &census.counts);
        let by = if names.is_some() { reading::BY_OPTION } else { "the names of datasets" };
        reading::note(&mut schema, &named.all, named.axes, by);
        let largest = types.iter().map(|layout| layout.largest_chunk).max().unwrap_or(0);
        let blocks = types.iter().map(|layout| layout.all_blocks).max().unwrap_or(0);
        let reader = Self {
            supplies,
            axes: named.axes,
            memory: (1 << 20) + blocks.min(BLOCKS_BYTES) + COPIES_OF_A_CHUNK * largest,
            next: (0, 0),
            open: None,
            types,
        };
        Ok(FileSource::of_files(files, schema, Some(census.total(&chosen)), reader))
    }

    /// The names of the datasets of a type that the selected columns need, without positions.
    fn needed(&self, selected: &[usize], layout: &TypeLayout) -> Vec<String> {
        let mut names: Vec<String> = Vec::new();
        for &column in selected {
            let needed = match &self.supplies[column] {
                Supply::Stored(name, _) => vec![name.as_str()],
                Supply::Mass => layout.mass_tables(),
                Supply::Radius => layout.radius_tables(),
                Supply::Weight => [layout.mass_tables(), layout.radius_tables()].concat(),
                Supply::Kind => Vec::new(),
            };
            for name in needed {
                if !names.iter().any(|known| known == name) {
                    names.push(name.to_owned());
                }
            }
        }
        names
    }

    /// Opens the next type in this file, or in the next. `None` after the last.
    fn next_part(&mut self, request: &Request<'_>) -> Result<Option<Part>, ReadError> {
        while let Some(path) = request.files.get(self.next.0) {
            let Some(layout) = self.types.get(self.next.1) else {
                self.next = (self.next.0 + 1, 0);
                continue;
            };
            self.next.1 += 1;
            let file = File::open(path)?;
            let Some(group) = layout::group_of(&file, layout.kind)? else { continue };
            let positions = layout::positions(&file, &group)?;
            if positions.rows == 0 {
                continue;
            }
            let (_, there) = file.names(&group)?;
            let mut tables = Vec::new();
            for name in self.needed(request.selected, layout) {
                // What one type has another may lack.
                if !there.contains(&name) {
                    continue;
                }
                let table = Table::open(&file, &group, &name)?;
                let table = table.filter(|table| table.rows == positions.rows).ok_or_else(|| {
                    let what = format!(
                        "{}/{name}: expected a row of numbers for each of {} particles",
                        group.name(),
                        positions.rows
                    );
                    file.wrong(group.address(), what)
                })?;
                tables.push((name, table));
            }
            let whole = |table: &Table| table.block_bytes(u64::MAX);
            let all =
                tables.iter().map(|(_, table)| whole(table)).fold(whole(&positions), u64::saturating_add);
            // Each block has its part of the memory.
            let most = |table: &Table| {
                if all <= BLOCKS_BYTES {
                    u64::MAX
                } else {
                    (whole(table) as f64 / all as f64 * BLOCKS_BYTES as f64) as u64
                }
            };
            let blocks = |table: Table| {
                let bytes = most(&table);
                Blocks::new(table, bytes)
            };
            let rows = positions.rows;
            return Ok(Some(Part {
                file,
                kind: self.next.1 - 1,
                positions: blocks(positions),
                blocks: tables.into_iter().map(|(name, table)| (name, blocks(table))).collect(),
                rows,
                row: 0,
            }));
        }
        Ok(None)
    }
}

impl Part {
    fn find(&self, name: &str) -> Option<&Blocks> {
        self.blocks.iter().find(|(known, _)| known == name).map(|(_, blocks)| blocks)
    }

    /// Loads the blocks with the next row. Returns the number of rows that can be delivered from
    /// them.
    fn load(&mut self) -> Result<u64, ReadError> {
        let mut rows = self.positions.load(&self.file, self.row)?;
        for (_, blocks) in &mut self.blocks {
            rows = rows.min(blocks.load(&self.file, self.row)?);
        }
        Ok(rows)
    }

    fn mass(&self, layout: &TypeLayout, row: u64) -> f64 {
        match &layout.mass {
            Some(Ok(name)) => self.find(name).map_or(f64::NAN, |blocks| blocks.get(row, 0)),
            Some(Err(mass)) => *mass,
            None => f64::NAN,
        }
    }

    fn radius(&self, layout: &TypeLayout, row: u64) -> f64 {
        let number = |name| self.find(name).map_or(f64::NAN, |blocks| blocks.get(row, 0));
        match &layout.radius {
            Some(Radius::Smoothing(name, factor)) => number(name) * factor,
            Some(Radius::Volume(name)) => Radius::of_cell(number(name)),
            Some(Radius::Density(name)) => Radius::of_cell(self.mass(layout, row) / number(name)),
            None => f64::NAN,
        }
    }

    /// Appends a column of `count` rows.
    fn append(&self, layout: &TypeLayout, supply: &Supply, count: usize, out: &mut Values) {
        let rows = self.row..self.row + count as u64;
        match supply {
            Supply::Stored(name, component) => match self.find(name) {
                Some(blocks) => blocks.append(self.row, count, *component, out),
                None => rows.for_each(|_| out.push(f64::NAN)),
            },
            Supply::Mass => rows.for_each(|row| out.push(self.mass(layout, row))),
            Supply::Radius => rows.for_each(|row| out.push(self.radius(layout, row))),
            Supply::Weight => {
                rows.for_each(|row| {
                    out.push(particles::weight(self.mass(layout, row), self.radius(layout, row)));
                });
            }
            Supply::Kind => rows.for_each(|_| out.push(layout.kind as f64)),
        }
    }
}

impl RecordReader for SnapshotReader {
    fn memory_needed(&self) -> u64 {
        self.memory
    }

    fn read(&mut self, request: &Request<'_>, batch: &mut PointBatch) -> Result<(), ReadError> {
        if self.open.as_ref().is_none_or(|part| part.row == part.rows) {
            self.open = None;
            self.open = self.next_part(request)?;
        }
        let Some(part) = &mut self.open else { return Ok(()) };
        let count = part.load()?.min(request.most as u64) as usize;
        let position = |row| self.axes.map(|axis| part.positions.get(row, axis));
        batch.position.extend((part.row..part.row + count as u64).map(position));
        for (column, &index) in batch.columns.iter_mut().zip(request.selected) {
            part.append(&self.types[part.kind], &self.supplies[index], count, column);
        }
        part.row += count as u64;
        Ok(())
    }
}

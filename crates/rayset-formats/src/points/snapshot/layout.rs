//! The layout of a snapshot: which groups and datasets it has, and which columns they make.

use hdf5_reader::group::Group;

use super::hdf5::File;
use super::header::Header;
use super::table::Table;
use super::units;
use crate::points::particles::{self, MOST_TYPES, Supply};
use crate::points::{ColumnInfo, ColumnType, ReadError, roles};

pub(super) const POSITIONS: &str = "Coordinates";
/// Names of the mass of a particle.
const MASSES: [&str; 2] = ["Masses", "Mass"];
/// Names of the smoothing length: of GADGET and its kin, and of SWIFT.
const SMOOTHING: [&str; 2] = ["SmoothingLength", "SmoothingLengths"];
const VOLUMES: [&str; 2] = ["Volume", "Volumes"];
const DENSITIES: [&str; 2] = ["Density", "Densities"];
/// Radius of a cell of a mesh in radii of the ball of its volume.
const CELL_FACTOR: f64 = 2.5;
/// Largest number of datasets of a type of particle.
const MOST_TABLES: usize = 1024;

/// The group of a type of particle in a file. `None` if the file has none with positions.
pub(super) fn group_of(file: &File, kind: usize) -> Result<Option<Group>, ReadError> {
    let Some(group) = file.group(&format!("PartType{kind}"))? else { return Ok(None) };
    let (_, tables) = file.names(&group)?;
    Ok(tables.iter().any(|name| name == POSITIONS).then_some(group))
}

/// The number of particles of each type in a file. `None` if it is not laid out as a snapshot is.
pub(super) fn counts(file: &File) -> Result<Option<[u64; MOST_TYPES]>, ReadError> {
    let (mut counts, mut found) = ([0; MOST_TYPES], false);
    let (groups, _) = file.names(&file.root()?)?;
    for kind in (0..MOST_TYPES).filter(|kind| groups.contains(&format!("PartType{kind}"))) {
        if let Some(group) = group_of(file, kind)? {
            counts[kind] = positions(file, &group)?.rows;
            found = true;
        }
    }
    Ok(found.then_some(counts))
}

/// The positions of a type of particle.
pub(super) fn positions(file: &File, group: &Group) -> Result<Table, ReadError> {
    /// Upper bound on the compression ratio of Deflate.
    const MOST_DEFLATED: u64 = 1032;
    let name = || format!("{}/{POSITIONS}", group.name());
    let table = Table::open(file, group, POSITIONS)?;
    let table = table.filter(|table| table.width == 3 && !table.kind.is_integer());
    let table = table.ok_or_else(|| {
        file.wrong(
            group.address(),
            format!("{}: expected a dataset of three floating-point numbers a row", name()),
        )
    })?;
    let bytes = table.rows.saturating_mul(table.row_bytes());
    if bytes / MOST_DEFLATED > file.bytes {
        let what = format!(
            "{}: {} rows are said to follow, more than a file of {} bytes can hold, even compressed",
            name(),
            table.rows,
            file.bytes
        );
        return Err(file.wrong(table.address(), what));
    }
    Ok(table)
}

/// The unit of the masses of a file, which is one: that of a dataset of masses of any type,
/// otherwise that of the whole snapshot.
fn unit_of_masses(file: &File) -> Result<String, ReadError> {
    for kind in 0..MOST_TYPES {
        let Some(group) = group_of(file, kind)? else { continue };
        let (_, names) = file.names(&group)?;
        for name in MASSES.iter().filter(|name| names.iter().any(|found| found == *name)) {
            let Some(table) = Table::open(file, &group, name)? else { continue };
            let unit = units::of(&table.attributes(file)?);
            if !unit.is_empty() {
                return Ok(unit);
            }
        }
    }
    for name in ["Units", "Parameters", "Header"] {
        let Some(group) = file.group(name)? else { continue };
        let unit = units::of_masses(&file.attributes(&group)?);
        if !unit.is_empty() {
            return Ok(unit);
        }
    }
    Ok(String::new())
}

/// Where the radii of the particles of a type come from.
#[derive(Clone, PartialEq)]
pub(super) enum Radius {
    /// A dataset, and the factor that makes it the radius of compact support.
    Smoothing(String, f64),
    /// The volume of a cell, or its mass and density.
    Volume(String),
    Density(String),
}

impl Radius {
    /// The radius of a cell of this volume.
    pub(super) fn of_cell(volume: f64) -> f64 {
        CELL_FACTOR * (0.75 / std::f64::consts::PI * volume).cbrt()
    }

    fn description(&self, header: &Header) -> String {
        match (self, &header.gamma) {
            (Self::Smoothing(name, factor), Some((_, kernel))) => {
                format!("{factor} {name}, the radius of compact support of the kernel {kernel}")
            }
            (Self::Smoothing(name, _), None) => format!("{name}, which is the radius of compact support"),
            (Self::Volume(name), _) => format!("{CELL_FACTOR} (3 {name} / 4π)^(1/3)"),
            (Self::Density(name), _) => format!("{CELL_FACTOR} (3 mass / 4π {name})^(1/3)"),
        }
    }
}

/// A dataset that becomes columns.
struct Stored {
    name: String,
    width: usize,
    kind: ColumnType,
    unit: String,
}

/// A type of particles: its datasets, and the rules for what is derived.
pub(super) struct TypeLayout {
    pub(super) kind: usize,
    tables: Vec<Stored>,
    /// The dataset with masses; otherwise the mass of all.
    pub(super) mass: Option<Result<String, f64>>,
    /// Of the masses, wherever they are. Empty if none is stated.
    mass_unit: String,
    pub(super) radius: Option<Radius>,
    pub(super) position_unit: String,
    /// Bytes of the largest chunk, and of the blocks of all datasets.
    pub(super) largest_chunk: u64,
    pub(super) all_blocks: u64,
}

impl TypeLayout {
    /// Reads what a file says about the type.
    pub(super) fn read(file: &File, header: &Header, kind: usize) -> Result<Self, ReadError> {
        let mut layout = Self {
            kind,
            tables: Vec::new(),
            mass: None,
            mass_unit: String::new(),
            radius: None,
            position_unit: String::new(),
            largest_chunk: 0,
            all_blocks: 0,
        };
        let Some(group) = group_of(file, kind)? else { return Ok(layout) };
        let rows = positions(file, &group)?.rows;
        let (_, names) = file.names(&group)?;
        for name in names.iter().take(MOST_TABLES) {
            let Some(table) = Table::open(file, &group, name)? else { continue };
            let unit = units::of(&table.attributes(file)?);
            layout.largest_chunk = layout.largest_chunk.max(table.chunk_bytes);
            layout.all_blocks = layout.all_blocks.saturating_add(table.block_bytes(u64::MAX));
            if name == POSITIONS {
                layout.position_unit = unit;
            } else if table.rows == rows {
                layout.tables.push(Stored { name: name.clone(), width: table.width, kind: table.kind, unit });
            }
        }
        let find = |names: &[&str]| {
            let found = layout.tables.iter().find(|t| t.width == 1 && names.contains(&t.name.as_str()));
            found.map(|table| table.name.clone())
        };
        let mass = find(&MASSES).map(Ok).or_else(|| header.mass(kind).map(Err));
        let factor = header.gamma.as_ref().map_or(1.0, |(gamma, _)| *gamma);
        let radius = (find(&SMOOTHING).map(|name| Radius::Smoothing(name, factor)))
            .or_else(|| find(&VOLUMES).map(Radius::Volume))
            .or_else(|| find(&DENSITIES).filter(|_| mass.is_some()).map(Radius::Density));
        (layout.mass, layout.radius) = (mass, radius);
        if layout.mass.is_some() {
            let own = layout.mass_tables().first().and_then(|name| layout.table(name));
            let own = own.map(|table| table.unit.clone()).filter(|unit| !unit.is_empty());
            layout.mass_unit = own.map_or_else(|| unit_of_masses(file), Ok)?;
        }
        Ok(layout)
    }

    fn table(&self, name: &str) -> Option<&Stored> {
        self.tables.iter().find(|table| table.name == name)
    }

    /// The datasets from which the radius is made.
    pub(super) fn radius_tables(&self) -> Vec<&str> {
        match &self.radius {
            Some(Radius::Smoothing(name, _) | Radius::Volume(name)) => vec![name],
            Some(Radius::Density(name)) => self.mass_tables().into_iter().chain([name.as_str()]).collect(),
            None => Vec::new(),
        }
    }

    pub(super) fn mass_tables(&self) -> Vec<&str> {
        match &self.mass {
            Some(Ok(name)) => vec![name],
            _ => Vec::new(),
        }
    }

    /// The type of the numbers of the mass or the radius.
    fn kind_of_mass(&self) -> ColumnType {
        self.mass_tables()
            .first()
            .and_then(|name| self.table(name))
            .map_or(ColumnType::F64, |table| table.kind)
    }

    fn kind_of_radius(&self) -> ColumnType {
        match &self.radius {
            Some(Radius::Smoothing(name, _)) => self.table(name).map_or(ColumnType::F64, |table| table.kind),
            _ => ColumnType::F64,
        }
    }
}

/// The columns of all types that are read, each with where it comes from. Of numbers that some of
/// the types do not have these are NaN; integers that not all of them have are left out.
pub(super) fn columns(types: &[TypeLayout]) -> Vec<(ColumnInfo, Supply)> {
    let Some(first) = types.first() else { return Vec::new() };
    let common = |of: fn(&TypeLayout) -> ColumnType| types.iter().map(of).reduce(ColumnType::common);
    let common = |of| common(of).unwrap_or(ColumnType::F64);
    let mut columns = Vec::new();
    let with_radius = types.iter().all(|layout| layout.radius.is_some());
    if with_radius {
        let info = ColumnInfo::new("radius", common(TypeLayout::kind_of_radius));
        columns.push((info.with_unit(&first.position_unit), Supply::Radius));
    }
    if types.iter().all(|layout| layout.mass.is_some()) {
        if with_radius {
            columns.push((ColumnInfo::new("weight", ColumnType::F64), Supply::Weight));
        }
        let info = ColumnInfo::new("mass", common(TypeLayout::kind_of_mass)).with_unit(&first.mass_unit);
        columns.push((info, Supply::Mass));
    }
    if types.len() > 1 {
        columns.push((ColumnInfo::new("type", ColumnType::U8).of_classes(), Supply::Kind));
    }
    let taken: Vec<String> = columns.iter().map(|(info, _)| info.name.clone()).collect();
    let mut seen: Vec<&str> = Vec::new();
    for table in types.iter().flat_map(|layout| &layout.tables) {
        let is_mass = MASSES.contains(&table.name.as_str()) && taken.iter().any(|name| name == "mass");
        if is_mass || seen.contains(&table.name.as_str()) || taken.contains(&table.name) {
            continue;
        }
        seen.push(&table.name);
        let same: Vec<&Stored> = types.iter().filter_map(|layout| layout.table(&table.name)).collect();
        let kind = same.iter().map(|t| t.kind).reduce(ColumnType::common).unwrap_or(table.kind);
        let everywhere = same.len() == types.len();
        if same.iter().any(|t| t.width != table.width) || (!everywhere && kind.is_integer()) {
            continue;
        }
        for (component, name) in roles::plain_components(&table.name, table.width).into_iter().enumerate() {
            let info = ColumnInfo::new(name, kind).with_unit(&table.unit);
            columns.push((info, Supply::Stored(table.name.clone(), component)));
        }
    }
    columns
}

/// Columns under other names.
pub(super) struct Renamed {
    pub(super) columns: Vec<(ColumnInfo, Supply)>,
    /// Names of the three coordinates and of all columns.
    pub(super) all: Vec<String>,
    /// Which of the three coordinates are x, y and z.
    pub(super) axes: [usize; 3],
}

/// The columns under the given names, which begin with those of the three coordinates; `-` leaves a
/// column out.
pub(super) fn renamed(
    columns: Vec<(ColumnInfo, Supply)>,
    names: Option<&[String]>,
) -> Result<Renamed, String> {
    let own = ["x", "y", "z"]
        .map(str::to_owned)
        .into_iter()
        .chain(columns.iter().map(|(info, _)| info.name.clone()));
    let own: Vec<String> = own.collect();
    let Some(names) = names else { return Ok(Renamed { columns, all: own, axes: [0, 1, 2] }) };
    if names.len() != own.len() {
        let (given, wanted) = (names.len(), own.len());
        return Err(format!("{given} names of columns are given for {wanted}: {}", own.join(",")));
    }
    let (coordinates, others) = names.split_at(3);
    let [Some(x), Some(y), Some(z)] = roles::axes(coordinates) else {
        return Err("x, y and z must be the first three of the names of columns, in any order".into());
    };
    let columns = columns.into_iter().zip(others).filter(|(_, name)| !name.is_empty() && *name != "-");
    let columns = columns.map(|((info, supply), name)| {
        let is_class = info.is_class || roles::is_class(name);
        (ColumnInfo { name: name.clone(), is_class, ..info }, supply)
    });
    Ok(Renamed { columns: columns.collect(), all: names.to_vec(), axes: [x, y, z] })
}

/// What is read and how radii and weights are made, for the description of the source.
pub(super) fn description(header: &Header, types: &[TypeLayout], counts: &[u64; MOST_TYPES]) -> String {
    let mut words = header.description();
    // There is a column only if all types have it.
    let with_radius = types.iter().all(|layout| layout.radius.is_some());
    let with_weight = with_radius && types.iter().all(|layout| layout.mass.is_some());
    for layout in types {
        words.push_str(&format!(
            "; {} particles of type {}",
            counts[layout.kind],
            particles::name(layout.kind)
        ));
        if let Some(radius) = layout.radius.as_ref().filter(|_| with_radius) {
            words.push_str(&format!(", radius = {}", radius.description(header)));
        }
    }
    if with_weight {
        words.push_str("; weight = mass / (π/8 radius³)");
    }
    if let Some(unit) = types.first().map(|layout| &layout.position_unit).filter(|unit| !unit.is_empty()) {
        words.push_str(&format!("; positions in {unit}"));
    }
    words
}

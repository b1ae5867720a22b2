//! Which columns of points are kept if nobody names them: all, as long as they cost little.

use std::path::Path;

use rayset::build::{BuildOptions, Rule, ShapeRule};
use rayset::points::{ColumnInfo, HARMONIC, HARMONIC_CONSTANTS, PointSource, ROUND_RADIUS, SHAPE_COLUMNS};

use crate::host::Host;
use crate::speed::{SPEED, is_velocity};

/// Most bytes that attributes add to a point if nobody asked for them.
const MOST_BYTES: usize = 16;
/// Most attributes of a cloud.
const MOST: usize = 32;
/// What looks are chosen by comes first, in this order.
const FIRST: [&str; 4] = ["classification", "intensity", "reflectance", "temperature"];
/// Columns that a cloud keeps by itself, or that say nothing of a point.
const OWN: [&str; 5] = ["radius", "weight", "red", "green", "blue"];

/// Whether a column belongs to the shapes of ellipsoids, which a cloud keeps by itself.
fn is_of_shapes(name: &str) -> bool {
    SHAPE_COLUMNS.contains(&name) || name == ROUND_RADIUS
}

/// Whether a column has coefficients of the colours of all directions, which a cloud keeps, too.
fn is_of_harmonics(name: &str) -> bool {
    name.starts_with(HARMONIC) || HARMONIC_CONSTANTS.contains(&name)
}

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
                "left out {}: attributes take up to {MOST_BYTES} bytes a point unless --attributes names them",
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

/// What to say of points whose shapes are by columns of their normals; `None` if there are none.
pub fn remark_on_normals<S: PointSource + ?Sized>(
    sources: &[Box<S>],
    options: &BuildOptions,
) -> Option<String> {
    let measures = matches!(options.radius, None | Some(Rule::Auto)) && options.shape == ShapeRule::Auto;
    let schemas = || sources.iter().map(|source| source.schema());
    let have = |name: &str| schemas().all(|schema| schema.find(name).is_some());
    if !measures || have("radius") || have(SHAPE_COLUMNS[0]) {
        return None;
    }
    let (schema, normals) = schemas().find_map(|schema| Some((schema, schema.normals()?)))?;
    let [x, y, z] = normals.map(|index| &schema.columns[index].name);
    Some(format!("points are discs across their normals ({x}, {y}, {z}); balls with --shape round"))
}

/// The columns that all sources have, those by which looks are chosen first, up to a bounded number
/// of bytes a point.
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
    let has_shapes = SHAPE_COLUMNS.iter().all(|name| schema.find(name).is_some());
    let has_harmonics = schema.harmonics().0 > 0;
    // Whoever asks for all gets them, too.
    let normals = schema.normals().filter(|_| most_bytes < usize::MAX);
    let is_own = |index: usize, column: &ColumnInfo| {
        if has_shapes && is_of_shapes(&column.name) {
            return true;
        }
        if has_harmonics && is_of_harmonics(&column.name) {
            return true;
        }
        if normals.is_some_and(|normals| normals.contains(&index)) {
            return true;
        }
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
    let has_velocity = found.iter().any(|column| column.name.strip_suffix("_x").is_some_and(is_velocity));
    let (mut done, mut bytes): (Vec<&str>, usize) = (Vec::new(), 0);
    for column in &found {
        if done.contains(&column.name.as_str()) || column.name == SPEED && has_velocity {
            continue;
        }
        // Components of a vector are kept together, or not at all: one of them says nothing. A
        // speed comes with its velocity.
        let whole = vector_of(column, &found);
        let stored = whole.iter().filter(|c| !(has_velocity && c.name == SPEED));
        let own: usize = stored.map(|c| c.kind.bytes()).sum();
        let fits = bytes + own <= most_bytes && columns.kept.len() + whole.len() <= MOST;
        bytes += if fits { own } else { 0 };
        let into = if fits { &mut columns.kept } else { &mut columns.left_out };
        into.extend(whole.iter().map(|c| c.name.clone()));
        done.extend(whole.iter().map(|c| c.name.as_str()));
    }
    columns
}

/// The columns that make a vector with one of them, in their order: `v_x`, `v_y` and `v_z`, or
/// `v_0`, `v_1` and so on, and the speed of a velocity; a column by itself is all of its vector.
fn vector_of<'c>(column: &'c ColumnInfo, all: &[&'c ColumnInfo]) -> Vec<&'c ColumnInfo> {
    let stem = |name: &str| {
        let (stem, end) = name.rsplit_once('_')?;
        let is_component = matches!(end, "x" | "y" | "z") || end.parse::<u16>().is_ok();
        is_component.then(|| stem.to_owned())
    };
    let Some(of) = stem(&column.name) else { return vec![column] };
    let mut whole: Vec<&ColumnInfo> =
        all.iter().copied().filter(|other| stem(&other.name).as_ref() == Some(&of)).collect();
    if is_velocity(&of) {
        whole.extend(all.iter().copied().filter(|other| other.name == SPEED));
    }
    whole
}

/// The columns that names stand for: a vector's name stands for all of its components.
fn named<S: PointSource + ?Sized>(names: &[String], sources: &[Box<S>]) -> Vec<String> {
    let Some(first) = sources.first() else { return names.to_vec() };
    let schema = first.schema();
    let mut found = Vec::new();
    for name in names {
        let components: Vec<&str> = match schema.find(name) {
            Some(_) => Vec::new(),
            None => schema.names().filter(|column| is_component_of(column, name)).collect(),
        };
        if components.is_empty() {
            found.push(name.clone());
        } else {
            found.extend(components.into_iter().map(str::to_owned));
        }
    }
    found
}

fn is_component_of(column: &str, vector: &str) -> bool {
    let Some((stem, end)) = column.rsplit_once('_') else { return false };
    stem == vector && (matches!(end, "x" | "y" | "z") || end.parse::<u16>().is_ok())
}

/// The columns that are asked for: `all`, `none` or names; by default the customary ones.
pub fn wanted<S: PointSource + ?Sized>(asked: Option<&[String]>, sources: &[Box<S>]) -> Columns {
    let of = |kept: Vec<String>| Columns { kept, left_out: Vec::new() };
    match asked {
        None => customary(sources),
        Some([one]) if one == "all" => of(of_all(sources).kept),
        Some([one]) if one == "none" => of(Vec::new()),
        Some(names) => of(named(names, sources)),
    }
}

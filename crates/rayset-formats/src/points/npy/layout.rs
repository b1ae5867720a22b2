//! Which numbers of the arrays of a file are positions, and which are columns.

use std::io;
use std::path::Path;

use super::array::{MOST_WIDTH, Rows, Strand};
use crate::array_file::{Array, Fault, Scalar};
use crate::points::{ColorDepth, ColumnInfo, ColumnType, Schema, reading, roles, unnamed};
use rayset_base::numbers::Stored;

/// A number of each row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Source {
    /// Index of the strand, and the byte in its rows.
    pub(super) strand: usize,
    pub(super) offset: usize,
    pub(super) scalar: Scalar,
}

impl Source {
    pub(super) fn column_type(&self) -> ColumnType {
        ColumnType::of(self.scalar.stored)
    }
}

/// What a file has for each point.
pub(super) struct Layout {
    pub(super) strands: Vec<Strand>,
    pub(super) axes: [Source; 3],
    pub(super) columns: Vec<Source>,
    pub(super) schema: Schema,
    pub(super) rows: u64,
}

/// Numbers with their names, of which three are to be the positions.
#[derive(Default)]
struct Named {
    strands: Vec<Strand>,
    names: Vec<String>,
    sources: Vec<Source>,
}

impl Named {
    /// Adds the numbers of each row of an array that is not structured.
    fn add_plain(&mut self, array: &Array, rows: Rows, scalar: Scalar, names: &[String]) {
        let size = scalar.stored.bytes();
        let first = self.strands.len();
        if rows.apart {
            let starts = (0..rows.width).map(|i| rows.rows.saturating_mul(i * size as u64));
            self.strands.extend(starts.map(|start| Strand::new(array, start, size)));
        } else {
            self.strands.push(Strand::new(array, 0, size * rows.width as usize));
        }
        for (i, name) in names.iter().enumerate() {
            let (strand, offset) = if rows.apart { (first + i, 0) } else { (first, i * size) };
            self.names.push(name.clone());
            self.sources.push(Source { strand, offset, scalar });
        }
    }

    /// Adds the fields of a structured array.
    fn add_fields(&mut self, array: &Array) {
        let strand = self.strands.len();
        self.strands.push(Strand::new(array, 0, array.header.element_bytes));
        for field in &array.header.fields {
            if field.components > MOST_WIDTH as usize {
                continue;
            }
            for (i, name) in roles::components(&field.name, field.components).into_iter().enumerate() {
                let offset = field.offset + i * field.scalar.stored.bytes();
                self.names.push(name);
                self.sources.push(Source { strand, offset, scalar: field.scalar });
            }
        }
    }

    /// Takes other names, if there are any.
    fn renamed(self, names: Option<&[String]>) -> Result<Self, Fault> {
        match names {
            None => Ok(self),
            Some(names) if names.len() == self.names.len() => Ok(Self { names: names.to_vec(), ..self }),
            Some(names) => Err(no_points(format!(
                "{} names of columns are given for rows of {} numbers: {}",
                names.len(),
                self.names.len(),
                roles::shortened(&self.names.join(","), 400)
            ))),
        }
    }

    /// Takes x, y and z as positions, and the rest as columns. `None` if the three are not there.
    /// `by` says where the names come from.
    fn finish(self, rows: u64, description: String, by: &str) -> Option<Layout> {
        let [Some(x), Some(y), Some(z)] = roles::axes(&self.names) else { return None };
        let (mut infos, mut columns) = (Vec::new(), Vec::new());
        for (place, (name, source)) in self.names.iter().zip(&self.sources).enumerate() {
            if [x, y, z].contains(&place) || name.is_empty() || name == "-" {
                continue;
            }
            let info = ColumnInfo::new(name, source.column_type());
            infos.push(if roles::is_class(name) { info.of_classes() } else { info });
            columns.push(*source);
        }
        let mut schema = Schema::new(infos, ColorDepth::Guess);
        schema.roles = roles::colors(&schema.columns);
        let kinds =
            ["red", "green", "blue"].map(|name| schema.find(name).map(|column| schema.columns[column].kind));
        schema.color_depth = match kinds {
            [Some(ColumnType::U8), Some(ColumnType::U8), Some(ColumnType::U8)] => ColorDepth::Byte,
            _ => ColorDepth::Guess,
        };
        schema.description = description;
        reading::note(&mut schema, &self.names, [x, y, z], by);
        let axes = [x, y, z].map(|place| self.sources[place]);
        Some(Layout { strands: self.strands, axes, columns, schema, rows })
    }
}

/// Names of the numbers of a plain row, by those of the first rows.
fn plain_names(path: &Path, array: &Array, rows: Rows, scalar: Scalar) -> io::Result<Vec<String>> {
    let sample = array.first_rows(path, rows, scalar, unnamed::ROWS)?;
    let names = unnamed::names(rows.width as usize, &sample).into_iter().enumerate();
    Ok(names.map(|(i, name)| if name.starts_with("column") { format!("column_{i}") } else { name }).collect())
}

const NAMELESS: &str = "the names of columns have no x, y and z";

fn no_points(what: String) -> Fault {
    Fault::Wrong { at: 0, what }
}

/// Why an array is no points.
fn wrong(array: &Array) -> String {
    let shape = array.header.shape_text();
    let found = match array.number() {
        None if !array.header.is_structured => format!("its elements are of the type {}", array.header.descr),
        _ if array.header.shape.len() > 2 => {
            // Rows of a few numbers, and many of them.
            let last = array.header.shape.last().copied().unwrap_or(0);
            let rows = array.header.shape.iter().rev().nth(1).is_some_and(|&rows| rows > 16);
            let way = match (last * u64::from(rows), array.number().map(|scalar| scalar.stored)) {
                (3 | 4, Some(Stored::U8)) => ": a picture, or several clouds",
                (3..=7, Some(_)) => {
                    ": several clouds, of which `numpy.save(\"points.npy\", a[0])` writes the first, or a grid of points, \
                     which `a.reshape(-1, a.shape[-1])` makes rows of"
                }
                _ => ": a volume, or several clouds; `numpy.save(\"volume.npy\", a[0])` writes the first",
            };
            format!("it has {shape} elements{way}")
        }
        None | Some(_) if array.header.shape.len() == 2 && array.header.shape[1] > MOST_WIDTH => {
            format!("it has {shape} numbers: a depth map, or a picture; a depth map becomes points in Open3D")
        }
        _ if array.header.is_structured => {
            let names: Vec<String> =
                array.header.fields.iter().take(12).map(|f| roles::excerpt(&f.name)).collect();
            format!("it has {shape} elements with the fields {}", names.join(", "))
        }
        _ => format!("it has {shape} numbers"),
    };
    format!(
        "this array is no points: {found}; expected N × 3 numbers or more in a row (at most {MOST_WIDTH}), three rows, or \
         fields x, y and z. `numpy.save(\"points.npy\", numpy.column_stack([x, y, z, …]))` makes one"
    )
}

impl Layout {
    /// The layout of a file that is one array. The error says why it is no points.
    pub(super) fn of_array(path: &Path, array: &Array, names: Option<&[String]>) -> Result<Self, Fault> {
        let mut named = Named::default();
        let description = format!("array of NumPy, {}", array.header.shape_text());
        if array.header.is_structured {
            if let ([rows], true) = (array.header.shape.as_slice(), array.header.element_bytes > 0) {
                named.add_fields(array);
                let by = if names.is_some() { reading::BY_OPTION } else { "the names of fields" };
                let layout = named.renamed(names)?.finish(*rows, description, by);
                return layout
                    .ok_or_else(|| no_points(if names.is_some() { NAMELESS.into() } else { wrong(array) }));
            }
            return Err(no_points(wrong(array)));
        }
        let (Some(rows), Some(scalar)) = (array.rows().filter(|rows| rows.width >= 3), array.number()) else {
            return Err(no_points(wrong(array)));
        };
        named.add_plain(array, rows, scalar, &plain_names(path, array, rows, scalar)?);
        let by = if names.is_some() { reading::BY_OPTION } else { "the values of the first rows" };
        named.renamed(names)?.finish(rows.rows, description, by).ok_or_else(|| no_points(NAMELESS.into()))
    }

    /// The layout of an archive. The error says what it has instead of points.
    pub(super) fn of_archive(path: &Path, arrays: &[Array], names: Option<&[String]>) -> Result<Self, Fault> {
        let base =
            |array: &Array| array.member.name.rsplit('/').next().unwrap_or_default().to_ascii_lowercase();
        let is_plain =
            |array: &&Array| array.number().is_some() && array.rows().is_some_and(|rows| rows.width >= 3);
        let called = |name: &&str| arrays.iter().position(|a| base(a) == **name && is_plain(&a));
        let axes = || {
            let names: Vec<String> = arrays.iter().map(base).collect();
            roles::axes(&names).iter().all(Option::is_some)
        };
        let one = |wanted: &dyn Fn(&&Array) -> bool| {
            let mut found = arrays.iter().enumerate().filter(|(_, array)| wanted(array));
            found.next().map(|(i, _)| i).filter(|_| found.next().is_none())
        };
        // Arrays with a row of numbers for each row of another.
        let agreeing = |array: &Array| {
            let rows = |array: &Array| array.number().and_then(|_| array.rows()).map(|rows| rows.rows);
            let others = arrays.iter().filter(|other| rows(other).is_some() && rows(other) == rows(array));
            others.count().saturating_sub(1)
        };
        let most = arrays.iter().filter(is_plain).map(agreeing).max().unwrap_or(0);
        let agreed = |array: &&Array| {
            let is_three = array.rows().is_some_and(|rows| rows.width == 3);
            most > 0
                && is_plain(array)
                && is_three
                && agreeing(array) == most
                && roles::may_be_positions(&base(array))
        };
        // By its name; three arrays; a structured one; one that others agree with; else the only
        // one that can be.
        let position = roles::POSITIONS.iter().find_map(called);
        let position = match position {
            None if axes() => None,
            None => one(&|array| array.header.is_structured)
                .or_else(|| one(&agreed))
                .or_else(|| one(&|array| is_plain(array) && (most == 0 || agreeing(array) == most))),
            found => found,
        };
        let mut named = Named::default();
        let (mut rows, mut taken) = (None, Vec::new());
        if let Some(array) = position.map(|index| &arrays[index]) {
            if array.header.is_structured {
                return Self::of_array(path, array, names);
            }
            if let (Some(of), Some(scalar)) = (array.rows(), array.number()) {
                named.add_plain(array, of, scalar, &plain_names(path, array, of, scalar)?);
                rows = Some(of.rows);
                taken.push(roles::excerpt(&array.member.name));
            }
        }
        let is_x = |array: &&Array| roles::axes(&[base(array)])[0].is_some();
        let rows = rows.or_else(|| arrays.iter().find(is_x).map(|array| array.header.count()));
        // With names of columns, any arrays that agree are a table.
        let table =
            || arrays.iter().filter(|array| array.number().is_some()).max_by_key(|array| agreeing(array));
        let rows = rows.or_else(|| names.and_then(|_| table()?.rows()).map(|of| of.rows));
        let Some(rows) = rows else { return Err(no_points(refused(arrays))) };
        let mut left_out = Vec::new();
        for (index, array) in arrays.iter().enumerate().filter(|(index, _)| Some(*index) != position) {
            let of = array.rows().filter(|of| of.rows == rows && of.width > 0);
            match (of, array.number()) {
                (Some(of), Some(scalar)) => {
                    let name = arrays[index].member.name.clone();
                    taken.push(roles::excerpt(&name));
                    named.add_plain(array, of, scalar, &roles::components(&name, of.width as usize));
                }
                _ => left_out.push(format!(
                    "{} ({})",
                    roles::excerpt(&array.member.name),
                    array.header.shape_text()
                )),
            }
        }
        let mut description = format!("archive of arrays of NumPy, {rows} rows");
        if !left_out.is_empty() {
            left_out.truncate(8);
            description.push_str(&format!("; left out for their shapes or types: {}", left_out.join(", ")));
        }
        let used = named.renamed(names)?;
        let by = match names {
            Some(_) => reading::BY_OPTION.to_owned(),
            None => format!("the arrays {}", roles::shortened(&taken.join(", "), 200)),
        };
        let nameless = || if names.is_some() { NAMELESS.into() } else { refused(arrays) };
        used.finish(rows, description, &by).ok_or_else(|| no_points(nameless()))
    }
}

fn refused(arrays: &[Array]) -> String {
    let named: Vec<String> = (arrays.iter().take(12))
        .map(|array| format!("{} ({})", roles::excerpt(&array.member.name), array.header.shape_text()))
        .collect();
    format!(
        "this archive has no points: expected an array `positions` of N × 3 numbers, or arrays x, y and z; it has {}. \
         `numpy.savez(\"points.npz\", positions=…, intensity=…)` makes one",
        if named.is_empty() { "none that can be read".to_owned() } else { named.join(", ") }
    )
}

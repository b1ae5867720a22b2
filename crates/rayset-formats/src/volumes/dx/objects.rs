//! The objects of a header: grids of positions, arrays, and fields, which join both.

use super::words::{Word, Words};
use rayset_base::geometry::DVec3;
use rayset_base::numbers::Stored;
use rayset_files::grid::VolumeError;

/// A regular grid of positions.
#[derive(Clone, Default)]
pub(super) struct Positions {
    /// Points along each axis, the slowest first.
    pub(super) counts: Vec<u64>,
    pub(super) origin: DVec3,
    /// The step along each axis.
    pub(super) deltas: Vec<DVec3>,
    pub(super) place: String,
}

/// Where the numbers of an array are.
#[derive(Clone)]
pub(super) enum Location {
    /// From this offset in the file.
    Here(u64),
    /// From this offset behind the header.
    BehindHeader(u64),
    /// From an offset in another file.
    Beside(String, u64),
}

/// An array of numbers.
#[derive(Clone)]
pub(super) struct Array {
    /// The type as it is written. Not all can be read.
    pub(super) kind: String,
    pub(super) real: bool,
    /// Numbers of each item.
    pub(super) components: u64,
    pub(super) items: u64,
    pub(super) text: bool,
    /// `None` if binary numbers do not say it.
    pub(super) big_endian: Option<bool>,
    pub(super) location: Location,
    /// Whether its items belong to the connections between positions.
    pub(super) of_cells: bool,
    pub(super) place: String,
}

impl Array {
    /// The type of its numbers. `None` if it is no type of numbers.
    pub(super) fn stored(&self) -> Option<Stored> {
        Some(match self.kind.as_str() {
            "byte" | "unsigned byte" | "ubyte" | "char" | "unsigned char" => Stored::U8,
            "signed byte" | "signed char" => Stored::I8,
            "unsigned short" | "ushort" => Stored::U16,
            "short" | "signed short" => Stored::I16,
            "unsigned int" | "uint" => Stored::U32,
            "int" | "signed int" => Stored::I32,
            "hyper" => Stored::I64,
            "float" => Stored::F32,
            "double" => Stored::F64,
            _ => return None,
        })
    }
}

/// The parts of a field: names of parts, and of objects.
pub(super) type Field = Vec<(String, String)>;

#[derive(Clone)]
pub(super) enum Object {
    Positions(Positions),
    Array(Array),
    Field(Field),
    Other,
}

/// The objects of a file with their names.
pub(super) struct Objects {
    pub(super) all: Vec<(String, Object)>,
    /// The offset behind the header.
    pub(super) end: u64,
}

impl Objects {
    pub(super) fn read(words: &mut Words<'_>) -> Result<Self, VolumeError> {
        let mut all: Vec<(String, Object)> = Vec::new();
        while let Some(word) = words.next()? {
            let object = all.last_mut().map(|(_, object)| object);
            match object {
                _ if word.is("object") => all.push(begin(words)?),
                _ if word.is("end") => {
                    words.end_line()?;
                    break;
                }
                Some(Object::Positions(positions)) => clause_of_positions(words, &word, positions)?,
                Some(Object::Array(array)) if word.is("attribute") => {
                    let of_what = words.expect("a name")?.text == "dep";
                    let value = (words.expect("a type")?, words.expect("a value")?).1;
                    array.of_cells |= of_what && value.text == "connections";
                }
                Some(Object::Field(parts)) if word.is("component") => {
                    let name = words.expect("the name of a component")?.text;
                    let mut value = words.expect("an object")?;
                    if value.is("value") {
                        value = words.expect("an object")?;
                    }
                    parts.push((name, value.text));
                }
                // Other clauses, and objects of other kinds.
                _ => {}
            }
        }
        Ok(Self { all, end: words.at() })
    }

    pub(super) fn get(&self, name: &str) -> Option<&Object> {
        self.all.iter().find(|(known, _)| known == name).map(|(_, object)| object)
    }
}

/// Reads the name and kind of an object, and all of an array.
fn begin(words: &mut Words<'_>) -> Result<(String, Object), VolumeError> {
    let name = words.expect("the name of an object")?.text;
    let mut kind = words.expect("the class of an object")?;
    if kind.is("class") {
        kind = words.expect("the class of an object")?;
    }
    let object = match kind.text.as_str() {
        "gridpositions" => Object::Positions(Positions { place: words.place(), ..Positions::default() }),
        "array" => Object::Array(array(words)?),
        "field" => Object::Field(Field::new()),
        _ => Object::Other,
    };
    Ok((name, object))
}

fn clause_of_positions(
    words: &mut Words<'_>,
    word: &Word,
    positions: &mut Positions,
) -> Result<(), VolumeError> {
    let mut three = |what: &str| {
        let numbers = <[f64; 3]>::try_from(words.numbers()?).ok();
        let vector = numbers.map(DVec3::from_array).filter(|vector| vector.is_finite());
        vector.ok_or_else(|| {
            words.wrong(&format!("{what}: expected three finite numbers; grids of three dimensions are read"))
        })
    };
    if word.is("origin") {
        positions.origin = three("origin")?;
    } else if word.is("delta") {
        positions.deltas.push(three("delta")?);
    } else if word.is("counts") {
        let counts = words.numbers()?;
        let whole = counts.iter().all(|n| n.fract() == 0.0 && *n >= 0.0 && *n < 2_f64.powi(53));
        if !whole {
            return Err(words.wrong("counts: expected whole numbers"));
        }
        positions.counts = counts.iter().map(|n| *n as u64).collect();
    }
    Ok(())
}

fn array(words: &mut Words<'_>) -> Result<Array, VolumeError> {
    let mut array = Array {
        kind: "float".into(),
        real: true,
        components: 1,
        items: 0,
        text: true,
        big_endian: None,
        location: Location::Here(0),
        of_cells: false,
        place: words.place(),
    };
    loop {
        let word = words.expect("the numbers of an array")?;
        match word.text.as_str() {
            "type" => {
                array.kind = words.expect("a type")?.text;
                if matches!(array.kind.as_str(), "signed" | "unsigned") {
                    array.kind = format!("{} {}", array.kind, words.expect("a type")?.text);
                }
            }
            "category" => array.real = words.expect("a category")?.text == "real",
            "rank" => drop(words.count("a rank")?),
            "shape" => {
                let shape = words.numbers()?;
                array.components = shape.iter().product::<f64>() as u64;
            }
            "items" => array.items = words.count("a number of items")?,
            "msb" => array.big_endian = Some(true),
            "lsb" => array.big_endian = Some(false),
            "text" | "ascii" => array.text = true,
            "binary" | "ieee" => array.text = false,
            "data" => {
                array.location = location(words, &array)?;
                return Ok(array);
            }
            other => return Err(words.wrong(&format!("unknown word `{}` in an array", other.escape_debug()))),
        }
    }
}

/// Reads where the numbers of an array are, and goes on behind those that follow.
fn location(words: &mut Words<'_>, array: &Array) -> Result<Location, VolumeError> {
    let word = words.expect("where the numbers of an array are")?;
    if word.is("follows") {
        words.end_line()?;
        let at = words.at();
        let count = array.items.checked_mul(array.components);
        let count = count.ok_or_else(|| words.wrong("an array of more numbers than any file holds"))?;
        if array.text {
            words.skip_numbers(count)?;
        } else {
            let width = array.stored().map_or(1, Stored::bytes) as u64;
            words.skip_bytes(count.saturating_mul(width))?;
        }
        return Ok(Location::Here(at));
    }
    if word.is("file") {
        let name = words.expect("the name of a file")?.text;
        let (name, offset) =
            name.split_once(',').map_or((name.as_str(), None), |(name, offset)| (name, Some(offset)));
        let offset = match offset {
            None => 0,
            Some("") => words.count("an offset")?,
            Some(offset) => {
                offset.parse().map_err(|_| words.wrong("expected an offset behind the name of a file"))?
            }
        };
        return Ok(Location::Beside(name.to_owned(), offset));
    }
    let offset = word.text.parse().map_err(|_| {
        let found = word.text.escape_debug();
        words.wrong(&format!("expected `follows`, an offset, or `file` and its name, and found `{found}`"))
    })?;
    Ok(Location::BehindHeader(offset))
}

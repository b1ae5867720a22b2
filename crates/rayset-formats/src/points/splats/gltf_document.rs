//! Where a glTF file keeps its Gaussian splats: the primitives with the extension
//! `KHR_gaussian_splatting`, placed by their nodes, and where in which file each attribute lies.
//!
//! Format: Khronos, *glTF 2.0* and *`KHR_gaussian_splatting`* (ratified 2026). A file is JSON, with
//! its data in files beside it, or a `.glb`: a header of 12 bytes, and chunks of a length, a type
//! and their content, first the JSON, then the data.

use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::bounded_json;
use crate::points::{Place, ReadError};
use rayset_base::geometry::{DAffine3, DMat3, DQuat, DVec3};
use rayset_store::storage::input_file::InputFile;

/// What a `.glb` begins with.
pub(super) const MAGIC: &[u8; 4] = b"glTF";
const EXTENSION: &str = "KHR_gaussian_splatting";
/// Most bytes of the JSON.
const MOST_JSON: u64 = 8 << 20;
/// Deepest nesting of nodes, most nodes and primitives that are looked at, and most places of
/// splats.
const DEEPEST: usize = 64;
const MOST_VISITED: usize = 1 << 20;
const MOST_PLACES: usize = 4096;
/// Most bytes from one element of an accessor to the next.
const MOST_STRIDE: u64 = 252;
/// Longest sentence about a file, in letters.
const LONGEST: usize = 300;
const CHUNK_JSON: u32 = 0x4e4f_534a;
const CHUNK_DATA: u32 = 0x004e_4942;

/// The splats of a file.
#[derive(Debug)]
pub(super) struct Document {
    /// The file itself, and those beside it that have data.
    pub(super) files: Vec<PathBuf>,
    /// The primitives with splats, in the order of the nodes.
    pub(super) primitives: Vec<Primitive>,
}

/// Splats that a node places in the world.
#[derive(Debug)]
pub(super) struct Primitive {
    pub(super) count: u64,
    pub(super) world_from_local: DAffine3,
    /// Degree of the harmonics.
    pub(super) degree: u8,
    /// Whether colours are linear light.
    pub(super) is_linear: bool,
    /// In the order of [`attributes`].
    pub(super) accessors: Vec<Accessor>,
}

/// Numbers of one attribute, in a file.
#[derive(Clone, Debug)]
pub(super) struct Accessor {
    /// The file, of the document's.
    pub(super) file: usize,
    pub(super) offset: u64,
    /// Bytes from one splat to the next.
    pub(super) stride: u64,
    pub(super) component: Component,
    /// Numbers of a splat.
    pub(super) width: usize,
    is_normalized: bool,
    count: u64,
}

/// The type of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Component {
    I8,
    U8,
    I16,
    U16,
    F32,
}

impl Component {
    fn of(code: u64) -> Option<Self> {
        Some(match code {
            5120 => Self::I8,
            5121 => Self::U8,
            5122 => Self::I16,
            5123 => Self::U16,
            5126 => Self::F32,
            _ => return None,
        })
    }

    pub(super) fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::F32 => 4,
        }
    }
}

impl Accessor {
    /// Bytes of the numbers of one splat.
    pub(super) fn bytes(&self) -> usize {
        self.width * self.component.bytes()
    }

    /// A number of a splat, from the bytes of its numbers.
    pub(super) fn value(&self, bytes: &[u8], number: usize) -> f64 {
        let bytes = &bytes[number * self.component.bytes()..];
        let normalized = |value: f64, largest: f64| {
            if self.is_normalized { (value / largest).max(-1.0) } else { value }
        };
        match self.component {
            Component::I8 => normalized(f64::from(bytes[0].cast_signed()), 127.0),
            Component::U8 => normalized(f64::from(bytes[0]), 255.0),
            Component::I16 => normalized(f64::from(i16::from_le_bytes([bytes[0], bytes[1]])), 32767.0),
            Component::U16 => normalized(f64::from(u16::from_le_bytes([bytes[0], bytes[1]])), 65535.0),
            Component::F32 => f64::from(f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])),
        }
    }
}

/// The attributes of splats of a degree, and how many numbers each has: position, rotation, scale,
/// opacity, then the harmonics, each for red, green and blue.
fn attributes(degree: u8) -> Vec<(String, usize)> {
    let own = |name: &str| format!("{EXTENSION}:{name}");
    let mut all = vec![("POSITION".into(), 3), (own("ROTATION"), 4), (own("SCALE"), 3), (own("OPACITY"), 1)];
    for of in 0..=degree {
        all.extend((0..=2 * of).map(|n| (own(&format!("SH_DEGREE_{of}_COEF_{n}")), 3)));
    }
    all
}

/// A file that is read.
struct Reading<'p> {
    path: &'p Path,
    json: Value,
    files: Vec<PathBuf>,
    /// For each buffer its file, the offset there, and its bytes.
    buffers: Vec<(usize, u64, u64)>,
}

/// What nodes have been found to place.
#[derive(Default)]
struct Found {
    primitives: Vec<Primitive>,
    /// Nodes and primitives that were looked at.
    visited: usize,
}

impl Document {
    /// Reads a document; `None` if it has no splats.
    ///
    /// # Errors
    /// [`ReadError`] if it cannot be read, is malformed, or has splats of another kind.
    pub(super) fn read(path: &Path) -> Result<Option<Self>, ReadError> {
        let (json, data) = json_of(path)?;
        let uses = json["extensionsUsed"].as_array().is_some_and(|all| all.iter().any(|v| v == EXTENSION));
        if !uses {
            return Ok(None);
        }
        let mut reading = Reading { path, json, files: vec![path.to_owned()], buffers: Vec::new() };
        reading.buffers(data)?;
        let primitives = reading.scene()?;
        Ok((!primitives.is_empty()).then_some(Self { files: reading.files, primitives }))
    }
}

/// The JSON of a file, and the place and the bytes of the data behind it.
fn json_of(path: &Path) -> Result<(Value, Option<(u64, u64)>), ReadError> {
    let io = ReadError::io(path);
    let fail = |byte: u64, what: String| ReadError::malformed(path, Place::Byte(byte), what);
    let mut file = InputFile::open(path).map_err(io)?;
    let mut head = Vec::new();
    (&mut file).take(20).read_to_end(&mut head).map_err(io)?;
    let word = |at: usize| u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]);
    let is_binary = head.starts_with(MAGIC);
    let (start, bytes) = if is_binary {
        if head.len() < 20 || word(16) != CHUNK_JSON {
            return Err(fail(12, "a glTF file that does not begin with its JSON".into()));
        }
        if word(4) != 2 {
            return Err(fail(4, format!("glTF of version {}; version 2 can be read", word(4))));
        }
        (20, u64::from(word(12)))
    } else {
        (0, file.length().map_err(io)?)
    };
    if bytes > MOST_JSON {
        return Err(fail(start, format!("{bytes} bytes of JSON; at most {MOST_JSON} are read")));
    }
    file.seek(SeekFrom::Start(start)).map_err(io)?;
    let mut text = Vec::new();
    (&mut file).take(bytes).read_to_end(&mut text).map_err(io)?;
    let json =
        bounded_json::parse(&text).map_err(|error| fail(start, format!("not the JSON of glTF: {error}")))?;
    let mut next = [0; 8];
    if !is_binary || file.read_exact(&mut next).is_err() {
        return Ok((json, None));
    }
    let word = |at: usize| u32::from_le_bytes([next[at], next[at + 1], next[at + 2], next[at + 3]]);
    let data = start + bytes + 8;
    let there = file.length().map_err(io)?.saturating_sub(data).min(word(0).into());
    Ok((json, (word(4) == CHUNK_DATA).then_some((data, there))))
}

impl Reading<'_> {
    /// Quotes of the file in what is said are shortened.
    fn fail(&self, what: String) -> ReadError {
        let what = if what.chars().count() > LONGEST {
            what.chars().take(LONGEST).chain(['…']).collect()
        } else {
            what
        };
        ReadError::malformed(self.path, Place::Byte(0), what)
    }

    /// The object of a list that another refers to.
    fn object(&self, list: &str, index: &Value) -> Result<&Value, ReadError> {
        let found = index.as_u64().and_then(|index| self.json[list].get(usize::try_from(index).ok()?));
        found.ok_or_else(|| self.fail(format!("`{list}` has no number {index}")))
    }

    /// A whole number that is 0 where it is left out.
    fn whole(&self, of: &Value, key: &str) -> Result<u64, ReadError> {
        let wrong = || self.fail(format!("`{key}`: expected a whole number, and got {}", of[key]));
        if of[key].is_null() { Ok(0) } else { of[key].as_u64().ok_or_else(wrong) }
    }

    /// Finds where buffers are; `data` is what follows the JSON.
    fn buffers(&mut self, data: Option<(u64, u64)>) -> Result<(), ReadError> {
        let buffers = self.json["buffers"].as_array().cloned().unwrap_or_default();
        for (number, buffer) in buffers.iter().enumerate() {
            let bytes = self.whole(buffer, "byteLength")?;
            match (buffer["uri"].as_str(), data) {
                (None, Some((offset, there))) if number == 0 => {
                    self.buffers.push((0, offset, bytes.min(there)));
                }
                (None, _) => return Err(self.fail(format!("buffer {number} has neither a `uri` nor data"))),
                (Some(uri), _) if uri.starts_with("data:") => {
                    let what = format!(
                        "buffer {number} is in the JSON itself (`data:`); write it to a file, or as .glb"
                    );
                    return Err(self.fail(what));
                }
                (Some(uri), _) => {
                    // Beside the file, and nowhere else.
                    if uri.is_empty() || uri.contains(['/', '\\', ':', '%']) {
                        let what = format!(
                            "buffer {number} is in `{uri}`; expected the name of a file beside this one"
                        );
                        return Err(self.fail(what));
                    }
                    let beside = self.path.with_file_name(uri);
                    let file = InputFile::open(&beside).map_err(ReadError::io(&beside))?;
                    let there = file.length().map_err(ReadError::io(&beside))?;
                    self.files.push(beside);
                    self.buffers.push((self.files.len() - 1, 0, bytes.min(there)));
                }
            }
        }
        Ok(())
    }

    /// Goes through the nodes of the scene that is shown, or of the first.
    fn scene(&self) -> Result<Vec<Primitive>, ReadError> {
        let shown = self.json["scene"].as_u64().unwrap_or(0);
        let scene = self.object("scenes", &Value::from(shown))?;
        let nodes = list(&scene["nodes"]);
        let mut found = Found::default();
        nodes.iter().try_for_each(|node| self.node(node, &DAffine3::IDENTITY, 0, &mut found))?;
        Ok(found.primitives)
    }

    fn node(
        &self,
        index: &Value,
        world_from_parent: &DAffine3,
        depth: usize,
        found: &mut Found,
    ) -> Result<(), ReadError> {
        let node = self.object("nodes", index)?;
        let primitives = match &node["mesh"] {
            Value::Null => &[],
            mesh => list(&self.object("meshes", mesh)?["primitives"]),
        };
        found.visited += 1 + primitives.len();
        if depth > DEEPEST || found.visited > MOST_VISITED {
            let what =
                format!("nodes are nested deeper than {DEEPEST}, or there are more than {MOST_VISITED}");
            return Err(self.fail(what));
        }
        let placed =
            place(node).ok_or_else(|| self.fail(format!("node {index} has a transform that is none")))?;
        let world_from_local = *world_from_parent * placed;
        for primitive in primitives.iter().filter(|primitive| !primitive["extensions"][EXTENSION].is_null()) {
            found.primitives.push(self.primitive(primitive, world_from_local)?);
        }
        if found.primitives.len() > MOST_PLACES {
            return Err(self.fail(format!("more than {MOST_PLACES} places of splats")));
        }
        let children = list(&node["children"]);
        children.iter().try_for_each(|child| self.node(child, &world_from_local, depth + 1, found))
    }

    fn primitive(&self, primitive: &Value, world_from_local: DAffine3) -> Result<Primitive, ReadError> {
        let extension = &primitive["extensions"][EXTENSION];
        if let Some((name, _)) = extension["extensions"].as_object().and_then(|all| all.iter().next()) {
            let what = format!("splats with the extension {name}, which is not read; write them without it");
            return Err(self.fail(what));
        }
        if extension["kernel"].as_str().is_some_and(|kernel| kernel != "ellipse") {
            return Err(
                self.fail(format!("splats of the kernel {}; expected `ellipse`", extension["kernel"]))
            );
        }
        let is_linear = match extension["colorSpace"].as_str() {
            None | Some("srgb_rec709_display" | "BT.709") => false,
            Some("lin_rec709_display") => true,
            Some(other) => {
                let what = format!(
                    "splats in the colours `{other}`; expected srgb_rec709_display or lin_rec709_display"
                );
                return Err(self.fail(what));
            }
        };
        let given = &primitive["attributes"];
        let has = |(name, _): &(String, usize)| !given[name.as_str()].is_null();
        let degree = (0..=3).rev().find(|&degree| attributes(degree)[4..].iter().all(has)).unwrap_or(0);
        // Those of linear light are not read.
        let accessors: Vec<Accessor> = attributes(if is_linear { 0 } else { degree })
            .into_iter()
            .map(|(name, width)| self.accessor(&given[name.as_str()], &name, width))
            .collect::<Result<_, _>>()?;
        let count = accessors[0].count;
        if let Some(other) = accessors.iter().find(|accessor| accessor.count != count) {
            return Err(self.fail(format!("{} values of an attribute of {count} splats", other.count)));
        }
        Ok(Primitive { count, world_from_local, degree, is_linear, accessors })
    }

    fn accessor(&self, index: &Value, name: &str, width: usize) -> Result<Accessor, ReadError> {
        if index.is_null() {
            return Err(self.fail(format!("splats without {name}")));
        }
        let of = self.object("accessors", index)?;
        let wrong = |what: &str| self.fail(format!("{name}: {what}"));
        if !of["sparse"].is_null() {
            return Err(wrong("a sparse accessor, which is not read"));
        }
        let component = of["componentType"].as_u64().and_then(Component::of);
        let component = component.ok_or_else(|| wrong("numbers of a type that splats do not have"))?;
        let expected = ["", "SCALAR", "VEC2", "VEC3", "VEC4"][width];
        if of["type"] != expected {
            return Err(wrong(&format!("{} where {expected} was expected", of["type"])));
        }
        let view = self.object("bufferViews", &of["bufferView"])?;
        let buffer = self.whole(view, "buffer")?;
        let &(file, start, bytes) = (self.buffers.get(usize::try_from(buffer).unwrap_or(usize::MAX)))
            .ok_or_else(|| wrong("data of a buffer that is not there"))?;
        let own = (width * component.bytes()) as u64;
        let stride = self.whole(view, "byteStride")?;
        let stride = if stride == 0 { own } else { stride };
        if !(own..=MOST_STRIDE).contains(&stride) {
            return Err(wrong(&format!(
                "{stride} bytes from one to the next; expected {own} to {MOST_STRIDE}"
            )));
        }
        let (within, count) = (self.whole(of, "byteOffset")?, self.whole(of, "count")?);
        let of_view = self.whole(view, "byteOffset")?;
        let begin = of_view.checked_add(within);
        let there = of_view.saturating_add(self.whole(view, "byteLength")?).min(bytes);
        let needed = count.checked_sub(1).map_or(Some(0), |last| last.checked_mul(stride)?.checked_add(own));
        let end = begin.zip(needed).and_then(|(begin, needed)| begin.checked_add(needed));
        if end.is_none_or(|end| end > there) {
            return Err(wrong(&format!(
                "{count} values of {own} bytes, which end behind the {there} that are there of their buffer"
            )));
        }
        let is_normalized = of["normalized"] == true;
        let offset = start + begin.unwrap_or_default();
        Ok(Accessor { file, offset, stride, component, width, is_normalized, count })
    }
}

/// The elements of a list; none of what is no list.
fn list(value: &Value) -> &[Value] {
    value.as_array().map_or(&[], Vec::as_slice)
}

/// How a node is placed in the space of its parent; `None` if its numbers are none.
fn place(node: &Value) -> Option<DAffine3> {
    let numbers = |key: &str, count: usize| -> Option<Option<Vec<f64>>> {
        if node[key].is_null() {
            return Some(None);
        }
        let list = node[key].as_array().filter(|list| list.len() == count)?;
        list.iter().map(|v| v.as_f64().filter(|v| v.is_finite())).collect::<Option<Vec<_>>>().map(Some)
    };
    if let Some(m) = numbers("matrix", 16)? {
        let column = |c: usize| DVec3::new(m[4 * c], m[4 * c + 1], m[4 * c + 2]);
        let linear = DMat3::from_cols(column(0), column(1), column(2));
        return Some(DAffine3::from_mat3_translation(linear, column(3)));
    }
    let three = |key: &str, otherwise: f64| {
        let of = |v: Option<Vec<f64>>| v.map_or(DVec3::splat(otherwise), |v| DVec3::from_slice(&v));
        numbers(key, 3).map(of)
    };
    let rotation = numbers("rotation", 4)?.map_or(DQuat::IDENTITY, |v| DQuat::from_slice(&v));
    let rotation = Some(rotation.normalize()).filter(|rotation| rotation.is_finite())?;
    Some(DAffine3::from_scale_rotation_translation(
        three("scale", 1.0)?,
        rotation,
        three("translation", 0.0)?,
    ))
}

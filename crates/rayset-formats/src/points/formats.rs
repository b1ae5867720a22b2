//! The formats that points are read from, and how the format of a file is recognized: by its first
//! bytes, and only where these say nothing by its name.

use std::io::Read;
use std::path::Path;

#[cfg(feature = "e57")]
use super::e57::E57Reader;
use super::gadget::{self, GadgetReader};
#[cfg(feature = "las")]
use super::las::LasReader;
use super::mesh::{MeshFormat, MeshSource, ObjPointReader, begins_as_off};
use super::npy::{self, NpyReader};
use super::packed::Packing;
use super::pcd::{self, PcdReader};
use super::ply::PlyReader;
use super::ply_body::Body;
use super::ply_header::Property;
use super::ptx::{self, PtxReader};
#[cfg(feature = "hdf5")]
use super::snapshot::SnapshotReader;
use super::splats::{
    CompressedPlyReader, GaussianPlyReader, GltfReader, KsplatReader, SogReader, SplatReader, SpzReader,
};
use super::stream::Stream;
use super::text::TextReader;
use super::velodyne::VelodyneReader;
use super::vtk::{self, VtkReader};
use super::{Place, PointSource, ReadError, geographic, roles};
use crate::refusals;
use rayset_base::setters;
use rayset_store::storage::input_file::{self, InputFile, Named};

/// Information for a reader that some formats do not contain.
#[derive(Clone, Debug, Default)]
#[cfg_attr(not(feature = "internals"), non_exhaustive)]
pub struct ReadOptions {
    /// Names of all columns of text files, of arrays of NumPy and of snapshots in HDF5, overriding
    /// their own; `-` or an empty name skips a column.
    pub text_columns: Option<Vec<String>>,
    /// Points to sample on the faces of a mesh, evenly by area. If `None`, ten points are sampled
    /// for each triangle, at least a million and at most 20 million; of a PLY file with 20 000
    /// vertices or more, or with measurements of each, its vertices are the points.
    pub mesh_points: Option<u64>,
    /// Types of the particles that are read from snapshots of simulations: `gas`, `dark`, `disk`,
    /// `bulge`, `stars`, `black-holes`, or `PartType` and a number. If `None`, gas where there is
    /// any, otherwise all.
    pub particles: Option<Vec<String>>,
}

setters!(ReadOptions {
    with_text_columns => text_columns: Option<Vec<String>>,
    with_mesh_points => mesh_points: Option<u64>,
    with_particles => particles: Option<Vec<String>>,
});

/// Bytes from the start of a file by which its format is recognized.
const HEAD_BYTES: u64 = 4096;

type Opened = Result<Box<dyn PointSource>, ReadError>;

/// A format that points are read from.
struct Format {
    /// Endings of the names of its files, without the dot, in lower case.
    extensions: &'static [&'static str],
    /// Whether a file that begins with these bytes, [`HEAD_BYTES`] or all that there are, is of
    /// this format, whatever its name.
    begins: fn(&[u8]) -> bool,
    open: fn(&Path, &ReadOptions) -> Opened,
}

/// A reader's points as those of any.
fn boxed<S: PointSource + 'static>(source: Result<S, ReadError>) -> Opened {
    Ok(Box::new(source?))
}

/// Opens with a reader that is compiled only with a feature of the library.
macro_rules! compiled_with {
    ($feature:literal, $path:ident, $options:ident, $opened:expr) => {{
        let _ = $options;
        #[cfg(feature = $feature)]
        let opened = boxed($opened);
        #[cfg(not(feature = $feature))]
        let opened = Err(ReadError::NotCompiled { path: $path.to_owned(), feature: $feature });
        opened
    }};
}

const fn format(
    extensions: &'static [&'static str],
    begins: fn(&[u8]) -> bool,
    open: fn(&Path, &ReadOptions) -> Opened,
) -> Format {
    Format { extensions, begins, open }
}

/// Files that begin as those of other formats do, with anything: their names alone tell.
const BY_NAME: fn(&[u8]) -> bool = |_| false;

/// In this order: the first that recognizes the beginning of a file reads it.
const FORMATS: &[Format] = &[
    format(&["ply"], |head| head.starts_with(b"ply\n") || head.starts_with(b"ply\r"), open_ply),
    format(&["spz"], SpzReader::begins, |path, _| boxed(SpzReader::open(path))),
    format(&["glb", "gltf"], |head| head.starts_with(b"glTF"), |path, _| open_gltf(path)),
    format(&["sog"], SogReader::begins, |path, _| boxed(SogReader::open(path))),
    format(&["splat"], BY_NAME, |path, _| boxed(SplatReader::open(path))),
    format(&["ksplat"], BY_NAME, |path, _| boxed(KsplatReader::open(path))),
    format(&["stl"], begins_as_stl, |path, options| {
        boxed(MeshSource::survey(path, MeshFormat::Stl, options.mesh_points))
    }),
    format(&["obj"], BY_NAME, open_obj),
    format(&["off"], begins_as_off, |path, options| {
        boxed(MeshSource::survey(path, MeshFormat::Off, options.mesh_points))
    }),
    format(&["gadget", "gadget2"], gadget::begins, |path, options| {
        boxed(GadgetReader::open(path, options.particles.as_deref()))
    }),
    format(&["npy", "npz"], npy::begins, |path, options| {
        boxed(NpyReader::open(path, options.text_columns.as_deref()))
    }),
    format(&["hdf5", "h5", "hdf"], is_hdf5, |path, options| {
        compiled_with!("hdf5", path, options, {
            SnapshotReader::open(path, options.particles.as_deref(), options.text_columns.as_deref())
        })
    }),
    format(&["vtk", "vtp", "vtu"], vtk::begins, |path, _| boxed(VtkReader::open(path))),
    format(
        &["e57"],
        |head| head.starts_with(b"ASTM-E57"),
        |path, options| compiled_with!("e57", path, options, E57Reader::open(path)),
    ),
    format(
        &["las", "laz"],
        |head| head.starts_with(b"LASF"),
        |path, options| compiled_with!("las", path, options, LasReader::open(path)),
    ),
    format(&["pcd"], pcd::begins, |path, _| boxed(PcdReader::open(path))),
    format(&["ptx"], ptx::begins, |path, _| boxed(PtxReader::open(path))),
    format(&["bin", "velodyne"], BY_NAME, |path, _| boxed(VelodyneReader::open(path))),
    format(&["xyz", "txt", "csv", "asc", "pts"], BY_NAME, |path, options| {
        boxed(TextReader::open(path, options.text_columns.as_deref()))
    }),
];

/// Binary files of STL begin with anything, even with this word.
fn begins_as_stl(head: &[u8]) -> bool {
    head.starts_with(b"solid") && head.windows(12).any(|part| part == b"facet normal")
}

/// Meshes in PLY with fewer vertices than this are shapes, whose faces are what they are; those
/// with more are of scans, whose vertices are the points that were measured.
const SHAPE_VERTICES: u64 = 20_000;

/// Whether a property of a vertex is part of a shape and its colours; others are measurements,
/// which faces do not have.
fn is_of_shape(name: &str) -> bool {
    let name = name.to_ascii_lowercase();
    let colour = name.strip_prefix("diffuse_").unwrap_or(&name);
    matches!(colour, "red" | "green" | "blue" | "alpha")
        || matches!(
            &*name,
            "x" | "y" | "z" | "nx" | "ny" | "nz" | "r" | "g" | "b" | "a" | "s" | "t" | "u" | "v"
        )
        || matches!(&*name, "texture_u" | "texture_v" | "texnumber")
}

/// Whether properties have a colour among them.
fn has_color(names: &[&str]) -> bool {
    let has = |name: &str| names.iter().any(|known| known.eq_ignore_ascii_case(name));
    ["red", "green", "blue"].iter().all(|name| has(name)) || roles::color_places(names).is_some()
}

/// Opens the vertices of a PLY file, which may be Gaussians, or its faces.
fn open_ply(path: &Path, options: &ReadOptions) -> Opened {
    // A pipe is read only once.
    if matches!(input_file::look(path).map_err(ReadError::io(path))?, Named::File(_)) {
        let (header, _) = Body::open(path)?;
        let vertex = header.elements.iter().find(|element| element.name == "vertex");
        let names: Vec<&str> = vertex.iter().flat_map(|v| &v.properties).map(Property::name).collect();
        if CompressedPlyReader::has_layout(&names) {
            return Ok(Box::new(CompressedPlyReader::open(path)?));
        }
        if GaussianPlyReader::has_layout(&names) {
            return Ok(Box::new(GaussianPlyReader::open(path)?));
        }
        let faces =
            header.elements.iter().find(|element| element.name == "face").map_or(0, |face| face.count);
        if options.mesh_points.is_some() && header.elements.iter().any(|element| element.name == "face") {
            return Ok(Box::new(MeshSource::survey(path, MeshFormat::Ply, options.mesh_points)?));
        }
        if let Some(vertex) = vertex.filter(|_| faces > 0) {
            // Faces without an area, or that cannot be read, leave the vertices. Colours of faces
            // alone are on faces.
            let of_faces = header.elements.iter().filter(|element| element.name == "face");
            let of_faces: Vec<&str> =
                of_faces.flat_map(|face| &face.properties).map(Property::name).collect();
            let is_few = vertex.count < SHAPE_VERTICES || has_color(&of_faces) && !has_color(&names);
            let is_shape = is_few && names.iter().all(|name| is_of_shape(name));
            if let Some(mesh) = is_shape.then(|| MeshSource::of_faces(path, MeshFormat::Ply)).flatten() {
                return Ok(Box::new(mesh));
            }
            let vertices = PlyReader::open(path)?;
            return Ok(Box::new(vertices.with_warning(format!(
                "the {} vertices are read, not the {faces} faces; `rayset build --mesh-points N` has points on the faces",
                vertex.count
            ))));
        }
    }
    Ok(Box::new(PlyReader::open(path)?))
}

/// Opens the splats of a glTF file. Others are for renderers.
fn open_gltf(path: &Path) -> Opened {
    match GltfReader::open(path)? {
        Some(splats) => boxed(Ok(splats)),
        None => Err(unknown(path, &head(path)?)),
    }
}

/// Opens the faces of an OBJ file or, where there are none, its vertices.
fn open_obj(path: &Path, options: &ReadOptions) -> Opened {
    let mesh = MeshSource::survey(path, MeshFormat::Obj, options.mesh_points)?;
    if mesh.triangles() > 0 {
        return Ok(Box::new(mesh));
    }
    let has_colors = !mesh.schema().columns.is_empty();
    Ok(Box::new(ObjPointReader::open(path, mesh.vertices(), has_colors)?))
}

/// Whether a file is HDF5: its signature is at the start, or after a block of the user's of 512,
/// 1024, 2048, … bytes.
fn is_hdf5(head: &[u8]) -> bool {
    [0, 512, 1024, 2048].iter().any(|&at| head.get(at..).is_some_and(|h| h.starts_with(b"\x89HDF\r\n\x1a\n")))
}

/// Formats that are looked for within gzip and zstd, by their first extensions: those that are read
/// from start to end.
const LOOKED_THROUGH: &[&str] = &["ply", "pcd", "ptx", "xyz"];
/// Formats, by their first extensions, of which compression is a part.
const COMPRESSED: &[&str] = &["spz"];

impl ReadOptions {
    /// Endings of the names of files of points, without the dot, in lower case; and those of what
    /// may be around them.
    pub fn extensions() -> impl Iterator<Item = &'static str> {
        let packings = [Packing::Gzip, Packing::Zstd].map(|packing| packing.ending().trim_start_matches('.'));
        FORMATS.iter().flat_map(|format| format.extensions).copied().chain(packings)
    }
}

/// Opens a file in its own format, which its first bytes tell or, where these say nothing, the
/// extension of its name. Text, PLY, PCD and PTX may be compressed with gzip or zstd. Positions in
/// degrees of longitude and latitude become metres.
///
/// # Errors
/// [`ReadError`] if the file cannot be opened, its header is malformed, or its format is unknown.
pub fn open(path: impl AsRef<Path>, options: &ReadOptions) -> Result<Box<dyn PointSource>, ReadError> {
    let path = path.as_ref();
    geographic::in_metres(path, open_as_it_is(path, options)?, || open_as_it_is(path, options))
}

/// The format that a file begins as.
fn begun(head: &[u8]) -> Option<&'static Format> {
    FORMATS.iter().find(|format| (format.begins)(head))
}

/// The format whose ending a name has.
fn named(name: &str) -> Option<&'static Format> {
    let ends = |extension: &&str| name.ends_with(&format!(".{extension}"));
    FORMATS.iter().find(|format| format.extensions.iter().any(ends))
}

/// The error for a file of no format that is read.
fn unknown(path: &Path, head: &[u8]) -> ReadError {
    let known: Vec<&str> = FORMATS.iter().flat_map(|format| format.extensions).copied().collect();
    let advice = refusals::advice(path, head, &known.join(", "));
    ReadError::UnknownFormat { path: path.to_owned(), advice }
}

/// Any text may be a table, under any name. `head` begins what is to be read, whose name would be
/// `inner` if it were not compressed.
fn open_table(path: &Path, inner: &Path, head: &[u8], options: &ReadOptions) -> Option<Opened> {
    // Bytes of 0 may follow the last line.
    let used = head.iter().rposition(|&byte| byte != 0).map_or(0, |last| last + 1);
    let is_text = used > 0 && !head[..used].contains(&0) && !refusals::is_recognized(inner, head);
    let table = is_text.then(|| TextReader::open(path, options.text_columns.as_deref()).ok()).flatten();
    table.map(|table| boxed(Ok(table)))
}

fn lower_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().to_lowercase()
}

/// Opens a pipe, which is read only once: its first bytes tell what it is, or its name, otherwise
/// it is a table.
fn open_pipe(path: &Path, options: &ReadOptions) -> Opened {
    let mut stream = Stream::open(path)?;
    let head = stream.head(HEAD_BYTES).map_err(ReadError::io(path))?;
    let name = lower_name(path);
    let packing = [Packing::Gzip, Packing::Zstd].into_iter().find_map(|p| name.strip_suffix(p.ending()));
    let found = begun(&head).or_else(|| named(packing.unwrap_or(&name)));
    match found.map(|format| format.extensions[0]) {
        Some("ply") => boxed(PlyReader::of(stream)),
        Some("pcd") => boxed(PcdReader::of(stream)),
        Some("ptx") => boxed(PtxReader::of(stream)),
        None | Some("xyz") if !head.is_empty() && !refusals::is_recognized(path, &head) => {
            boxed(TextReader::of(stream, options.text_columns.as_deref()))
        }
        Some(other) if !head.is_empty() => {
            let what = format!(
                "{} is read in many places, which a pipe does not allow; write it to a file. A pipe may have text, PLY, PCD or \
                 PTX, compressed or not",
                other.to_uppercase()
            );
            Err(ReadError::malformed(path, Place::Byte(0), what))
        }
        _ => Err(unknown(path, &head)),
    }
}

fn open_as_it_is(path: &Path, options: &ReadOptions) -> Opened {
    if matches!(input_file::look(path), Ok(Named::Other)) {
        return open_pipe(path, options);
    }
    let head = head(path)?;
    let name = lower_name(path);
    let by_name = named(&name);
    if head.is_empty()
        && input_file::is_file(path)
        && !by_name.is_some_and(|format| format.extensions.contains(&"txt"))
    {
        let what = "this file is empty: it was not written, or not copied";
        let damaged = by_name.map(|_| ReadError::malformed(path, Place::Byte(0), what));
        return Err(damaged.unwrap_or_else(|| unknown(path, &head)));
    }
    let Some(packing) = Packing::of(&head) else {
        // Names of other files end as those of scans do.
        let is_other = name.ends_with("bin") && refusals::is_recognized(path, &head);
        let by_name = by_name.filter(|_| !is_other && !refusals::is_marked(&head));
        return match begun(&head).or(by_name) {
            Some(format) => (format.open)(path, options),
            None => open_table(path, path, &head, options).unwrap_or_else(|| Err(unknown(path, &head))),
        };
    };
    // A format of which compression is a part has files that begin so, or a name of its own.
    let content = unpacked_head(path)?;
    let inner = name.strip_suffix(packing.ending()).unwrap_or(&name);
    let within = begun(&content).or_else(|| named(inner).filter(|_| inner.len() < name.len()));
    let Some(format) = begun(&head).or(within).or(by_name) else {
        let table = open_table(path, Path::new(inner), &content, options);
        return table.unwrap_or_else(|| Err(unknown(path, &head)));
    };
    let is_within = within.is_some_and(|within| std::ptr::eq(within, format));
    let reads = |formats: &[&str]| formats.contains(&format.extensions[0]);
    if is_within && !reads(LOOKED_THROUGH) && !reads(COMPRESSED) {
        let what = format!(
            "this is {} around a {} file, which is not read from start to end; decompress it first",
            packing.name(),
            format.extensions[0].to_uppercase()
        );
        return Err(ReadError::malformed(path, Place::Byte(0), what));
    }
    (format.open)(path, options)
}

/// The first bytes of what a compressed file holds.
fn unpacked_head(path: &Path) -> Result<Vec<u8>, ReadError> {
    Stream::open(path)?.head(HEAD_BYTES).map_err(ReadError::io(path))
}

/// The first bytes of a file. Empty if it is a pipe or a device, whose bytes can be read only once.
fn head(path: &Path) -> Result<Vec<u8>, ReadError> {
    let mut head = Vec::new();
    if matches!(input_file::look(path).map_err(ReadError::io(path))?, Named::File(_)) {
        InputFile::open(path)
            .map_err(ReadError::io(path))?
            .take(HEAD_BYTES)
            .read_to_end(&mut head)
            .map_err(ReadError::io(path))?;
    }
    Ok(head)
}

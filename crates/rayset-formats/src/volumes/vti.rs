//! VTK ImageData in XML (`.vti`) of one piece, and a RectilinearGrid (`.vtr`) that is evenly
//! spaced: the scalars of its points, otherwise those of its cells at their centres; as text,
//! inline or appended, raw or base64, plain or zlib.

use std::io::{BufReader, Read};
use std::path::Path;

use super::data::{VoxelSpan, data_at, regular_file_bytes};
use super::fields::{numbers, parsed};
use super::rectilinear::{Coordinates, Even};
use crate::vtk_xml::{self, DataArray, Document, Fault, Group, Opened, Piece, Tag, Words};
use rayset_base::geometry::{DAffine3, DMat3, DVec3};
use rayset_base::numbers::Stored;
use rayset_files::grid::VolumeError;
use rayset_files::grid::{Described, VolumeSource, Voxels};

/// The elements of grids that are read.
const IMAGE: &str = "ImageData";
const RECTILINEAR: &str = "RectilinearGrid";

fn of_fault(path: &Path) -> impl Fn(Fault) -> VolumeError {
    move |fault| match fault {
        Fault::Io(source) => VolumeError::Io { path: path.to_owned(), source },
        Fault::Header { place, what } => VolumeError::header(path, &place, &what),
        Fault::Data(what) => VolumeError::Data { path: path.to_owned(), offset: 0, what },
    }
}

/// An error at an attribute of an element.
fn wrong(path: &Path, tag: &Tag, attribute: &str, what: &str) -> VolumeError {
    of_fault(path)(tag.wrong(attribute, what))
}

pub(super) fn open(path: &Path) -> Result<VolumeSource, VolumeError> {
    let file_bytes = regular_file_bytes(path)?;
    let document = vtk_xml::read(path).map_err(of_fault(path))?;
    let piece = only_piece(path, &document)?;
    let extent = extent(path, &document, piece)?;
    // Voxels are at the points, or at the centres of the cells.
    let (tag, of_cells) = wanted_array(path, piece)?;
    let size = [0, 2, 4].map(|i| {
        let cells = extent[i + 1].checked_sub(extent[i]).and_then(|n| u64::try_from(n).ok()).unwrap_or(0);
        if of_cells { cells } else { cells.saturating_add(1) }
    });
    let words = Words::of(&document.file).map_err(of_fault(path))?;
    let described = Described {
        size,
        stored: stored(path, tag)?,
        big_endian: words.big_endian,
        scale: 1.0,
        offset: 0.0,
        space_from_voxel: if document.data.name == RECTILINEAR {
            even(path, &document, piece, &extent, file_bytes, of_cells)?
        } else {
            place(path, &document.data, &extent, of_cells)?
        },
        size_place: document.data.place("WholeExtent"),
        axes_place: document.data.place(if document.data.name == RECTILINEAR { "" } else { "Spacing" }),
    };
    let bytes = described.check(path)?;
    let count = bytes / described.stored.bytes() as u64;
    let array = DataArray { path, document: &document, tag, words, count, bytes, file_bytes };
    match array.open(described.stored).map_err(of_fault(path))? {
        Opened::Plain(start) => {
            let voxels = VoxelSpan { path, start, bytes, rest: None }.plain()?;
            Ok(VolumeSource::new(&described, bytes, voxels))
        }
        Opened::Stream { data, rest, is_text } => {
            // Text has no byte order.
            let big_endian = described.big_endian && !is_text;
            let voxels = Voxels { path: path.to_owned(), data, rest };
            Ok(VolumeSource::new(&Described { big_endian, ..described }, bytes, voxels))
        }
    }
}

/// The piece of the image.
fn only_piece<'d>(path: &Path, document: &'d Document) -> Result<&'d Piece, VolumeError> {
    let is_read = |kind: &str| [IMAGE, RECTILINEAR].contains(&kind);
    if document.file.attribute("type").is_some_and(|kind| !is_read(kind)) {
        return Err(wrong(path, &document.file, "type", "only ImageData and RectilinearGrid are read"));
    }
    if !is_read(&document.data.name) {
        return Err(VolumeError::header(
            path,
            IMAGE,
            "missing; only image data and rectilinear grids are read",
        ));
    }
    match document.pieces.as_slice() {
        [piece] => Ok(piece),
        [] => Err(VolumeError::header(path, "Piece", "missing; a volume has one piece")),
        [_, second, ..] => {
            Err(wrong(path, &second.tag, "", "a second Piece; volumes in several are not read"))
        }
    }
}

/// The first and last point along each axis: of the whole extent, which the single piece must
/// cover.
fn extent(path: &Path, document: &Document, piece: &Piece) -> Result<[i64; 6], VolumeError> {
    let six = |tag: &Tag, name| {
        let numbers = tag.attribute(name).and_then(parsed::<i64, 6>);
        numbers.ok_or_else(|| wrong(path, tag, name, "expected six whole numbers"))
    };
    let whole = six(&document.data, "WholeExtent")?;
    let own = six(&piece.tag, "Extent")?;
    if own != whole {
        let what =
            "differs from WholeExtent; volumes in several pieces, or in a part of their extent, are not read";
        return Err(wrong(path, &piece.tag, "Extent", what));
    }
    Ok(whole)
}

/// The array named as the scalars, otherwise the first with one component; of the points, otherwise
/// of the cells. Also returns whether it is an array of cells.
fn wanted_array<'p>(path: &Path, piece: &'p Piece) -> Result<(&'p Tag, bool), VolumeError> {
    let single = |tag: &&Tag| tag.attribute("NumberOfComponents").is_none_or(|n| n.trim() == "1");
    let wanted = |group: &'p Group| {
        let named = group.scalars.as_deref();
        let named =
            named.and_then(|name| group.arrays.iter().find(|tag| tag.attribute("Name") == Some(name)));
        named.or_else(|| group.arrays.iter().find(single))
    };
    let (tag, of_cells) = match (wanted(&piece.points), wanted(&piece.cells)) {
        (Some(tag), _) => (tag, false),
        (None, Some(tag)) => (tag, true),
        (None, None) => {
            let what = "no DataArray of one number each in its PointData or CellData";
            return Err(wrong(path, &piece.tag, "", what));
        }
    };
    if !single(&tag) {
        return Err(wrong(path, tag, "NumberOfComponents", "only one number a voxel is read"));
    }
    Ok((tag, of_cells))
}

fn stored(path: &Path, tag: &Tag) -> Result<Stored, VolumeError> {
    Ok(match tag.attribute("type").unwrap_or_default() {
        "Int8" => Stored::I8,
        "UInt8" => Stored::U8,
        "Int16" => Stored::I16,
        "UInt16" => Stored::U16,
        "Int32" => Stored::I32,
        "UInt32" => Stored::U32,
        "Int64" => Stored::I64,
        "UInt64" => Stored::U64,
        "Float32" => Stored::F32,
        "Float64" => Stored::F64,
        _ => return Err(wrong(path, tag, "type", "expected Int8 to UInt64, Float32 or Float64")),
    })
}

fn place(path: &Path, image: &Tag, extent: &[i64; 6], of_cells: bool) -> Result<DAffine3, VolumeError> {
    let three = |name, default| match image.attribute(name) {
        None => Ok(DVec3::splat(default)),
        Some(text) => numbers(text)
            .map(DVec3::from_array)
            .ok_or_else(|| wrong(path, image, name, "expected three finite numbers")),
    };
    let (spacing, origin) = (three("Spacing", 1.0)?, three("Origin", 0.0)?);
    let direction = match image.attribute("Direction") {
        None => DMat3::IDENTITY,
        Some(text) => numbers(text)
            .map(|rows| DMat3::from_cols_array(&rows).transpose())
            .ok_or_else(|| wrong(path, image, "Direction", "expected nine finite numbers"))?,
    };
    let linear = direction * DMat3::from_diagonal(spacing);
    let first = DVec3::new(extent[0] as f64, extent[2] as f64, extent[4] as f64);
    let first = first + if of_cells { 0.5 } else { 0.0 };
    Ok(DAffine3::from_mat3_translation(linear, origin + linear * first))
}

/// The space of a rectilinear grid, of whose points the coordinates along each axis are evenly
/// spaced.
fn even(
    path: &Path,
    document: &Document,
    piece: &Piece,
    extent: &[i64; 6],
    file_bytes: u64,
    of_cells: bool,
) -> Result<DAffine3, VolumeError> {
    let words = Words::of(&document.file).map_err(of_fault(path))?;
    let arrays = &piece.coordinates.arrays;
    if arrays.len() != 3 {
        let what = format!("{} DataArrays in its Coordinates, where 3 were expected", arrays.len());
        return Err(wrong(path, &piece.tag, "", &what));
    }
    let mut even = Even::default();
    for (axis, tag) in arrays.iter().enumerate() {
        let stored = stored(path, tag)?;
        let count = extent[2 * axis + 1].checked_sub(extent[2 * axis]).and_then(|n| n.checked_add(1));
        let count = count.and_then(|n| u64::try_from(n).ok()).filter(|n| *n > 0);
        let bytes = count.and_then(|count| count.checked_mul(stored.bytes() as u64));
        let (Some(count), Some(bytes)) = (count, bytes) else {
            return Err(wrong(path, &piece.tag, "Extent", "has no points, or more than any file"));
        };
        let array = DataArray { path, document, tag, words, count, bytes, file_bytes };
        let open = || array.open(stored).map_err(of_fault(path));
        let is_text = matches!(open()?, Opened::Stream { is_text: true, .. });
        let big_endian = words.big_endian && !is_text;
        let numbers = || -> Result<Box<dyn Read + Send>, VolumeError> {
            Ok(match open()? {
                Opened::Plain(start) => Box::new(data_at(path, start)?),
                Opened::Stream { data, .. } => Box::new(BufReader::new(data)),
            })
        };
        let coordinates = Coordinates { axis, stored, big_endian, count };
        coordinates.read(&mut even, numbers)?.map_err(|what| wrong(path, tag, "", &what))?;
    }
    let origin = even.first + even.spacing * if of_cells { 0.5 } else { 0.0 };
    Ok(DAffine3::from_mat3_translation(DMat3::from_diagonal(even.spacing), origin))
}

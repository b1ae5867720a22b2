//! Points of VTK's files in XML: PolyData (`.vtp`) and UnstructuredGrid (`.vtu`).

use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use super::part::{Part, Stored, VtkArray};
use crate::points::roles::excerpt;
use crate::points::{ColumnType, Place, ReadError};
use crate::vtk_xml::{self, DataArray, Document, Fault, Opened, Piece, Tag, Words};
use rayset_store::storage::input_file::InputFile;

/// Whether a file begins as those of VTK in XML do.
pub(super) fn begins(head: &[u8]) -> bool {
    const ROOT: &[u8] = b"<VTKFile";
    head.windows(ROOT.len()).any(|window| window == ROOT)
}

fn of_fault(path: &Path) -> impl Fn(Fault) -> ReadError {
    let malformed = |path: &Path, place: &str, what: &str| {
        // The place begins with "byte" and its number; the rest names the element.
        let number = place.strip_prefix("byte ").and_then(|rest| rest.split(',').next()?.parse().ok());
        let element = place.split_once(", ").map_or("", |(_, element)| element);
        let what = if element.is_empty() { what.to_owned() } else { format!("{element}: {what}") };
        ReadError::malformed(path, Place::Byte(number.unwrap_or(0)), what)
    };
    move |fault| match fault {
        Fault::Io(source) => ReadError::Io { path: path.to_owned(), source },
        Fault::Header { place, what } => malformed(path, &place, &what),
        Fault::Data(what) => malformed(path, "", &what),
    }
}

/// Reads the elements of a file, and finds its points in them.
pub(super) fn scan(path: &Path) -> Result<(Document, Vec<Part>, String), ReadError> {
    let fail = of_fault(path);
    let document = vtk_xml::read(path).map_err(&fail)?;
    let kind = document.data.name.clone();
    let advice = match kind.as_str() {
        "PolyData" | "UnstructuredGrid" => None,
        "ImageData" => Some("it is a volume; a name that ends in .vti opens it as one"),
        "RectilinearGrid" | "StructuredGrid" => Some(
            "it is a grid; ParaView's filter Resample To Image and Save Data as .vti make a volume of it that opens",
        ),
        _ => Some(
            "expected PolyData or UnstructuredGrid; of a file that names others, as .pvtp, .pvtu, .vtm and .pvd do, give those",
        ),
    };
    if let Some(advice) = advice {
        let what = format!("the data are of the kind `{}`: {advice}", excerpt(&kind));
        return Err(fail(document.data.wrong("", &what)));
    }
    let mut parts = Vec::new();
    for (index, piece) in document.pieces.iter().enumerate() {
        let rows = piece.tag.attribute("NumberOfPoints").and_then(|text| text.trim().parse::<u64>().ok());
        let rows =
            rows.ok_or_else(|| fail(piece.tag.wrong("NumberOfPoints", "expected the number of points")))?;
        if rows > 0 {
            parts.push(part_of(piece, index, rows).map_err(&fail)?);
        }
    }
    Ok((document, parts, format!("VTK {kind} in XML")))
}

fn part_of(piece: &Piece, index: usize, rows: u64) -> Result<Part, Fault> {
    let Some(tag) = piece.coordinates.arrays.first() else {
        return Err(piece.tag.wrong("", "a piece without Points"));
    };
    let positions = array(tag, index, true, 0);
    let positions = positions.filter(|array| array.width == 3 && !array.kind.is_integer());
    let positions = positions
        .ok_or_else(|| tag.wrong("", "expected three numbers of the type Float32 or Float64 a point"))?;
    let arrays = piece.points.arrays.iter().enumerate();
    let arrays = arrays.filter_map(|(place, tag)| array(tag, index, false, place)).collect();
    Ok(Part { rows, positions, arrays })
}

/// An array of numbers. `None` if it is of texts, or of rows that are too long.
fn array(tag: &Tag, piece: usize, is_position: bool, index: usize) -> Option<VtkArray> {
    let kind = match tag.attribute("type")? {
        "UInt8" => ColumnType::U8,
        "Int8" => ColumnType::I8,
        "UInt16" => ColumnType::U16,
        "Int16" => ColumnType::I16,
        "UInt32" => ColumnType::U32,
        "Int32" => ColumnType::I32,
        "UInt64" => ColumnType::U64,
        "Int64" => ColumnType::I64,
        "Float32" => ColumnType::F32,
        "Float64" => ColumnType::F64,
        _ => return None,
    };
    let width =
        tag.attribute("NumberOfComponents").map_or(Ok(1), |text| text.trim().parse::<usize>()).ok()?;
    let name = excerpt(tag.attribute("Name").unwrap_or_default());
    // Components of 0 stand for one.
    let width = width.max(1);
    (width <= 64).then_some(VtkArray { name, kind, width, stored: Stored::Xml { piece, is_position, index } })
}

/// A stream of the numbers of an array, and whether they are in big-endian order.
pub(super) fn open(
    path: &Path,
    document: &Document,
    array: &VtkArray,
    rows: u64,
) -> Result<(Box<dyn Read + Send>, bool), ReadError> {
    let fail = of_fault(path);
    let Stored::Xml { piece, is_position, index } = array.stored else {
        return Err(ReadError::malformed(path, Place::Byte(0), "an array that is not in XML"));
    };
    let piece = &document.pieces[piece];
    let group = if is_position { &piece.coordinates } else { &piece.points };
    let words = Words::of(&document.file).map_err(&fail)?;
    let count = rows.saturating_mul(array.width as u64);
    let data = DataArray {
        path,
        document,
        tag: &group.arrays[index],
        words,
        count,
        bytes: count.saturating_mul(array.kind.bytes() as u64),
        file_bytes: InputFile::open(path).and_then(|file| file.length()).map_err(ReadError::io(path))?,
    };
    match data.open(array.kind).map_err(&fail)? {
        Opened::Plain(start) => {
            let mut file = InputFile::open(path).map_err(ReadError::io(path))?;
            file.seek(SeekFrom::Start(start)).map_err(ReadError::io(path))?;
            Ok((Box::new(BufReader::with_capacity(1 << 16, file)), words.big_endian))
        }
        Opened::Stream { data, is_text, .. } => Ok((data, words.big_endian && !is_text)),
    }
}

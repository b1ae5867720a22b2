//! VTK ImageData in XML (`.vti`) of one piece: the scalars of its points, otherwise those of its cells at their centres; as
//! text, inline or appended, raw or base64, plain or zlib.

mod blocks;
mod header;
mod text;

use std::io::{self, BufRead, BufReader, Read};
use std::path::Path;

use self::blocks::{Blocks, Words};
use self::header::{Group, Header, Tag};
use self::text::{Base64, UntilTag};
use super::data::{MOST_DEFLATED, Place, Voxels, data_at, regular_file_bytes, what_of};
use super::error::ReadError;
use super::fields::{numbers, parsed};
use super::numbers::Numbers;
use super::source::{Described, VolumeSource};
use super::stored::Stored;
use crate::geometry::{DAffine3, DMat3, DVec3};

pub(super) fn open(path: &Path) -> Result<VolumeSource, ReadError> {
    let header = header::read(path)?;
    let extent = extent(path, &header)?;
    // Voxels are at the points, or at the centres of the cells.
    let (tag, of_cells) = wanted_array(path, &header)?;
    let size = [0, 2, 4].map(|i| {
        let cells = extent[i + 1].checked_sub(extent[i]).and_then(|n| u64::try_from(n).ok()).unwrap_or(0);
        if of_cells { cells } else { cells.saturating_add(1) }
    });
    let words = Words::of(path, &header.file)?;
    let described = Described {
        size,
        stored: stored(path, tag)?,
        big_endian: words.big_endian,
        scale: 1.0,
        offset: 0.0,
        space_from_voxel: place(path, &header.image, &extent, of_cells)?,
        size_place: header.image.place("WholeExtent"),
        axes_place: header.image.place("Spacing"),
    };
    let bytes = described.check(path)?;
    let array = Array { path, tag, words, bytes, file_bytes: regular_file_bytes(path)? };
    let format = tag.attribute("format");
    let voxels = match format {
        Some("ascii") => array.ascii(&described)?,
        Some("binary") => array.encoded(&Encoded::Inline(array.content()?), &header)?,
        Some("appended") => array.encoded(&array.appended(&header)?, &header)?,
        _ => return Err(tag.wrong(path, "format", "expected ascii, binary or appended")),
    };
    // Text has no byte order.
    let big_endian = described.big_endian && format != Some("ascii");
    Ok(VolumeSource::new(&Described { big_endian, ..described }, bytes, voxels))
}

/// The first and last point along each axis: of the whole extent, which the single piece must cover.
fn extent(path: &Path, header: &Header) -> Result<[i64; 6], ReadError> {
    let six = |tag: &Tag, name| {
        let numbers = tag.attribute(name).and_then(parsed::<i64, 6>);
        numbers.ok_or_else(|| tag.wrong(path, name, "expected six whole numbers"))
    };
    let whole = six(&header.image, "WholeExtent")?;
    let piece = six(&header.piece, "Extent")?;
    if piece != whole {
        let what =
            "differs from WholeExtent; volumes in several pieces, or in a part of their extent, are not read";
        return Err(header.piece.wrong(path, "Extent", what));
    }
    Ok(whole)
}

/// The array named as the scalars, otherwise the first with one component; of the points, otherwise of the cells. Also
/// returns whether it is an array of cells.
fn wanted_array<'h>(path: &Path, header: &'h Header) -> Result<(&'h Tag, bool), ReadError> {
    let single = |tag: &&Tag| tag.attribute("NumberOfComponents").is_none_or(|n| n.trim() == "1");
    let wanted = |group: &'h Group| {
        let named = group.scalars.as_deref();
        let named =
            named.and_then(|name| group.arrays.iter().find(|tag| tag.attribute("Name") == Some(name)));
        named.or_else(|| group.arrays.iter().find(single))
    };
    let (tag, of_cells) = match (wanted(&header.points), wanted(&header.cells)) {
        (Some(tag), _) => (tag, false),
        (None, Some(tag)) => (tag, true),
        (None, None) => {
            let what = "no DataArray of one number each in its PointData or CellData";
            return Err(header.piece.wrong(path, "", what));
        }
    };
    if !single(&tag) {
        return Err(tag.wrong(path, "NumberOfComponents", "only one number a voxel is read"));
    }
    Ok((tag, of_cells))
}

fn stored(path: &Path, tag: &Tag) -> Result<Stored, ReadError> {
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
        _ => return Err(tag.wrong(path, "type", "expected Int8 to UInt64, Float32 or Float64")),
    })
}

fn place(path: &Path, image: &Tag, extent: &[i64; 6], of_cells: bool) -> Result<DAffine3, ReadError> {
    let three = |name, default| match image.attribute(name) {
        None => Ok(DVec3::splat(default)),
        Some(text) => numbers(text)
            .map(DVec3::from_array)
            .ok_or_else(|| image.wrong(path, name, "expected three finite numbers")),
    };
    let (spacing, origin) = (three("Spacing", 1.0)?, three("Origin", 0.0)?);
    let direction = match image.attribute("Direction") {
        None => DMat3::IDENTITY,
        Some(text) => numbers(text)
            .map(|rows| DMat3::from_cols_array(&rows).transpose())
            .ok_or_else(|| image.wrong(path, "Direction", "expected nine finite numbers"))?,
    };
    let linear = direction * DMat3::from_diagonal(spacing);
    let first = DVec3::new(extent[0] as f64, extent[2] as f64, extent[4] as f64);
    let first = first + if of_cells { 0.5 } else { 0.0 };
    Ok(DAffine3::from_mat3_translation(linear, origin + linear * first))
}

/// Where binary data are, and how they are encoded.
enum Encoded {
    /// Base64 in the element itself, from this byte of the file on.
    Inline(u64),
    /// Raw bytes in the appended data, from this byte of the file on.
    Raw(u64),
    Base64(u64),
}

/// The array that holds the voxels.
struct Array<'a> {
    path: &'a Path,
    tag: &'a Tag,
    words: Words,
    /// Bytes of all voxels.
    bytes: u64,
    file_bytes: u64,
}

impl Array<'_> {
    /// The byte offset of the text of the element.
    fn content(&self) -> Result<u64, ReadError> {
        self.tag.content.ok_or_else(|| self.tag.wrong(self.path, "", "the element is empty"))
    }

    fn early(&self, what: &str) -> ReadError {
        let what = format!("the file ends before all voxels are there: {what}");
        ReadError::Data { path: self.path.to_owned(), offset: 0, what }
    }

    fn ascii(&self, described: &Described) -> Result<Voxels, ReadError> {
        let at = self.content()?;
        let count = self.bytes / described.stored.bytes() as u64;
        // At least one digit each, and one separator between two numbers.
        let least = 2 * count - 1;
        if self.file_bytes - at.min(self.file_bytes) < least {
            return Err(self.early(&format!("{count} numbers need at least {least} bytes")));
        }
        let data = Box::new(Numbers::new(data_at(self.path, at)?, described.stored, count, true));
        Ok(Voxels { path: self.path.to_owned(), data, rest: Some(0) })
    }

    fn appended(&self, header: &Header) -> Result<Encoded, ReadError> {
        let wrong = |what| Err(self.tag.wrong(self.path, "offset", what));
        let Some(offset) = self.tag.attribute("offset").and_then(parsed::<u64, 1>) else {
            return wrong("expected a number of bytes");
        };
        let Some((tag, start)) = &header.appended else { return wrong("there is no AppendedData") };
        let Some(at) = start.checked_add(offset[0]).filter(|at| *at < self.file_bytes) else {
            return wrong("is beyond the end of the file");
        };
        match tag.attribute("encoding") {
            Some("raw") => Ok(Encoded::Raw(at)),
            Some("base64") => Ok(Encoded::Base64(at)),
            _ => Err(tag.wrong(self.path, "encoding", "expected raw or base64")),
        }
    }

    /// Binary data, preceded by words that give their length.
    fn encoded(&self, encoded: &Encoded, header: &Header) -> Result<Voxels, ReadError> {
        let compressor = header.file.attribute("compressor").filter(|name| !name.is_empty());
        match compressor {
            None => self.uncompressed(encoded),
            Some("vtkZLibDataCompressor") => self.compressed(encoded),
            Some(_) => {
                let what = "expected vtkZLibDataCompressor, or none; others are not read";
                Err(header.file.wrong(self.path, "compressor", what))
            }
        }
    }

    fn uncompressed(&self, encoded: &Encoded) -> Result<Voxels, ReadError> {
        let mut data = self.reader(encoded, 0)?;
        let said = self.words.read(&mut data).map_err(|error| self.unreadable(&error))?;
        self.check_length(said)?;
        let width = self.words.width();
        if let Encoded::Raw(at) = encoded {
            return Place { path: self.path, start: at + width, bytes: self.bytes, rest: None }.plain();
        }
        self.check_room(encoded, width.saturating_add(self.bytes))?;
        // Other arrays may follow in the appended data, but nothing may follow in an element.
        let rest = matches!(encoded, Encoded::Inline(_)).then_some(0);
        Ok(Voxels { path: self.path.to_owned(), data: Box::new(data), rest })
    }

    fn compressed(&self, encoded: &Encoded) -> Result<Voxels, ReadError> {
        let unreadable = |error| self.unreadable(&error);
        let mut head = self.reader(encoded, 0)?;
        let mut word = || self.words.read(&mut head).map_err(unreadable);
        let [blocks, block_bytes, partial_bytes] = [word()?, word()?, word()?];
        let last_bytes = if partial_bytes == 0 { block_bytes } else { partial_bytes };
        let whole = blocks.checked_sub(1).and_then(|whole| whole.checked_mul(block_bytes));
        let all = whole.and_then(|whole| whole.checked_add(last_bytes)).unwrap_or(0);
        self.check_length(all)?;
        if last_bytes > block_bytes {
            return Err(self.tag.wrong(
                self.path,
                "",
                "its last compressed block is said to be longer than the others",
            ));
        }
        // The sizes of the blocks are read twice instead of being stored, however many blocks there are.
        let head_bytes = blocks.saturating_add(3).saturating_mul(self.words.width());
        self.check_room(encoded, head_bytes)?;
        let mut compressed_bytes = 0_u64;
        for _ in 0..blocks {
            compressed_bytes = compressed_bytes.saturating_add(word()?);
        }
        self.check_room(encoded, head_bytes.saturating_add(compressed_bytes))?;
        if self.bytes / MOST_DEFLATED > compressed_bytes {
            let what =
                format!("{compressed_bytes} compressed bytes cannot hold the {} of the voxels", self.bytes);
            return Err(self.early(&what));
        }
        let sizes = self.reader(encoded, 3 * self.words.width())?;
        let data = self.reader(encoded, head_bytes)?;
        let alone = matches!(encoded, Encoded::Inline(_));
        let blocks = Blocks::new(sizes, data, self.words, blocks, [block_bytes, last_bytes], alone);
        Ok(Voxels { path: self.path.to_owned(), data: Box::new(blocks), rest: Some(0) })
    }

    /// A reader of the decoded data after the first `skip` bytes.
    fn reader(&self, encoded: &Encoded, skip: u64) -> Result<Box<dyn BufRead + Send>, ReadError> {
        let (Encoded::Inline(at) | Encoded::Raw(at) | Encoded::Base64(at)) = *encoded;
        if let Encoded::Raw(_) = encoded {
            return Ok(Box::new(data_at(self.path, at.saturating_add(skip))?));
        }
        let mut data = BufReader::with_capacity(1 << 16, Base64::new(UntilTag::new(data_at(self.path, at)?)));
        let skipped = io::copy(&mut Read::by_ref(&mut data).take(skip), &mut io::sink());
        skipped.map_err(|error| self.unreadable(&error))?;
        Ok(Box::new(data))
    }

    fn unreadable(&self, error: &io::Error) -> ReadError {
        ReadError::Data { path: self.path.to_owned(), offset: 0, what: what_of(error) }
    }

    fn check_length(&self, said: u64) -> Result<(), ReadError> {
        if said == self.bytes {
            return Ok(());
        }
        let what = format!("it is said to hold {said} bytes, and the extent asks for {}", self.bytes);
        Err(self.tag.wrong(self.path, "", &what))
    }

    /// Checks that the file is large enough for this number of decoded bytes.
    fn check_room(&self, encoded: &Encoded, bytes: u64) -> Result<(), ReadError> {
        let (Encoded::Inline(at) | Encoded::Raw(at) | Encoded::Base64(at)) = *encoded;
        let left = self.file_bytes.saturating_sub(at);
        let room = if let Encoded::Raw(_) = encoded { left } else { left / 4 * 3 };
        if bytes <= room {
            return Ok(());
        }
        Err(self.early(&format!("{bytes} bytes of data are said to follow, and there is room for {room}")))
    }
}

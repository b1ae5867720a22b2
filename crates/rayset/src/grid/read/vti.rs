//! VTK ImageData in XML (`.vti`): the scalars of its points, inline or appended, raw or base64, plain or zlib.

use std::io::{self, Read};
use std::path::Path;

use flate2::read::ZlibDecoder;

use super::{Described, ReadError, Stored, VolumeSource, counts, data_at, numbers};
use crate::geometry::{DAffine3, DMat3, DVec3};

/// Headers are looked for in so many bytes from the start.
const HEAD_BYTES: u64 = 1 << 20;
/// A block of compressed data is larger than this in no file that a program writes.
const MOST_BLOCK_BYTES: u64 = 256 << 20;

pub(super) fn open(path: &Path) -> Result<VolumeSource, ReadError> {
    let wrong = |place: &str, what: &str| ReadError::Header {
        path: path.to_owned(),
        place: place.to_owned(),
        what: what.to_owned(),
    };
    let mut head = Vec::new();
    let read = data_at(path, 0)?.take(HEAD_BYTES).read_to_end(&mut head);
    read.map_err(|source| ReadError::Io { path: path.to_owned(), source })?;
    let tag = |name: &str| find_tag(&head, name, 0).map(|(tag, _)| tag);
    let file = tag("VTKFile").ok_or_else(|| wrong("VTKFile", "missing; this is not a VTK file in XML"))?;
    let image = tag("ImageData").ok_or_else(|| wrong("ImageData", "missing; only image data is read"))?;
    let extent: [f64; 6] = attribute(&image, "WholeExtent")
        .and_then(|text| numbers(&text))
        .ok_or_else(|| wrong("ImageData, WholeExtent", "expected six numbers"))?;
    let size = [0, 2, 4].map(|i| (extent[i + 1] - extent[i] + 1.0).max(0.0) as u64);
    if let Some(pieces) = find_tag(&head, "Piece", 0).and_then(|(_, at)| find_tag(&head, "Piece", at)) {
        let place = format!("Piece at byte {}", pieces.1);
        return Err(wrong(&place, "volumes in several pieces are not read"));
    }
    let points = find_tag(&head, "PointData", 0).ok_or_else(|| wrong("PointData", "missing"))?;
    let (array, content) =
        wanted_array(&head, &points).ok_or_else(|| wrong("DataArray", "no scalars of points"))?;
    let stored = match attribute(&array, "type").unwrap_or_default().as_str() {
        "Int8" => Stored::I8,
        "UInt8" => Stored::U8,
        "Int16" => Stored::I16,
        "UInt16" => Stored::U16,
        "Int32" => Stored::I32,
        "UInt32" => Stored::U32,
        "Float32" => Stored::F32,
        "Float64" => Stored::F64,
        _ => return Err(wrong("DataArray, type", "expected Int8 to UInt32, Float32 or Float64")),
    };
    if attribute(&array, "NumberOfComponents").is_some_and(|n| n != "1") {
        return Err(wrong("DataArray, NumberOfComponents", "only one number a voxel is read"));
    }
    let format = attribute(&array, "format").unwrap_or_default();
    let (start, base64) = match format.as_str() {
        "binary" => (content as u64, true),
        "appended" => {
            let (appended, at) = find_tag(&head, "AppendedData", 0)
                .ok_or_else(|| wrong("AppendedData", "missing, or more than 1 MiB from the start"))?;
            let base64 = attribute(&appended, "encoding").is_some_and(|e| e == "base64");
            let offset = attribute(&array, "offset").and_then(|text| counts_one(&text));
            let offset = offset.ok_or_else(|| wrong("DataArray, offset", "expected a number of bytes"))?;
            let marker = head[at..].iter().position(|&b| b == b'_').unwrap_or(0);
            ((at + marker + 1) as u64 + offset, base64)
        }
        _ => return Err(wrong("DataArray, format", "expected binary or appended")),
    };
    let big_endian = attribute(&file, "byte_order").is_some_and(|order| order == "BigEndian");
    let wide = attribute(&file, "header_type").is_some_and(|kind| kind == "UInt64");
    let compressed = match attribute(&file, "compressor").as_deref() {
        None => false,
        Some("vtkZLibDataCompressor") => true,
        Some(_) => return Err(wrong("VTKFile, compressor", "expected vtkZLibDataCompressor or none")),
    };
    let file = data_at(path, start)?;
    let mut data: Box<dyn Read + Send> = if base64 {
        Box::new(Base64 { inner: file, ready: [0; 3], count: 0, at: 0 })
    } else {
        Box::new(file)
    };
    let io =
        |source| ReadError::Data { path: path.to_owned(), offset: 0, what: io::Error::to_string(&source) };
    let word = |data: &mut dyn Read| read_word(data, wide, big_endian);
    let data: Box<dyn Read + Send> = if compressed {
        let blocks = word(&mut data).map_err(io)?;
        let (_, _) = (word(&mut data).map_err(io)?, word(&mut data).map_err(io)?);
        if blocks > 1 << 24 {
            return Err(wrong("DataArray", "more than 16777216 compressed blocks"));
        }
        let sizes = (0..blocks).map(|_| word(&mut data)).collect::<Result<Vec<u64>, _>>().map_err(io)?;
        Box::new(Blocks { inner: data, sizes: sizes.into_iter(), block: io::Cursor::new(Vec::new()) })
    } else {
        word(&mut data).map_err(io)?;
        data
    };
    let described = Described {
        size,
        stored,
        big_endian,
        scale: 1.0,
        offset: 0.0,
        space_from_voxel: place(&image, &extent),
    };
    Ok(VolumeSource::new(path, described, data))
}

fn place(image: &str, extent: &[f64; 6]) -> DAffine3 {
    let three = |name: &str| attribute(image, name).and_then(|text| numbers::<3>(&text));
    let spacing = DVec3::from_array(three("Spacing").unwrap_or([1.0; 3]));
    let origin = DVec3::from_array(three("Origin").unwrap_or([0.0; 3]));
    let rows: [f64; 9] = attribute(image, "Direction")
        .and_then(|text| numbers(&text))
        .unwrap_or([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    let linear = DMat3::from_cols_array(&rows).transpose() * DMat3::from_diagonal(spacing);
    let first = DVec3::new(extent[0], extent[2], extent[4]);
    DAffine3::from_mat3_translation(linear, origin + linear * first)
}

/// The first tag of a name from a byte on, and where its content starts.
fn find_tag(bytes: &[u8], name: &str, from: usize) -> Option<(String, usize)> {
    let opening = format!("<{name}");
    let at = from + bytes.get(from..)?.windows(opening.len()).position(|w| w == opening.as_bytes())?;
    let end = at + bytes[at..].iter().position(|&b| b == b'>')? + 1;
    Some((String::from_utf8_lossy(&bytes[at..end]).into_owned(), end))
}

/// The array that is named as scalars, else the first of the points.
fn wanted_array(head: &[u8], (points, from): &(String, usize)) -> Option<(String, usize)> {
    let wanted = attribute(points, "Scalars");
    let mut at = *from;
    let mut first = None;
    while let Some((tag, end)) = find_tag(head, "DataArray", at) {
        if wanted.is_none() || attribute(&tag, "Name") == wanted {
            return Some((tag, end));
        }
        first.get_or_insert((tag, end));
        at = end;
    }
    first
}

fn attribute(tag: &str, name: &str) -> Option<String> {
    let opening = format!(" {name}=\"");
    let at = tag.find(&opening)? + opening.len();
    Some(tag[at..].split('"').next()?.to_owned())
}

fn counts_one(text: &str) -> Option<u64> {
    counts(&format!("{text} 0 0")).map(|c| c[0])
}

fn read_word(data: &mut dyn Read, wide: bool, big_endian: bool) -> io::Result<u64> {
    let mut bytes = [0; 8];
    let used = if wide { 8 } else { 4 };
    data.read_exact(&mut bytes[..used])?;
    if big_endian {
        bytes[..used].reverse();
    }
    Ok(u64::from_le_bytes(bytes))
}

/// Blocks that are compressed one by one.
struct Blocks {
    inner: Box<dyn Read + Send>,
    sizes: std::vec::IntoIter<u64>,
    block: io::Cursor<Vec<u8>>,
}

impl Read for Blocks {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        loop {
            let read = self.block.read(out)?;
            if read > 0 || out.is_empty() {
                return Ok(read);
            }
            let Some(size) = self.sizes.next() else { return Ok(0) };
            let compressed = (&mut self.inner).take(size.min(MOST_BLOCK_BYTES));
            let mut block = Vec::new();
            ZlibDecoder::new(compressed).take(MOST_BLOCK_BYTES).read_to_end(&mut block)?;
            self.block = io::Cursor::new(block);
        }
    }
}

/// Base64 in one or several pieces, each padded by itself.
struct Base64<R> {
    inner: R,
    ready: [u8; 3],
    count: usize,
    at: usize,
}

impl<R: Read> Base64<R> {
    /// Decodes the next four letters; false at the end.
    fn refill(&mut self) -> io::Result<bool> {
        let (mut bits, mut letters, mut padding) = (0_u32, 0, 0);
        while letters < 4 {
            let mut byte = [0];
            if self.inner.read(&mut byte)? == 0 {
                return Ok(false);
            }
            let value = match byte[0] {
                b'A'..=b'Z' => byte[0] - b'A',
                b'a'..=b'z' => byte[0] - b'a' + 26,
                b'0'..=b'9' => byte[0] - b'0' + 52,
                b'+' => 62,
                b'/' => 63,
                b'=' => {
                    padding += 1;
                    0
                }
                b if b.is_ascii_whitespace() => continue,
                _ => return Ok(false),
            };
            bits = bits << 6 | u32::from(value);
            letters += 1;
        }
        self.ready = [(bits >> 16) as u8, (bits >> 8) as u8, bits as u8];
        (self.count, self.at) = (3_usize.saturating_sub(padding), 0);
        Ok(true)
    }
}

impl<R: Read> Read for Base64<R> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let mut written = 0;
        while written < out.len() {
            if self.at == self.count && !self.refill()? {
                break;
            }
            let now = (self.count - self.at).min(out.len() - written);
            out[written..written + now].copy_from_slice(&self.ready[self.at..self.at + now]);
            self.at += now;
            written += now;
        }
        Ok(written)
    }
}

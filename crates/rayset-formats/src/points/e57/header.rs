//! The header of an E57 file, and the XML that describes its scans.
//!
//! The `e57` crate interprets the XML. What could make it need much memory is checked before: the
//! header against the file, the size of the text, and the number of its parts, of which a document
//! is made in memory.

use std::io::{BufReader, Read};
use std::path::Path;

use e57::{E57Reader, PointCloud};

use super::pages::{PAGE_BYTES, Pages};
use crate::points::{Place, ReadError, quiet};
use rayset_store::storage::input_file::InputFile;

const HEADER_BYTES: usize = 48;
/// Longest XML in bytes. That of a scan takes some 5 kB.
const XML_LIMIT: u64 = 32 << 20;
/// Largest number of tags and attributes together, each of which takes up to 200 bytes while the
/// XML is interpreted. A scan has some 300.
const MARK_LIMIT: usize = 600_000;

/// What a file says of itself and its scans.
pub(super) struct Contents {
    pub(super) scans: Vec<PointCloud>,
    /// The coordinate reference system; empty if there is none.
    pub(super) crs: String,
    /// The program that wrote the file; empty if it does not say.
    pub(super) software: String,
    /// Byte of the file at which the XML begins.
    pub(super) xml_start: u64,
}

/// Opens a file, and reads what it says of its scans.
pub(super) fn open(path: &Path) -> Result<(Contents, Pages), ReadError> {
    let mut file = InputFile::open(path).map_err(ReadError::io(path))?;
    let bytes = file.length().map_err(ReadError::io(path))?;
    let (xml_start, xml_bytes) = check_header(path, &mut file, bytes)?;
    let mut pages = Pages::new(path, file, bytes);
    check_xml(&mut pages, xml_start, xml_bytes)?;

    let bad = |what: String| ReadError::malformed(path, Place::Byte(xml_start), what);
    let file = InputFile::open(path).map_err(ReadError::io(path))?;
    let contents = quiet::catch(|| interpret(file, xml_start));
    let contents = contents.ok_or_else(|| bad("the XML that begins here cannot be interpreted".into()))?;
    let contents = contents.map_err(|e| {
        let said = e.to_string();
        let said = said.strip_prefix("Invalid E57 content: ").unwrap_or(&said);
        bad(format!("in the XML that begins here: {}", said.replace(char::is_control, " ")))
    })?;
    Ok((contents, pages))
}

fn interpret(file: InputFile, xml_start: u64) -> e57::Result<Contents> {
    let reader = E57Reader::new(BufReader::new(file))?;
    let words = |text: Option<&str>| text.unwrap_or_default().trim().to_owned();
    Ok(Contents {
        scans: reader.pointclouds(),
        crs: words(reader.coordinate_metadata()),
        software: words(reader.library_version()),
        xml_start,
    })
}

/// Checks the header against the length of the file. Returns where the XML begins, and its length
/// in bytes.
fn check_header(path: &Path, file: &mut InputFile, bytes: u64) -> Result<(u64, u64), ReadError> {
    let bad = |byte: u64, what: String| ReadError::malformed(path, Place::Byte(byte), what);
    let mut header = Vec::new();
    let read = file.take(HEADER_BYTES as u64).read_to_end(&mut header);
    read.map_err(ReadError::io(path))?;
    if !header.starts_with(b"ASTM-E57") {
        return Err(bad(0, "the file does not begin with `ASTM-E57`, so it is not E57".into()));
    }
    if header.len() < HEADER_BYTES {
        return Err(bad(bytes, format!("the file ends within its header, which takes {HEADER_BYTES} bytes")));
    }
    let number = |at: usize, size: usize| {
        header[at..at + size].iter().rev().fold(0_u64, |value, &byte| value << 8 | u64::from(byte))
    };
    let (major, minor) = (number(8, 4), number(12, 4));
    if (major, minor) != (1, 0) {
        return Err(bad(8, format!("E57 {major}.{minor} is unknown; 1.0 can be read")));
    }
    let [length, xml_start, xml_bytes, page_bytes] = [16, 24, 32, 40].map(|at| number(at, 8));
    if page_bytes != PAGE_BYTES {
        return Err(bad(40, format!("pages of {page_bytes} bytes, where E57 has {PAGE_BYTES}")));
    }
    if length != bytes || !bytes.is_multiple_of(PAGE_BYTES) {
        let what = format!(
            "the header says that the file has {length} bytes, in pages of {PAGE_BYTES}, and it has {bytes}; it is cut \
             off or damaged"
        );
        return Err(bad(16, what));
    }
    if xml_bytes > XML_LIMIT.min(bytes) {
        let what = format!(
            "an XML section of {xml_bytes} bytes, in a file of {bytes}; up to {XML_LIMIT} bytes are read"
        );
        return Err(bad(32, what));
    }
    Ok((xml_start, xml_bytes))
}

/// Reads the XML once, for its checksums and to see that its document will be of bearable size.
fn check_xml(pages: &mut Pages, start: u64, bytes: u64) -> Result<(), ReadError> {
    pages.go_to(start, "the XML section", 24)?;
    let (mut left, mut marks, mut part) = (bytes, 0, [0; 4096]);
    while left > 0 {
        let part = &mut part[..left.min(4096) as usize];
        pages.read(part, "its XML section")?;
        marks += part.iter().filter(|byte| b"<=".contains(byte)).count();
        left -= part.len() as u64;
    }
    if marks > MARK_LIMIT {
        let what = format!(
            "the XML that begins here has {marks} tags and attributes, and up to {MARK_LIMIT} are read; write the \
             scans to several files"
        );
        return Err(ReadError::malformed(pages.path(), Place::Byte(start), what));
    }
    Ok(())
}

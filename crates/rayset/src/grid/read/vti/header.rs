//! The XML elements of a VTI file, up to its appended data, which are not XML.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::Path;

use quick_xml::Reader;
use quick_xml::XmlVersion;
use quick_xml::events::{BytesStart, Event};

use super::super::ReadError;
use super::super::data::{data_at, io_error};

/// Limit on the bytes of a file that are read as XML, without the text of arrays.
const MOST_HEADER_BYTES: u64 = 1 << 20;
/// Limits on the number of arrays in each group, the attributes of an element, and the nesting depth.
const MOST_ARRAYS: usize = 4096;
const MOST_ATTRIBUTES: usize = 64;
const MOST_DEPTH: usize = 64;

/// An element's start.
#[derive(Debug, Default)]
pub(super) struct Tag {
    pub(super) name: String,
    attributes: Vec<(String, String)>,
    /// Its byte offset in the file.
    at: u64,
    /// The byte offset of its own text. `None` if there is none.
    pub(super) content: Option<u64>,
}

/// The arrays of points, or of cells.
#[derive(Debug, Default)]
pub(super) struct Group {
    /// The name of the active scalar array.
    pub(super) scalars: Option<String>,
    pub(super) arrays: Vec<Tag>,
}

/// The elements of a file that are used.
#[derive(Debug, Default)]
pub(super) struct Header {
    pub(super) file: Tag,
    pub(super) image: Tag,
    pub(super) piece: Tag,
    pub(super) points: Group,
    pub(super) cells: Group,
    /// The element, and the byte offset of its data.
    pub(super) appended: Option<(Tag, u64)>,
}

impl Tag {
    fn of(start: &BytesStart<'_>, at: u64) -> Result<Self, String> {
        let mut attributes: Vec<(String, String)> = Vec::new();
        // The parser's own check for duplicate attributes takes quadratic time.
        for attribute in start.attributes().with_checks(false) {
            let attribute = attribute.map_err(|error| format!("this is not well-formed XML: {error}"))?;
            let key = attribute.key.as_ref();
            if attributes.len() == MOST_ATTRIBUTES {
                return Err(format!("more than {MOST_ATTRIBUTES} attributes"));
            }
            if attributes.iter().any(|(known, _)| known == key) {
                return Err(format!("the attribute {key} comes twice"));
            }
            let value =
                attribute.normalized_value(XmlVersion::Implicit1_0).map_err(|error| error.to_string())?;
            attributes.push((key.to_owned(), value.into_owned()));
        }
        Ok(Self { name: start.name().as_ref().to_owned(), attributes, at, content: None })
    }

    pub(super) fn attribute(&self, name: &str) -> Option<&str> {
        self.attributes.iter().find(|(key, _)| key == name).map(|(_, value)| value.as_str())
    }

    /// The place for messages: "byte 230, DataArray, offset".
    pub(super) fn place(&self, attribute: &str) -> String {
        let place = format!("byte {}, {}", self.at, self.name);
        if attribute.is_empty() { place } else { format!("{place}, {attribute}") }
    }

    pub(super) fn wrong(&self, path: &Path, attribute: &str, what: &str) -> ReadError {
        ReadError::header(path, &self.place(attribute), what)
    }
}

type Xml = Reader<io::Take<BufReader<File>>>;

pub(super) fn read(path: &Path) -> Result<Header, ReadError> {
    // The parser does not count a byte-order mark.
    let mut mark = Vec::new();
    data_at(path, 0)?.take(3).read_to_end(&mut mark).map_err(io_error(path))?;
    let first = if mark == [0xef, 0xbb, 0xbf] { 3 } else { 0 };
    let mut xml = Reader::from_reader(data_at(path, first)?.take(MOST_HEADER_BYTES));
    let (mut header, mut buffer, mut open) = (Header::default(), Vec::new(), Vec::new());
    loop {
        buffer.clear();
        let at = first + xml.buffer_position();
        let place = format!("byte {at}");
        let wrong = |what: &str| ReadError::header(path, &place, what);
        let event = xml.read_event_into(&mut buffer);
        let event = event.map_err(|error| match error {
            quick_xml::Error::Io(error) => io_error(path)(io::Error::new(error.kind(), error.to_string())),
            other => wrong(&format!("this is not well-formed XML: {other}")),
        });
        if xml.get_ref().limit() == 0 {
            return Err(wrong(&format!("the header goes on beyond {MOST_HEADER_BYTES} bytes")));
        }
        if open.len() > MOST_DEPTH {
            return Err(wrong("elements in elements, more than 64 deep"));
        }
        match event? {
            Event::Start(start) => {
                let tag = Tag::of(&start, at).map_err(|what| wrong(&what))?;
                open.push(tag.name.clone());
                let appended = open == ["VTKFile", "AppendedData"];
                header.take(&open, tag).map_err(wrong)?;
                if appended {
                    let start = marker(&mut xml).map_err(io_error(path))?;
                    let start = start.ok_or_else(|| wrong("expected `_` before the appended data"))?;
                    if let Some(appended) = &mut header.appended {
                        appended.1 = first + start;
                    }
                    break;
                }
            }
            Event::Empty(start) => {
                let tag = Tag::of(&start, at).map_err(|what| wrong(&what))?;
                open.push(tag.name.clone());
                header.take(&open, tag).map_err(wrong)?;
                open.pop();
            }
            Event::End(_) => {
                open.pop();
            }
            Event::Eof if open.is_empty() => break,
            Event::Eof => return Err(wrong(&format!("the file ends within {}", open.join(" / ")))),
            _ => {}
        }
        if open.last().is_some_and(|name| name == "DataArray" || name == "Array") {
            let text = pass_text(&mut xml).map_err(io_error(path))?.map(|at| first + at);
            if let (Some(at), Some(tag)) = (text, header.array(&open)) {
                if tag.content.is_some() {
                    return Err(tag.wrong(path, "", "its text is in several parts"));
                }
                tag.content = Some(at);
            }
        }
    }
    header.check(path)?;
    Ok(header)
}

/// Skips text up to the next tag, without storing it. Returns the offset of its first character that is not white space.
fn pass_text(xml: &mut Xml) -> io::Result<Option<u64>> {
    let limit = xml.get_ref().limit();
    xml.get_mut().set_limit(u64::MAX);
    let (mut stream, mut found) = (xml.stream(), None);
    loop {
        let offset = stream.offset();
        let held = stream.fill_buf()?;
        let end = held.iter().position(|&byte| byte == b'<').unwrap_or(held.len());
        if found.is_none() {
            let letter = held[..end].iter().position(|byte| !byte.is_ascii_whitespace());
            found = letter.map(|letter| offset + letter as u64);
        }
        let done = end < held.len() || held.is_empty();
        stream.consume(end);
        if done {
            break;
        }
    }
    xml.get_mut().set_limit(limit);
    Ok(found)
}

/// Reads the `_` before the appended data. Returns the offset of the data; `None` if anything else is found.
fn marker(xml: &mut Xml) -> io::Result<Option<u64>> {
    let mut stream = xml.stream();
    loop {
        let mut byte = [0];
        if stream.read(&mut byte)? == 0 {
            return Ok(None);
        }
        match byte[0] {
            b'_' => return Ok(Some(stream.offset())),
            space if space.is_ascii_whitespace() => {}
            _ => return Ok(None),
        }
    }
}

impl Header {
    /// Records an element, which is the innermost of the open ones.
    fn take(&mut self, open: &[String], tag: Tag) -> Result<(), &'static str> {
        let path: Vec<&str> = open.iter().map(String::as_str).collect();
        match path.as_slice() {
            ["VTKFile"] => self.file = tag,
            ["VTKFile", "ImageData"] if self.image.name.is_empty() => self.image = tag,
            ["VTKFile", "ImageData"] => return Err("a second ImageData"),
            ["VTKFile", "ImageData", "Piece"] if self.piece.name.is_empty() => self.piece = tag,
            ["VTKFile", "ImageData", "Piece"] => {
                return Err("a second Piece; volumes in several are not read");
            }
            ["VTKFile", "ImageData", "Piece", group @ ("PointData" | "CellData")] => {
                self.group(group).scalars = tag.attribute("Scalars").map(ToOwned::to_owned);
            }
            ["VTKFile", "ImageData", "Piece", group @ ("PointData" | "CellData"), "DataArray"] => {
                let arrays = &mut self.group(group).arrays;
                if arrays.len() == MOST_ARRAYS {
                    return Err("more than 4096 arrays");
                }
                arrays.push(tag);
            }
            ["VTKFile", "AppendedData"] => self.appended = Some((tag, 0)),
            _ => {}
        }
        Ok(())
    }

    fn group(&mut self, name: &str) -> &mut Group {
        if name == "PointData" { &mut self.points } else { &mut self.cells }
    }

    /// The array that is open. `None` if it is not an array of points or cells.
    fn array(&mut self, open: &[String]) -> Option<&mut Tag> {
        let path: Vec<&str> = open.iter().map(String::as_str).collect();
        match path.as_slice() {
            ["VTKFile", "ImageData", "Piece", group @ ("PointData" | "CellData"), "DataArray"] => {
                self.group(group).arrays.last_mut()
            }
            _ => None,
        }
    }

    /// Checks that all required elements are present.
    fn check(&self, path: &Path) -> Result<(), ReadError> {
        let missing = |name: &str, what: &str| Err(ReadError::header(path, name, what));
        if self.file.name.is_empty() {
            return missing("VTKFile", "missing; this is not a VTK file in XML");
        }
        if self.file.attribute("type").is_some_and(|kind| kind != "ImageData") {
            return Err(self.file.wrong(path, "type", "only ImageData is read"));
        }
        if self.image.name.is_empty() {
            return missing("ImageData", "missing; only image data are read");
        }
        if self.piece.name.is_empty() {
            return missing("Piece", "missing; a volume has one piece");
        }
        Ok(())
    }
}

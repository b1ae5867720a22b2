//! The XML elements of a file of VTK, up to its appended data, which are not XML.

use std::io::{self, BufRead, BufReader, Read};
use std::path::Path;

use quick_xml::Reader;
use quick_xml::XmlVersion;
use quick_xml::events::{BytesStart, Event};

use super::fault::{Fault, data_at};
use rayset_base::regular_file::held;
use rayset_store::storage::input_file::InputFile;

/// Limit on the bytes of a file that are read as XML, without the text of arrays.
const MOST_HEADER_BYTES: u64 = 1 << 20;
/// Limits on the number of arrays in each group, the attributes of an element, and the nesting
/// depth.
const MOST_ARRAYS: usize = 4096;
const MOST_ATTRIBUTES: usize = 64;
const MOST_DEPTH: usize = 64;

/// An element's start.
#[derive(Debug, Default)]
pub(crate) struct Tag {
    pub(crate) name: String,
    attributes: Vec<(String, String)>,
    /// Its byte offset in the file.
    at: u64,
    /// The byte offset of its own text. `None` if there is none.
    pub(crate) content: Option<u64>,
}

/// The arrays of points, or of cells.
#[derive(Debug, Default)]
pub(crate) struct Group {
    /// The name of the active scalar array.
    pub(crate) scalars: Option<String>,
    pub(crate) arrays: Vec<Tag>,
}

/// A part of the data, with points of its own.
#[derive(Debug, Default)]
pub(crate) struct Piece {
    pub(crate) tag: Tag,
    /// What each point has, and each cell.
    pub(crate) points: Group,
    pub(crate) cells: Group,
    /// Where points are: of each, or along each axis.
    pub(crate) coordinates: Group,
}

/// The elements of a file that are used.
#[derive(Debug, Default)]
pub(crate) struct Document {
    pub(crate) file: Tag,
    /// The element with the data, which is called `ImageData`, `PolyData`, ….
    pub(crate) data: Tag,
    pub(crate) pieces: Vec<Piece>,
    /// The element, and the byte offset of its data.
    pub(crate) appended: Option<(Tag, u64)>,
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

    pub(crate) fn attribute(&self, name: &str) -> Option<&str> {
        self.attributes.iter().find(|(key, _)| key == name).map(|(_, value)| value.as_str())
    }

    /// The place for messages: "byte 230, DataArray, offset".
    pub(crate) fn place(&self, attribute: &str) -> String {
        let place = format!("byte {}, {}", self.at, self.name);
        if attribute.is_empty() { place } else { format!("{place}, {attribute}") }
    }

    pub(crate) fn wrong(&self, attribute: &str, what: &str) -> Fault {
        Fault::Header { place: self.place(attribute), what: what.to_owned() }
    }
}

type Xml = Reader<io::Take<BufReader<InputFile>>>;

/// Reads the elements of a file.
pub(crate) fn read(path: &Path) -> Result<Document, Fault> {
    // The parser does not count a byte-order mark.
    let mut mark = Vec::new();
    data_at(path, 0)?.take(3).read_to_end(&mut mark)?;
    let first = if mark == [0xef, 0xbb, 0xbf] { 3 } else { 0 };
    let mut xml = Reader::from_reader(data_at(path, first)?.take(MOST_HEADER_BYTES));
    let (mut header, mut buffer, mut open) = (Document::default(), Vec::new(), Vec::new());
    loop {
        buffer.clear();
        let at = first + xml.buffer_position();
        let place = format!("byte {at}");
        let wrong = |what: &str| Fault::Header { place: place.clone(), what: what.to_owned() };
        let event = xml.read_event_into(&mut buffer);
        let event = event.map_err(|error| match error {
            quick_xml::Error::Io(error) => Fault::Io(io::Error::new(error.kind(), error.to_string())),
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
                header.take(&open, tag).map_err(|what| wrong(&what))?;
                if appended {
                    let start = marker(&mut xml)?;
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
                header.take(&open, tag).map_err(|what| wrong(&what))?;
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
            let text = pass_text(&mut xml)?.map(|at| first + at);
            if let (Some(at), Some(tag)) = (text, header.array(&open)) {
                if tag.content.is_some() {
                    return Err(tag.wrong("", "its text is in several parts"));
                }
                tag.content = Some(at);
            }
        }
    }
    if header.file.name.is_empty() {
        return Err(Fault::Header {
            place: "VTKFile".into(),
            what: "missing; this is not a VTK file in XML".into(),
        });
    }
    Ok(header)
}

/// Skips text up to the next tag, without storing it. Returns the offset of its first character
/// that is not white space.
fn pass_text(xml: &mut Xml) -> io::Result<Option<u64>> {
    let limit = xml.get_ref().limit();
    xml.get_mut().set_limit(u64::MAX);
    let (mut stream, mut found) = (xml.stream(), None);
    loop {
        let offset = stream.offset();
        let held = held(&mut stream)?;
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

/// Reads the `_` before the appended data. Returns the offset of the data; `None` if anything else
/// is found.
fn marker(xml: &mut Xml) -> io::Result<Option<u64>> {
    let mut stream = xml.stream();
    loop {
        let Some(&byte) = held(&mut stream)?.first() else { return Ok(None) };
        stream.consume(1);
        match byte {
            b'_' => return Ok(Some(stream.offset())),
            space if space.is_ascii_whitespace() => {}
            _ => return Ok(None),
        }
    }
}

impl Document {
    /// Records an element, which is the innermost of the open ones.
    fn take(&mut self, open: &[String], tag: Tag) -> Result<(), String> {
        let path: Vec<&str> = open.iter().map(String::as_str).collect();
        match path.as_slice() {
            ["VTKFile"] => self.file = tag,
            ["VTKFile", "AppendedData"] => self.appended = Some((tag, 0)),
            ["VTKFile", _] if self.data.name.is_empty() => self.data = tag,
            ["VTKFile", second] if self.data.name == **second => return Err(format!("a second {second}")),
            ["VTKFile", data, "Piece"] if self.data.name == **data => {
                self.pieces.push(Piece { tag, ..Piece::default() });
            }
            ["VTKFile", _, "Piece", _] => {
                if let Some(group) = self.group(&path) {
                    group.scalars = tag.attribute("Scalars").map(ToOwned::to_owned);
                }
            }
            ["VTKFile", _, "Piece", group, "DataArray"] => {
                if let Some(group) = self.group(&["VTKFile", "", "Piece", *group]) {
                    if group.arrays.len() == MOST_ARRAYS {
                        return Err("more than 4096 arrays".into());
                    }
                    group.arrays.push(tag);
                }
            }
            _ => {}
        }
        Ok(())
    }

    /// The group of arrays of the last piece that a path of elements leads to.
    fn group(&mut self, path: &[&str]) -> Option<&mut Group> {
        let piece = self.pieces.last_mut()?;
        match path {
            [_, _, _, "PointData"] => Some(&mut piece.points),
            [_, _, _, "CellData"] => Some(&mut piece.cells),
            [_, _, _, "Points" | "Coordinates"] => Some(&mut piece.coordinates),
            _ => None,
        }
    }

    /// The array that is open. `None` if it is not an array of a group.
    fn array(&mut self, open: &[String]) -> Option<&mut Tag> {
        let path: Vec<&str> = open.iter().map(String::as_str).collect();
        match path.as_slice() {
            ["VTKFile", _, "Piece", group, "DataArray"] => {
                self.group(&["VTKFile", "", "Piece", *group])?.arrays.last_mut()
            }
            _ => None,
        }
    }
}

//! The records of a PLY file after its header, in ASCII and both binary byte orders.

use std::io::{self, BufRead, Read};
use std::path::Path;

use super::decimal_mark::{DecimalMark, NotANumber};
use super::ply_header::{Element, Encoding, Header, Property, Scalar};
use super::stream::Stream;
use super::{Place, ReadError, roles};

/// Most bytes of records that are read at a time, unless a record is longer.
pub(super) const BUFFER_BYTES: usize = 256 << 10;
/// Longest line of an ASCII file in bytes, so that a file without line ends needs bounded memory.
const LINE_LIMIT: usize = 1 << 20;

/// A part of a record, in the order of the file.
#[derive(Clone, Copy, Debug)]
pub(super) enum Part {
    /// The value of a property.
    Scalar(f64),
    /// The number of items of a list, which follow.
    Count(u32),
    Item(f64),
}

#[derive(Debug)]
pub(super) struct Body {
    input: Stream,
    encoding: Encoding,
    /// Bytes read, in binary files.
    byte: u64,
    /// Lines read, in ASCII files.
    line: u64,
    record: Vec<u8>,
    /// The decimal mark of an ASCII file.
    mark: DecimalMark,
    /// The byte that ends a line of an ASCII file.
    line_end: u8,
}

impl Body {
    /// Upper bound on the memory in bytes that reading needs.
    pub(super) fn memory_needed(&self) -> u64 {
        self.input.memory_needed()
    }

    /// Checks what follows the records in a compressed file, so that its checksum is found to be
    /// right.
    pub(super) fn check_rest(&mut self) -> Result<(), ReadError> {
        self.input.check_rest()
    }

    /// Opens a file and reads its header.
    pub(super) fn open(path: &Path) -> Result<(Header, Self), ReadError> {
        Self::of(Stream::open(path)?)
    }

    /// Reads the header of a stream.
    pub(super) fn of(mut input: Stream) -> Result<(Header, Self), ReadError> {
        let path = input.path().to_owned();
        let header = Header::read(&path, &mut input)?;
        let (byte, line, encoding) = (header.bytes, header.lines, header.encoding);
        let line_end = header.line_end;
        Ok((
            header,
            Self { input, encoding, byte, line, record: Vec::new(), mark: DecimalMark::Open, line_end },
        ))
    }

    pub(super) fn encoding(&self) -> Encoding {
        self.encoding
    }

    /// An error at `byte` of a binary file, or on the line of an ASCII file that was read last.
    fn fail(&self, byte: u64, what: impl Into<String>) -> ReadError {
        let place = if self.encoding == Encoding::Ascii { Place::Line(self.line) } else { Place::Byte(byte) };
        ReadError::malformed(self.input.path(), place, what)
    }

    fn io(&self) -> impl Fn(io::Error) -> ReadError + use<> {
        let path = self.input.path().to_owned();
        move |source| ReadError::io(&path)(source)
    }

    fn ends_early(&self, element: &Element, read: u64) -> ReadError {
        let records = match element.name.as_str() {
            "vertex" => "vertices".to_owned(),
            "face" => "faces".to_owned(),
            other => format!("records of element `{}`", roles::excerpt(other)),
        };
        self.fail(self.byte, format!("the file ends early: {read} of {} {records} read", element.count))
    }

    /// Skips all records of an element.
    pub(super) fn skip(&mut self, element: &Element) -> Result<(), ReadError> {
        if element.properties.is_empty() {
            return Ok(());
        }
        if let (Some(stride), false) = (element.stride(), self.encoding == Encoding::Ascii) {
            let bytes = element.count.saturating_mul(stride as u64);
            let skipped = self.skip_bytes(bytes)?;
            return if skipped == bytes {
                Ok(())
            } else {
                Err(self.ends_early(element, skipped / stride as u64))
            };
        }
        for index in 0..element.count {
            if self.encoding == Encoding::Ascii {
                self.read_line(element, index)?;
            } else {
                self.record(element, index, |_| false, |_, _| Ok(()))?;
            }
        }
        Ok(())
    }

    /// Whether records of a fixed size can be passed over without reading them.
    pub(super) fn can_seek(&self) -> bool {
        self.input.can_seek()
    }

    /// Passes over `count` binary records of `stride` bytes.
    pub(super) fn seek_records(&mut self, count: u64, stride: usize) -> Result<(), ReadError> {
        let bytes = count.saturating_mul(stride as u64);
        self.input.seek_forward(bytes).map_err(self.io())?;
        self.byte += bytes;
        Ok(())
    }

    /// Reads record `index` of an element and passes its parts to `visit`, with the index of their
    /// property. The items of lists for which `wants` is false are skipped. Errors of `visit` are
    /// reported with their place in the file.
    pub(super) fn record(
        &mut self,
        element: &Element,
        index: u64,
        wants: impl Fn(usize) -> bool,
        visit: impl FnMut(usize, Part) -> Result<(), String>,
    ) -> Result<(), ReadError> {
        if self.encoding != Encoding::Ascii {
            return self.binary_record(element, index, wants, visit);
        }
        self.read_line(element, index)?;
        let parsed = parse_line(&self.record, &mut self.mark, &element.properties, wants, visit);
        parsed.map_err(|what| self.fail(self.byte, what))
    }

    fn binary_record(
        &mut self,
        element: &Element,
        index: u64,
        wants: impl Fn(usize) -> bool,
        mut visit: impl FnMut(usize, Part) -> Result<(), String>,
    ) -> Result<(), ReadError> {
        for (place, property) in element.properties.iter().enumerate() {
            let at = self.byte;
            match *property {
                Property::Scalar { kind, .. } => {
                    let value = self.binary_value(kind, element, index)?;
                    visit(place, Part::Scalar(value)).map_err(|what| self.fail(at, what))?;
                }
                Property::List { count, item, .. } => {
                    let items = self.binary_value(count, element, index)?;
                    let items = list_count(items).map_err(|what| self.fail(at, what))?;
                    visit(place, Part::Count(items)).map_err(|what| self.fail(at, what))?;
                    if !wants(place) {
                        let bytes = u64::from(items) * item.size() as u64;
                        if self.skip_bytes(bytes)? < bytes {
                            return Err(self.ends_early(element, index));
                        }
                        continue;
                    }
                    for _ in 0..items {
                        let at = self.byte;
                        let value = self.binary_value(item, element, index)?;
                        visit(place, Part::Item(value)).map_err(|what| self.fail(at, what))?;
                    }
                }
            }
        }
        Ok(())
    }

    /// Reads `count` records of `stride` bytes of an element without lists, from record `index` on.
    pub(super) fn fixed(
        &mut self,
        element: &Element,
        index: u64,
        count: usize,
        stride: usize,
    ) -> Result<&[u8], ReadError> {
        let read = self.read_bytes(count * stride)?;
        if read < count * stride {
            return Err(self.ends_early(element, index + (read / stride) as u64));
        }
        Ok(&self.record)
    }

    fn binary_value(&mut self, kind: Scalar, element: &Element, index: u64) -> Result<f64, ReadError> {
        if self.read_bytes(kind.size())? < kind.size() {
            return Err(self.ends_early(element, index));
        }
        Ok(kind.decode(&self.record, self.encoding == Encoding::BigEndian))
    }

    /// Reads up to `bytes` bytes into `self.record`; fewer only at the end of the file. Returns how
    /// many were read.
    fn read_bytes(&mut self, bytes: usize) -> Result<usize, ReadError> {
        self.record.resize(bytes, 0);
        let mut read = 0;
        while read < bytes {
            match self.input.read(&mut self.record[read..]) {
                Ok(0) => break,
                Ok(n) => read += n,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(e) => return Err(self.io()(e)),
            }
        }
        self.byte += read as u64;
        Ok(read)
    }

    fn skip_bytes(&mut self, bytes: u64) -> Result<u64, ReadError> {
        let skipped = io::copy(&mut (&mut self.input).take(bytes), &mut io::sink()).map_err(self.io())?;
        self.byte += skipped;
        Ok(skipped)
    }

    /// Reads the next line that is not empty into `self.record`.
    fn read_line(&mut self, element: &Element, index: u64) -> Result<(), ReadError> {
        loop {
            self.record.clear();
            let read = (&mut self.input).take(LINE_LIMIT as u64).read_until(self.line_end, &mut self.record);
            let read = read.map_err(self.io())?;
            if read == 0 {
                return Err(self.ends_early(element, index));
            }
            self.line += 1;
            if read == LINE_LIMIT && self.record.last() != Some(&self.line_end) {
                return Err(self.fail(0, format!("a line of more than {LINE_LIMIT} bytes")));
            }
            if !self.record.trim_ascii().is_empty() {
                return Ok(());
            }
        }
    }
}

fn list_count(items: f64) -> Result<u32, String> {
    if Scalar::U32.holds(items) {
        Ok(items as u32)
    } else {
        Err(format!("a list of {items} items; expected a whole number from 0 to {}", u32::MAX))
    }
}

/// Parses the line of an ASCII record.
fn parse_line(
    line: &[u8],
    mark: &mut DecimalMark,
    properties: &[Property],
    wants: impl Fn(usize) -> bool,
    mut visit: impl FnMut(usize, Part) -> Result<(), String>,
) -> Result<(), String> {
    let text = std::str::from_utf8(line).map_err(|_| "not text, in a file that says it is ASCII")?;
    let mut words = text.split_ascii_whitespace();
    let mut number = |kind: Scalar| -> Result<f64, String> {
        let word =
            words.next().ok_or_else(|| format!("too few values for {} properties", properties.len()))?;
        let value = mark.parse(word).map_err(|why| match why {
            NotANumber::Word => format!("`{}` is not a number", roles::excerpt(word)),
            NotANumber::OtherMark => format!(
                "`{}` has two decimal marks, or another than the numbers before it; a file has one, and thousands have none",
                roles::excerpt(word)
            ),
        })?;
        if kind.holds(value) {
            Ok(value)
        } else {
            Err(format!("`{}` is no value of type {}", roles::excerpt(word), kind.column_type()))
        }
    };
    for (place, property) in properties.iter().enumerate() {
        match *property {
            Property::Scalar { kind, .. } => visit(place, Part::Scalar(number(kind)?))?,
            Property::List { count, item, .. } => {
                let items = list_count(number(count)?)?;
                visit(place, Part::Count(items))?;
                for _ in 0..items {
                    let value = number(item)?;
                    if wants(place) {
                        visit(place, Part::Item(value))?;
                    }
                }
            }
        }
    }
    match words.count() {
        0 => Ok(()),
        more => {
            Err(format!("{more} values more than the {} properties of the header take", properties.len()))
        }
    }
}

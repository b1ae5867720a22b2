//! Splitting records into fields.

use std::borrow::Cow;

use csv_core::{ReadRecordResult, Reader, ReaderBuilder};

/// The separator between two values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Separator {
    Semicolon,
    Tab,
    Comma,
    /// Any number of blanks and tabs.
    Blank,
}

impl Separator {
    /// In the order in which they are tried: if a line could have either of two, the one that is
    /// rarer within numbers comes first.
    pub(super) const ALL: [Self; 4] = [Self::Semicolon, Self::Tab, Self::Comma, Self::Blank];

    fn byte(self) -> Option<u8> {
        match self {
            Self::Semicolon => Some(b';'),
            Self::Tab => Some(b'\t'),
            Self::Comma => Some(b','),
            Self::Blank => None,
        }
    }
}

/// The state of splitting a record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Progress {
    Complete,
    /// A quote is open at the end of the line, so the record continues.
    QuoteOpen,
    /// There is a carriage return within a line.
    CarriageReturn,
}

/// Splits records into fields, line by line. Separators within quotes belong to the value, and a
/// doubled quote is a quote.
#[derive(Debug)]
pub(super) struct Splitter {
    /// `None` for blanks.
    parser: Option<Reader>,
    /// The values of the record, without quotes and separators if there is a `parser`.
    text: Vec<u8>,
    /// Start and end of each value in `text`.
    fields: Vec<(usize, usize)>,
    /// The number of bytes of `text` in use, and of known `ends`.
    written: usize,
    known: usize,
    ends: Vec<usize>,
}

impl Splitter {
    pub(super) fn new(separator: Separator) -> Self {
        let parser = separator.byte().map(|byte| ReaderBuilder::new().delimiter(byte).build());
        Self { parser, text: Vec::new(), fields: Vec::new(), written: 0, known: 0, ends: Vec::new() }
    }

    /// Splits a whole record at once, to try a separator; `None` if a quote is not closed.
    pub(super) fn whole(separator: Separator, record: &[u8]) -> Option<Self> {
        let mut splitter = Self::new(separator);
        (splitter.start(record) == Progress::Complete).then_some(splitter)
    }

    /// Begins a record with its first line, which has no line end.
    #[inline]
    pub(super) fn start(&mut self, line: &[u8]) -> Progress {
        self.fields.clear();
        (self.written, self.known) = (0, 0);
        if self.parser.is_some() {
            return self.go_on(line);
        }
        self.text.clear();
        self.text.extend_from_slice(line);
        self.split_blanks()
    }

    /// Continues a record whose quote is open with another line.
    pub(super) fn go_on(&mut self, line: &[u8]) -> Progress {
        let Some(parser) = &mut self.parser else { return Progress::Complete };
        // The parser writes no more than it reads. It must not be given an empty input, which would
        // mean the end of the file.
        let room = line.len() + 1;
        if self.text.len() < self.written + room {
            self.text.resize(self.written + room, 0);
        }
        if self.ends.len() < self.known + room {
            self.ends.resize(self.known + room, 0);
        }
        for mut input in [line, b"\n"] {
            while !input.is_empty() {
                let (text, ends) = (&mut self.text[self.written..], &mut self.ends[self.known..]);
                let (result, read, written, known) = parser.read_record(input, text, ends);
                input = &input[read..];
                self.written += written;
                self.known += known;
                if result == ReadRecordResult::Record {
                    if !input.is_empty() || read == line.len() && line.last() == Some(&b'\r') {
                        return Progress::CarriageReturn;
                    }
                    let mut start = 0;
                    self.fields.extend(
                        self.ends[..self.known].iter().map(|&end| (std::mem::replace(&mut start, end), end)),
                    );
                    return Progress::Complete;
                }
            }
        }
        Progress::QuoteOpen
    }

    fn split_blanks(&mut self) -> Progress {
        let (text, mut at) = (self.text.as_slice(), 0);
        while at < text.len() {
            let start = at;
            match text[at] {
                b' ' | b'\t' => {
                    at += 1;
                    continue;
                }
                b'"' => at += text[at + 1..].iter().position(|&b| b == b'"').map_or(0, |length| length + 2),
                _ => {}
            }
            while at < text.len() {
                match text[at] {
                    b' ' | b'\t' => break,
                    b'\r' => return Progress::CarriageReturn,
                    _ => at += 1,
                }
            }
            self.fields.push((start, at));
        }
        Progress::Complete
    }

    /// Number of values of the record.
    #[inline]
    pub(super) fn len(&self) -> usize {
        self.fields.len()
    }

    /// Whether the last value is empty, as it is behind a trailing separator.
    pub(super) fn ends_empty(&self) -> bool {
        self.fields.last().is_some_and(|_| self.bytes(self.len() - 1).is_empty())
    }

    /// A value, without blanks and quotes around it. Panics if `index` is out of range.
    #[inline]
    pub(super) fn bytes(&self, index: usize) -> &[u8] {
        let (start, end) = self.fields[index];
        match self.text[start..end].trim_ascii() {
            // The parser does not remove quotes that do not begin the field, for example after a
            // blank.
            [b'"', inner @ .., b'"'] => inner.trim_ascii(),
            field => field,
        }
    }

    /// A value as text; invalid UTF-8 is replaced.
    pub(super) fn field(&self, index: usize) -> Cow<'_, str> {
        String::from_utf8_lossy(self.bytes(index))
    }

    /// All values, as names: line breaks and other control characters become blanks.
    pub(super) fn names(&self) -> Vec<String> {
        (0..self.len()).map(|i| self.field(i).replace(char::is_control, " ")).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn split(separator: Separator, record: &str) -> Option<Vec<String>> {
        Splitter::whole(separator, record.as_bytes()).map(|s| s.names())
    }

    #[test]
    fn quotes_blanks_and_missing_values_are_taken_apart() {
        let fields = |separator, record| split(separator, record).expect("whole");
        assert_eq!(
            fields(Separator::Comma, r#"1, "2","a ""b"", c",,-4 ,"#),
            ["1", "2", r#"a "b", c"#, "", "-4", ""]
        );
        assert_eq!(fields(Separator::Semicolon, "1,5;\"2;5\";3"), ["1,5", "2;5", "3"]);
        assert_eq!(fields(Separator::Tab, "\t 1\t2 "), ["", "1", "2"]);
        assert_eq!(fields(Separator::Blank, " 1\t 2  \"a b\" 3\""), ["1", "2", "a b", "3\""]);
        assert_eq!(split(Separator::Comma, "1,\"2"), None);
    }

    #[test]
    fn a_record_goes_on_while_its_quote_is_open_and_ends_there() {
        let mut splitter = Splitter::new(Separator::Comma);
        for _ in 0..3 {
            assert_eq!(splitter.start(b"1,\"a"), Progress::QuoteOpen);
            assert_eq!(splitter.go_on(b""), Progress::QuoteOpen);
            assert_eq!(splitter.go_on(b"b\",2"), Progress::Complete);
            assert_eq!(splitter.names(), ["1", "a  b", "2"]);
        }
        for separator in Separator::ALL {
            let mut splitter = Splitter::new(separator);
            assert_eq!(splitter.start(b"1 2 3\r4 5 6"), Progress::CarriageReturn);
        }
    }
}

//! The literals of Python of which the header of a NPY file consists.

/// Deepest nesting. A structured type in a structured type needs a few levels.
const MOST_DEPTH: usize = 32;

/// A value. Tuples are lists.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Literal {
    Text(String),
    Number(u64),
    Bool(bool),
    List(Vec<Literal>),
    Dict(Vec<(String, Literal)>),
}

impl Literal {
    pub(super) fn get(&self, key: &str) -> Option<&Self> {
        let Self::Dict(items) = self else { return None };
        items.iter().find(|(known, _)| known == key).map(|(_, value)| value)
    }

    pub(super) fn list(&self) -> Option<&[Self]> {
        if let Self::List(items) = self { Some(items) } else { None }
    }

    pub(super) fn text(&self) -> Option<&str> {
        if let Self::Text(text) = self { Some(text) } else { None }
    }

    /// A number, or a list of numbers.
    pub(super) fn numbers(&self) -> Option<Vec<u64>> {
        let number = |item: &Self| if let Self::Number(n) = item { Some(*n) } else { None };
        match self {
            Self::List(items) => items.iter().map(number).collect(),
            item => Some(vec![number(item)?]),
        }
    }
}

/// Parses a value at the start of a text. The error has the place in the text and what was
/// expected.
pub(super) fn parse(text: &str) -> Result<Literal, (usize, &'static str)> {
    let mut parser = Parser { text: text.as_bytes(), at: 0 };
    parser.value(0).map_err(|what| (parser.at, what))
}

struct Parser<'a> {
    text: &'a [u8],
    at: usize,
}

impl Parser<'_> {
    /// The next character that is no white space, which stays.
    fn peek(&mut self) -> Option<u8> {
        while self.text.get(self.at).is_some_and(u8::is_ascii_whitespace) {
            self.at += 1;
        }
        self.text.get(self.at).copied()
    }

    fn take(&mut self, wanted: u8) -> bool {
        let found = self.peek() == Some(wanted);
        self.at += usize::from(found);
        found
    }

    fn value(&mut self, depth: usize) -> Result<Literal, &'static str> {
        if depth > MOST_DEPTH {
            return Err("values in values, more than 32 deep");
        }
        match self.peek() {
            Some(b'\'' | b'"') => self.string().map(Literal::Text),
            Some(b'0'..=b'9') => self.number().map(Literal::Number),
            Some(b'(') => self.items(b')', depth).map(Literal::List),
            Some(b'[') => self.items(b']', depth).map(Literal::List),
            Some(b'{') => self.dict(depth).map(Literal::Dict),
            _ => self.word(),
        }
    }

    fn word(&mut self) -> Result<Literal, &'static str> {
        for (word, value) in [("True", true), ("False", false)] {
            if self.text[self.at..].starts_with(word.as_bytes()) {
                self.at += word.len();
                return Ok(Literal::Bool(value));
            }
        }
        Err("expected a text, a whole number, a list, True or False")
    }

    fn number(&mut self) -> Result<u64, &'static str> {
        let mut number = 0_u64;
        while let Some(digit @ b'0'..=b'9') = self.text.get(self.at) {
            let next = number.checked_mul(10).and_then(|n| n.checked_add(u64::from(digit - b'0')));
            number = next.ok_or("a number beyond 64 bits")?;
            self.at += 1;
        }
        // Python 2 wrote long integers with this letter.
        self.at += usize::from(self.text.get(self.at) == Some(&b'L'));
        Ok(number)
    }

    fn string(&mut self) -> Result<String, &'static str> {
        let quote = self.text[self.at];
        self.at += 1;
        let mut bytes = Vec::new();
        loop {
            match self.text.get(self.at) {
                None => return Err("a text that does not end"),
                Some(&byte) if byte == quote => break,
                Some(b'\\') => {
                    self.at += 1;
                    bytes.push(*self.text.get(self.at).ok_or("a text that does not end")?);
                }
                Some(&byte) => bytes.push(byte),
            }
            self.at += 1;
        }
        self.at += 1;
        Ok(String::from_utf8_lossy(&bytes).into_owned())
    }

    fn items(&mut self, end: u8, depth: usize) -> Result<Vec<Literal>, &'static str> {
        self.at += 1;
        let mut items = Vec::new();
        while !self.take(end) {
            items.push(self.value(depth + 1)?);
            if !self.take(b',') && self.peek() != Some(end) {
                return Err("expected a comma or the end of the list");
            }
        }
        Ok(items)
    }

    fn dict(&mut self, depth: usize) -> Result<Vec<(String, Literal)>, &'static str> {
        self.at += 1;
        let mut items = Vec::new();
        while !self.take(b'}') {
            if !matches!(self.peek(), Some(b'\'' | b'"')) {
                return Err("expected a name in quotes");
            }
            let key = self.string()?;
            if !self.take(b':') {
                return Err("expected a colon");
            }
            items.push((key, self.value(depth + 1)?));
            if !self.take(b',') && self.peek() != Some(b'}') {
                return Err("expected a comma or the end of the dictionary");
            }
        }
        Ok(items)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_of_all_kinds_are_parsed_and_nonsense_is_an_error_with_its_place() {
        let header = parse(
            "{'descr': [('x', '<f4', (3,)), ((\"a\\'b\", 'y'), '|u1')], 'fortran_order': False, 'shape': (12L,), }",
        );
        let header = header.expect("a header");
        assert_eq!(header.get("shape").and_then(Literal::numbers), Some(vec![12]));
        assert_eq!(header.get("fortran_order"), Some(&Literal::Bool(false)));
        let fields = header.get("descr").and_then(Literal::list).expect("a list");
        assert_eq!(
            fields[1].list().expect("a tuple")[0].list().expect("title and name")[0].text(),
            Some("a'b")
        );
        for (text, at) in [
            ("{'a' 1}", 5),
            ("[1 2]", 3),
            ("'abc", 4),
            ("nan", 0),
            ("[99999999999999999999]", 20),
            ("{1: 2}", 1),
        ] {
            assert_eq!(parse(text).expect_err(text).0, at, "{text}");
        }
        assert!(parse(&"[".repeat(1000)).is_err());
    }
}

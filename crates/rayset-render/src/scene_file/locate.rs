//! Finds the place of a value in the text of a JSON document.

use std::collections::HashSet;

/// One step from a value to a value inside it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Step<'k> {
    Key(&'k str),
    Index(usize),
}

/// A place in a text; line and column are counted from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct TextPosition {
    pub(super) line: usize,
    pub(super) column: usize,
}

/// The part of an object's member to locate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Part {
    Key,
    Value,
}

/// The place of the value at the end of a path, or of its key, in a text that is known to be JSON.
pub(super) fn locate(text: &str, path: &[Step<'_>], part: Part) -> TextPosition {
    let mut scanner = Scanner { bytes: text.as_bytes(), at: 0, key_at: None };
    for step in path {
        scanner.key_at = None;
        let before = scanner.at;
        if !scanner.enter(step) {
            scanner.at = before;
            break;
        }
    }
    scanner.skip_space();
    place_of(text, scanner.key_at.filter(|_| part == Part::Key).unwrap_or(scanner.at))
}

/// The first key that occurs twice in one object, if any, and the place of its second occurrence.
pub(super) fn repeated_key(text: &str) -> Option<(String, TextPosition)> {
    let mut scanner = Scanner { bytes: text.as_bytes(), at: 0, key_at: None };
    let mut open: Vec<HashSet<String>> = Vec::new();
    loop {
        scanner.skip_space();
        let at = scanner.at;
        match scanner.bytes.get(at)? {
            b'{' | b'[' => open.push(HashSet::new()),
            b'}' | b']' => drop(open.pop()),
            b'"' => {
                let word = scanner.string();
                let rest = &scanner.bytes[scanner.at.min(scanner.bytes.len())..];
                if rest.trim_ascii_start().first() == Some(&b':')
                    && let Some(keys) = open.last_mut()
                {
                    if keys.contains(&word) {
                        return Some((word, place_of(text, at)));
                    }
                    keys.insert(word);
                }
                continue;
            }
            _ => {}
        }
        scanner.at += 1;
    }
}

fn place_of(text: &str, at: usize) -> TextPosition {
    let before = &text.as_bytes()[..at.min(text.len())];
    let line = before.iter().filter(|&&b| b == b'\n').count() + 1;
    let start = before.iter().rposition(|&b| b == b'\n').map_or(0, |i| i + 1);
    TextPosition { line, column: String::from_utf8_lossy(&before[start..]).chars().count() + 1 }
}

struct Scanner<'a> {
    bytes: &'a [u8],
    at: usize,
    /// Offset of the key of the value that was entered last.
    key_at: Option<usize>,
}

impl Scanner<'_> {
    fn skip_space(&mut self) {
        while self.bytes.get(self.at).is_some_and(|b| b.is_ascii_whitespace() || *b == b',' || *b == b':') {
            self.at += 1;
        }
    }

    /// Skips a string and returns its decoded contents.
    fn string(&mut self) -> String {
        let start = self.at;
        self.at += 1;
        while let Some(&b) = self.bytes.get(self.at) {
            match b {
                b'\\' => self.at += 1,
                b'"' => break,
                _ => {}
            }
            self.at += 1;
        }
        self.at = (self.at + 1).min(self.bytes.len());
        serde_json::from_slice(&self.bytes[start..self.at]).unwrap_or_default()
    }

    /// Skips a whole value.
    fn skip_value(&mut self) {
        self.skip_space();
        let mut depth = 0_usize;
        while let Some(&b) = self.bytes.get(self.at) {
            match b {
                b'"' => {
                    self.string();
                    if depth == 0 {
                        return;
                    }
                    continue;
                }
                b'{' | b'[' => depth += 1,
                b'}' | b']' if depth <= 1 => {
                    self.at += usize::from(depth == 1);
                    return;
                }
                b'}' | b']' => depth -= 1,
                b',' if depth == 0 => return,
                _ => {}
            }
            self.at += 1;
        }
    }

    /// Moves to a value inside the one that starts here; false if there is none.
    fn enter(&mut self, step: &Step<'_>) -> bool {
        self.skip_space();
        match (step, self.bytes.get(self.at)) {
            (Step::Index(index), Some(b'[')) => {
                self.at += 1;
                for _ in 0..*index {
                    self.skip_value();
                }
                true
            }
            (Step::Key(key), Some(b'{')) => {
                self.at += 1;
                loop {
                    self.skip_space();
                    if self.bytes.get(self.at) != Some(&b'"') {
                        return false;
                    }
                    let key_at = self.at;
                    if self.string() == *key {
                        self.key_at = Some(key_at);
                        return true;
                    }
                    self.skip_value();
                }
            }
            _ => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_found_where_they_stand() {
        let text = "{\n  \"a\": [1, {\"b\": \"x]\\\"\", \"c\": 2}],\n  \"d\": true\n}";
        let key = Step::Key;
        let at = |path: &[Step<'_>]| {
            let TextPosition { line, column } = locate(text, path, Part::Value);
            (line, column)
        };
        assert_eq!(at(&[]), (1, 1));
        assert_eq!(at(&[key("a"), Step::Index(0)]), (2, 9));
        assert_eq!(at(&[key("a"), Step::Index(1), key("c")]), (2, 31));
        assert_eq!(at(&[key("d")]), (3, 8));
        assert_eq!(locate(text, &[key("d")], Part::Key), TextPosition { line: 3, column: 3 });
        assert_eq!(repeated_key("{\"a\": {\"b\": 1}, \"b\": [\"a\", \"a\"]}"), None);
        let (key, place) = repeated_key("{\"a\": 1,\n \"a\": 2}").expect("it stands twice");
        assert_eq!((key.as_str(), place), ("a", TextPosition { line: 2, column: 2 }));
        let (key, place) =
            repeated_key("{\"a\" : 1,\"\\u0061\" :2}").expect("it stands twice, once in disguise");
        assert_eq!((key.as_str(), place), ("a", TextPosition { line: 1, column: 10 }));
    }
}

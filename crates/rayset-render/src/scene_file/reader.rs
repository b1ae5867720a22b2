//! Strict reading of JSON documents: every value is requested with a type, every key has to be
//! known, and every error says where it occurred and what was expected.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use super::SceneFileError;
use super::json::{Json, Member};
use super::locate::{Part, Step, locate, repeated_key};
use crate::field::linear_from_srgb;
use crate::scene::{BRIGHTEST, FARTHEST, SHORTEST};
use rayset_base::geometry::DVec3;
use rayset_store::storage::beside;

/// A document: its text, in which errors are located, and the file it was read from.
pub(super) struct Document<'a> {
    pub(super) file: &'a Path,
    pub(super) text: &'a str,
    /// Paths of all files that the document refers to.
    pub(super) named: RefCell<BTreeSet<PathBuf>>,
}

impl<'a> Document<'a> {
    /// The path of a file that the document refers to, relative to the folder of the document.
    pub(super) fn beside(&self, name: &str) -> PathBuf {
        let path =
            self.file.parent().map_or_else(|| PathBuf::from(name), |folder| beside(folder, Path::new(name)));
        self.named.borrow_mut().insert(path.clone());
        path
    }

    /// Parses the text.
    pub(super) fn parse(&self) -> Result<Json<'a>, SceneFileError> {
        let value = Json::parse(self.text).map_err(|e| {
            // The parser's message ends with the place, which the error reports separately.
            let what = e.to_string();
            let what = what.split(" at line ").next().unwrap_or_default();
            let what = what.replace("EOF while parsing", "the text ends in the middle of");
            let what = match what.as_str() {
                "recursion limit exceeded" => "lists and objects are nested more than 127 deep".to_owned(),
                // The reader's own error: the text is JSON, but has too many values.
                _ if e.is_data() => what,
                _ => format!("this is not JSON: {what}"),
            };
            self.error_at(e.line().max(1), e.column().max(1), String::new(), what)
        })?;
        if let Some((key, place)) = repeated_key(self.text) {
            let what = "this key stands twice in one object; only one can count".to_owned();
            return Err(self.error_at(place.line, place.column, key, what));
        }
        Ok(value)
    }

    fn error_at(&self, line: usize, column: usize, key: String, what: String) -> SceneFileError {
        SceneFileError { file: self.file.to_owned(), line, column, key, what }
    }
}

/// A value and its path in the document.
#[derive(Clone)]
pub(super) struct Cursor<'a> {
    pub(super) document: &'a Document<'a>,
    pub(super) value: &'a Json<'a>,
    /// The last step of the path, linked to those before it; `None` at the root.
    way: Option<Rc<Way<'a>>>,
}

/// The path from the root of a document to a value in it. Values inside one list or object share
/// all but the last step.
struct Way<'a> {
    before: Option<Rc<Self>>,
    step: Step<'a>,
}

/// An object, with its members.
#[derive(Clone)]
pub(super) struct Object<'a> {
    pub(super) cursor: Cursor<'a>,
    members: &'a [Member<'a>],
}

impl<'a> Cursor<'a> {
    pub(super) fn root(document: &'a Document<'a>, value: &'a Json<'a>) -> Self {
        Self { document, value, way: None }
    }

    /// An error at this value.
    pub(super) fn error(&self, what: impl Into<String>) -> SceneFileError {
        self.error_of(Part::Value, what)
    }

    fn error_of(&self, part: Part, what: impl Into<String>) -> SceneFileError {
        let place = locate(self.document.text, &self.steps(), part);
        self.document.error_at(place.line, place.column, self.name(), what.into())
    }

    /// An error at this value that says what was expected and what was found.
    pub(super) fn expected(&self, what: &str) -> SceneFileError {
        let found = self.value;
        self.error(format!("expected {what}, found {found}"))
    }

    /// The steps from the root to the value.
    fn steps(&self) -> Vec<Step<'a>> {
        let steps = std::iter::successors(self.way.as_ref(), |way| way.before.as_ref()).map(|way| way.step);
        let mut steps: Vec<_> = steps.collect();
        steps.reverse();
        steps
    }

    /// The path to the value in the notation of error messages.
    fn name(&self) -> String {
        let mut name = String::new();
        for step in self.steps() {
            match step {
                Step::Key(key) => {
                    let dot = if name.is_empty() { "" } else { "." };
                    name.extend([dot, shortened(key)]);
                }
                Step::Index(index) => name = format!("{name}[{index}]"),
            }
        }
        name
    }

    fn inner(&self, value: &'a Json<'a>, step: Step<'a>) -> Self {
        let way = Rc::new(Way { before: self.way.clone(), step });
        Self { document: self.document, value, way: Some(way) }
    }

    /// An object, all of whose keys are among `known`.
    pub(super) fn object(&self, known: &[&str]) -> Result<Object<'a>, SceneFileError> {
        let object = self.any_object()?;
        for (key, value) in object.members {
            if !known.contains(&&**key) {
                let nearest = nearest(key, known);
                let hint = nearest.map_or_else(
                    || format!("expected one of {}", known.join(", ")),
                    |nearest| format!("did you mean \"{nearest}\"?"),
                );
                let unknown = self.inner(value, Step::Key(key));
                return Err(unknown.error_of(Part::Key, format!("unknown key; {hint}")));
            }
        }
        Ok(object)
    }

    /// An object whose keys are checked later.
    pub(super) fn any_object(&self) -> Result<Object<'a>, SceneFileError> {
        match self.value {
            Json::Object(members) => Ok(Object { cursor: self.clone(), members }),
            _ => Err(self.expected("an object")),
        }
    }

    /// The items of a list of at most `most` items.
    pub(super) fn list(&self, most: usize) -> Result<Vec<Self>, SceneFileError> {
        match self.value {
            Json::List(items) if items.len() > most => {
                Err(self.error(format!("a list of {}; at most {most} are read here", items.len())))
            }
            Json::List(items) => {
                Ok(items.iter().enumerate().map(|(i, item)| self.inner(item, Step::Index(i))).collect())
            }
            _ => Err(self.expected("a list")),
        }
    }

    pub(super) fn text(&self) -> Result<&'a str, SceneFileError> {
        self.value.as_str().ok_or_else(|| self.expected("text"))
    }

    pub(super) fn boolean(&self) -> Result<bool, SceneFileError> {
        self.value.as_bool().ok_or_else(|| self.expected("true or false"))
    }

    /// A number in a range, with both ends included.
    pub(super) fn number(&self, least: f64, most: f64) -> Result<f64, SceneFileError> {
        let fits = |v: &f64| (least..=most).contains(v);
        self.value.as_f64().filter(fits).ok_or_else(|| {
            let plain = |v: f64| {
                if (1e-4..1e6).contains(&v.abs()) || v == 0.0 { v.to_string() } else { format!("{v:e}") }
            };
            self.expected(&format!("a number from {} to {}", plain(least), plain(most)))
        })
    }

    /// A coordinate, or any other number of either sign.
    pub(super) fn any_number(&self) -> Result<f64, SceneFileError> {
        self.number(-FARTHEST, FARTHEST)
    }

    /// A length.
    pub(super) fn positive(&self) -> Result<f64, SceneFileError> {
        self.number(SHORTEST, FARTHEST)
    }

    /// A whole number in a range, with both ends included.
    pub(super) fn whole(&self, least: u32, most: u32) -> Result<u32, SceneFileError> {
        let whole = self.value.as_u64().and_then(|v| u32::try_from(v).ok());
        whole
            .filter(|v| (least..=most).contains(v))
            .ok_or_else(|| self.expected(&format!("a whole number from {least} to {most}")))
    }

    pub(super) fn numbers<const N: usize>(&self) -> Result<[f64; N], SceneFileError> {
        let items = match self.value {
            Json::List(items) if items.len() == N => self.list(N)?,
            _ => return Err(self.expected(&format!("a list of {N} numbers"))),
        };
        let mut numbers = [0.0; N];
        for (number, item) in numbers.iter_mut().zip(&items) {
            *number = item.any_number()?;
        }
        Ok(numbers)
    }

    pub(super) fn vector(&self) -> Result<DVec3, SceneFileError> {
        self.numbers::<3>().map(DVec3::from_array)
    }

    /// A vector that is long enough to define a direction.
    pub(super) fn direction(&self) -> Result<DVec3, SceneFileError> {
        let vector = self.vector()?;
        let length = vector.length();
        if length >= SHORTEST {
            Ok(vector)
        } else {
            let found = Json::Number(length);
            Err(self.error(format!(
                "expected a direction, at least {SHORTEST:e} long; found a vector of length {found}"
            )))
        }
    }

    /// A colour: `"#c8b090"`, display-encoded (sRGB), or three numbers of linear light.
    pub(super) fn color(&self) -> Result<[f64; 3], SceneFileError> {
        const EXPECTED: &str = "a colour like \"#c8b090\" or [0.5, 0.4, 0.3] (linear light)";
        match self.value {
            Json::Text(text) => {
                let hex = text.strip_prefix('#').filter(|hex| hex.len() == 6 && hex.is_ascii());
                let value = hex.and_then(|hex| u32::from_str_radix(hex, 16).ok());
                let value = value.ok_or_else(|| self.expected(EXPECTED))?;
                Ok([16, 8, 0].map(|shift| linear_from_srgb(f64::from(value >> shift & 255) / 255.0)))
            }
            Json::List(items) if items.len() == 3 => {
                let mut color = [0.0; 3];
                for (channel, item) in color.iter_mut().zip(self.list(3)?) {
                    *channel = item.number(0.0, BRIGHTEST)?;
                }
                Ok(color)
            }
            _ => Err(self.expected(EXPECTED)),
        }
    }

    /// One of the given words.
    pub(super) fn one_of<T: Copy>(&self, words: &[(&str, T)]) -> Result<T, SceneFileError> {
        let names: Vec<&str> = words.iter().map(|(name, _)| *name).collect();
        let found = self.value.as_str().and_then(|text| words.iter().find(|(name, _)| *name == text));
        found.map(|&(_, value)| value).ok_or_else(|| {
            let close = self.value.as_str().and_then(|text| nearest(text, &names));
            let hint = close.map_or_else(String::new, |n| format!("; did you mean \"{n}\"?"));
            let mut error = self.expected(&format!("one of {}", names.join(", ")));
            error.what.push_str(&hint);
            error
        })
    }
}

impl<'a> Object<'a> {
    pub(super) fn get(&self, key: &str) -> Option<Cursor<'a>> {
        let (name, value) = self.members.iter().find(|(name, _)| name == key)?;
        Some(self.cursor.inner(value, Step::Key(name)))
    }

    pub(super) fn require(&self, key: &str) -> Result<Cursor<'a>, SceneFileError> {
        self.get(key).ok_or_else(|| self.cursor.error(format!("\"{key}\" is missing")))
    }

    pub(super) fn entries(&self) -> impl Iterator<Item = (&'a str, Cursor<'a>)> {
        self.members.iter().map(|(key, value)| (&**key, self.cursor.inner(value, Step::Key(key))))
    }

    /// The value of a key, converted by `read`, or `default` if the key is missing.
    pub(super) fn read_or<T>(
        &self,
        key: &str,
        default: T,
        read: impl FnOnce(&Cursor<'a>) -> Result<T, SceneFileError>,
    ) -> Result<T, SceneFileError> {
        self.get(key).map_or(Ok(default), |cursor| read(&cursor))
    }
}

/// The known word that is closest to `word`, if any is close enough.
pub(super) fn nearest<'w>(word: &str, known: &[&'w str]) -> Option<&'w str> {
    /// Longer words are hardly typing errors, and comparing words takes time quadratic in their
    /// length.
    const LONGEST: usize = 64;
    if word.len() > LONGEST {
        return None;
    }
    let close = known
        .iter()
        .filter(|k| k.len() <= LONGEST)
        .map(|k| (edits(&word.to_lowercase(), &k.to_lowercase()), *k))
        .min()?;
    (close.0 <= 1 + word.len() / 3).then_some(close.1)
}

/// A name as messages show it: truncated if it is too long.
pub(super) fn shortened(name: &str) -> &str {
    let end = name.char_indices().nth(60).map_or(name.len(), |(at, _)| at);
    &name[..end]
}

/// A list of words for messages, of which only the first are shown if there are many.
pub(super) fn listed(words: &[&str]) -> String {
    const MOST: usize = 24;
    let some: Vec<&str> = words.iter().take(MOST).map(|word| shortened(word)).collect();
    let more = if words.len() > MOST { format!(" and {} more", words.len() - MOST) } else { String::new() };
    format!("{}{more}", some.join(", "))
}

/// Levenshtein distance (1966): the number of letters to insert, delete or replace to turn one word
/// into the other.
fn edits(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, &y) in b.iter().enumerate() {
            let exchanged = diagonal + usize::from(x != y);
            diagonal = row[j + 1];
            row[j + 1] = exchanged.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[b.len()]
}

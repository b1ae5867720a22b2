//! A JSON document in little memory: strings borrow from the text if possible, lists and objects
//! have no spare capacity, and the number of values is limited.

use std::borrow::Cow;
use std::cell::Cell;
use std::fmt;

use serde::de::{DeserializeSeed, Deserializer, Error, MapAccess, SeqAccess, Visitor};

/// Most values that a document may contain, nested values included.
pub(super) const MOST_VALUES: usize = 1 << 19;

/// A value.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Json<'t> {
    Null,
    Bool(bool),
    /// A number without sign, decimal point or exponent.
    Whole(u64),
    /// Any other number.
    Number(f64),
    Text(Cow<'t, str>),
    List(Box<[Json<'t>]>),
    /// Members in the order in which they appear in the text.
    Object(Box<[Member<'t>]>),
}

/// A member of an object: its key and its value.
pub(super) type Member<'t> = (Cow<'t, str>, Json<'t>);

const _: () = assert!(size_of::<Json<'_>>() == 24, "a value is small");

impl<'t> Json<'t> {
    /// Parses a text that consists of one JSON value.
    pub(super) fn parse(text: &'t str) -> Result<Self, serde_json::Error> {
        let mut reader = serde_json::Deserializer::from_str(text);
        let left = Cell::new(MOST_VALUES);
        let value = OneValue(&left).deserialize(&mut reader)?;
        reader.end()?;
        Ok(value)
    }

    pub(super) fn as_f64(&self) -> Option<f64> {
        match *self {
            Self::Whole(n) => Some(n as f64),
            Self::Number(n) => Some(n),
            _ => None,
        }
    }

    pub(super) fn as_u64(&self) -> Option<u64> {
        if let Self::Whole(n) = *self { Some(n) } else { None }
    }

    pub(super) fn as_bool(&self) -> Option<bool> {
        if let Self::Bool(b) = *self { Some(b) } else { None }
    }

    pub(super) fn as_str(&self) -> Option<&str> {
        if let Self::Text(text) = self { Some(text) } else { None }
    }

    pub(super) fn as_list(&self) -> Option<&[Self]> {
        if let Self::List(items) = self { Some(items) } else { None }
    }

    /// The value of a key of an object.
    pub(super) fn get(&self, key: &str) -> Option<&Self> {
        let Self::Object(members) = self else { return None };
        members.iter().find(|(name, _)| name == key).map(|(_, value)| value)
    }

    pub(super) fn is_number(&self) -> bool {
        matches!(self, Self::Whole(_) | Self::Number(_))
    }

    pub(super) fn is_list(&self) -> bool {
        matches!(self, Self::List(_))
    }

    pub(super) fn is_object(&self) -> bool {
        matches!(self, Self::Object(_))
    }

    /// Memory of the value and everything inside it in bytes, including the overhead of
    /// allocations.
    pub(super) fn bytes(&self) -> u64 {
        /// Overhead of an allocation in bytes.
        const BLOCK: u64 = 16;
        let owned =
            |text: &Cow<'_, str>| if let Cow::Owned(text) = text { text.len() as u64 + BLOCK } else { 0 };
        size_of::<Self>() as u64
            + match self {
                Self::Text(text) => owned(text),
                Self::List(items) => BLOCK + items.iter().map(Self::bytes).sum::<u64>(),
                Self::Object(members) => {
                    let key = size_of::<Cow<'_, str>>() as u64;
                    BLOCK + members.iter().map(|(name, value)| key + owned(name) + value.bytes()).sum::<u64>()
                }
                _ => 0,
            }
    }

    /// Upper bound of the cursors that exist at a time while the document is read: the members of
    /// all lists and objects on the way from the root to a value, for the value for which they are
    /// most.
    pub(super) fn widest_way(&self) -> u64 {
        let below = |count: usize, inner: u64| count as u64 + inner;
        match self {
            Self::List(items) => below(items.len(), items.iter().map(Self::widest_way).max().unwrap_or(0)),
            Self::Object(members) => {
                below(members.len(), members.iter().map(|(_, value)| value.widest_way()).max().unwrap_or(0))
            }
            _ => 1,
        }
    }
}

impl fmt::Display for Json<'_> {
    /// A short description for error messages, however long the value is.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        /// Longest string that is repeated in full, in bytes.
        const LONGEST: usize = 60;
        match self {
            Self::Null => f.write_str("null"),
            Self::Bool(b) => write!(f, "{b}"),
            Self::Whole(n) => write!(f, "{n}"),
            Self::Number(n) if *n == n.trunc() && n.abs() < 1e15 => write!(f, "{n}"),
            Self::Number(n) => write!(f, "{n:?}"),
            Self::Text(text) if text.len() <= LONGEST => write!(f, "{text:?}"),
            Self::Text(text) => {
                let start: String = text.chars().take(LONGEST / 2).collect();
                write!(f, "{start:?}… ({} bytes of text)", text.len())
            }
            Self::List(items) => write!(f, "a list of {}", items.len()),
            Self::Object(_) => f.write_str("an object"),
        }
    }
}

/// Deserialises one value and counts it against the limit.
struct OneValue<'c>(&'c Cell<usize>);

impl<'t> DeserializeSeed<'t> for OneValue<'_> {
    type Value = Json<'t>;

    fn deserialize<D: Deserializer<'t>>(self, deserializer: D) -> Result<Json<'t>, D::Error> {
        let left = self.0.get();
        if left == 0 {
            return Err(D::Error::custom(format_args!(
                "more than {MOST_VALUES} values; points and voxels belong into files of their own"
            )));
        }
        self.0.set(left - 1);
        deserializer.deserialize_any(self)
    }
}

/// A key, borrowed from the text if it is written without escapes.
struct Key;

impl<'t> DeserializeSeed<'t> for Key {
    type Value = Cow<'t, str>;

    fn deserialize<D: Deserializer<'t>>(self, deserializer: D) -> Result<Cow<'t, str>, D::Error> {
        deserializer.deserialize_str(self)
    }
}

impl<'t> Visitor<'t> for Key {
    type Value = Cow<'t, str>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a key")
    }

    fn visit_borrowed_str<E: Error>(self, text: &'t str) -> Result<Cow<'t, str>, E> {
        Ok(Cow::Borrowed(text))
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<Cow<'t, str>, E> {
        Ok(Cow::Owned(text.to_owned()))
    }
}

impl<'t> Visitor<'t> for OneValue<'_> {
    type Value = Json<'t>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a JSON value")
    }

    fn visit_unit<E: Error>(self) -> Result<Json<'t>, E> {
        Ok(Json::Null)
    }

    fn visit_bool<E: Error>(self, value: bool) -> Result<Json<'t>, E> {
        Ok(Json::Bool(value))
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<Json<'t>, E> {
        Ok(Json::Whole(value))
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<Json<'t>, E> {
        Ok(Json::Number(value as f64))
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<Json<'t>, E> {
        Ok(Json::Number(value))
    }

    fn visit_borrowed_str<E: Error>(self, text: &'t str) -> Result<Json<'t>, E> {
        Ok(Json::Text(Cow::Borrowed(text)))
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<Json<'t>, E> {
        Ok(Json::Text(Cow::Owned(text.to_owned())))
    }

    fn visit_seq<A: SeqAccess<'t>>(self, mut items: A) -> Result<Json<'t>, A::Error> {
        let mut list = Vec::new();
        while let Some(item) = items.next_element_seed(OneValue(self.0))? {
            list.push(item);
        }
        Ok(Json::List(list.into_boxed_slice()))
    }

    fn visit_map<A: MapAccess<'t>>(self, mut members: A) -> Result<Json<'t>, A::Error> {
        let mut object = Vec::new();
        while let Some(key) = members.next_key_seed(Key)? {
            object.push((key, members.next_value_seed(OneValue(self.0))?));
        }
        Ok(Json::Object(object.into_boxed_slice()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_what_the_text_says_and_their_number_is_bounded() {
        let text = r#"{"a": [1, -2, 0.5, true, null], "b\n": "c"}"#;
        let value = Json::parse(text).expect("JSON");
        let list = value.get("a").and_then(Json::as_list).expect("a list");
        assert_eq!(list[0].as_u64(), Some(1));
        assert_eq!((list[1].as_f64(), list[1].as_u64()), (Some(-2.0), None));
        assert_eq!(list[2].to_string(), "0.5");
        assert_eq!((list[3].as_bool(), &list[4]), (Some(true), &Json::Null));
        assert_eq!(value.get("b\n").and_then(Json::as_str), Some("c"));
        assert_eq!(value.widest_way(), 2 + 5 + 1);
        assert!(Json::parse("[1] 2").is_err() && Json::parse("[1, 1e999]").is_err());
        let list = |count: usize| format!("[{}]", vec!["0"; count].join(","));
        assert!(Json::parse(&list(MOST_VALUES - 1)).is_ok());
        assert!(Json::parse(&list(MOST_VALUES)).is_err());
    }
}

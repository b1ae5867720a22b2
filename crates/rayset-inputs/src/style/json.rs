//! Styles as JSON: an object with a key for each option that was given.

use serde::de::Error as _;
use serde::ser::SerializeMap;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::{Map, Value};

use super::error::StyleError;
use super::spelling::Spelling;
use super::table::{OPTIONS, Style, StyleOption};

impl Style {
    /// Reads an object whose keys are names of options; `null` and `false` are options that were not given.
    ///
    /// # Errors
    /// What is unknown or wrong, by its key.
    pub fn from_object(object: &Map<String, Value>, spelling: Spelling) -> Result<Self, StyleError> {
        let mut style = Self::default();
        for (key, value) in object {
            let wrong = |what: String| StyleError { option: key.clone(), what };
            let option = spelling.option(key).ok_or_else(|| {
                let names: Vec<_> = OPTIONS.iter().map(|option| spelling.of(option.name())).collect();
                wrong(format!("there is no such option; there are {}", names.join(", ")))
            })?;
            if !value.is_null() && value != &Value::Bool(false) {
                option.read(value).map_err(wrong)?.make(&mut style);
            }
        }
        style.check(spelling)?;
        Ok(style)
    }
}

impl Serialize for Style {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        for option in OPTIONS {
            if let Some(value) = option.json(self) {
                map.serialize_entry(&Spelling::Camel.of(StyleOption::name(option)), &value)?;
            }
        }
        map.end()
    }
}

impl<'de> Deserialize<'de> for Style {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let object = Map::deserialize(deserializer)?;
        Self::from_object(&object, Spelling::Camel).map_err(D::Error::custom)
    }
}

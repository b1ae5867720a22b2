//! Styles as JSON: an object with one key per option that is set.

use serde::de::Error as _;
use serde::ser::SerializeMap;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::{Map, Value};

use super::error::StyleError;
use super::spelling::Spelling;
use super::table::{OPTIONS, Style};

impl Style {
    /// Reads an object whose keys are option names. `null` and `false` leave an option unset.
    ///
    /// # Errors
    /// The first unknown key, invalid value or broken rule.
    pub fn from_object(object: &Map<String, Value>, spelling: Spelling) -> Result<Self, StyleError> {
        let mut style = Self::default();
        for (key, value) in object {
            let wrong = |what: String| StyleError { option: key.clone(), what };
            let option = spelling.option(key).ok_or_else(|| {
                let names: Vec<_> = OPTIONS.iter().map(|option| spelling.of(option.name)).collect();
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
                map.serialize_entry(&Spelling::Camel.of(option.name), &value)?;
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

//! Kinds of option values: each reads a value from text or JSON, and writes it back.

use std::fmt::Display;
use std::str::FromStr;

use rayset::ParseError;
use rayset::scene::{FARTHEST, Lod, OpacityRule, SHORTEST, Samples};
use serde_json::{Value, json};

use super::values::{Background, Choice, Flag, Rgb, StepLength, ValueRange, Words};
use crate::values;

/// Reads and writes the value of an option.
pub(crate) trait Kind<T> {
    /// Reads a value from a command line.
    fn parse(&self, text: &str) -> Result<T, String>;

    /// Writes a value as on a command line; `parse` reads it back unchanged.
    fn text(&self, value: &T) -> String;

    /// Reads a value from JSON. A string is read like text on a command line.
    fn read(&self, json: &Value) -> Result<T, String> {
        match json.as_str() {
            Some(text) => self.parse(text),
            None => Err(format!("expected a text, and got {json}")),
        }
    }

    /// Writes a value as JSON; `read` reads it back unchanged.
    fn json(&self, value: &T) -> Value {
        self.text(value).into()
    }

    /// The permitted words; empty if the value is not one of a few words.
    fn choices(&self) -> Vec<Choice> {
        Vec::new()
    }

    /// Whether a value may begin with `-`.
    fn is_signed(&self) -> bool {
        false
    }

    /// Whether the option takes no value.
    fn is_flag(&self) -> bool {
        false
    }

    /// Whether the option may be given more than once.
    fn is_list(&self) -> bool {
        false
    }

    /// The value of an option that is given again.
    fn joined(&self, _before: Option<&T>, value: &T) -> T
    where
        T: Clone,
    {
        value.clone()
    }
}

/// One of a few words.
pub(crate) struct Word;

impl<T: Words> Kind<T> for Word {
    fn parse(&self, text: &str) -> Result<T, String> {
        let found = T::ALL.iter().find(|(_, choice)| choice.word == text).map(|(value, _)| *value);
        found.ok_or_else(|| {
            let words: Vec<&str> = T::ALL.iter().map(|(_, choice)| choice.word).collect();
            format!("`{text}` is none of {}", words.join(", "))
        })
    }

    fn text(&self, value: &T) -> String {
        value.word().to_owned()
    }

    fn choices(&self) -> Vec<Choice> {
        T::ALL.iter().map(|(_, choice)| *choice).collect()
    }
}

/// A value that the library parses from its name.
pub(crate) struct Named;

impl<T: FromStr<Err = ParseError> + Display> Kind<T> for Named {
    fn parse(&self, text: &str) -> Result<T, String> {
        text.parse().map_err(|error: ParseError| error.to_string())
    }

    fn text(&self, value: &T) -> String {
        value.to_string()
    }
}

/// A flag: set or unset.
pub(crate) struct Switch;

impl Kind<Flag> for Switch {
    fn parse(&self, _: &str) -> Result<Flag, String> {
        Ok(Flag)
    }

    fn text(&self, _: &Flag) -> String {
        String::new()
    }

    fn read(&self, json: &Value) -> Result<Flag, String> {
        // The caller has handled `false` already.
        if json == &json!(true) { Ok(Flag) } else { Err(format!("expected true or false, and got {json}")) }
    }

    fn json(&self, _: &Flag) -> Value {
        json!(true)
    }

    fn is_flag(&self) -> bool {
        true
    }
}

/// A number from the first to the second, both included.
pub(crate) struct Number(pub(crate) f64, pub(crate) f64);

/// A factor.
pub(crate) const POSITIVE: Number = Number(f64::MIN_POSITIVE, f64::MAX);

/// A length.
pub(crate) const LENGTH: Number = Number(SHORTEST, FARTHEST);

impl Kind<f64> for Number {
    fn parse(&self, text: &str) -> Result<f64, String> {
        values::number_within(text, self.0, self.1)
    }

    fn text(&self, value: &f64) -> String {
        value.to_string()
    }

    fn read(&self, json: &Value) -> Result<f64, String> {
        self.parse(&number_text(json)?)
    }

    fn json(&self, value: &f64) -> Value {
        json!(value)
    }

    fn is_signed(&self) -> bool {
        self.0 < 0.0
    }
}

/// A whole number from the first to the second, both included.
pub(crate) struct Whole(pub(crate) u32, pub(crate) u32);

impl Kind<u32> for Whole {
    fn parse(&self, text: &str) -> Result<u32, String> {
        let number = text.trim().parse().ok().filter(|v| (self.0..=self.1).contains(v));
        number.ok_or_else(|| format!("`{text}` is not a whole number from {} to {}", self.0, self.1))
    }

    fn text(&self, value: &u32) -> String {
        value.to_string()
    }

    fn read(&self, json: &Value) -> Result<u32, String> {
        self.parse(&number_text(json)?)
    }

    fn json(&self, value: &u32) -> Value {
        json!(value)
    }
}

/// Rays of a pixel: a number along each side, 1 to 64, or `auto`.
pub(crate) struct Rays;

impl Kind<Samples> for Rays {
    fn parse(&self, text: &str) -> Result<Samples, String> {
        if text.trim() == "auto" {
            return Ok(Samples::Auto { exposure: 0.0 });
        }
        let number = Whole(1, 64).parse(text).map_err(|expected| format!("{expected}, nor `auto`"))?;
        Ok(Samples::Fixed(number))
    }

    fn text(&self, value: &Samples) -> String {
        match value {
            Samples::Fixed(number) => number.to_string(),
            _ => "auto".to_owned(),
        }
    }

    fn read(&self, json: &Value) -> Result<Samples, String> {
        self.parse(&number_text(json)?)
    }

    fn json(&self, value: &Samples) -> Value {
        match value {
            Samples::Fixed(number) => json!(number),
            _ => json!("auto"),
        }
    }
}

/// Level of detail: `off`, `auto`, `coarse`, or a factor on the width of pixels.
pub(crate) struct Detail;

impl Kind<Lod> for Detail {
    fn parse(&self, text: &str) -> Result<Lod, String> {
        let known = match text.trim() {
            "off" => Some(Lod::Off),
            "auto" => Some(Lod::AUTO),
            "coarse" => Some(Lod::COARSE),
            number => number.parse().ok().and_then(Lod::footprint),
        };
        known.ok_or_else(|| format!("`{text}` is not off, auto, coarse or a number from 0.0625 to 64"))
    }

    fn text(&self, value: &Lod) -> String {
        match value {
            Lod::Footprint(factor) if *value != Lod::AUTO => factor.to_string(),
            Lod::Footprint(_) => "auto".to_owned(),
            Lod::Coarse(_) => "coarse".to_owned(),
            _ => "off".to_owned(),
        }
    }

    fn read(&self, json: &Value) -> Result<Lod, String> {
        self.parse(&number_text(json)?)
    }

    fn json(&self, value: &Lod) -> Value {
        match value {
            Lod::Footprint(factor) if *value != Lod::AUTO => json!(factor),
            _ => json!(self.text(value)),
        }
    }
}

/// A number of JSON, or a text, as a text.
fn number_text(json: &Value) -> Result<String, String> {
    match json {
        Value::Number(number) => Ok(number.to_string()),
        Value::String(text) => Ok(text.clone()),
        _ => Err(format!("expected a number, and got {json}")),
    }
}

/// A few numbers of JSON.
fn numbers<const N: usize>(json: &Value) -> Option<[f64; N]> {
    let numbers: Option<Vec<f64>> = json.as_array()?.iter().map(Value::as_f64).collect();
    numbers?.try_into().ok()
}

/// Three numbers, as a JSON array or as `1,0,-2.5`. The function parses and validates the text.
pub(crate) struct Vector(pub(crate) fn(&str) -> Result<[f64; 3], String>);

impl Kind<[f64; 3]> for Vector {
    fn parse(&self, text: &str) -> Result<[f64; 3], String> {
        (self.0)(text)
    }

    fn text(&self, [x, y, z]: &[f64; 3]) -> String {
        format!("{x},{y},{z}")
    }

    fn read(&self, json: &Value) -> Result<[f64; 3], String> {
        match (json.as_str(), numbers(json)) {
            (Some(text), _) => self.parse(text),
            (None, Some(numbers)) => self.parse(&self.text(&numbers)),
            _ => Err(format!("expected three numbers, and got {json}")),
        }
    }

    fn json(&self, value: &[f64; 3]) -> Value {
        json!(value)
    }

    fn is_signed(&self) -> bool {
        true
    }
}

/// A whole number.
pub(crate) struct Count;

impl Kind<u64> for Count {
    fn parse(&self, text: &str) -> Result<u64, String> {
        text.trim().parse().map_err(|_| format!("`{text}` is not a whole number"))
    }

    fn text(&self, value: &u64) -> String {
        value.to_string()
    }

    fn read(&self, json: &Value) -> Result<u64, String> {
        self.parse(&number_text(json)?)
    }

    fn json(&self, value: &u64) -> Value {
        json!(value)
    }
}

/// Names, separated by commas; or a list of them in JSON. Given more than once, a list goes on.
pub(crate) struct List {
    /// Whether `-` stands for a name.
    pub(crate) dashes: bool,
}

impl Kind<Vec<String>> for List {
    fn parse(&self, text: &str) -> Result<Vec<String>, String> {
        Ok(text.split(',').map(str::to_owned).collect())
    }

    fn text(&self, value: &Vec<String>) -> String {
        value.join(",")
    }

    fn read(&self, json: &Value) -> Result<Vec<String>, String> {
        let names = |list: &Vec<Value>| list.iter().map(|name| Some(name.as_str()?.to_owned())).collect();
        match (json.as_str(), json.as_array().and_then(names)) {
            (Some(text), _) => self.parse(text),
            (None, Some(names)) => Ok(names),
            _ => Err(format!("expected names, and got {json}")),
        }
    }

    fn json(&self, value: &Vec<String>) -> Value {
        json!(value)
    }

    fn is_signed(&self) -> bool {
        self.dashes
    }

    fn joined(&self, before: Option<&Vec<String>>, value: &Vec<String>) -> Vec<String> {
        before.into_iter().flatten().chain(value).cloned().collect()
    }

    fn is_list(&self) -> bool {
        true
    }
}

/// Any text.
pub(crate) struct Text;

/// A text that means something: the function says what is wrong with it.
pub(crate) struct Checked(pub(crate) fn(&str) -> Result<(), String>);

impl Kind<String> for Checked {
    fn parse(&self, text: &str) -> Result<String, String> {
        (self.0)(text).map(|()| text.to_owned())
    }

    fn text(&self, value: &String) -> String {
        value.clone()
    }
}

impl Kind<String> for Text {
    fn parse(&self, text: &str) -> Result<String, String> {
        Ok(text.to_owned())
    }

    fn text(&self, value: &String) -> String {
        value.clone()
    }
}

/// The ends of a colour map: `0:10`, `1%:99%`, or two numbers in JSON.
pub(crate) struct Range;

impl Kind<ValueRange> for Range {
    fn parse(&self, text: &str) -> Result<ValueRange, String> {
        ValueRange::parse(text)
    }

    fn text(&self, value: &ValueRange) -> String {
        value.to_string()
    }

    fn read(&self, json: &Value) -> Result<ValueRange, String> {
        match (json.as_str(), numbers(json)) {
            (Some(text), _) => self.parse(text),
            (None, Some([low, high])) => self.parse(&format!("{low}:{high}")),
            _ => Err(format!("expected two numbers, or a range like 1%:99%, and got {json}")),
        }
    }

    fn json(&self, value: &ValueRange) -> Value {
        value.numbers().map_or_else(|| self.text(value).into(), |numbers| json!(numbers))
    }

    fn is_signed(&self) -> bool {
        true
    }
}

/// An opacity rule. JSON may also have a number, which is the extinction, or the points of a curve.
pub(crate) struct Opacity;

impl Kind<OpacityRule> for Opacity {
    fn parse(&self, text: &str) -> Result<OpacityRule, String> {
        values::opacity(text).map_err(|error| format!("{error:#}"))
    }

    fn text(&self, value: &OpacityRule) -> String {
        match value {
            OpacityRule::Extinction(kappa) => format!("extinction:{kappa}"),
            OpacityRule::Curve(points) => {
                points.iter().map(|(x, y)| format!("{x}:{y}")).collect::<Vec<_>>().join(",")
            }
            _ => "clamp".to_owned(),
        }
    }

    fn read(&self, json: &Value) -> Result<OpacityRule, String> {
        let curve = || {
            let points: Option<Vec<[f64; 2]>> = json.as_array()?.iter().map(numbers).collect();
            points.filter(|points| !points.is_empty())
        };
        match json {
            Value::String(text) => self.parse(text),
            Value::Number(kappa) => self.parse(&format!("extinction:{kappa}")),
            _ => match curve() {
                Some(points) => {
                    let rule = OpacityRule::Curve(points.into_iter().map(|[x, y]| (x, y)).collect());
                    self.parse(&self.text(&rule))
                }
                None => Err(format!(
                    "expected clamp, an extinction, or a curve [[0, 0], [1, 0.5]], and got {json}"
                )),
            },
        }
    }

    fn json(&self, value: &OpacityRule) -> Value {
        match value {
            OpacityRule::Curve(points) => points.iter().map(|&(x, y)| json!([x, y])).collect(),
            other => self.text(other).into(),
        }
    }
}

/// A colour.
pub(crate) struct Color;

impl Kind<Rgb> for Color {
    fn parse(&self, text: &str) -> Result<Rgb, String> {
        Rgb::parse(text)
    }

    fn text(&self, value: &Rgb) -> String {
        value.to_string()
    }
}

/// A colour, or `none`.
pub(crate) struct Behind;

impl Kind<Background> for Behind {
    fn parse(&self, text: &str) -> Result<Background, String> {
        Background::parse(text)
    }

    fn text(&self, value: &Background) -> String {
        value.to_string()
    }
}

/// A length, or `auto`.
pub(crate) struct Step;

impl Kind<StepLength> for Step {
    fn parse(&self, text: &str) -> Result<StepLength, String> {
        StepLength::parse(text)
    }

    fn text(&self, value: &StepLength) -> String {
        value.to_string()
    }

    fn read(&self, json: &Value) -> Result<StepLength, String> {
        self.parse(&number_text(json)?)
    }

    fn json(&self, value: &StepLength) -> Value {
        match value {
            StepLength::Automatic => json!("auto"),
            StepLength::Length(length) => json!(length),
        }
    }
}

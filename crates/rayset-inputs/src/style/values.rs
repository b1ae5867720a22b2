//! Types of option values other than numbers and text.

use rayset::scene::FARTHEST;

use crate::values;

/// A permitted word, and its meaning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Choice {
    /// The word.
    pub word: &'static str,
    /// Its meaning; empty if the word is self-explanatory.
    pub help: &'static str,
}

/// An enumeration whose values are written as words.
pub(crate) trait Words: Copy + PartialEq + Send + Sync + 'static {
    /// All values, in the order of the help.
    const ALL: &'static [(Self, Choice)];

    fn word(self) -> &'static str {
        Self::ALL.iter().find(|(value, _)| *value == self).map_or("", |(_, choice)| choice.word)
    }
}

macro_rules! words {
    ($(#[$about:meta])* $name:ident { $($(#[doc = $help:literal])? $value:ident = $word:literal),+ $(,)? }) => {
        $(#[$about])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum $name {
            $($(#[doc = $help])? #[allow(missing_docs, reason = "the word says it")] $value),+
        }

        impl Words for $name {
            const ALL: &'static [(Self, Choice)] =
                &[$((Self::$value, Choice { word: $word, help: words!(@help $($help)?) })),+];
        }
    };
    (@help $help:literal) => { $help.trim_ascii() };
    (@help) => { "" };
}

words! {
    /// A look.
    LookName {
        /// The field itself: density up to 1 is opacity, lit from the eye
        Density = "density",
        /// Solid surfaces in the points' own colours, or plain
        Surface = "surface",
        /// Surfaces, each class of points in a colour of its own
        Classes = "classes",
        /// Surfaces, coloured by height
        Height = "height",
        /// Surfaces, grey by intensity
        Intensity = "intensity",
        /// Glowing gas: colours and opacity by the logarithm of the density
        Gas = "gas",
        /// Voxels, by their values
        Volume = "volume",
        /// Voxels whose values are labels: a colour each, none between two
        Labels = "labels",
        /// Gaussian splats: their own colours, unlit
        Splats = "splats",
    }
}

words! {
    /// Where light comes from.
    Shading { None = "none", Headlight = "headlight" }
}

words! {
    /// In which values light is added up along rays.
    Compositing {
        /// As light adds up
        Linear = "linear",
        /// As displays are given it, as splats are trained
        Display = "display",
    }
}

words! {
    /// Where the samples of a ray begin.
    Phase { Half = "half", Hashed = "hashed" }
}

words! {
    /// A side to look from.
    Side {
        Front = "front",
        Back = "back",
        Left = "left",
        Right = "right",
        Top = "top",
        Bottom = "bottom",
        /// From the front, the right and above
        Iso = "iso",
    }
}

impl LookName {
    /// Whether the look is for voxels.
    #[must_use]
    pub fn is_of_voxels(self) -> bool {
        matches!(self, Self::Volume | Self::Labels)
    }

    /// The name, as on a command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.word()
    }
}

/// The value of an option that is either set or unset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Flag;

/// A display-encoded (sRGB) colour: red, green, blue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rgb(pub [u8; 3]);

impl Rgb {
    pub(super) fn parse(text: &str) -> Result<Self, String> {
        Ok(Self(values::color(text)?.map(|v| (v * 255.0).round() as u8)))
    }
}

impl std::fmt::Display for Rgb {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [red, green, blue] = self.0;
        write!(f, "#{red:02x}{green:02x}{blue:02x}")
    }
}

/// The background of the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Background {
    /// Transparent.
    Transparent,
    /// A colour.
    Color(Rgb),
}

impl Background {
    pub(super) fn parse(text: &str) -> Result<Self, String> {
        if text == "none" { Ok(Self::Transparent) } else { Rgb::parse(text).map(Self::Color) }
    }
}

impl std::fmt::Display for Background {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Transparent => f.write_str("none"),
            Self::Color(color) => color.fmt(f),
        }
    }
}

/// The distance between samples, in units of the input.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StepLength {
    /// By the radii of the points, or the size of the voxels.
    Automatic,
    /// A fixed length.
    Length(f64),
}

impl StepLength {
    pub(super) fn parse(text: &str) -> Result<Self, String> {
        if text == "auto" {
            return Ok(Self::Automatic);
        }
        values::length(text).map(Self::Length).map_err(|what| format!("{what}, or `auto`"))
    }
}

impl std::fmt::Display for StepLength {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Automatic => f.write_str("auto"),
            Self::Length(length) => length.fmt(f),
        }
    }
}

/// One end of a range of values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum End {
    Value(f64),
    /// The value below which so many percent lie.
    Percent(f64),
}

/// The values at the ends of a colour map: numbers, or percentiles of what it shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ValueRange(pub(crate) End, pub(crate) End);

impl std::fmt::Display for End {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Value(value) => write!(f, "{value}"),
            Self::Percent(share) => write!(f, "{share}%"),
        }
    }
}

impl std::fmt::Display for ValueRange {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}:{}", self.0, self.1)
    }
}

impl ValueRange {
    /// Two ends: `0:10`, `1%:99%`.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        let wrong = || format!("`{text}` is not a range; write it as 0:10, or 1%:99%");
        let end = |text: &str| match text.trim().strip_suffix('%') {
            Some(share) => share.trim().parse().ok().map(End::Percent),
            None => text.trim().parse().ok().map(End::Value),
        };
        let (low, high) = text.split_once(':').ok_or_else(wrong)?;
        let (low, high) = (end(low).ok_or_else(wrong)?, end(high).ok_or_else(wrong)?);
        for end in [low, high] {
            match end {
                End::Value(v) if !(v.abs() <= FARTHEST) => {
                    return Err(format!("`{text}`: expected numbers from -1e18 to 1e18"));
                }
                End::Percent(share) if !(0.0..=100.0).contains(&share) => {
                    return Err(format!("`{text}`: expected 0% to 100%"));
                }
                _ => {}
            }
        }
        Ok(Self(low, high))
    }

    /// Both ends, if they are numbers.
    pub(super) fn numbers(self) -> Option<[f64; 2]> {
        match (self.0, self.1) {
            (End::Value(low), End::Value(high)) => Some([low, high]),
            _ => None,
        }
    }
}

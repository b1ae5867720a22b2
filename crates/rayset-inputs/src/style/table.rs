//! The table of options. Each option is defined here and nowhere else.

use std::sync::Arc;

use rayset::scene::{Colormap, Kernel, OpacityRule};
use serde_json::Value;

use super::kinds::{
    Behind, Color, Kind, LENGTH, Named, Number, Opacity, Range, Step, Switch, Text, Vector, Whole, Word,
};
use super::values::{Background, Choice, Flag, LookName, Phase, Rgb, Shading, Side, StepLength, ValueRange};
use crate::values;

/// The subject of an option.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Group {
    /// The picture of any input.
    Picture,
    /// The look of a cloud or grid. A scene file has its own.
    Look,
    /// The camera. A scene file has its own.
    Camera,
}

/// An option of a [`Style`].
pub struct StyleOption {
    identifier: &'static str,
    /// The help text, on one line.
    pub help: &'static str,
    /// Its subject.
    pub group: Group,
    /// Options that exclude it, by their names on a command line.
    pub excludes: &'static [&'static str],
    /// Options that it requires, by their names on a command line.
    pub needs: &'static [&'static str],
    parse: fn(&str) -> Result<Change, String>,
    read: fn(&Value) -> Result<Change, String>,
    text: fn(&Style) -> Option<String>,
    json: fn(&Style) -> Option<Value>,
    copy: fn(&Style, &mut Style),
    choices: fn() -> Vec<Choice>,
    is_signed: fn() -> bool,
    is_flag: fn() -> bool,
}

impl std::fmt::Debug for StyleOption {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("StyleOption").field(&self.identifier).finish()
    }
}

macro_rules! style {
    ($(
        $group:ident {$(
            $(#[doc = $help:literal])+
            $name:ident: $value:ty = $kind:expr
            $(, excludes $excludes:expr)?
            $(, needs $needs:expr)?
        );+ $(;)?}
    )+) => {
        /// Options for the look of a cloud or grid and for its camera. Unset options are chosen
        /// from the data.
        #[derive(Clone, Debug, Default, PartialEq)]
        pub struct Style {
            $($($(#[doc = $help])+ pub $name: Option<$value>,)+)+
        }

        /// All options, in the order of the program's help.
        pub static OPTIONS: &[StyleOption] = &[$($(
            StyleOption {
                identifier: stringify!($name),
                help: concat!($($help),+).trim_ascii_start(),
                group: Group::$group,
                excludes: style!(@list $($excludes)?),
                needs: style!(@list $($needs)?),
                parse: |text| {
                    let value: $value = $kind.parse(text)?;
                    Ok(Change::new(move |style| style.$name = Some(value.clone())))
                },
                read: |json| {
                    let value: $value = $kind.read(json)?;
                    Ok(Change::new(move |style| style.$name = Some(value.clone())))
                },
                text: |style| style.$name.as_ref().map(|value| $kind.text(value)),
                json: |style| style.$name.as_ref().map(|value| $kind.json(value)),
                copy: |from, to| to.$name.clone_from(&from.$name),
                choices: || Kind::<$value>::choices(&$kind),
                is_signed: || Kind::<$value>::is_signed(&$kind),
                is_flag: || Kind::<$value>::is_flag(&$kind),
            },
        )+)+];
    };
    (@list) => { &[] };
    (@list $names:expr) => { &$names };
}

style! {
    Picture {
        /// Rays along each side of a pixel, 1 to 64; 2 by default, 1 of scenes
        samples: u32 = Whole(1, 64);
        /// Exposure in stops, -32 to 32: light is multiplied by two to this power
        exposure: f64 = Number(-32.0, 32.0);
    }
    Look {
        /// Look; chosen from the data by default, and said
        look: LookName = Word;
        /// Kernel: wyvill (by default), chen, gaussian, cubic-spline, wendland-c2, epanechnikov,
        /// triweight
        kernel: Kernel = Named;
        /// Kernels integrate to one (smoothed-particle hydrodynamics); left out where weights are
        /// densities already, as those of snapshots are
        normalised: Flag = Switch;
        /// Radii of the points, as a factor of those in the file, 0.001 to 1000
        radius_scale: f64 = Number(1e-3, 1e3);
        /// Opacity from density, or from a grid's values: clamp, extinction:K, or a curve like
        /// 0:0,1:0.5,4:1
        opacity: OpacityRule = Opacity;
        /// Length that opacity refers to, in units of the input
        unit_distance: f64 = LENGTH;
        /// One colour for all, as #c8b090
        color: Rgb = Color, excludes ["colormap", "color-by"];
        /// Colour map: viridis, inferno, magma, plasma, turbo, grey, coolwarm, cividis, thermal,
        /// haline, deep, dense, ice, balance, RdBu, terrain; with _r reversed
        colormap: Colormap = Named;
        /// What the colour map shows: density, a stored attribute, or a coordinate: x, y, z, height
        color_by: String = Text;
        /// Values at the ends of the colour map: numbers, as 0:10, or percentiles of what it shows,
        /// as 1%:99%
        value_range: ValueRange = Range;
        /// The colour map is over the logarithm; from 1 % to 99 % of the positive values, if
        /// --value-range says nothing
        log: Flag = Switch;
        /// Light: from the eye, or none
        shading: Shading = Word;
        /// How much darker creases and what lies close behind edges become, 0 to 4
        ambient_occlusion: f64 = Number(0.0, 4.0);
        /// Background colour, or `none`: transparent
        background: Background = Behind;
        /// Distance between samples, in units of the input, or `auto` (by default)
        step: StepLength = Step;
        /// Automatic distance between samples as a fraction of the radius, 0.001 to 4; 0.25 by
        /// default
        step_fraction: f64 = Number(1e-3, 4.0);
        /// Samples of a ray begin half a step from the eye (by default), or a different fraction
        /// for each pixel
        phase: Phase = Word;
        /// Rays end where less than this is seen through, 0 to 0.999; 0.01 by default
        stop: f64 = Number(0.0, 0.999);
    }
    Camera {
        /// Side to look from; iso, a three-quarter view, by default
        view: Side = Word, excludes ["position", "direction"];
        /// Eye
        position: [f64; 3] = Vector(values::vector);
        /// What the eye looks at; the middle of the input by default
        look_at: [f64; 3] = Vector(values::vector), excludes ["direction"], needs ["position"];
        /// Viewing direction: with an eye instead of --look-at, without one to frame the input from
        /// another side
        direction: [f64; 3] = Vector(values::direction);
        /// Up: x, y, z, -x, -y, -z or a vector; chosen from the data by default
        up: [f64; 3] = Vector(values::axis);
        /// Vertical field of view in degrees, 0.001 to 179; 35 by default
        fovy: f64 = Number(1e-3, 179.0);
        /// Parallel rays
        orthographic: Flag = Switch;
        /// Height of an orthographic picture, in units of the input
        height: f64 = LENGTH, needs ["orthographic"];
    }
}

/// Sets one option of a style. A command line collects changes until all of its options are parsed.
#[derive(Clone)]
pub struct Change(Arc<dyn Fn(&mut Style) + Send + Sync>);

impl Change {
    fn new(change: impl Fn(&mut Style) + Send + Sync + 'static) -> Self {
        Self(Arc::new(change))
    }

    /// Sets the option.
    pub fn make(&self, style: &mut Style) {
        (self.0)(style);
    }
}

impl std::fmt::Debug for Change {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut style = Style::default();
        self.make(&mut style);
        f.debug_tuple("Change").field(&style.words()).finish()
    }
}

/// The names of the options on a command line, in the order of [`OPTIONS`].
static NAMES: std::sync::LazyLock<Vec<String>> =
    std::sync::LazyLock::new(|| OPTIONS.iter().map(|option| option.identifier.replace('_', "-")).collect());

impl StyleOption {
    /// Finds an option by its name on a command line.
    #[must_use]
    pub fn find(name: &str) -> Option<&'static Self> {
        NAMES.iter().position(|known| known == name).map(|i| &OPTIONS[i])
    }

    /// Its name on a command line, without dashes in front: `radius-scale`.
    #[must_use]
    pub fn name(&'static self) -> &'static str {
        let place = OPTIONS.iter().position(|option| option.identifier == self.identifier);
        place.map_or(self.identifier, |i| &NAMES[i])
    }

    /// Reads a value from a command line.
    ///
    /// # Errors
    /// The problem, and the expected value.
    pub fn parse(&self, text: &str) -> Result<Change, String> {
        (self.parse)(text)
    }

    /// Reads a value from JSON.
    ///
    /// # Errors
    /// As [`parse`](Self::parse).
    pub fn read(&self, json: &Value) -> Result<Change, String> {
        (self.read)(json)
    }

    /// Its value in a style, as on a command line. Empty for a flag; `None` if it is unset.
    #[must_use]
    pub fn text(&self, style: &Style) -> Option<String> {
        (self.text)(style)
    }

    /// Its value in a style, as JSON. `None` if it is unset.
    #[must_use]
    pub fn json(&self, style: &Style) -> Option<Value> {
        (self.json)(style)
    }

    /// Whether a style sets it.
    #[must_use]
    pub fn is_given(&self, style: &Style) -> bool {
        self.text(style).is_some()
    }

    /// Copies its value, or its absence, from one style to another.
    pub fn copy(&self, from: &Style, to: &mut Style) {
        (self.copy)(from, to);
    }

    /// The permitted words; empty if its value is not one of a few words.
    #[must_use]
    pub fn choices(&self) -> Vec<Choice> {
        (self.choices)()
    }

    /// Whether its value may begin with `-`.
    #[must_use]
    pub fn is_signed(&self) -> bool {
        (self.is_signed)()
    }

    /// Whether it takes no value.
    #[must_use]
    pub fn is_flag(&self) -> bool {
        (self.is_flag)()
    }
}

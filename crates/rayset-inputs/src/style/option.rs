//! Options: each is defined once, in a table, with its name, its help and its kind of value.

use std::sync::Arc;

use serde_json::Value;

use super::values::Choice;

/// The subject of an option.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Group {
    /// The picture of any input.
    Picture,
    /// The look of a cloud or grid. A scene file has its own.
    Look,
    /// The camera. A scene file has its own.
    Camera,
    /// What is built of points or voxels. Clouds and grids have been built with theirs.
    Build,
}

/// Values that are set by options, all of which are in one table.
pub trait Options: Clone + Default + 'static {
    /// All options, in the order of the program's help.
    const TABLE: &'static [OptionOf<Self>];
}

/// The options that are set, as words of a command line: `--look=gas`.
pub(crate) fn words<T: Options>(of: &T) -> Vec<String> {
    let word = |option: &OptionOf<T>, text: String| match option.is_flag() {
        true => format!("--{}", option.name),
        false => format!("--{}={text}", option.name),
    };
    T::TABLE.iter().filter_map(|option| Some(word(option, option.text(of)?))).collect()
}

/// An option that sets one value of a `T`.
pub struct OptionOf<T: 'static> {
    /// Its name on a command line, without dashes in front: `radius-scale`.
    pub name: &'static str,
    /// The help text, on one line.
    pub help: &'static str,
    /// Its subject.
    pub group: Group,
    /// Options that exclude it, by their names on a command line.
    pub excludes: &'static [&'static str],
    /// Options that it requires, by their names on a command line.
    pub needs: &'static [&'static str],
    pub(crate) parse: fn(&str) -> Result<Change<T>, String>,
    pub(crate) read: fn(&Value) -> Result<Change<T>, String>,
    pub(crate) text: fn(&T) -> Option<String>,
    pub(crate) json: fn(&T) -> Option<Value>,
    pub(crate) copy: fn(&T, &mut T),
    pub(crate) choices: fn() -> Vec<Choice>,
    pub(crate) is_signed: fn() -> bool,
    pub(crate) is_flag: fn() -> bool,
    pub(crate) is_list: fn() -> bool,
}

impl<T> std::fmt::Debug for OptionOf<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("OptionOf").field(&self.name).finish()
    }
}

impl<T: Options> OptionOf<T> {
    /// Finds an option by its name on a command line.
    #[must_use]
    pub fn find(name: &str) -> Option<&'static Self> {
        T::TABLE.iter().find(|option| option.name == name)
    }

    /// Reads a value from a command line.
    ///
    /// # Errors
    /// The problem, and the expected value.
    pub fn parse(&self, text: &str) -> Result<Change<T>, String> {
        (self.parse)(text)
    }

    /// Reads a value from JSON.
    ///
    /// # Errors
    /// As [`parse`](Self::parse).
    pub fn read(&self, json: &Value) -> Result<Change<T>, String> {
        (self.read)(json)
    }

    /// Its value, as on a command line. Empty for a flag; `None` if it is unset.
    #[must_use]
    pub fn text(&self, of: &T) -> Option<String> {
        (self.text)(of)
    }

    /// Its value, as JSON. `None` if it is unset.
    #[must_use]
    pub fn json(&self, of: &T) -> Option<Value> {
        (self.json)(of)
    }

    /// Whether it is set.
    #[must_use]
    pub fn is_given(&self, of: &T) -> bool {
        self.text(of).is_some()
    }

    /// Copies its value, or its absence.
    pub fn copy(&self, from: &T, to: &mut T) {
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

    /// Whether it may be given more than once.
    #[must_use]
    pub fn is_list(&self) -> bool {
        (self.is_list)()
    }
}

/// Sets one option. A command line collects changes until all of its options are parsed.
pub struct Change<T>(Arc<dyn Fn(&mut T) + Send + Sync>);

impl<T> Change<T> {
    pub(crate) fn new(change: impl Fn(&mut T) + Send + Sync + 'static) -> Self {
        Self(Arc::new(change))
    }

    /// Sets the option.
    pub fn make(&self, of: &mut T) {
        (self.0)(of);
    }
}

impl<T> Clone for Change<T> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

impl<T: Options> std::fmt::Debug for Change<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut changed = T::default();
        self.make(&mut changed);
        f.debug_tuple("Change").field(&words(&changed)).finish()
    }
}

/// A name of Rust as one on a command line: dashes stand for underscores.
pub(crate) const fn dashed<const N: usize>(identifier: &str) -> [u8; N] {
    let mut name = [0; N];
    let mut at = 0;
    while at < N {
        let byte = identifier.as_bytes()[at];
        name[at] = if byte == b'_' { b'-' } else { byte };
        at += 1;
    }
    name
}

/// Defines a type whose values are options, and its table.
macro_rules! options {
    (
        $(#[$about:meta])*
        $all:ident
        $(
            $group:ident {$(
                $(#[doc = $help:literal])+
                $name:ident: $value:ty = $kind:expr
                $(, excludes $excludes:expr)?
                $(, needs $needs:expr)?
            );+ $(;)?}
        )+
    ) => {
        $(#[$about])*
        #[derive(Clone, Debug, Default, PartialEq)]
        pub struct $all {
            $($($(#[doc = $help])+ pub $name: Option<$value>,)+)+
        }

        impl $all {
            /// The options that are set, as words of a command line: `--look=gas`.
            #[must_use]
            pub fn words(&self) -> Vec<String> {
                $crate::style::option::words(self)
            }
        }

        impl $crate::style::option::Options for $all {
            const TABLE: &'static [$crate::style::option::OptionOf<Self>] = &[$($(
                $crate::style::option::OptionOf {
                    name: {
                        const IDENTIFIER: &str = stringify!($name);
                        const NAME: [u8; IDENTIFIER.len()] = $crate::style::option::dashed(IDENTIFIER);
                        match std::str::from_utf8(&NAME) {
                            Ok(name) => name,
                            Err(_) => IDENTIFIER,
                        }
                    },
                    help: concat!($($help),+).trim_ascii_start(),
                    group: $crate::style::option::Group::$group,
                    excludes: $crate::style::option::options!(@list $($excludes)?),
                    needs: $crate::style::option::options!(@list $($needs)?),
                    parse: |text| {
                        let value: $value = $kind.parse(text)?;
                        Ok($crate::style::option::Change::new(move |of: &mut Self| {
                            of.$name = Some($kind.joined(of.$name.as_ref(), &value));
                        }))
                    },
                    read: |json| {
                        let value: $value = $kind.read(json)?;
                        Ok($crate::style::option::Change::new(move |of: &mut Self| of.$name = Some(value.clone())))
                    },
                    text: |of| of.$name.as_ref().map(|value| $kind.text(value)),
                    json: |of| of.$name.as_ref().map(|value| $kind.json(value)),
                    copy: |from, to| to.$name.clone_from(&from.$name),
                    choices: || $crate::style::kinds::Kind::<$value>::choices(&$kind),
                    is_signed: || $crate::style::kinds::Kind::<$value>::is_signed(&$kind),
                    is_flag: || $crate::style::kinds::Kind::<$value>::is_flag(&$kind),
                    is_list: || $crate::style::kinds::Kind::<$value>::is_list(&$kind),
                },
            )+)+];
        }
    };
    (@list) => { &[] };
    (@list $names:expr) => { &$names };
}
pub(crate) use options;

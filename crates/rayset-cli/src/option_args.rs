//! Command-line options of the tables of options: of styles, and of what is built.

use std::ffi::OsStr;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::error::ErrorKind;
use clap::{Arg, ArgAction, ArgMatches, Args, Command, Error, FromArgMatches};
use rayset_inputs::BuildChoices;
use rayset_inputs::style::{Change, Choice, Group, OptionOf, Options, Style};

/// The options of a table as clap arguments: those for which `wants` is true, under headings of
/// their subjects.
#[derive(Clone, Default)]
pub(crate) struct OptionArgs<T, S>(pub(crate) T, std::marker::PhantomData<S>);

/// Which options of a table a command has.
pub(crate) trait Selection: Clone + Default + Send + Sync + 'static {
    /// The heading of a group; `None` if the command has none of its options.
    fn heading(group: Group) -> Option<&'static str>;
}

/// Those of any input.
#[derive(Clone, Default)]
pub(crate) struct OfInput;

/// The same, without those of the picture.
#[cfg(feature = "view")]
#[derive(Clone, Default)]
pub(crate) struct WithoutPicture;

/// Those of the command that builds.
#[derive(Clone, Default)]
pub(crate) struct OfBuild;

impl Selection for OfInput {
    fn heading(group: Group) -> Option<&'static str> {
        Some(match group {
            Group::Picture => "Picture",
            Group::Look => "Look of a cloud or grid (a scene file says this itself)",
            Group::Camera => "Camera (by default it frames the whole input; a scene file has its own)",
            Group::Build => "Building of inputs that were not built before",
        })
    }
}

#[cfg(feature = "view")]
impl Selection for WithoutPicture {
    fn heading(group: Group) -> Option<&'static str> {
        OfInput::heading(group).filter(|_| group != Group::Picture)
    }
}

impl Selection for OfBuild {
    fn heading(group: Group) -> Option<&'static str> {
        (group == Group::Build).then_some("What is built of the input")
    }
}

/// A style, with or without the options of the picture.
pub(crate) type StyleArgs<S> = OptionArgs<Style, S>;
/// What is built of points or voxels.
pub(crate) type ChoiceArgs<S> = OptionArgs<BuildChoices, S>;

/// The options of a table that a command has, with their headings.
fn selected<T: Options, S: Selection>() -> impl Iterator<Item = (&'static OptionOf<T>, &'static str)> {
    T::TABLE.iter().filter_map(|option| Some((option, S::heading(option.group)?)))
}

impl<T: Options, S: Selection> Args for OptionArgs<T, S> {
    fn augment_args(command: Command) -> Command {
        selected::<T, S>().fold(command, |command, (option, heading)| command.arg(argument(option, heading)))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl<T: Options, S: Selection> FromArgMatches for OptionArgs<T, S> {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, Error> {
        let mut args = Self::default();
        args.update_from_arg_matches(matches)?;
        Ok(args)
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), Error> {
        for (option, _) in selected::<T, S>() {
            if option.is_flag() {
                if matches.get_flag(option.name) {
                    let change =
                        option.parse("").map_err(|what| Error::raw(ErrorKind::InvalidValue, what))?;
                    change.make(&mut self.0);
                }
            } else {
                let changes = matches.get_many::<Change<T>>(option.name).into_iter().flatten();
                changes.for_each(|change| change.make(&mut self.0));
            }
        }
        Ok(())
    }
}

fn argument<T: Options>(option: &'static OptionOf<T>, heading: &'static str) -> Arg {
    let name = option.name;
    let arg = Arg::new(name)
        .long(name)
        .help(option.help)
        .help_heading(heading)
        .conflicts_with_all(option.excludes.iter().copied())
        .requires_all(option.needs.iter().copied());
    if option.is_flag() {
        return arg.action(ArgAction::SetTrue);
    }
    let arg = if option.is_list() { arg.action(ArgAction::Append) } else { arg };
    let value_name = name.replace('-', "_").to_ascii_uppercase();
    arg.value_name(value_name).allow_hyphen_values(option.is_signed()).value_parser(ValueOf(option))
}

/// Parses the value of an option.
struct ValueOf<T: 'static>(&'static OptionOf<T>);

impl<T> Clone for ValueOf<T> {
    fn clone(&self) -> Self {
        Self(self.0)
    }
}

impl<T: Options> TypedValueParser for ValueOf<T> {
    type Value = Change<T>;

    fn parse_ref(&self, command: &Command, arg: Option<&Arg>, value: &OsStr) -> Result<Change<T>, Error> {
        if let Some(words) = self.words() {
            PossibleValuesParser::new(words).parse_ref(command, arg, value)?;
        }
        let option = self.0;
        (move |text: &str| option.parse(text)).parse_ref(command, arg, value)
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        self.words().map(|words| Box::new(words.into_iter()) as Box<dyn Iterator<Item = PossibleValue>>)
    }
}

impl<T: Options> ValueOf<T> {
    /// The permitted words; `None` if the value is not one of a few words.
    fn words(&self) -> Option<Vec<PossibleValue>> {
        let choices = self.0.choices();
        let value = |choice: &Choice| {
            let value = PossibleValue::new(choice.word);
            if choice.help.is_empty() { value } else { value.help(choice.help) }
        };
        (!choices.is_empty()).then(|| choices.iter().map(value).collect())
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    #[command(no_binary_name = true)]
    struct Words {
        #[command(flatten)]
        style: StyleArgs<OfInput>,
    }

    fn read(words: &[&str]) -> Result<Style, String> {
        Words::try_parse_from(words).map(|words| words.style.0).map_err(|error| error.to_string())
    }

    #[test]
    fn the_words_of_a_style_are_read_as_the_style() {
        let all = [
            "--samples=3",
            "--exposure=-1.5",
            "--look=gas",
            "--normalised",
            "--opacity=0:0,1:0.5",
            "--colormap=magma_r",
            "--color-by=T",
            "--value-range=-1:99%",
            "--log",
            "--step=auto",
            "--position=-1,2,3",
            "--up=0,0,-1",
            "--orthographic",
            "--height=2",
        ];
        let style = read(&all).expect("options");
        assert_eq!(style.words(), all);
        assert_eq!(
            read(&["--value-range", "-1:2", "--up", "-z"]).expect("signs").words(),
            ["--value-range=-1:2", "--up=0,0,-1"]
        );
    }

    #[test]
    fn mistakes_are_said_with_the_option_and_what_it_takes() {
        let wrong = |words: &[&str]| read(words).expect_err("a mistake");
        assert!(
            wrong(&["--look", "gass"]).contains("a similar value exists: 'gas'"),
            "{}",
            wrong(&["--look", "gass"])
        );
        let scale = wrong(&["--radius-scale", "1e9"]);
        assert!(
            scale.contains("--radius-scale <RADIUS_SCALE>")
                && scale.contains("not a number from 0.001 to 1000"),
            "{scale}"
        );
        assert!(wrong(&["--color", "red", "--log"]).contains("not a colour"));
        assert!(wrong(&["--step=-1"]).contains("or `auto`"));
        assert!(wrong(&["--color=#000000", "--colormap=magma"]).contains("cannot be used with"));
        assert!(wrong(&["--look-at=0,0,0"]).contains("--position"));
    }
}

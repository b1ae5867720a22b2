//! Command-line options for a style.

use std::ffi::OsStr;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::error::ErrorKind;
use clap::{Arg, ArgAction, ArgMatches, Args, Command, Error, FromArgMatches};
use rayset_inputs::style::{Change, Choice, Group, OPTIONS, Style, StyleOption};

/// A style as clap arguments. `WITH_PICTURE` includes the options of [`Group::Picture`].
#[derive(Clone, Default)]
pub(crate) struct StyleArgs<const WITH_PICTURE: bool>(pub(crate) Style);

fn options(with_picture: bool) -> impl Iterator<Item = &'static StyleOption> {
    OPTIONS.iter().filter(move |option| with_picture || option.group != Group::Picture)
}

impl<const WITH_PICTURE: bool> Args for StyleArgs<WITH_PICTURE> {
    fn augment_args(command: Command) -> Command {
        options(WITH_PICTURE).fold(command, |command, option| command.arg(argument(option)))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl<const WITH_PICTURE: bool> FromArgMatches for StyleArgs<WITH_PICTURE> {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, Error> {
        let mut args = Self::default();
        args.update_from_arg_matches(matches)?;
        Ok(args)
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), Error> {
        for option in options(WITH_PICTURE) {
            if option.is_flag() {
                if matches.get_flag(option.name()) {
                    let change =
                        option.parse("").map_err(|what| Error::raw(ErrorKind::InvalidValue, what))?;
                    change.make(&mut self.0);
                }
            } else if let Some(change) = matches.get_one::<Change>(option.name()) {
                change.make(&mut self.0);
            }
        }
        Ok(())
    }
}

fn argument(option: &'static StyleOption) -> Arg {
    let heading = match option.group {
        Group::Picture => "Picture",
        Group::Look => "Look of a cloud or grid (a scene file says this itself)",
        Group::Camera => "Camera (by default it frames the whole input; a scene file has its own)",
    };
    let name = option.name();
    let arg = Arg::new(name)
        .long(name)
        .help(option.help)
        .help_heading(heading)
        .conflicts_with_all(option.excludes.iter().copied())
        .requires_all(option.needs.iter().copied());
    if option.is_flag() {
        return arg.action(ArgAction::SetTrue);
    }
    let value_name = name.replace('-', "_").to_ascii_uppercase();
    arg.value_name(value_name).allow_hyphen_values(option.is_signed()).value_parser(ValueOf(option))
}

/// Parses the value of an option.
#[derive(Clone)]
struct ValueOf(&'static StyleOption);

impl TypedValueParser for ValueOf {
    type Value = Change;

    fn parse_ref(&self, command: &Command, arg: Option<&Arg>, value: &OsStr) -> Result<Change, Error> {
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

impl ValueOf {
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
        style: StyleArgs<true>,
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

//! What is printed, and where: results to standard output, progress and errors to standard error.
//!
//! Names and texts from files are not trusted: characters that would move the cursor, colour the
//! terminal or change the direction of writing are shown by their numbers instead. Addresses are
//! shown without what grants access to them, wherever in a text they stand; only [`say_invitation`]
//! writes one that does.

use std::fmt::Write as _;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

use rayset::storage::{redacted, shown};
pub use rayset_inputs::text::{bytes, count};

/// Why results could not be printed. A closed pipe is the reader's wish, not a failure.
static LOST: Mutex<Option<io::Error>> = Mutex::new(None);
/// Whether standard output is in use for a picture or points.
static TAKEN: AtomicBool = AtomicBool::new(false);

/// Writes a line of results.
pub fn say(line: impl std::fmt::Display) {
    result(&printable(&line.to_string(), |c| c.escape_unicode().to_string()));
}

/// A value as indented JSON.
pub fn json(value: &impl serde::Serialize) -> anyhow::Result<()> {
    let text = json_text(value)?;
    let lines: Vec<String> =
        text.lines().map(|line| printable(line, |c| format!("\\u{:04x}", u32::from(c)))).collect();
    result(&lines.join("\n"));
    Ok(())
}

/// A value as indented JSON, as it may be printed or written to a file.
pub fn json_text(value: &impl serde::Serialize) -> anyhow::Result<String> {
    let text = serde_json::to_string_pretty(value)?;
    if matches!(redacted(&text), std::borrow::Cow::Borrowed(_)) {
        return Ok(text);
    }
    // Each string by itself: in the text, its end could be taken for a part of an address.
    let (mut out, mut rest) = (String::with_capacity(text.len()), text.as_str());
    while let Some(start) = rest.find('"') {
        let (before, literal) = rest.split_at(start);
        let mut is_escaped = false;
        let end = literal.char_indices().skip(1).find(|&(_, c)| {
            let ends = c == '"' && !is_escaped;
            is_escaped = c == '\\' && !is_escaped;
            ends
        });
        let (literal, after) = literal.split_at(end.map_or(literal.len(), |(at, _)| at + 1));
        let string: String = serde_json::from_str(literal)?;
        let _ = write!(out, "{before}{}", serde_json::to_string(&redacted(&string))?);
        rest = after;
    }
    Ok(out + rest)
}

/// Writes an address that lets in whoever has it, to the person who is to open it.
pub fn say_invitation(address: &str) {
    result(address);
}

fn result(text: &str) {
    if TAKEN.load(Ordering::Relaxed) {
        return write_remark(text);
    }
    let mut stdout = io::stdout().lock();
    let written = writeln!(stdout, "{text}").and_then(|()| stdout.flush());
    if let Err(error) = written {
        LOST.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
    }
}

/// Sends results to standard error from now on, because standard output is an output of the
/// command.
pub fn leave_standard_output() {
    TAKEN.store(true, Ordering::Relaxed);
}

/// Checks that all results have been printed.
pub fn check_results() -> anyhow::Result<()> {
    match LOST.lock().unwrap_or_else(PoisonError::into_inner).take() {
        Some(error) if error.kind() != io::ErrorKind::BrokenPipe => Err(lost(error)),
        _ => Ok(()),
    }
}

/// Prints what the command line itself answers: help or the version.
pub fn answer(answer: &clap::Error) -> anyhow::Result<()> {
    match answer.print().and_then(|()| io::stdout().flush()) {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => Err(lost(error)),
        _ => Ok(()),
    }
}

/// The error that results cannot be printed.
fn lost(error: io::Error) -> anyhow::Error {
    anyhow::Error::new(error).context("results are lost: cannot write to standard output")
}

/// Writes a remark that is not a result.
pub fn remark(line: impl std::fmt::Display) {
    write_remark(&printable(&line.to_string(), |c| c.escape_unicode().to_string()));
}

fn write_remark(text: &str) {
    let _ = writeln!(io::stderr().lock(), "{text}");
}

/// Writes why the program failed, on one line.
pub fn fail(error: &anyhow::Error) {
    remark(format_args!("error: {error:#}"));
}

/// Writes what is wrong with the command line, in several lines. Options that help does not show
/// are not suggested.
pub fn misused(mut error: clap::Error, program: &clap::Command) {
    use clap::error::{ContextKind, ContextValue};
    if let Some(ContextValue::String(option)) = error.get(ContextKind::SuggestedArg)
        && !is_shown(option.trim_start_matches('-'), program)
    {
        error.remove(ContextKind::SuggestedArg);
        error.remove(ContextKind::SuggestedSubcommand);
    }
    error.render().to_string().lines().for_each(remark);
}

/// Whether a program or one of its commands has an option of this name that its help shows.
fn is_shown(option: &str, program: &clap::Command) -> bool {
    let name = option.split(['=', ' ']).next().unwrap_or(option);
    let here = program.get_arguments().any(|arg| arg.get_long() == Some(name) && !arg.is_hide_set());
    here || name == "help" || name == "version" || program.get_subcommands().any(|c| is_shown(option, c))
}

/// Leaves out the secrets of addresses, and replaces characters that a terminal would obey, as
/// `shown` says.
fn printable(text: &str, shown: impl Fn(char) -> String) -> String {
    let text = redacted(text);
    let obeyed = |c: char| {
        c.is_control()
            || matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
    };
    if !text.contains(obeyed) {
        return text.into_owned();
    }
    text.chars().map(|c| if obeyed(c) { shown(c) } else { c.to_string() }).collect()
}

/// The name of a file or an object, without its folder.
pub fn name_of(path: &Path) -> String {
    let shown = PathBuf::from(shown(path));
    shown.file_name().unwrap_or(shown.as_os_str()).to_string_lossy().into_owned()
}

/// A number in as few digits as represent it exactly, in scientific notation if it is very small or
/// very large.
pub fn number<T: Copy + Into<f64> + std::fmt::Display + std::fmt::LowerExp>(value: T) -> String {
    let size = value.into().abs();
    if size == 0.0 || (1e-5..1e16).contains(&size) { value.to_string() } else { format!("{value:e}") }
}

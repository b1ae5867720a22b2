//! `rayset completions` and `rayset man`: what shells and the manual know of the command line, from
//! its definition.

use std::io::Write;
use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::{Args, Command};
use clap_complete::Shell;

use rayset_terminal::outputs::{self, Outputs};
use rayset_terminal::report;

/// Write a completion script to standard output.
///
/// Bash: `rayset completions bash > ~/.local/share/bash-completion/completions/rayset`. Zsh: into a
/// folder of $fpath, as `_rayset`. Fish: `~/.config/fish/completions/rayset.fish`.
#[derive(Args)]
pub(crate) struct CompletionsArgs {
    /// Shell
    #[arg(value_enum)]
    shell: Shell,
}

/// Write the manual pages: rayset.1, and one of each command.
#[derive(Args)]
pub(crate) struct ManArgs {
    /// Folder to write them to; it is made if need be
    #[arg(long)]
    out: PathBuf,
}

pub(crate) fn completions(args: &CompletionsArgs, mut command: Command) -> Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut command, "rayset", &mut script);
    match std::io::stdout().lock().write_all(&script) {
        // Whoever reads has had enough.
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        written => written.context("cannot write the script to standard output"),
    }
}

pub(crate) fn man(args: &ManArgs, command: Command) -> Result<()> {
    std::fs::create_dir_all(&args.out).with_context(|| format!("cannot make {}", args.out.display()))?;
    // Commands of commands get their full names.
    let mut command = command.disable_help_subcommand(true);
    command.build();
    let mut outputs = Outputs::default();
    let mut pages = vec![("rayset.1".to_owned(), command.clone())];
    for sub in command.get_subcommands().filter(|sub| !sub.is_hide_set()) {
        let name = format!("rayset-{}", sub.get_name());
        pages.push((format!("{name}.1"), sub.clone()));
    }
    for (file, command) in &pages {
        let mut page = Vec::new();
        clap_mangen::Man::new(command.clone()).render(&mut page)?;
        outputs::write(&outputs.add(&args.out.join(file), None)?, &page)?;
    }
    report::say(format_args!("{}: {} pages", args.out.display(), pages.len()));
    Ok(())
}

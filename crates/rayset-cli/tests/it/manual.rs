//! Completions and manual pages are of the command line as it is.

use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};

use crate::common::{folder, program};

fn said(arguments: &[&str]) -> String {
    let output = program().args(arguments).output().expect("the program runs");
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// The commands that the program's help lists.
fn commands() -> Vec<String> {
    let help = said(&["--help"]);
    let (_, list) = help.split_once("Commands:\n").expect("a list of commands");
    let lines = list.lines().take_while(|line| !line.is_empty());
    let names = lines.filter(|line| line.starts_with("  ") && !line.starts_with("   "));
    let names = names.filter_map(|line| line.split_whitespace().next()).filter(|name| *name != "help");
    names.map(str::to_owned).collect()
}

#[test]
fn completions_of_every_shell_know_the_commands_and_their_options_and_bash_reads_its_own() {
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let script = said(&["completions", shell]);
        for word in ["render", "annotate", "colormap", "completions"] {
            assert!(script.contains(word), "{shell}: no {word}");
        }
    }
    let bash = Command::new("bash").arg("-n").stdin(Stdio::piped()).stderr(Stdio::piped()).spawn();
    let Ok(mut bash) = bash else { return eprintln!("skipped: there is no bash") };
    let mut input = bash.stdin.take().expect("a pipe");
    input.write_all(said(&["completions", "bash"]).as_bytes()).expect("it is read");
    drop(input);
    let output = bash.wait_with_output().expect("bash ends");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && errors.is_empty(), "{errors}");
}

#[test]
fn every_command_has_a_manual_page_that_formats_without_a_warning() {
    let folder = folder();
    let pages = folder.path().join("man");
    said(&["man", "--out", pages.to_str().expect("a path")]);
    let commands = commands();
    assert!(commands.len() >= 11, "{commands:?}");
    let names = commands.iter().map(|name| format!("rayset-{name}.1"));
    for file in names.chain(["rayset.1".to_owned()]) {
        let page = std::fs::read_to_string(pages.join(&file)).expect("a page");
        assert!(page.contains(".SH NAME") && page.contains(".SH SYNOPSIS"), "{file}");
        let groff =
            Command::new("groff").args(["-Kutf8", "-man", "-Tutf8", "-ww"]).arg(pages.join(&file)).output();
        match groff {
            Ok(output) => {
                let warnings = String::from_utf8_lossy(&output.stderr);
                assert!(output.status.success() && warnings.is_empty(), "{file}: {warnings}");
                assert!(!output.stdout.is_empty());
            }
            Err(_) => eprintln!("skipped: there is no groff"),
        }
    }
    let render = std::fs::read_to_string(pages.join("rayset-render.1")).expect("a page");
    assert!(render.contains("annotate") && render.contains("value\\-range"), "options are in the page");
    assert_eq!(std::fs::read_dir(&pages).expect("a folder").count(), commands.len() + 1);
}

#[test]
fn the_help_of_build_names_every_kind_of_file_that_the_documents_do() {
    let document = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/inputs.md");
    let document = std::fs::read_to_string(document).expect("the document");
    // Kinds are the words with several capitals in the first column of both tables.
    let kinds: Vec<&str> = (document.lines().filter_map(|line| line.strip_prefix("| ")?.split(" |").next()))
        .take_while(|cell| *cell != "look")
        .flat_map(|cell| cell.split(|c: char| !c.is_ascii_alphanumeric()))
        .filter(|word| {
            word.chars().filter(|c| !c.is_ascii_lowercase()).count() > 1
                && !word.starts_with(char::is_numeric)
        })
        .collect();
    assert!(kinds.len() > 30 && kinds.contains(&"E57") && kinds.contains(&"NIfTI"), "{kinds:?}");
    let help = said(&["build", "--help"]);
    let help: Vec<&str> = help.split(|c: char| !c.is_ascii_alphanumeric()).collect();
    for kind in kinds {
        assert!(help.contains(&kind), "the help does not name {kind}");
    }
}

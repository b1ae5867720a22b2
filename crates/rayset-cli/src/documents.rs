//! The commands in the documents are commands of this program.

use std::path::Path;

use clap::Parser;

use crate::Cli;

/// The words of a command line, in which only single quotes mean anything.
fn words(line: &str) -> Vec<String> {
    let mut words = Vec::new();
    for (number, part) in line.split('\'').enumerate() {
        if number % 2 == 1 {
            words.push(part.to_owned());
        } else {
            words.extend(part.split_whitespace().map(str::to_owned));
        }
    }
    words
}

/// The commands of a document: indented lines that begin with the program's name.
fn commands(text: &str) -> impl Iterator<Item = &str> {
    text.lines().filter_map(|line| line.strip_prefix("    ").filter(|line| line.starts_with("rayset ")))
}

#[test]
fn every_command_in_the_documents_is_one_of_the_program() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let documents = [
        ("README.md", 5),
        ("docs/cookbook.md", 40),
        ("docs/inputs.md", 2),
        ("docs/gallery.md", 20),
        ("docs/viewer.md", 2),
    ];
    for (name, least) in documents {
        let text = std::fs::read_to_string(root.join(name)).expect("the document reads");
        let mut found = 0;
        for line in commands(&text) {
            found += 1;
            if let Err(error) = Cli::try_parse_from(words(line)) {
                panic!("{name}: {line}\n{error}");
            }
        }
        assert!(found >= least, "{name} has {found} commands");
    }
}

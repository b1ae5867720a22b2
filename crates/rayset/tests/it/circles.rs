//! No circle of files: who reads one file needs those that it uses, and never comes back to where
//! they began.
//!
//! Imports are followed to the file that defines a name, through what folders hand on
//! (`pub use self::…`).

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// A module, as the names on the way to it from the root of its crate.
type Module = Vec<String>;

struct File {
    /// Paths that it uses, each with whether it hands the name on.
    uses: Vec<(Vec<String>, bool)>,
}

struct Crate {
    files: BTreeMap<Module, File>,
}

fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).expect("a folder of sources") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push(path);
        }
    }
}

fn module_of(path: &Path) -> Module {
    let mut names: Module =
        path.with_extension("").iter().map(|name| name.to_string_lossy().into_owned()).collect();
    if names.last().is_some_and(|name| name == "mod" || name == "lib" || name == "main") {
        names.pop();
    }
    names
}

/// What is compiled into the crate itself, without comments.
fn code(text: &str) -> String {
    let text = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
    text.lines().filter(|line| !line.trim_start().starts_with("//")).collect::<Vec<_>>().join("\n")
}

/// `a::{b, c::d}` as `a::b` and `a::c::d`.
fn expand(tree: &str, found: &mut Vec<String>) {
    let Some((before, rest)) = tree.split_once('{') else {
        return found.push(tree.trim().to_owned());
    };
    let inner = rest.rsplit_once('}').map_or(rest, |(inner, _)| inner);
    let (mut depth, mut part) = (0, String::new());
    for letter in inner.chars().chain([',']) {
        match letter {
            ',' if depth == 0 => {
                if !part.trim().is_empty() {
                    expand(&format!("{}{}", before.trim(), part.trim()), found);
                }
                part.clear();
                continue;
            }
            '{' => depth += 1,
            '}' => depth -= 1,
            _ => {}
        }
        part.push(letter);
    }
}

fn names(path: &str) -> Vec<String> {
    path.split("::").map(|name| name.trim().to_owned()).collect()
}

/// Whether what stands before `use` on its line makes it an import: nothing, or who may see it.
fn is_import(before: &str) -> bool {
    let line = before.rsplit('\n').next().unwrap_or_default().trim();
    line.is_empty() || line == "pub" || (line.starts_with("pub(") && line.ends_with(')'))
}

impl File {
    fn read(text: &str) -> Self {
        let code = code(text);
        let mut uses = Vec::new();
        let mut rest = String::new();
        for statement in code.split(';') {
            let start = statement.rfind("use ").filter(|&at| is_import(&statement[..at]));
            let Some(start) = start else {
                rest.push_str(statement);
                continue;
            };
            let line = statement[..start].rfind('\n').map_or(0, |at| at + 1);
            let visible = &statement[line..start];
            rest.push_str(&statement[..line]);
            let mut paths = Vec::new();
            expand(&statement[start + 4..], &mut paths);
            for path in paths {
                let mut path = names(path.split(" as ").next().unwrap_or_default());
                // In a module within the file.
                if visible.starts_with(' ') && path[0] == "super" {
                    path[0] = "self".to_owned();
                }
                uses.push((path, visible.contains("pub")));
            }
        }
        // Paths in the midst of code, those into modules below included.
        let declared = code.lines().filter_map(|line| line.trim().strip_suffix(';')?.split("mod ").nth(1));
        for module in declared {
            let known = format!("{module}::");
            let before = |at: usize| rest[..at].chars().next_back();
            let is_path =
                |at: &usize| before(*at).is_none_or(|c| !(c.is_alphanumeric() || c == '_' || c == ':'));
            if rest.match_indices(&known).any(|(at, _)| is_path(&at)) {
                uses.push((names(&format!("self::{module}")), false));
            }
        }
        for root in ["crate::", "super::"] {
            for (at, _) in rest.match_indices(root) {
                let end = rest[at..].find(|c: char| !(c.is_alphanumeric() || c == '_' || c == ':'));
                uses.push((names(rest[at..at + end.unwrap_or(0)].trim_end_matches(':')), false));
            }
        }
        Self { uses }
    }
}

impl Crate {
    fn read(root: &Path) -> Self {
        let mut paths = Vec::new();
        sources(root, &mut paths);
        let file = |path: &PathBuf| {
            let text = std::fs::read_to_string(path).expect("a source file");
            (module_of(path.strip_prefix(root).expect("below the root")), File::read(&text))
        };
        Self { files: paths.iter().map(file).collect() }
    }

    /// The module whose file defines what a path means in a module; `None` for what is of another
    /// crate.
    fn definition(&self, module: &Module, path: &[String], depth: u32) -> Option<Module> {
        let mut here = module.clone();
        let mut path = path.iter().peekable();
        match path.peek().map(|name| name.as_str()) {
            Some("crate") => {
                here.clear();
                path.next();
            }
            Some("self") => drop(path.next()),
            Some("super") => {
                while path.next_if(|name| *name == "super").is_some() {
                    here.pop();
                }
            }
            _ => {}
        }
        let mut entered = here != *module || path.len() == 0;
        while let Some(name) = path.peek() {
            let below: Module = here.iter().cloned().chain([(*name).clone()]).collect();
            if !self.files.contains_key(&below) {
                break;
            }
            (here, entered) = (below, true);
            path.next();
        }
        let file = self.files.get(&here)?;
        if let Some(name) = path.peek()
            && depth < 8
        {
            let handed_on = file.uses.iter().find(|(to, on)| *on && to.last() == Some(name));
            if let Some(found) = handed_on.and_then(|(to, _)| self.definition(&here, to, depth + 1)) {
                return Some(found);
            }
        }
        entered.then_some(here)
    }

    /// What each file uses of others. A folder's file that only hands names on does not use where
    /// they are from.
    fn arrows(&self) -> BTreeMap<Module, BTreeSet<Module>> {
        let mut arrows = BTreeMap::new();
        for (module, file) in &self.files {
            let known = file.uses.iter().filter(|(path, on)| !on || path[0] == "crate" || path[0] == "super");
            let to = known.filter_map(|(path, _)| self.definition(module, path, 0));
            arrows.insert(module.clone(), to.filter(|to| to != module).collect());
        }
        arrows
    }
}

/// The files of circles, and those between them: what is left where files that use nothing of the
/// others go, and go again.
fn circles(mut arrows: BTreeMap<Module, BTreeSet<Module>>) -> BTreeMap<Module, BTreeSet<Module>> {
    loop {
        let done: BTreeSet<Module> =
            arrows.iter().filter(|(_, to)| to.is_empty()).map(|(from, _)| from.clone()).collect();
        if done.is_empty() {
            return arrows;
        }
        arrows.retain(|from, _| !done.contains(from));
        arrows.values_mut().for_each(|to| to.retain(|to| !done.contains(to)));
    }
}

#[test]
fn no_circle_of_files_in_library_and_program() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    for (name, least) in [
        ("rayset-base", 4),
        ("rayset-store", 60),
        ("rayset-files", 80),
        ("rayset-formats", 100),
        ("rayset-render", 300),
        ("rayset-cli", 20),
        ("rayset-inputs", 10),
    ] {
        let root = here.with_file_name(name).join("src");
        let arrows = Crate::read(&root).arrows();
        let count: usize = arrows.values().map(BTreeSet::len).sum();
        assert!(count > least, "{count} arrows in {}: imports are not understood any more", root.display());
        let left = circles(arrows);
        assert!(left.is_empty(), "{}: {left:#?}", root.display());
    }
}

#[test]
fn a_circle_is_found() {
    let file = |text: &str| File::read(text);
    let files = [
        (vec![], "mod a;\nmod b;\npub use self::a::A;\n"),
        (vec!["a".to_owned()], "use crate::b::{B, c};\npub struct A;\n"),
        (vec!["b".to_owned()], "//! B.\n\nfn b() { crate::A }\n"),
        (vec!["c".to_owned()], "mod d;\nconst C: u8 = 0;\nfn c() { d::d() }\n"),
        (vec!["c".to_owned(), "d".to_owned()], "pub fn d() { super::C }\n"),
    ];
    let all = Crate { files: files.into_iter().map(|(module, text)| (module, file(text))).collect() };
    let names: Vec<String> = circles(all.arrows()).into_keys().flatten().collect();
    assert_eq!(names, ["a", "b", "c", "c", "d"]);
}

//! The order of the modules, and what the library keeps away from.

use std::path::{Path, PathBuf};

/// The crates of the library, each with those of them that it may use, and its modules: data flows
/// this way, and a module knows those before it and none behind.
const CRATES: [(&str, &[&str], &[&str]); 6] = [
    (
        "rayset-base",
        &[],
        &[
            "bytes",
            "parse",
            "setters",
            "sync",
            "cancel",
            "kernel",
            "srgb",
            "geometry",
            "nearest_first",
            "regular_file",
            "text_numbers",
            "numbers",
        ],
    ),
    ("rayset-store", &["rayset-base"], &["storage", "output", "spill", "container", "working_set"]),
    (
        "rayset-files",
        &["rayset-base", "rayset-store"],
        &["points", "paged_file", "octree", "grid", "paged_files"],
    ),
    (
        "rayset-formats",
        &["rayset-base", "rayset-store", "rayset-files"],
        &["words", "refusals", "array_file", "vtk_xml", "points", "volumes"],
    ),
    (
        "rayset-render",
        &["rayset-base", "rayset-store", "rayset-files"],
        &["math", "lod", "field", "scene", "image", "trace", "scene_file"],
    ),
    ("rayset", &["rayset-base", "rayset-store", "rayset-files", "rayset-formats", "rayset-render"], &[]),
];

/// The folder of a crate.
fn of_crate(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).with_file_name(name)
}

fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).expect("the folder of the library") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push(path);
        }
    }
}

/// A file of the library.
struct Source {
    /// The number of its crate in [`CRATES`].
    of: usize,
    /// Below the sources of its crate.
    path: PathBuf,
    module: String,
    /// Without comments.
    code: String,
}

fn library() -> Vec<Source> {
    let mut all = Vec::new();
    for (of, (name, ..)) in CRATES.iter().enumerate() {
        let root = of_crate(name).join("src");
        let mut files = Vec::new();
        sources(&root, &mut files);
        all.extend(files.into_iter().map(|path| {
            let text = std::fs::read_to_string(&path).expect("a source file");
            let path = path.strip_prefix(&root).expect("below the root").to_path_buf();
            let first = path.iter().next().expect("a name").to_string_lossy();
            let module = first.trim_end_matches(".rs").to_owned();
            let code: Vec<&str> = text.lines().filter(|line| !line.trim_start().starts_with("//")).collect();
            Source { of, code: code.join("\n"), path, module }
        }));
    }
    assert!(all.len() > 300, "the library has moved: {} files", all.len());
    all
}

#[test]
fn crates_and_modules_know_only_those_before_them() {
    for (name, may_use, _) in CRATES {
        let manifest = std::fs::read_to_string(of_crate(name).join("Cargo.toml")).expect("a manifest");
        let used = manifest.split("[dev-dependencies]").next().unwrap_or_default();
        let used = used.lines().filter_map(|line| line.strip_suffix(".workspace = true"));
        let strange: Vec<&str> = used.filter(|u| u.starts_with("rayset") && !may_use.contains(u)).collect();
        assert!(strange.is_empty(), "{name} uses {strange:?}");
    }
    for Source { of, path, module, code } in library() {
        let (name, _, order) = CRATES[of];
        // The crate `rayset` only names what the others have.
        if module == "lib" || order.is_empty() {
            continue;
        }
        let own = order.iter().position(|m| *m == module);
        let own = own.unwrap_or_else(|| panic!("`{module}` has no place in the order of {name}"));
        for other in order.iter().skip(own + 1) {
            let known = format!("crate::{other}::");
            assert!(
                !code.contains(&known),
                "{name}: {} knows `{other}`, which comes after it",
                path.display()
            );
        }
    }
}

/// `cargo test` turns features of dependencies on for the program, too: what tests ask for beyond
/// it would be tested and not shipped.
#[test]
fn tests_turn_no_feature_on_in_what_is_shipped() {
    let mut manifests = Vec::new();
    for entry in std::fs::read_dir(of_crate("")).expect("the folder of crates") {
        manifests.push(std::fs::read_to_string(entry.expect("an entry").path().join("Cargo.toml")));
    }
    let manifests: Vec<String> = manifests.into_iter().map(|text| text.expect("a manifest")).collect();
    assert!(manifests.len() >= 10, "{} crates", manifests.len());
    let name = |line: &str| line.split(['.', ' ']).next().unwrap_or_default().to_owned();
    let lines = |of_tests: bool| {
        let sections = manifests.iter().flat_map(|text| text.split("\n[")).filter(move |section| {
            let head = section.lines().next().unwrap_or_default();
            head.ends_with("dependencies]") && head.contains("dev-") == of_tests
        });
        sections.flat_map(|section| section.lines().skip(1))
    };
    let shipped: Vec<String> = lines(false).map(name).collect();
    assert!(shipped.contains(&"serde_json".to_owned()) && shipped.contains(&"laz".to_owned()));
    let beyond: Vec<&str> = lines(true)
        .filter(|line| line.contains("features") && !line.contains("\"internals\""))
        .filter(|line| shipped.contains(&name(line)))
        // A runtime for the servers of tests, beside the one that the program makes.
        .filter(|line| name(line) != "tokio")
        .collect();
    assert!(beyond.is_empty(), "{beyond:?}");
}

/// They are compiled with the feature that opens the rest, for the sake of tests.
#[test]
fn examples_use_the_public_surface_alone() {
    let lib = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/lib.rs");
    let lib = std::fs::read_to_string(lib).expect("the root of the library");
    let hidden = lib.split_once("#[doc(hidden)]\npub use {").expect("what is hidden").1;
    let hidden: Vec<&str> =
        hidden.split(|letter: char| !(letter.is_alphanumeric() || letter == '_')).collect();
    let hidden: Vec<&str> =
        hidden.into_iter().filter(|word| CRATES.iter().any(|(.., modules)| modules.contains(word))).collect();
    assert!(hidden.contains(&"working_set") && hidden.contains(&"trace"), "{hidden:?}");
    let mut files = Vec::new();
    sources(&Path::new(env!("CARGO_MANIFEST_DIR")).join("examples"), &mut files);
    assert!(files.len() > 6);
    for path in files {
        let code = std::fs::read_to_string(&path).expect("an example");
        for module in &hidden {
            assert!(!code.contains(&format!("rayset::{module}")), "{} uses `{module}`", path.display());
            assert!(!code.contains(&format!("    {module}::")), "{} uses `{module}`", path.display());
        }
    }
}

#[test]
fn the_library_neither_prints_nor_reads_arguments_nor_keeps_global_state() {
    for Source { path, code, .. } in library() {
        // The hook that keeps panics of decoders quiet is the process's, as hooks are, and asks its
        // own thread. Who opens addresses is said once in a process, so that every path may be one.
        // And a process that a signal ends creates no further file anywhere.
        let of_the_process = ["points/quiet.rs", "storage/address.rs", "output/partial.rs"];
        if of_the_process.map(Path::new).contains(&path.as_path()) {
            continue;
        }
        for word in
            ["println!", "eprintln!", "env::args", "thread_local!", "OnceLock", "LazyLock", "LazyCell"]
        {
            assert!(!code.contains(word), "{}: {word}", path.display());
        }
        if let Some(item) = code.lines().find(|line| is_static(line)) {
            panic!("{}: {item}", path.display());
        }
    }
}

/// Whether a line begins a static: `static X`, `pub(crate) static mut X`.
fn is_static(line: &str) -> bool {
    let line = line.trim_start();
    let visible = line.strip_prefix("pub").map(str::trim_start);
    let line =
        visible.map_or(line, |rest| match rest.strip_prefix('(').and_then(|rest| rest.split_once(')')) {
            Some((_, rest)) => rest.trim_start(),
            None => rest,
        });
    line.strip_prefix("static").is_some_and(|rest| rest.starts_with(char::is_whitespace))
}

#[test]
fn statics_are_found_however_visible() {
    for line in ["static A: u8 = 0;", "pub static A: u8 = 0;", "  pub(crate) static mut A: u8 = 0;"] {
        assert!(is_static(line), "{line}");
    }
    for line in ["fn f(a: &'static str) {", "let statics = 1;", "public static"] {
        assert!(!is_static(line), "{line}");
    }
}

/// Where a ray's time goes: from the first call of a render to the inner loop of the kernel.
const RAYS_WAY: [&str; 2] = ["trace", "field"];
const MOST_LINES_OF_A_FUNCTION: usize = 60;
const MOST_LINES_OF_A_FILE: usize = 450;
/// The brute-force renderer is read on its own, and no ray of a picture passes through it.
const BESIDE_THE_WAY: &str = "trace/reference";

/// How the words begin that may stand before `fn`; comments begin otherwise.
const BEFORE_FN: [&str; 6] = ["pub", "const", "async", "unsafe", "extern", "\"C"];

/// The lengths of functions that are longer than allowed, each with the function's first line.
fn long_functions(text: &str, most: usize) -> Vec<(usize, String)> {
    let lines: Vec<&str> = text.lines().collect();
    let mut long = Vec::new();
    for (i, line) in lines.iter().enumerate() {
        let code = line.trim_start();
        let indent = &line[..line.len() - code.len()];
        let is_function = (code.split_whitespace())
            .find(|word| !BEFORE_FN.iter().any(|before| word.starts_with(before)))
            .is_some_and(|word| word == "fn");
        // The body of a function of one line, or of a macro's, is not sought.
        if !is_function || !code.ends_with(['{', '(', '<']) {
            continue;
        }
        let end = format!("{indent}}}");
        let length = 1 + lines[i..].iter().take_while(|line| **line != end).count();
        if length > most {
            long.push((length, code.to_owned()));
        }
    }
    long
}

#[test]
fn functions_and_files_on_a_rays_way_are_short() {
    let root = of_crate("rayset-render").join("src");
    let mut files = Vec::new();
    RAYS_WAY.iter().for_each(|module| sources(&root.join(module), &mut files));
    files.retain(|path| !path.starts_with(root.join(BESIDE_THE_WAY)));
    assert!(files.len() > 40, "a ray's way has moved: {}", root.display());
    for path in files {
        let text = std::fs::read_to_string(&path).expect("a source file");
        let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
        let lines = code.lines().count();
        assert!(lines <= MOST_LINES_OF_A_FILE, "{} has {lines} lines", path.display());
        let long = long_functions(code, MOST_LINES_OF_A_FUNCTION);
        assert!(long.is_empty(), "{}: {long:?}", path.display());
    }
}

#[test]
fn long_functions_are_found_whatever_stands_before_them() {
    let body = "    let a = 1;\n".repeat(4);
    for head in
        ["fn f() {", "pub(super) const fn f<T>(", "pub unsafe extern \"C\" fn f() {", "async fn f() {"]
    {
        let text = format!("{head}\n{body}}}\n");
        assert_eq!(long_functions(&text, 5).len(), 1, "{head}");
        assert!(long_functions(&text, 6).is_empty(), "{head}");
    }
    assert!(long_functions("fn f() { 1 }\nconst A: [u8; 1] = [\n1,\n2,\n3,\n4,\n5,\n];\n", 5).is_empty());
}

/// Columns that a comment may reach. Tables are as wide as they are.
const MOST_COLUMNS: usize = 100;

fn is_wide_comment(line: &str) -> bool {
    let Some(comment) = line.trim_start().strip_prefix("//") else { return false };
    let text = comment.trim_start_matches(['/', '!']).trim_start();
    line.chars().count() > MOST_COLUMNS && !text.starts_with('|')
}

#[test]
fn comments_fit_a_hundred_columns() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut files = Vec::new();
    for folder in ["crates", "python/src", "fuzz/src", "fuzz/fuzz_targets", "paper"] {
        sources(&root.join(folder), &mut files);
    }
    files.retain(|path| !path.components().any(|part| part.as_os_str() == "target"));
    assert!(files.len() > 600, "the sources have moved: {} files", files.len());
    let mut wide = Vec::new();
    for path in files {
        let text = std::fs::read_to_string(&path).expect("a source file");
        let lines = text.lines().enumerate().filter(|(_, line)| is_wide_comment(line));
        wide.extend(lines.map(|(number, _)| format!("{}:{}", path.display(), number + 1)));
    }
    assert!(wide.is_empty(), "{wide:#?}");
}

#[test]
fn wide_comments_are_found_and_tables_are_not() {
    let words = "word ".repeat(20);
    assert!(is_wide_comment(&format!("    /// {words}")) && is_wide_comment(&format!("//! {words}")));
    assert!(
        !is_wide_comment(&format!("/// | {words}")) && !is_wide_comment(&format!("    let a = {words};"))
    );
    assert!(!is_wide_comment("// a comment"));
}

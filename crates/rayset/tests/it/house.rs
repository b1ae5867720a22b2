//! The order of the modules, and what the library keeps away from.

use std::path::{Path, PathBuf};

/// Data flows this way: a module knows those before it and none behind.
const ORDER: [&str; 28] = [
    "parse",
    "setters",
    "sync",
    "cancel",
    "geometry",
    "regular_file",
    "text_numbers",
    "numbers",
    "storage",
    "array_file",
    "output",
    "spill",
    "vtk_xml",
    "points",
    "container",
    "octree",
    "grid",
    "working_set",
    "field",
    "scene",
    "image",
    "trace",
    "scene_file",
    "build",
    "file",
    "memory",
    "parts",
    "volumes",
];

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

/// Each file of the library with its module and its code without comments.
fn library() -> Vec<(PathBuf, String, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    sources(&root, &mut files);
    assert!(files.len() > 40, "the library has moved: {}", root.display());
    files
        .into_iter()
        .map(|path| {
            let place = path.strip_prefix(&root).expect("below the root").to_path_buf();
            let first = place.iter().next().expect("a name").to_string_lossy();
            let text = std::fs::read_to_string(&path).expect("a source file");
            let code: String =
                text.lines().filter(|l| !l.trim_start().starts_with("//")).collect::<Vec<_>>().join("\n");
            (place.clone(), first.trim_end_matches(".rs").to_owned(), code)
        })
        .collect()
}

#[test]
fn modules_know_only_those_before_them() {
    for (path, module, code) in library() {
        if module == "lib" {
            continue;
        }
        let own = ORDER.iter().position(|m| *m == module);
        let own = own.unwrap_or_else(|| panic!("`{module}` has no place in the order of modules"));
        for other in ORDER.iter().skip(own + 1) {
            let known = format!("crate::{other}::");
            assert!(!code.contains(&known), "{} knows `{other}`, which comes after it", path.display());
        }
    }
}

/// They are compiled with the feature that opens the rest, for the sake of tests.
#[test]
fn examples_use_the_public_surface_alone() {
    let lib = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/lib.rs");
    let lib = std::fs::read_to_string(lib).expect("the root of the library");
    let hidden: Vec<&str> =
        lib.split("#[doc(hidden)]\npub mod ").skip(1).filter_map(|rest| rest.split(';').next()).collect();
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
    for (path, _, code) in library() {
        // The hook that keeps panics of decoders quiet is the process's, as hooks are, and asks its own thread.
        // And who opens addresses is said once in a process, so that every path may be one.
        if [Path::new("points/quiet.rs"), Path::new("storage/address.rs")].contains(&path.as_path()) {
            continue;
        }
        for word in [
            "println!",
            "eprintln!",
            "env::args",
            "thread_local!",
            "OnceLock",
            "OnceCell",
            "LazyLock",
            "LazyCell",
        ] {
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
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
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

//! Folders and patterns as inputs: the files that they stand for.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};

/// Deepest nesting of folders that is followed.
const DEEPEST: usize = 32;

/// The files that inputs stand for: a file for itself, a folder for all files below it, a pattern such as `tiles/*.laz` for
/// those that match. Sorted within each folder and pattern, so that the order of a directory does not matter. Hidden files
/// and folders are left out.
pub(crate) fn expand(inputs: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for input in inputs {
        if input.is_dir() {
            let before = files.len();
            below(input, 0, &mut files)?;
            if files.len() == before {
                bail!("{} is a folder without files", input.display());
            }
        } else if is_pattern(input) && !input.exists() {
            matching(input, &mut files)?;
        } else {
            files.push(input.clone());
        }
    }
    Ok(files)
}

fn is_pattern(path: &Path) -> bool {
    path.to_string_lossy().contains(['*', '?', '['])
}

fn matching(pattern: &Path, files: &mut Vec<PathBuf>) -> Result<()> {
    let text = pattern.to_string_lossy();
    let paths = glob::glob(&text).with_context(|| format!("{text} is no pattern of file names"))?;
    let before = files.len();
    for path in paths {
        let path = path?;
        if path.is_file() {
            files.push(path);
        }
    }
    if files.len() == before {
        bail!("no file matches {text}");
    }
    Ok(())
}

fn below(folder: &Path, depth: usize, files: &mut Vec<PathBuf>) -> Result<()> {
    let doing = || format!("cannot read the folder {}", folder.display());
    if depth == DEEPEST {
        bail!("{}: folders are nested more than {DEEPEST} deep", folder.display());
    }
    let mut entries = Vec::new();
    for entry in std::fs::read_dir(folder).with_context(doing)? {
        let entry = entry.with_context(doing)?;
        if !entry.file_name().to_string_lossy().starts_with('.') {
            entries.push(entry.path());
        }
    }
    entries.sort();
    for path in entries {
        if path.is_dir() {
            below(&path, depth + 1, files)?;
        } else {
            files.push(path);
        }
    }
    Ok(())
}

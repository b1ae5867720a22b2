//! Folders and patterns as inputs: the files that they stand for.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use rayset::points::{self, ReadError, ReadOptions};
use rayset::storage::address_of;
use rayset::volumes;

use super::kinds;
use crate::host::Host;

/// What `-` stands for.
const STANDARD_INPUT: &str = "/dev/stdin";

/// Deepest nesting of folders that is followed.
const DEEPEST: usize = 32;

/// The files that inputs stand for.
#[derive(Clone, Debug, Default)]
pub struct Files {
    /// Their paths.
    pub paths: Vec<PathBuf>,
    /// Of each, whether a person named it; otherwise a folder or a pattern did.
    named: Vec<bool>,
}

impl Files {
    /// Whether a person named each file; otherwise a folder or a pattern did.
    #[must_use]
    pub fn are_named(&self) -> &[bool] {
        &self.named
    }

    /// Files of which is known whether a person named each; those beyond `named` were.
    #[must_use]
    pub fn of(paths: Vec<PathBuf>, mut named: Vec<bool>) -> Self {
        named.resize(paths.len(), true);
        Self { paths, named }
    }

    /// Each path, and whether a person named it.
    pub(crate) fn iter(&self) -> impl Iterator<Item = (&Path, bool)> {
        self.paths.iter().map(PathBuf::as_path).zip(self.named.iter().copied())
    }
}

/// The files that inputs stand for: a file for itself, a folder for all files below it that can be
/// read, a pattern such as `tiles/*.laz` for those that match. Sorted within each folder and
/// pattern, so that the order of a directory does not matter. Hidden files and folders are left
/// out. A folder that is one thing, as a series of DICOM or a Zarr array is, stands for itself. `-`
/// is the standard input.
pub fn expand(inputs: &[PathBuf], host: &dyn Host) -> Result<Files> {
    let (mut files, mut named) = (Vec::new(), Vec::new());
    for input in inputs {
        named.resize(files.len(), false);
        if cfg!(unix) && input.as_os_str() == "-" {
            files.push(STANDARD_INPUT.into());
            named.push(true);
        } else if input.is_dir() {
            let before = files.len();
            below(input, 0, &mut files)?;
            if files.len() == before {
                bail!("{} is a folder without files", input.display());
            }
            let found = files.split_off(before);
            files.extend(readable(input, found, host)?);
        } else if address_of(input).is_none() && is_pattern(input) && !input.exists() {
            matching(input, &mut files)?;
        } else {
            files.push(input.clone());
            named.push(true);
        }
    }
    named.resize(files.len(), false);
    Ok(Files { paths: files, named })
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

/// Of the files of a folder those that can be read. The others, read-me files and previews among
/// them, are named.
fn readable(folder: &Path, files: Vec<PathBuf>, host: &dyn Host) -> Result<Vec<PathBuf>> {
    if let [_] = files.as_slice() {
        return Ok(files);
    }
    let (mut kept, mut left_out) = (Vec::new(), Vec::new());
    for file in files {
        match why_not(&file)? {
            None => kept.push(file),
            Some(why) => left_out.push((file, why)),
        }
    }
    let Some((first, why)) = left_out.first() else { return Ok(kept) };
    let first = first.strip_prefix(folder).unwrap_or(first);
    if kept.is_empty() {
        bail!("none of the {} files in {} can be read: {why}", left_out.len(), folder.display());
    }
    host.remark(&format!(
        "left out {} of {} files in {}, the first being {}: name it to be told why",
        left_out.len(),
        left_out.len() + kept.len(),
        folder.display(),
        first.display()
    ));
    Ok(kept)
}

/// Why a file of a folder is not read; `None` if it is, or has something in it that a person has to
/// be told.
fn why_not(file: &Path) -> Result<Option<String>> {
    if file.is_dir() || volumes::is_volume(file)? || kinds::is_built(file)? {
        return Ok(None);
    }
    if kinds::is_scene(file)? {
        return Ok(Some(format!("{} is a scene", file.display())));
    }
    let ends = |names: &[&str]| {
        names.iter().any(|name| file.extension().is_some_and(|e| e.eq_ignore_ascii_case(name)))
    };
    if !ends(&["txt", "csv", "asc"]) && ReadOptions::extensions().any(|known| ends(&[known])) {
        return Ok(None);
    }
    Ok(match points::open(file, &ReadOptions::default()) {
        Ok(_) => None,
        Err(error @ (ReadError::UnknownFormat { .. } | ReadError::Malformed { .. })) => {
            Some(error.to_string())
        }
        Err(error) => return Err(error.into()),
    })
}

/// Whether a folder is one thing that is not read, for which there is a sentence.
fn is_one_thing(folder: &Path) -> Result<bool> {
    let error = points::open(folder, &ReadOptions::default()).err();
    let is_known = |error: &ReadError| match error {
        ReadError::UnknownFormat { advice, .. } => !advice.starts_with("this is a folder"),
        _ => false,
    };
    Ok(volumes::is_volume(folder)? || error.as_ref().is_some_and(is_known))
}

fn below(folder: &Path, depth: usize, files: &mut Vec<PathBuf>) -> Result<()> {
    let doing = || format!("cannot read the folder {}", folder.display());
    if depth == DEEPEST {
        bail!("{}: folders are nested more than {DEEPEST} deep", folder.display());
    }
    if is_one_thing(folder)? {
        files.push(folder.to_owned());
        return Ok(());
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

//! The files of a snapshot that was written in several: `snap_004.0.hdf5`, `snap_004.1.hdf5`, or
//! `snap_004.0`, ….

use std::io;
use std::path::{Path, PathBuf};

use super::{Place, ReadError};
use rayset_store::storage::input_file;

/// Largest number of files of a snapshot.
const MOST_FILES: u64 = 1 << 16;

/// All `count` files of the snapshot to which the file at `path` belongs, in order; `extension` is
/// what follows the number in their names, with its dot, or empty.
///
/// # Errors
/// If the name has no number below `count`, or one of the files is missing or cannot be looked at.
pub(super) fn of(path: &Path, count: u64, extension: &str) -> Result<Vec<PathBuf>, ReadError> {
    if count <= 1 {
        return Ok(vec![path.to_owned()]);
    }
    let fail = |what: String| ReadError::malformed(path, Place::Byte(0), what);
    if count > MOST_FILES {
        return Err(fail(format!(
            "its header says that it is one of {count} files; at most {MOST_FILES} are read"
        )));
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let base = name.strip_suffix(extension).and_then(|stem| stem.rsplit_once('.'));
    let base = base.filter(|(_, number)| number.parse::<u64>().is_ok_and(|number| number < count));
    let Some((base, _)) = base else {
        return Err(fail(format!(
            "its header says that it is one of {count} files; expected a name with its number, as in \
             {}.0{extension}, by which the others are found",
            name.strip_suffix(extension).unwrap_or(&name)
        )));
    };
    let files = (0..count).map(|number| path.with_file_name(format!("{base}.{number}{extension}")));
    let files: Vec<PathBuf> = files.collect();
    for file in &files {
        input_file::look(file).map_err(|error| {
            let source = if error.kind() == io::ErrorKind::NotFound {
                let what =
                    format!("it is one of the {count} files of a snapshot with {name}, and is not there");
                io::Error::new(io::ErrorKind::NotFound, what)
            } else {
                error
            };
            ReadError::Io { path: file.clone(), source }
        })?;
    }
    Ok(files)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_found_by_their_numbers_and_the_missing_one_is_named() {
        let folder = tempfile::tempdir().expect("a folder");
        let at = |name: &str| folder.path().join(name);
        for name in ["s.0.h5", "s.1.h5", "t.0", "t.1"] {
            std::fs::write(at(name), "").expect("a write");
        }
        assert_eq!(of(&at("s.1.h5"), 2, ".h5").expect("two"), [at("s.0.h5"), at("s.1.h5")]);
        assert_eq!(of(&at("t.0"), 2, "").expect("two"), [at("t.0"), at("t.1")]);
        assert_eq!(of(&at("s.1.h5"), 1, ".h5").expect("itself"), [at("s.1.h5")]);
        let said = of(&at("s.0.h5"), 3, ".h5").expect_err("one is missing").to_string();
        assert!(said.contains("s.2.h5") && said.contains("one of the 3 files"), "{said}");
        for name in ["s.h5", "s.2.h5", "s.x.h5"] {
            let said = of(&at(name), 2, ".h5").expect_err("no number").to_string();
            assert!(said.contains("one of 2 files; expected a name with its number"), "{said}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn a_file_that_the_system_cannot_look_at_is_not_said_to_be_missing() {
        let folder = tempfile::tempdir().expect("a folder");
        let [first, second] = ["s.0.h5", "s.1.h5"].map(|name| folder.path().join(name));
        std::fs::write(&first, "").expect("a write");
        std::os::unix::fs::symlink(&second, &second).expect("a link to itself");
        let Err(ReadError::Io { path, source }) = of(&first, 2, ".h5") else {
            panic!("expected what the system says")
        };
        assert_eq!(path, second);
        assert_ne!(source.kind(), io::ErrorKind::NotFound);
        assert!(source.raw_os_error().is_some(), "{source}");
    }
}

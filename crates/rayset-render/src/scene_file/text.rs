//! Reads the text of scene and preset files.

use std::io::Read;
use std::path::Path;

use rayset_store::storage::input_file::InputFile;

/// Longest scene or preset file that is read, in bytes.
const LONGEST_BYTES: u64 = 4 << 20;

/// Reads the text of a scene or a preset.
pub(super) fn read_text(path: &Path) -> std::io::Result<String> {
    let (mut text, file) = (String::new(), InputFile::open(path)?);
    if file.take(LONGEST_BYTES + 1).read_to_string(&mut text)? as u64 > LONGEST_BYTES {
        let what = "longer than 4 MiB; points and voxels belong into files of their own";
        return Err(std::io::Error::new(std::io::ErrorKind::FileTooLarge, what));
    }
    Ok(text)
}

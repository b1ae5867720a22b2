//! Opening files whose paths come from users: anything that is not a regular file is an error
//! before any of it is read. Reading a pipe would wait for a writer, and a device may never end.
//! And reading what is buffered of them, whatever signals come.

use std::fs::{File, FileType, OpenOptions};
use std::io::{self, BufRead};
use std::path::Path;

/// Opens a regular file, or a link to one, for reading.
///
/// # Errors
/// As [`File::open`], and if the path is a folder, a pipe, a socket or a device.
pub fn open(path: &Path) -> io::Result<File> {
    check(std::fs::metadata(path)?.file_type())?;
    let mut options = OpenOptions::new();
    options.read(true);
    // Another file may take the name between the check and the opening.
    #[cfg(unix)]
    {
        use std::os::unix::fs::OpenOptionsExt;
        options.custom_flags(rustix::fs::OFlags::NONBLOCK.bits() as i32);
    }
    let file = options.open(path)?;
    check(file.metadata()?.file_type())?;
    Ok(file)
}

/// What the buffer of a reader holds, filled if it is empty; empty at the end. Unlike `fill_buf`,
/// it tries again if a signal interrupts the read.
pub fn held<R: BufRead + ?Sized>(input: &mut R) -> io::Result<&[u8]> {
    loop {
        match input.fill_buf() {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
            Ok(_) => break,
        }
    }
    // Of a buffer that holds something nothing is read. At the end, another read finds the end.
    match input.fill_buf() {
        Err(error) if error.kind() == io::ErrorKind::Interrupted => Ok(&[]),
        held => held,
    }
}

fn check(kind: FileType) -> io::Result<()> {
    if kind.is_file() {
        return Ok(());
    }
    Err(io::Error::new(io::ErrorKind::InvalidInput, format!("it is {}, not a regular file", name_of(kind))))
}

fn name_of(kind: FileType) -> &'static str {
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        if kind.is_fifo() {
            return "a pipe";
        }
        if kind.is_socket() {
            return "a socket";
        }
        if kind.is_char_device() || kind.is_block_device() {
            return "a device";
        }
    }
    if kind.is_dir() { "a folder" } else { "something else" }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn only_regular_files_and_links_to_them_open() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("file");
        std::fs::write(&file, "text").expect("a write");
        std::os::unix::fs::symlink(&file, folder.path().join("link")).expect("a link");
        assert!(open(&file).is_ok() && open(&folder.path().join("link")).is_ok());
        let said = |path: &Path| open(path).expect_err("no regular file").to_string();
        assert_eq!(said(folder.path()), "it is a folder, not a regular file");
        assert_eq!(said(Path::new("/dev/zero")), "it is a device, not a regular file");
    }
}

//! What the viewer keeps in the user's state folder: the key of its cookies, and the page that
//! leads a browser to it.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use rayset_view::{SECRET_BYTES, secret};

use rayset_terminal::report::remark;

/// The key that cookies are signed with, kept in the user's state folder so that pages connect
/// again after a restart; one for this run alone if there is no such folder.
pub(super) fn key() -> [u8; SECRET_BYTES] {
    match kept_key() {
        Ok(key) => key,
        Err(error) => {
            remark(format_args!("pages will not connect again after a restart: {error:#}"));
            // Without random numbers the server issues no invitation either, and says so.
            secret().unwrap_or_default()
        }
    }
}

fn kept_key() -> Result<[u8; SECRET_BYTES]> {
    let path = folder()?.join("view-key");
    if let Ok(bytes) = std::fs::read(&path)
        && let Ok(key) = bytes.try_into()
        && is_private(&path)
    {
        return Ok(key);
    }
    let key = secret()?;
    write_private(&path, &key)?;
    Ok(key)
}

/// The folder for what the program remembers between runs.
fn folder() -> Result<PathBuf> {
    let state = std::env::var_os("XDG_STATE_HOME").map(PathBuf::from).filter(|path| path.is_absolute());
    let home = || std::env::home_dir().map(|home| home.join(".local/state"));
    let folder = state.or_else(home).context("there is no home folder")?.join("rayset");
    std::fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
    Ok(folder)
}

/// Writes a file that nobody else can read. It has its name only when it is whole, so that no other
/// run reads half of it.
fn write_private(path: &Path, bytes: &[u8]) -> Result<()> {
    let beside = path.with_extension(std::process::id().to_string());
    let mut options = std::fs::File::options();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let written = options.open(&beside).and_then(|mut file| file.write_all(bytes));
    written
        .and_then(|()| std::fs::rename(&beside, path))
        .with_context(|| format!("cannot write {}", path.display()))
}

/// Whether nobody else may read a file.
fn is_private(path: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        std::fs::metadata(path).is_ok_and(|metadata| metadata.mode() & 0o077 == 0)
    }
    #[cfg(not(unix))]
    path.exists()
}

/// Opens the user's browser, if there is one. What is handed over is a file that only the user can
/// read, which leads to the address: others on the machine see the arguments of programs.
pub(super) fn open_browser(address: &str) {
    let page = format!(
        "<!doctype html><meta charset=utf-8><meta http-equiv=refresh content=\"0; url={address}\">\
         <a href=\"{address}\">Open the viewer</a>\n"
    );
    let opened = folder().and_then(|folder| {
        let path = folder.join("view-open.html");
        write_private(&path, page.as_bytes())?;
        start_browser(&path)
    });
    if opened.is_err() {
        remark("no browser was found; open the address in one");
    }
}

fn start_browser(page: &Path) -> Result<()> {
    let opener = if cfg!(target_os = "macos") { "open" } else { "xdg-open" };
    let quiet = std::process::Stdio::null;
    let mut command = std::process::Command::new(opener);
    command.arg(page).stdin(quiet()).stdout(quiet()).stderr(quiet()).spawn()?;
    Ok(())
}

//! Options of objects that are far away, which all commands have.

use std::env;
use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use clap::Args;
use rayset_far::Settings;
use rayset_inputs::values;

/// The cache's size if none is said.
const USUAL_BYTES: u64 = 8 << 30;
/// Variables of the environment that say what the options say.
const FOLDER: &str = "RAYSET_FAR_CACHE";
const SIZE: &str = "RAYSET_FAR_CACHE_SIZE";

/// Options of addresses.
#[derive(Args)]
#[command(next_help_heading = "Addresses: s3://, gs://, az://, https:// (docs/far.md)")]
pub(crate) struct FarArgs {
    /// Folder that keeps what was read of addresses; nothing is kept if none is named, here or by RAYSET_FAR_CACHE
    #[arg(long, global = true, value_name = "FOLDER", hide_short_help = true)]
    far_cache: Option<PathBuf>,
    /// Most bytes of that folder, which it never exceeds: 8GiB by default, or RAYSET_FAR_CACHE_SIZE
    #[arg(long, global = true, value_name = "SIZE", value_parser = values::size, hide_short_help = true)]
    far_cache_size: Option<u64>,
}

impl FarArgs {
    /// Opens addresses from now on.
    pub(crate) fn open(&self) -> Result<()> {
        let set = |name| env::var_os(name).filter(|value| !value.is_empty());
        let folder = self.far_cache.clone().or_else(|| set(FOLDER).map(PathBuf::from));
        if !rayset_far::is_available() && self.far_cache.is_some() {
            bail!(
                "--far-cache keeps what is read of addresses, which this program was built without: build it with `--features far`"
            );
        }
        let size = match (self.far_cache_size, set(SIZE)) {
            (Some(size), _) => size,
            (None, Some(text)) => {
                values::size(&text.to_string_lossy()).map_err(anyhow::Error::msg).context(SIZE)?
            }
            (None, None) => USUAL_BYTES,
        };
        if folder.is_none() && self.far_cache_size.is_some() {
            bail!("--far-cache-size is the size of a folder that no --far-cache names");
        }
        Ok(rayset_far::open_addresses(&Settings { cache: folder.map(|folder| (folder, size)) })?)
    }
}

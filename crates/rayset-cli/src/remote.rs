//! Options for remote objects, which all commands have.

use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::Args;
use rayset_inputs::values;
use rayset_remote::Settings;

/// Options of addresses.
#[derive(Args)]
#[command(next_help_heading = "Addresses: s3://, gs://, az://, https:// (docs/remote.md)")]
pub(crate) struct RemoteArgs {
    /// Folder that keeps what was read of addresses; nothing is kept if none is named, here or by
    /// RAYSET_REMOTE_CACHE
    #[arg(long, global = true, value_name = "FOLDER", hide_short_help = true)]
    remote_cache: Option<PathBuf>,
    /// Most bytes of that folder, which it never exceeds: 8GiB by default, or
    /// RAYSET_REMOTE_CACHE_SIZE
    #[arg(long, global = true, value_name = "SIZE", value_parser = values::size, hide_short_help = true)]
    remote_cache_size: Option<u64>,
}

impl RemoteArgs {
    /// Opens addresses from now on, for a command that may use so much memory, if it says that.
    pub(crate) fn open(&self, memory: Option<u64>) -> Result<()> {
        // While an output is sent, what it was made in is free again.
        const SENDING: u64 = 4;
        const LEAST_AND_MOST_SENDING: (u64, u64) = (8 << 20, 64 << 20);
        if !rayset_remote::is_available() && self.remote_cache.is_some() {
            bail!(
                "--remote-cache keeps what is read of addresses, which this program was built without: build it with `--features remote`"
            );
        }
        // What an option says is not sought in the environment, where it may be no size.
        let size = |text: &str| self.remote_cache_size.map_or_else(|| values::size(text), Ok);
        let mut settings = Settings::of_environment(size).map_err(anyhow::Error::msg)?;
        let (folder, bytes) = settings.cache.take().unzip();
        let folder = self.remote_cache.clone().or(folder);
        if folder.is_none() && self.remote_cache_size.is_some() {
            bail!("--remote-cache-size is the size of a folder that no --remote-cache names");
        }
        let bytes = self.remote_cache_size.or(bytes).unwrap_or(Settings::USUAL_BYTES);
        let (least, most) = LEAST_AND_MOST_SENDING;
        settings.sending_bytes = memory.map(|memory| (memory / SENDING).clamp(least, most));
        settings.cache = folder.map(|folder| (folder, bytes));
        Ok(rayset_remote::open_addresses(&settings)?)
    }
}

//! `rayset merge`: joins what several runs made parts of.

mod args;
mod cloud;
mod picture;

use std::io::Read;
use std::path::Path;

use anyhow::{Context, Result, bail};
use rayset::parts::PART_MAGIC;
use rayset::storage::InputFile;

pub(crate) use self::args::MergeArgs;

pub(crate) fn run(args: &MergeArgs) -> Result<()> {
    let Some(first) = args.parts.first() else { bail!("there are no parts to join") };
    if first.is_dir() {
        let [folder] = args.parts.as_slice() else { bail!("a cloud is merged from one folder") };
        return cloud::run(&cloud::Merge {
            folder,
            output: &args.output,
            memory: args.memory,
            keep: args.keep,
            aggregates: &args.aggregates,
            json: args.json,
        });
    }
    match start_of(first)? {
        PART_MAGIC => {
            if let Some(option) = args.aggregates.given() {
                bail!("{option} is for clouds, and these are parts of a picture");
            }
            picture::run(args)
        }
        _ => {
            bail!(
                "{}: byte 0: not a part; `rayset render --part` writes parts of pictures, `rayset build --part` folders of parts of clouds",
                first.display()
            )
        }
    }
}

/// The first eight bytes of a file or an object, or as many as there are.
fn start_of(path: &Path) -> Result<[u8; 8]> {
    let reading = || format!("cannot read {}", path.display());
    let mut start = Vec::new();
    // A pipe would be waited for, and is refused.
    InputFile::open(path).with_context(reading)?.take(8).read_to_end(&mut start).with_context(reading)?;
    start.resize(8, 0);
    Ok(start.try_into().unwrap_or_default())
}

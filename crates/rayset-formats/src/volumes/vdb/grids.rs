//! The beginning of a file, and the list of its grids.

use super::stream::{Stream, Wrong};

const MAGIC: [u8; 8] = [b' ', b'B', b'D', b'V', 0, 0, 0, 0];
/// The first of these stores masks of nodes as all later ones do.
const VERSIONS: std::ops::RangeInclusive<u32> = 222..=225;
const UUID_BYTES: u64 = 36;
const MOST_NAME_BYTES: u64 = 1 << 16;
/// Ends the name of a grid that shares it with others; a number follows.
const NUMBER_MARK: char = '\u{1e}';
const HALF: &str = "_HalfFloat";

/// A grid in a file.
pub(super) struct GridDescriptor {
    pub(super) name: String,
    /// The type of its tree, as in `Tree_float_5_4_3`.
    pub(super) tree: String,
    /// Whether its values are stored in half precision.
    pub(super) half: bool,
    /// Whether it shares the tree of another grid.
    pub(super) instance: bool,
    /// The offset of its compression, with which it begins.
    pub(super) start: u64,
}

/// What the beginning of a file says.
pub(super) struct Head {
    /// All grids, or the first alone if the file does not say where the others are.
    pub(super) entries: Vec<GridDescriptor>,
    /// The name of the program that wrote the file; empty if it does not say.
    pub(super) creator: String,
}

pub(super) fn read(stream: &mut Stream) -> Result<Head, Wrong> {
    if stream.array()? != MAGIC {
        return Err(Wrong { at: 0, what: "this is not an OpenVDB file".into() });
    }
    let version = stream.u32()?;
    if !VERSIONS.contains(&version) {
        let what = format!(
            "version {version} of the format; {} to {} are read. OpenVDB writes it anew: \
             `vdb_tool -read old.vdb -write new.vdb`",
            VERSIONS.start(),
            VERSIONS.end()
        );
        return Err(Wrong { at: 8, what });
    }
    // The version of the library.
    stream.skip(8)?;
    let with_offsets = stream.u8()? != 0;
    stream.skip(UUID_BYTES)?;
    let mut creator = String::new();
    metadata(stream, |name, text| {
        if name == "creator" {
            text.clone_into(&mut creator);
        }
    })?;
    let count = stream.u32()?;
    let mut entries = Vec::new();
    for number in 0..count {
        let (entry, end) = entry(stream)?;
        entries.push(entry);
        if !with_offsets {
            break;
        }
        // Every grid ends behind its beginning, so the list does.
        if number + 1 < count {
            if end <= stream.at() {
                return Err(stream.wrong(format!("a grid is said to end at byte {end}")));
            }
            stream.seek(end)?;
        }
    }
    Ok(Head { entries, creator })
}

/// A grid, and the offset of its end.
fn entry(stream: &mut Stream) -> Result<(GridDescriptor, u64), Wrong> {
    let name = stream.text(MOST_NAME_BYTES)?;
    let tree = stream.text(MOST_NAME_BYTES)?;
    let instance = !stream.text(MOST_NAME_BYTES)?.is_empty();
    // Where it begins, where its values do, where it ends. It begins right here.
    let [_, _, end] = [stream.i64()?, stream.i64()?, stream.i64()?];
    let entry = GridDescriptor {
        name: name.split(NUMBER_MARK).next().unwrap_or_default().to_owned(),
        half: tree.ends_with(HALF),
        tree: tree.trim_end_matches(HALF).to_owned(),
        instance,
        start: stream.at(),
    };
    Ok((entry, u64::try_from(end).unwrap_or(0)))
}

/// Reads named values, and hands on the texts among them, except very long ones.
pub(super) fn metadata(stream: &mut Stream, mut text: impl FnMut(&str, &str)) -> Result<(), Wrong> {
    let count = stream.u32()?;
    for _ in 0..count {
        let name = stream.text(MOST_NAME_BYTES)?;
        let kind = stream.text(MOST_NAME_BYTES)?;
        let bytes = u64::from(stream.u32()?);
        if kind == "string" && bytes <= MOST_NAME_BYTES {
            text(&name, &stream.letters(bytes)?);
        } else {
            stream.skip(bytes)?;
        }
    }
    Ok(())
}

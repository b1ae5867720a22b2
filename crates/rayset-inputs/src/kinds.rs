//! What a file is, by its first bytes, so that errors about other files can say what to do with
//! them.

use std::io::Read;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use rayset::file::{FileKind, LEAST_FILE_BYTES};
use rayset::storage::{InputFile, Named, look};
use rayset::volumes;
use rayset::{Cloud, Grid, points};

/// A file built by rayset.
pub enum Built {
    /// Of points.
    Cloud(Arc<Cloud>),
    /// Of voxels.
    Grid(Box<Grid>),
}

/// Files of JSON that are no scenes: endings of their names, in lower case.
const NO_SCENES: [&str; 9] = [
    ".gltf",
    ".geojson",
    ".topojson",
    "tileset.json",
    "ept.json",
    "zarr.json",
    "reconstruction.json",
    "transforms.json",
    ".ipynb",
];

/// Bytes of JSON that are looked at for the key that scenes have.
const MOST_JSON: u64 = 1 << 20;

/// Whether a file is a scene: by its name, or because it begins as JSON does, unless it is JSON of
/// someone else.
pub fn is_scene(path: &Path) -> Result<bool> {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
    if NO_SCENES.iter().any(|ending| name.ends_with(ending)) {
        return Ok(false);
    }
    Ok((name.ends_with(".json") || head(path)?.starts_with(b"{")) && !is_other_json(path)?)
}

/// Whether a file is whole JSON of someone else: a list, or an object without the key `rayset`
/// whose first key no scene has.
fn is_other_json(path: &Path) -> Result<bool> {
    /// Keys of scenes.
    const KEYS: [&str; 11] = [
        "$schema",
        "rayset",
        "comment",
        "image",
        "camera",
        "background",
        "lights",
        "rendering",
        "animation",
        "define",
        "root",
    ];
    let doing = || format!("cannot open {}", path.display());
    let mut text = Vec::new();
    if matches!(look(path).with_context(doing)?, Named::File(_)) {
        InputFile::open(path)
            .with_context(doing)?
            .take(MOST_JSON)
            .read_to_end(&mut text)
            .with_context(doing)?;
    }
    let text = String::from_utf8_lossy(&text);
    let text = text.trim_start_matches('\u{feff}').trim_start();
    if text.starts_with('[') {
        return Ok(true);
    }
    let first_key = text.strip_prefix('{').and_then(|rest| rest.trim_start().strip_prefix('"'));
    let first_key = first_key.and_then(|rest| rest.split('"').next());
    Ok(first_key.is_some_and(|key| !KEYS.contains(&key)) && !text.contains("\"rayset\""))
}

/// Whether a file was built by rayset, or was going to be.
pub fn is_built(path: &Path) -> Result<bool> {
    let head = head(path)?;
    let named = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("rset"));
    Ok(named || [FileKind::Cloud, FileKind::Grid].iter().any(|kind| head == kind.magic()))
}

/// The first eight bytes of a regular file; none of anything else.
fn head(path: &Path) -> Result<Vec<u8>> {
    let doing = || format!("cannot open {}", path.display());
    let mut head = Vec::new();
    if matches!(look(path).with_context(doing)?, Named::File(_)) {
        InputFile::open(path).with_context(doing)?.take(8).read_to_end(&mut head).with_context(doing)?;
    }
    Ok(head)
}

/// Opens a cloud or a grid.
pub fn open_built(path: &Path) -> Result<Built> {
    let doing = || format!("cannot open {}", path.display());
    let bytes = match look(path).with_context(doing)? {
        Named::File(bytes) => bytes,
        Named::Folder => bail!("{} is a folder; name a cloud or grid file in it", path.display()),
        Named::Other => bail!(
            "{} is a pipe or a device; a cloud or grid is read in many places and has to be a regular file",
            path.display()
        ),
    };
    let head = head(path)?;
    let is_cloud = head == FileKind::Cloud.magic();
    let is_grid = head == FileKind::Grid.magic();
    if (is_cloud || is_grid) && bytes < LEAST_FILE_BYTES {
        bail!(
            "{} ends at byte {}; a {} file has at least {LEAST_FILE_BYTES}: copy or build it again",
            path.display(),
            bytes,
            if is_cloud { "cloud" } else { "grid" }
        );
    }
    if is_cloud {
        Ok(Built::Cloud(Arc::new(Cloud::open(path)?)))
    } else if is_grid {
        Ok(Built::Grid(Box::new(Grid::open(path)?)))
    } else {
        bail!("{} is neither a cloud file nor a grid file; {}", path.display(), advice(path, &head));
    }
}

/// What to do with a file that has not been built.
fn advice(path: &Path, head: &[u8]) -> String {
    let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    let name = path.display();
    let built = path.with_extension("rset");
    match head {
        [] => "it is empty".into(),
        _ if head.iter().all(|&byte| byte == 0) => {
            "it begins with zeros, as files do that were not finished".into()
        }
        [b'{', ..] => "a scene goes to `rayset check` or `rayset render`".into(),
        _ => match extension.as_str() {
            "json" => "a scene goes to `rayset check` or `rayset render`".into(),
            "png" | "exr" => "it is a picture by its name".into(),
            known
                if points::ReadOptions::extensions().chain(volumes::extensions()).any(|one| one == known) =>
            {
                format!("build one of it: `rayset build {name} -o {}`", built.display())
            }
            _ => "`rayset build` makes one of points or voxels".into(),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_of_any_kind_that_is_read_is_to_be_built() {
        for extension in
            ["ply", "e57", "pcd", "ptx", "spz", "ksplat", "stl", "dx", "vdb", "slc", "nii", "gz", "zst"]
        {
            let said = advice(Path::new(&format!("folder/a.{extension}")), b"12345678");
            assert_eq!(
                said,
                format!("build one of it: `rayset build folder/a.{extension} -o folder/a.rset`")
            );
        }
        let said = advice(Path::new("a.unknown"), b"12345678");
        assert_eq!(said, "`rayset build` makes one of points or voxels");
    }
}

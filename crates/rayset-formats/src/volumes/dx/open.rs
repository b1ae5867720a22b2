//! Which field of a file is read, and where its voxels are.

use std::path::{Path, PathBuf};

use super::super::data::{VoxelSpan, data_at, regular_file_bytes};
use super::objects::{Array, Location, Object, Objects, Positions};
use super::words::Words;
use rayset_base::geometry::{DAffine3, DMat3};
use rayset_base::numbers::Stored;
use rayset_base::text_numbers::{Behind, TextNumbers};
use rayset_files::grid::VolumeError;
use rayset_files::grid::{Described, VolumeSource, Voxels};

/// Whether a file begins with an object, behind comments.
pub(in super::super) fn is_dx(head: &[u8]) -> bool {
    let text = String::from_utf8_lossy(head);
    let first = text.lines().map(str::trim).find(|line| !line.is_empty() && !line.starts_with('#'));
    let mut words = first.unwrap_or_default().split_ascii_whitespace();
    let classes =
        ["class gridpositions", "class gridconnections", "class array", "class field", "class group"];
    words.next() == Some("object") && classes.iter().any(|class| text.contains(class))
}

pub(in super::super) fn open(path: &Path) -> Result<VolumeSource, VolumeError> {
    let mut words = Words::open(path)?;
    let objects = Objects::read(&mut words)?;
    let (positions, array) = chosen(&objects).ok_or_else(|| {
        let what = "no field with a regular grid (`gridpositions`) and an array of its data; irregular grids are not \
                    read as volumes";
        words.wrong(what)
    })?;
    let wrong = |what: &str| VolumeError::header(path, &array.place, what);
    let stored = array.stored().filter(|_| array.real && array.components == 1).ok_or_else(|| {
        wrong(&format!(
            "{} numbers of type {} each; one real number each is read",
            array.components, array.kind
        ))
    })?;
    let big_endian = !array.text && array.big_endian.unwrap_or(false);
    if !array.text && stored.bytes() > 1 && array.big_endian.is_none() {
        return Err(wrong(
            "binary numbers whose order of bytes is not said; write `msb` or `lsb` before `ieee`",
        ));
    }
    let described = described(path, positions, array, stored, big_endian)?;
    let bytes = described.check(path)?;
    let count = bytes / stored.bytes() as u64;
    if array.items != count {
        return Err(wrong(&format!("an array of {} items for a grid of {count} voxels", array.items)));
    }
    let voxels = voxels(path, &objects, array, stored, bytes)?;
    let source = VolumeSource::new(&described, bytes, voxels);
    let fields = objects.all.iter().filter(|(_, object)| matches!(object, Object::Field(_))).count();
    if fields < 2 {
        return Ok(source);
    }
    Ok(source.with_about(format!("the first field that has a regular grid is read, of {fields}")))
}

/// The grid and the data of the first field that has both; without fields, the first grid and
/// array.
fn chosen(objects: &Objects) -> Option<(&Positions, &Array)> {
    let fields = objects.all.iter().filter_map(|(_, object)| match object {
        Object::Field(parts) => Some(parts),
        _ => None,
    });
    let part = |parts: &[(String, String)], wanted: &str| {
        let (_, object) = parts.iter().find(|(name, _)| name == wanted)?;
        objects.get(object)
    };
    let joined = |parts: &Vec<(String, String)>| match (part(parts, "positions"), part(parts, "data")) {
        (Some(Object::Positions(positions)), Some(Object::Array(array))) => Some((positions, array)),
        _ => None,
    };
    if fields.clone().next().is_some() {
        return fields.into_iter().find_map(joined);
    }
    let positions = objects.all.iter().find_map(|(_, object)| match object {
        Object::Positions(positions) => Some(positions),
        _ => None,
    });
    let array = objects.all.iter().find_map(|(_, object)| match object {
        Object::Array(array) => Some(array),
        _ => None,
    });
    positions.zip(array)
}

fn described(
    path: &Path,
    positions: &Positions,
    array: &Array,
    stored: Stored,
    big_endian: bool,
) -> Result<Described, VolumeError> {
    let wrong = |what: &str| VolumeError::header(path, &positions.place, what);
    let [a, b, c] = <[u64; 3]>::try_from(&*positions.counts)
        .map_err(|_| wrong("expected `counts` and three numbers; grids of three dimensions are read"))?;
    let deltas = <[_; 3]>::try_from(&*positions.deltas);
    let [da, db, dc] = deltas.map_err(|_| wrong("expected three lines `delta` of three numbers"))?;
    let size = if array.of_cells { [c, b, a].map(|n| n.saturating_sub(1)) } else { [c, b, a] };
    let center = if array.of_cells { 0.5 * (da + db + dc) } else { 0.0 * da };
    let linear = DMat3::from_cols(dc, db, da);
    Ok(Described {
        size,
        stored,
        big_endian,
        scale: 1.0,
        offset: 0.0,
        space_from_voxel: DAffine3::from_mat3_translation(linear, positions.origin + center),
        size_place: format!("{}, counts", positions.place),
        axes_place: format!("{}, delta", positions.place),
    })
}

fn voxels(
    path: &Path,
    objects: &Objects,
    array: &Array,
    stored: Stored,
    bytes: u64,
) -> Result<Voxels, VolumeError> {
    let (path, start): (PathBuf, u64) = match &array.location {
        Location::Here(at) => (path.to_owned(), *at),
        Location::BehindHeader(offset) => (path.to_owned(), objects.end.saturating_add(*offset)),
        Location::Beside(name, offset) => (path.with_file_name(name), *offset),
    };
    if !array.text {
        return VoxelSpan { path: &path, start, bytes, rest: None }.plain();
    }
    let left = regular_file_bytes(&path)?.saturating_sub(start);
    // At least one digit each, and one separator between two numbers.
    if array.items > left / 2 + 1 {
        let what =
            format!("the file ends before all voxels are there: {left} bytes for {} numbers", array.items);
        return Err(VolumeError::Data { path, offset: 0, what });
    }
    let data = TextNumbers::new(data_at(&path, start)?, stored, array.items, Behind::Space);
    Ok(Voxels { path, data: Box::new(data), rest: None })
}

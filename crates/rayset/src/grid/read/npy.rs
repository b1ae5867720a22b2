//! Arrays of NumPy of three dimensions (`.npy`), alone or in an archive (`.npz`).
//!
//! An array is indexed as `a[z, y, x]`, as imageio and scikit-image do. In an archive, the only array of three dimensions
//! is read, or that of a usual name; `spacing` or `sampling`, and `origin`, are three numbers in the order of its axes.

use std::io::Read;
use std::path::Path;

use super::data::{Place, Voxels, data_at, io_error};
use super::error::ReadError;
use super::source::{Described, VolumeSource};
use super::stored::Stored;
use crate::array_file::{ArrayHeader, Member, is_archive, members};
use crate::geometry::{DAffine3, DMat3, DVec3};

/// The arrays that are read if several have three dimensions, the first first.
const USUAL_NAMES: [&str; 4] = ["volume", "data", "vol", "arr_0"];
const SPACINGS: [&str; 2] = ["spacing", "sampling"];
const ORIGIN: &str = "origin";
const EXTENSION: &str = ".npy";

/// Whether a file is an array of numbers of three dimensions, or an archive that has one.
pub(super) fn is_volume(head: &[u8], path: &Path) -> bool {
    if is_archive(head) {
        let volume = |(_, header): &(Member, ArrayHeader)| is_volume_array(header);
        return arrays(path).is_ok_and(|arrays| arrays.iter().any(volume));
    }
    ArrayHeader::read(&mut &*head).is_ok_and(|header| is_volume_array(&header))
}

/// One slice is a picture.
fn is_volume_array(header: &ArrayHeader) -> bool {
    header.shape.len() == 3 && header.shape.iter().all(|n| *n > 1) && stored(&header.descr).is_some()
}

pub(super) fn open(path: &Path) -> Result<VolumeSource, ReadError> {
    let mut file = data_at(path, 0)?;
    let mut magic = [0; 4];
    let archive = file.read_exact(&mut magic).is_ok() && is_archive(&magic);
    if archive {
        return open_archive(path);
    }
    let mut file = data_at(path, 0)?;
    let header = ArrayHeader::read(&mut file).map_err(|what| ReadError::header(path, "byte 0", &what))?;
    let described = described(&header, "its header", [1.0; 3], [0.0; 3]);
    let described = described.map_err(|what| ReadError::header(path, "its header", &what))?;
    let bytes = described.check(path)?;
    let voxels = Place { path, start: header.bytes, bytes, rest: Some(0) }.plain()?;
    Ok(VolumeSource::new(&described, bytes, voxels))
}

fn open_archive(path: &Path) -> Result<VolumeSource, ReadError> {
    let arrays = arrays(path)?;
    let volumes: Vec<&(Member, ArrayHeader)> = arrays.iter().filter(|(_, h)| is_volume_array(h)).collect();
    let usual = || USUAL_NAMES.iter().find_map(|name| volumes.iter().find(|(m, _)| stem(m) == *name));
    let chosen = if let [one] = volumes[..] { Some(one) } else { usual().copied() };
    let (member, header) = chosen.ok_or_else(|| {
        let names: Vec<String> = arrays.iter().map(|(m, h)| format!("`{}` {:?}", stem(m), h.shape)).collect();
        let what = format!(
            "expected one array of three dimensions, or one called {}; the archive has {}",
            USUAL_NAMES.join(", "),
            names.join(", ")
        );
        ReadError::header(path, "its arrays", &what)
    })?;
    let place = format!("array `{}`", stem(member));
    let triple = |names: &[&str], default: f64| {
        let found = arrays.iter().find(|(m, _)| names.contains(&stem(m)));
        found.map_or(Ok([default; 3]), |(member, _)| three(path, member))
    };
    let (spacing, origin) = (triple(&SPACINGS, 1.0)?, triple(&[ORIGIN], 0.0)?);
    let described = described(header, &place, spacing, origin);
    let described = described.map_err(|what| ReadError::header(path, &place, &what))?;
    let bytes = described.check(path)?;
    if member.bytes != header.bytes + bytes {
        let what = format!(
            "it has {} bytes, and {} were expected from its shape",
            member.bytes - header.bytes.min(member.bytes),
            bytes
        );
        return Err(ReadError::header(path, &place, &what));
    }
    let mut data = member.open(path).map_err(io_error(path))?;
    ArrayHeader::read(&mut data).map_err(|what| ReadError::header(path, &place, &what))?;
    let voxels = Voxels { path: path.to_owned(), data, rest: Some(0) };
    let source = VolumeSource::new(&described, bytes, voxels);
    if volumes.len() == 1 {
        return Ok(source);
    }
    Ok(source.with_about(format!(
        "the array `{}` is read, of {} with three dimensions",
        stem(member),
        volumes.len()
    )))
}

/// The arrays of an archive with their headers.
fn arrays(path: &Path) -> Result<Vec<(Member, ArrayHeader)>, ReadError> {
    let members = members(path).map_err(io_error(path))?;
    let arrays = members.into_iter().filter(|member| member.name.ends_with(EXTENSION));
    arrays
        .map(|member| {
            let mut data = member.open(path).map_err(io_error(path))?;
            let header = ArrayHeader::read(&mut data);
            let header = header
                .map_err(|what| ReadError::header(path, &format!("array `{}`", stem(&member)), &what))?;
            Ok((member, header))
        })
        .collect()
}

fn stem(member: &Member) -> &str {
    member.name.trim_end_matches(EXTENSION)
}

/// Reads an array of three numbers.
fn three(path: &Path, member: &Member) -> Result<[f64; 3], ReadError> {
    let wrong = |what: &str| ReadError::header(path, &format!("array `{}`", stem(member)), what);
    let mut data = member.open(path).map_err(io_error(path))?;
    let header = ArrayHeader::read(&mut data).map_err(|what| wrong(&what))?;
    let types = stored(&header.descr).filter(|_| header.shape == [3]);
    let (stored, big_endian) = types.ok_or_else(|| wrong("expected three numbers"))?;
    let mut all = [0.0; 3];
    for one in &mut all {
        let (mut from, mut to) = ([0; 8], [0; 4]);
        let from = &mut from[..stored.bytes()];
        data.read_exact(from).map_err(|_| wrong("the file ends within three numbers"))?;
        if big_endian {
            from.reverse();
        }
        let kind = stored.kind();
        if let (Stored::F64, Ok(bytes)) = (stored, <[u8; 8]>::try_from(&*from)) {
            // Single precision would round it.
            *one = f64::from_le_bytes(bytes);
        } else if stored.convert(from, &mut to[..kind.bytes()]) {
            *one = f64::from(kind.value(&to[..kind.bytes()]));
        }
    }
    Ok(all)
}

/// `place` is where an error is. `spacing` and `origin` are in the order of the axes of the array.
fn described(
    header: &ArrayHeader,
    place: &str,
    spacing: [f64; 3],
    origin: [f64; 3],
) -> Result<Described, String> {
    let (stored, big_endian) = stored(&header.descr).ok_or_else(|| {
        format!(
            "elements of the type `{}`; numbers of i1 to i8, u1 to u8 and f2 to f8 are read",
            header.descr
        )
    })?;
    let [nz, ny, nx] = <[u64; 3]>::try_from(&*header.shape)
        .map_err(|_| format!("an array of the shape {:?}; a volume has three dimensions", header.shape))?;
    let [dz, dy, dx] = spacing;
    let [x, y, z] = [DVec3::X * dx, DVec3::Y * dy, DVec3::Z * dz];
    let (size, axes) = if header.fortran { ([nz, ny, nx], [z, y, x]) } else { ([nx, ny, nz], [x, y, z]) };
    let linear = DMat3::from_cols(axes[0], axes[1], axes[2]);
    Ok(Described {
        size,
        stored,
        big_endian,
        scale: 1.0,
        offset: 0.0,
        space_from_voxel: DAffine3::from_mat3_translation(
            linear,
            DVec3::new(origin[2], origin[1], origin[0]),
        ),
        size_place: format!("{place}, shape"),
        axes_place: format!("{place}, spacing"),
    })
}

/// The type of elements, and whether they are big-endian. `None` if they are no real numbers.
fn stored(descr: &str) -> Option<(Stored, bool)> {
    let (order, kind) = descr.split_at_checked(1)?;
    let stored = match kind {
        "b1" | "u1" => Stored::U8,
        "i1" => Stored::I8,
        "u2" => Stored::U16,
        "i2" => Stored::I16,
        "u4" => Stored::U32,
        "i4" => Stored::I32,
        "u8" => Stored::U64,
        "i8" => Stored::I64,
        "f2" => Stored::F16,
        "f4" => Stored::F32,
        "f8" => Stored::F64,
        _ => return None,
    };
    match order {
        "<" | "|" | "=" => Some((stored, false)),
        ">" => Some((stored, true)),
        _ => None,
    }
}

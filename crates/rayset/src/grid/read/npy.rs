//! Arrays of NumPy of three dimensions (`.npy`), alone or in an archive (`.npz`).
//!
//! An array is indexed as `a[z, y, x]`, as imageio and scikit-image do. In an archive, the only array of three dimensions
//! is read, or that of a usual name; axes of length one besides these three do not count; `spacing` or `sampling`, and `origin`, are three numbers in the order of its axes.

use std::io::Read;
use std::path::Path;

use super::data::{Place, Voxels, data_at, io_error, regular_file_bytes};
use super::error::ReadError;
use super::source::{Described, VolumeSource};
use crate::array_file::{Array, Fault, Header, MAGIC, Member, is_archive, text_place};
use crate::geometry::{DAffine3, DMat3, DVec3};
use crate::numbers::Stored;
use crate::storage::is_of_reading;

/// The arrays that are read if several have three dimensions, the first first.
const USUAL_NAMES: [&str; 9] = ["volume", "data", "vol", "image", "img", "density", "scan", "ct", "arr_0"];
const SPACINGS: [&str; 2] = ["spacing", "sampling"];
const ORIGIN: &str = "origin";

fn of_fault(path: &Path) -> impl Fn(Fault) -> ReadError {
    move |fault| match fault {
        Fault::Io(source) => io_error(path)(source),
        Fault::Wrong { at, what } => ReadError::header(path, &format!("byte {at}"), &what),
    }
}

/// Whether a file is an array of numbers of three dimensions, or an archive that has one.
pub(super) fn is_volume(head: &[u8], path: &Path) -> Result<bool, ReadError> {
    if is_archive(head) {
        return match Array::all(path) {
            Ok(arrays) => {
                Ok(!is_of_points(&arrays) && arrays.iter().any(|array| is_volume_array(&array.header)))
            }
            Err(Fault::Io(source)) if is_of_reading(&source) => Err(io_error(path)(source)),
            // Whoever reads it will say what is wrong with it.
            Err(_) => Ok(false),
        };
    }
    let Some((start, length)) = text_place(head) else { return Ok(false) };
    let text = head.get(start..start.saturating_add(length as usize));
    let header = text.and_then(|text| Header::parse(text, start).ok());
    Ok(header.is_some_and(|header| is_volume_array(&header)))
}

/// Whether an archive is of points: another array has as many rows as one of three numbers a row, and no volume has a usual
/// name. Matrices of cameras stand beside such points.
fn is_of_points(arrays: &[Array]) -> bool {
    let rows = |array: &Array| array.header.shape.first().copied();
    let agrees = |array: &Array| arrays.iter().filter(|other| rows(other) == rows(array)).count() > 1;
    let is_usual = |array: &Array| USUAL_NAMES.contains(&array.member.name.as_str());
    let has_volume = arrays.iter().any(|array| is_usual(array) && is_volume_array(&array.header));
    let mut of_three = arrays.iter().filter(|array| matches!(*array.header.shape.as_slice(), [_, 3]));
    !has_volume && of_three.any(agrees)
}

/// One slice is a picture.
fn is_volume_array(header: &Header) -> bool {
    three_axes(header).is_some_and(|shape| shape.iter().all(|n| *n > 1) && !is_pictures(shape))
        && stored(header).is_some()
}

/// The three axes of an array, which may have others of length one, as those of batches and channels are.
fn three_axes(header: &Header) -> Option<[u64; 3]> {
    let longer: Vec<u64> = header.shape.iter().copied().filter(|n| *n > 1).collect();
    let shape = if header.shape.len() > 3 { longer } else { header.shape.clone() };
    shape.try_into().ok()
}

/// Whether the last axis has colours or coordinates: the array is a picture, a grid of points, or several clouds.
fn is_pictures([planes, rows, last]: [u64; 3]) -> bool {
    last <= 4 && (planes > 16 || rows > 16)
}

pub(super) fn open(path: &Path) -> Result<VolumeSource, ReadError> {
    let mut magic = Vec::new();
    data_at(path, 0)?.take(MAGIC.len() as u64).read_to_end(&mut magic).map_err(io_error(path))?;
    if is_archive(&magic) {
        return open_archive(path);
    }
    let array = Array::open(path, Member::whole(regular_file_bytes(path)?)).map_err(of_fault(path))?;
    let described = described(&array.header, "its header", [1.0; 3], [0.0; 3]);
    let described = described.map_err(|what| ReadError::header(path, "its header", &what))?;
    let bytes = described.check(path)?;
    let voxels = Place { path, start: array.header.bytes, bytes, rest: Some(0) }.plain()?;
    Ok(VolumeSource::new(&described, bytes, voxels))
}

fn open_archive(path: &Path) -> Result<VolumeSource, ReadError> {
    let arrays = Array::all(path).map_err(of_fault(path))?;
    let volumes: Vec<&Array> = arrays.iter().filter(|array| is_volume_array(&array.header)).collect();
    let called = |name: &str| volumes.iter().find(|array| array.member.name == name);
    let usual = || USUAL_NAMES.iter().find_map(|name| called(name)).copied();
    let chosen = if let [one] = volumes[..] { Some(one) } else { usual() };
    let array = chosen.ok_or_else(|| {
        let name = |array: &Array| format!("`{}` {:?}", array.member.name, array.header.shape);
        let names: Vec<String> = arrays.iter().map(name).collect();
        let what = format!(
            "expected one array of three dimensions, or one called {}; the archive has {}",
            USUAL_NAMES.join(", "),
            names.join(", ")
        );
        ReadError::header(path, "its arrays", &what)
    })?;
    let (member, header) = (&array.member, &array.header);
    let place = format!("array `{}`", member.name);
    let triple = |names: &[&str], default: f64| {
        let found = arrays.iter().find(|array| names.contains(&array.member.name.as_str()));
        found.map_or(Ok([default; 3]), |array| three(path, array))
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
    let data = member.open(path, header.bytes).map_err(io_error(path))?;
    let voxels = Voxels { path: path.to_owned(), data, rest: Some(0) };
    let source = VolumeSource::new(&described, bytes, voxels);
    if volumes.len() == 1 {
        return Ok(source);
    }
    Ok(source.with_about(format!(
        "the array `{}` is read, of {} with three dimensions",
        member.name,
        volumes.len()
    )))
}

/// Reads an array of three numbers.
fn three(path: &Path, array: &Array) -> Result<[f64; 3], ReadError> {
    let (member, header) = (&array.member, &array.header);
    let wrong = |what: &str| ReadError::header(path, &format!("array `{}`", member.name), what);
    let types = stored(header).filter(|_| header.shape == [3]);
    let (stored, big_endian) = types.ok_or_else(|| wrong("expected three numbers"))?;
    let mut data = member.open(path, header.bytes).map_err(io_error(path))?;
    let mut all = [0.0; 3];
    for one in &mut all {
        let (mut from, mut to) = ([0; 8], [0; 4]);
        let from = &mut from[..stored.bytes()];
        data.read_exact(from).map_err(|error| match is_of_reading(&error) {
            true => io_error(path)(error),
            false => wrong("the file ends within three numbers"),
        })?;
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
fn described(header: &Header, place: &str, spacing: [f64; 3], origin: [f64; 3]) -> Result<Described, String> {
    let (stored, big_endian) = stored(header).ok_or_else(|| {
        let kind = if header.is_structured { "records" } else { header.descr.as_str() };
        format!("elements of the type `{kind}`; numbers of i1 to i8, u1 to u8 and f2 to f8 are read")
    })?;
    let [nz, ny, nx] = three_axes(header)
        .ok_or_else(|| format!("an array of the shape {:?}; a volume has three dimensions", header.shape))?;
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
fn stored(header: &Header) -> Option<(Stored, bool)> {
    let field = header.fields.first().filter(|_| !header.is_structured)?;
    Some((field.scalar.stored, field.scalar.big_endian))
}

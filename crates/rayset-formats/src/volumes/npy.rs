//! Arrays of NumPy of three dimensions (`.npy`), alone or in an archive (`.npz`), or of more, which
//! are series of volumes.
//!
//! An array is indexed as `a[z, y, x]`, as imageio and scikit-image do; axes before these three are
//! those of a series, and axes of length one besides these three do not count. In an archive, the
//! only array of three dimensions is read, or that of a usual name, otherwise a series; `spacing`
//! or `sampling`, and `origin`, are three numbers in the order of the axes.

use std::io::Read;
use std::path::Path;

use super::data::{VoxelSpan, data_at, io_error, regular_file_bytes};
use super::series::Series;
use crate::array_file::{Array, Fault, Header, MAGIC, Member, is_archive, text_place};
use rayset_base::geometry::{DAffine3, DMat3, DVec3};
use rayset_base::numbers::Stored;
use rayset_files::grid::VolumeError;
use rayset_files::grid::{Described, VolumeSource, Voxels};
use rayset_store::storage::is_of_reading;

/// The arrays that are read if several have three dimensions, the first first.
const USUAL_NAMES: [&str; 9] = ["volume", "data", "vol", "image", "img", "density", "scan", "ct", "arr_0"];
const SPACINGS: [&str; 2] = ["spacing", "sampling"];
const ORIGIN: &str = "origin";

fn of_fault(path: &Path) -> impl Fn(Fault) -> VolumeError {
    move |fault| match fault {
        Fault::Io(source) => io_error(path)(source),
        Fault::Wrong { at, what } => VolumeError::header(path, &format!("byte {at}"), &what),
    }
}

/// Whether a file is an array of numbers of three dimensions, or an archive that has one.
pub(super) fn is_volume(head: &[u8], path: &Path) -> Result<bool, VolumeError> {
    if is_archive(head) {
        return match Array::all(path) {
            Ok(arrays) => Ok(has_volume(&arrays)),
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

/// Whether an archive is of points: another array has as many rows as one of three numbers a row,
/// and no volume has a usual name. Matrices of cameras stand beside such points.
fn is_of_points(arrays: &[Array]) -> bool {
    let rows = |array: &Array| array.header.shape.first().copied();
    let agrees = |array: &Array| arrays.iter().filter(|other| rows(other) == rows(array)).count() > 1;
    let is_usual = |array: &Array| USUAL_NAMES.contains(&array.member.name.as_str());
    let is_usual_volume = |array: &Array| is_usual(array) && is_volume_array(&array.header);
    let has_volume = arrays.iter().any(|array| is_usual_volume(array) && !is_series(&array.header));
    let mut of_three = arrays.iter().filter(|array| matches!(*array.header.shape.as_slice(), [_, 3]));
    !has_volume && of_three.any(agrees)
}

/// Whether an array of an archive is its volume, or one of them. An archive with an array of three
/// numbers a row has points, unless another is of three dimensions: arrays of more stand beside
/// points, too.
fn has_volume(arrays: &[Array]) -> bool {
    let of_three = arrays.iter().any(|array| matches!(*array.header.shape.as_slice(), [_, 3]));
    let is_one = |array: &Array| is_volume_array(&array.header) && !(of_three && is_series(&array.header));
    !is_of_points(arrays) && arrays.iter().any(is_one)
}

/// One slice is a picture.
fn is_volume_array(header: &Header) -> bool {
    axes(header).is_some_and(|axes| axes.volume.iter().all(|n| *n > 1) && !axes.is_pictures())
        && stored(header).is_some()
}

fn is_series(header: &Header) -> bool {
    axes(header).is_some_and(|axes| !axes.series.is_empty())
}

/// The axes of an array without those of length one, as those of batches and channels are.
struct Axes {
    /// Those before a volume, none of which is empty.
    series: Vec<u64>,
    volume: [u64; 3],
}

/// Most axes of a series.
const MOST_SERIES_AXES: usize = 4;

fn axes(header: &Header) -> Option<Axes> {
    let longer: Vec<u64> = header.shape.iter().copied().filter(|n| *n != 1).collect();
    let shape = if header.shape.len() > 3 { longer } else { header.shape.clone() };
    let (series, volume) = shape.split_at_checked(shape.len().checked_sub(3)?)?;
    let is_read = series.len() <= MOST_SERIES_AXES && !series.contains(&0);
    Some(Axes { series: series.to_vec(), volume: volume.try_into().ok()? }).filter(|_| is_read)
}

impl Axes {
    /// Whether the last axis has colours or coordinates: the array is a picture, a film, a grid of
    /// points, or several clouds.
    fn is_pictures(&self) -> bool {
        let [planes, rows, last] = self.volume;
        last <= 4 && (planes > 16 || rows > 16 || !self.series.is_empty())
    }

    /// The volume that is asked for, and in which of the places in the file it is: with Fortran's
    /// order the first axis is the fastest.
    fn series(
        &self,
        path: &Path,
        header: &Header,
        index: Option<u64>,
    ) -> Result<(Series, Series), VolumeError> {
        let too_long = || VolumeError::header(path, "its header", "a series longer than any file");
        let volumes = self.series.iter().try_fold(1_u64, |all, n| all.checked_mul(*n));
        let said = Series::new(path, volumes.ok_or_else(too_long)?, index)?;
        let (mut place, mut left, mut stride) = (0, said.index, said.volumes);
        for n in self.series.iter().rev() {
            stride /= n;
            place += left % n * stride;
            left /= n;
        }
        Ok((said, Series { index: if header.fortran { place } else { said.index }, ..said }))
    }
}

pub(super) fn open(path: &Path, index: Option<u64>) -> Result<VolumeSource, VolumeError> {
    let mut magic = Vec::new();
    data_at(path, 0)?.take(MAGIC.len() as u64).read_to_end(&mut magic).map_err(io_error(path))?;
    if is_archive(&magic) {
        return open_archive(path, index);
    }
    let array = Array::open(path, Member::whole(regular_file_bytes(path)?)).map_err(of_fault(path))?;
    volume(path, &array, "its header", [[1.0; 3], [0.0; 3]], index, |all| {
        VoxelSpan { path, start: array.header.bytes, bytes: all, rest: Some(0) }.plain()
    })
}

/// The volume of an array, of which `voxels` opens all bytes. `spacing` and `origin` are in the
/// order of its axes.
fn volume(
    path: &Path,
    array: &Array,
    place: &str,
    [spacing, origin]: [[f64; 3]; 2],
    index: Option<u64>,
    voxels: impl FnOnce(u64) -> Result<Voxels, VolumeError>,
) -> Result<VolumeSource, VolumeError> {
    let header = &array.header;
    let wrong = |what: &str| VolumeError::header(path, place, what);
    let described = described(header, place, spacing, origin).map_err(|what| wrong(&what))?;
    let bytes = described.check(path)?;
    let (said, series) = match axes(header) {
        Some(axes) => axes.series(path, header, index)?,
        None => (Series::new(path, 1, index)?, Series::new(path, 1, None)?),
    };
    let voxels = voxels(series.bytes(bytes).ok_or_else(|| wrong("a series longer than any file"))?)?;
    let voxels = if header.fortran && series.volumes > 1 {
        series.interleaved(voxels, bytes, described.stored.bytes()).map_err(|what| wrong(&what))?
    } else {
        series.in_sequence(voxels, bytes)?
    };
    Ok(said.said_by(VolumeSource::new(&described, bytes, voxels)))
}

fn open_archive(path: &Path, index: Option<u64>) -> Result<VolumeSource, VolumeError> {
    let arrays = Array::all(path).map_err(of_fault(path))?;
    let mut volumes: Vec<&Array> = arrays.iter().filter(|array| is_volume_array(&array.header)).collect();
    if volumes.iter().any(|array| !is_series(&array.header)) {
        volumes.retain(|array| !is_series(&array.header));
    }
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
        VolumeError::header(path, "its arrays", &what)
    })?;
    let (member, header) = (&array.member, &array.header);
    let place = format!("array `{}`", member.name);
    let triple = |names: &[&str], default: f64| {
        let found = arrays.iter().find(|array| names.contains(&array.member.name.as_str()));
        found.map_or(Ok([default; 3]), |array| three(path, array))
    };
    let space = [triple(&SPACINGS, 1.0)?, triple(&[ORIGIN], 0.0)?];
    let source = volume(path, array, &place, space, index, |all| {
        if member.bytes != header.bytes + all {
            let what = format!(
                "it has {} bytes, and {all} were expected from its shape",
                member.bytes - header.bytes.min(member.bytes)
            );
            return Err(VolumeError::header(path, &place, &what));
        }
        let data = member.open(path, header.bytes).map_err(io_error(path))?;
        Ok(Voxels { path: path.to_owned(), data, rest: Some(0) })
    })?;
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
fn three(path: &Path, array: &Array) -> Result<[f64; 3], VolumeError> {
    let (member, header) = (&array.member, &array.header);
    let wrong = |what: &str| VolumeError::header(path, &format!("array `{}`", member.name), what);
    let types = stored(header).filter(|_| header.shape == [3]);
    let (stored, big_endian) = types.ok_or_else(|| wrong("expected three numbers"))?;
    let mut data = member.open(path, header.bytes).map_err(io_error(path))?;
    let mut all = [0.0; 3];
    for one in &mut all {
        let mut from = [0; 8];
        let from = &mut from[..stored.bytes()];
        data.read_exact(from).map_err(|error| match is_of_reading(&error) {
            true => io_error(path)(error),
            false => wrong("the file ends within three numbers"),
        })?;
        if big_endian {
            from.reverse();
        }
        *one = stored.number(from);
    }
    Ok(all)
}

/// `place` is where an error is. `spacing` and `origin` are in the order of the axes of the array.
fn described(header: &Header, place: &str, spacing: [f64; 3], origin: [f64; 3]) -> Result<Described, String> {
    let (stored, big_endian) = stored(header).ok_or_else(|| {
        let kind = if header.is_structured { "records" } else { header.descr.as_str() };
        format!("elements of the type `{kind}`; numbers of i1 to i8, u1 to u8 and f2 to f8 are read")
    })?;
    let [nz, ny, nx] = axes(header)
        .map(|axes| axes.volume)
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

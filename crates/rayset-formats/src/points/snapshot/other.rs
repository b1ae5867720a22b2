//! HDF5 files that are no snapshots: what they are, as far as that can be seen, and what makes
//! points of them.

use super::hdf5::File;
use crate::points::ReadError;
use crate::points::roles::excerpt;

/// Largest number of datasets that a message names.
const MOST_NAMED: usize = 8;

/// Why a file whose data are in other files is not read.
pub(super) fn of_other_files(file: &File) -> ReadError {
    let stem = file.path.file_stem().unwrap_or_default().to_string_lossy();
    let what = format!(
        "this file of SWIFT has no particles of its own but refers to those of others, which is not read; open one of \
         these, as in {stem}.0.hdf5, and the rest are found"
    );
    file.wrong(0, what)
}

/// Why a file is not read that has no particles where snapshots have them.
pub(super) fn refused(file: &File) -> ReadError {
    let kind = kind_of(file).unwrap_or("HDF5, of no layout that is known");
    let contents = contents(file).unwrap_or_else(|_| "its contents cannot be listed".into());
    let way = way_out(&contents);
    let what = format!(
        "this is {kind}: expected a snapshot of a simulation, with PartType0/Coordinates; {contents}. {way}"
    );
    file.wrong(0, what)
}

/// What makes a file that opens, by the names and shapes of what is in it.
fn way_out(contents: &str) -> String {
    let has = |part: &str| contents.contains(part);
    if has("/axis0 (") || has("/table (") {
        return "It is a table of pandas: `pandas.read_hdf(\"FILE\").to_csv(\"points.csv\", index=False)` makes one that \
                opens"
            .into();
    }
    if has("block size (") || has("bounding box (") {
        return "It is output of FLASH: from Python with yt, `numpy.save(\"volume.npy\", g[\"density\"])` of `g = \
                yt.load(\"FILE\").arbitrary_grid(left, right, dims=(256, 256, 256))` makes a volume that opens"
            .into();
    }
    // `name (a × b × c)`: a last length of three is of positions.
    let arrays = contents.split(['(', ')']).skip(1).step_by(2);
    let is_volume = |shape: &str| shape.split(" × ").count() == 3 && !shape.ends_with(" × 3");
    if arrays.clone().any(is_volume) {
        return "`numpy.save(\"volume.npy\", f[\"…\"][:])` with h5py makes a volume of three dimensions that opens".into();
    }
    "Save positions and columns of it as NPZ, as in `numpy.savez(\"points.npz\", positions=f[\"…\"][:], \
     density=f[\"…\"][:])` with h5py"
        .into()
}

/// What a file is by the attributes of its root.
fn kind_of(file: &File) -> Option<&'static str> {
    let attributes = file.attributes(&file.root().ok()?).ok()?;
    let marks = [
        ("openPMD", "a file of openPMD"),
        ("_NCProperties", "a file of NetCDF-4"),
        ("MATLAB_class", "a file of MATLAB"),
        ("VTKHDF", "a file of VTKHDF"),
        ("GMSH", "a file of Gmsh"),
    ];
    marks.iter().find(|(mark, _)| attributes.has(mark)).map(|(_, kind)| *kind)
}

/// The datasets of the root and of its groups, with their shapes.
fn contents(file: &File) -> Result<String, ReadError> {
    let root = file.root()?;
    let (groups, datasets) = file.names(&root)?;
    let mut named: Vec<String> = Vec::new();
    let mut count = 0_usize;
    let mut note = |group: &hdf5_reader::group::Group, below: &str, names: Vec<String>| {
        for name in names {
            count += 1;
            if named.len() < MOST_NAMED {
                let shape = file
                    .guarded(group.address(), &name, || group.dataset(&name))
                    .map(|d| d.shape().iter().map(u64::to_string).collect::<Vec<_>>().join(" × "));
                named.push(format!(
                    "{below}{} ({})",
                    excerpt(&name),
                    shape.unwrap_or_else(|_| "unreadable".into())
                ));
            }
        }
    };
    note(&root, "", datasets);
    for name in groups.iter().take(100) {
        if let Some(group) = file.group(name)? {
            let (_, datasets) = file.names(&group)?;
            note(&group, &format!("{}/", excerpt(name)), datasets);
        }
    }
    Ok(match (named.as_slice(), count) {
        ([], _) => format!("it has {} groups and no datasets in them", groups.len()),
        (named, count) if count > named.len() => {
            format!("it has {}, and {} more", named.join(", "), count - named.len())
        }
        (named, _) => format!("it has {}", named.join(", ")),
    })
}

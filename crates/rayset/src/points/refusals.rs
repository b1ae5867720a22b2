//! Files that are recognized but not read: what they are, and which tool or option makes one of them that opens.

use std::io::Read;
use std::path::Path;

use flate2::read::MultiGzDecoder;

use super::roles::excerpt;

/// Bytes that are looked at of what is compressed.
const HEAD_BYTES: u64 = 4096;

/// A kind of files that are not read.
struct Kind {
    /// What it is, as in "this is a molecule in PDB".
    what: &'static str,
    /// Bytes by which it is recognized, each with its place; any of these.
    marks: &'static [(usize, &'static [u8])],
    /// Endings of the names of its files, without the dot, in lower case.
    extensions: &'static [&'static str],
    /// What makes a file that opens.
    way: &'static str,
}

const ATOMS: &str = "write positions as an array, as in `numpy.save(\"atoms.npy\", MDAnalysis.Universe(\"…\").atoms.positions)`";
const FROM_BLENDER: &str = "Blender's File, Export, Stanford PLY makes a PLY of it";
const FROM_TABLE: &str =
    "write positions and columns as NPZ, as in `numpy.savez(\"points.npz\", positions=…, intensity=…)`";
const FROM_SCANNER: &str = "the scanner's own program exports E57, LAS or PTS";
const PICTURE: &str = "points come in files of points, such as PLY, LAS or CSV";

/// Recognized by content, in this order, and only then by name.
const KINDS: &[Kind] = &[
    Kind {
        what: "a molecule in PDB",
        marks: &[
            (0, b"HEADER    "),
            (0, b"ATOM  "),
            (0, b"HETATM"),
            (0, b"CRYST1"),
            (0, b"REMARK"),
            (0, b"TITLE     "),
            (0, b"COMPND    "),
        ],
        extensions: &["pdb", "ent", "pdbqt"],
        way: ATOMS,
    },
    Kind {
        what: "a volume without a header",
        marks: &[],
        extensions: &["raw", "img"],
        way: "say what they are, as in `rayset build --raw 256x256x128,u16 volume.raw -o volume.rset`, or name the header \
              that comes with them (.mhd, .nhdr, .hdr)",
    },
    Kind {
        what: "a molecule, or a trajectory of one",
        marks: &[],
        extensions: &["gro", "cif", "mmcif", "mol", "mol2", "sdf", "xtc", "trr", "dcd", "psf"],
        way: ATOMS,
    },
    Kind {
        what: "a dump of LAMMPS",
        marks: &[(0, b"ITEM: TIMESTEP"), (0, b"ITEM: UNITS"), (0, b"ITEM: TIME\n")],
        extensions: &["lammpstrj", "dump"],
        way: "write the columns x, y and z of a time step as an array, as in `numpy.save(\"atoms.npy\", \
              numpy.loadtxt(\"…\", skiprows=9, max_rows=…, usecols=(…)))`",
    },
    Kind {
        what: "geometry of Houdini",
        marks: &[(0, b"BgeoV"), (0, b"\x7fNSJb"), (0, b"PGEOMETRY"), (0, b"scf1")],
        extensions: &["bgeo", "geo", "bgeo.sc", "bgeosc"],
        way: "Houdini's File node writes it as PLY, and `splashsurf convert` makes VTK of particles",
    },
    Kind {
        what: "an image in DICOM",
        marks: &[(128, b"DICM")],
        extensions: &["dcm", "dicom", "ima"],
        way: "`dcm2niix FOLDER` makes one volume of a series, in NIfTI, that opens",
    },
    Kind {
        what: "a scene in USD",
        marks: &[(0, b"PXR-USDC"), (0, b"#usda")],
        extensions: &["usd", "usda", "usdc", "usdz"],
        way: FROM_BLENDER,
    },
    Kind { what: "a file of Blender", marks: &[(0, b"BLENDER")], extensions: &["blend"], way: FROM_BLENDER },
    Kind {
        what: "a scene or a mesh for renderers",
        marks: &[(0, b"glTF"), (0, b"Ogawa"), (0, b"Kaydara FBX Binary")],
        extensions: &["gltf", "glb", "abc", "fbx", "dae", "3ds", "ma", "mb", "c4d"],
        way: FROM_BLENDER,
    },
    Kind {
        what: "an octree of Potree",
        marks: &[],
        extensions: &["octree.bin", "hierarchy.bin", "cloud.js"],
        way: "open the LAS or LAZ files that it was made of",
    },
    Kind {
        what: "an Entwine Point Tile set",
        marks: &[],
        extensions: &["ept.json"],
        way: "`pdal translate ept://FOLDER points.laz` makes a LAZ of it",
    },
    Kind {
        what: "an array in Zarr",
        marks: &[],
        extensions: &["zarr", ".zarray", ".zgroup", ".zmetadata", "zarr.json"],
        way: "write it as an array of NumPy, as in `numpy.save(\"points.npy\", zarr.open(\"…\")[:])`",
    },
    Kind {
        what: "a file of ADIOS, as openPMD writes them",
        marks: &[],
        extensions: &["bp", "bp4", "bp5"],
        way: "write positions and columns of an iteration with openpmd-api as NPZ, as in `numpy.savez(\"points.npz\", \
              positions=…, weighting=…)`",
    },
    Kind {
        what: "a table of columns",
        marks: &[
            (0, b"PAR1"),
            (0, b"ARROW1"),
            (0, b"SQLite format 3"),
            (0, b"SIMPLE  ="),
            (0, b"MATLAB 5.0"),
            (0, b"CDF\x01"),
            (0, b"CDF\x02"),
            (0, b"CDF\x05"),
        ],
        extensions: &[
            "parquet", "feather", "arrow", "pkl", "pickle", "pt", "mat", "fits", "nc", "root", "gpkg",
            "xlsx", "shp",
        ],
        way: FROM_TABLE,
    },
    Kind {
        what: "a scan in a scanner's own format",
        marks: &[],
        extensions: &["rcp", "rcs", "fls", "lsproj", "zfs", "zfc", "rdbx", "pod", "dwg", "dgn", "3dd"],
        way: FROM_SCANNER,
    },
    Kind {
        what: "a picture",
        marks: &[
            (0, b"\x89PNG"),
            (0, b"\xff\xd8\xff"),
            (0, b"II*\0"),
            (0, b"MM\0*"),
            (0, b"GIF8"),
            (0, b"\x76\x2f\x31\x01"),
        ],
        extensions: &["png", "jpg", "jpeg", "tif", "tiff", "exr"],
        way: PICTURE,
    },
    Kind {
        what: "a cloud or a grid that is built already, by its name",
        marks: &[],
        extensions: &["rset"],
        way: "`rayset render` and `rayset info` open it",
    },
];

/// What a file is that no reader takes, why not, and what to do. `known` are the endings of names that are read.
pub(super) fn advice(path: &Path, head: &[u8], known: &str) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
    if path.is_dir() {
        return of_folder(path, &name);
    }
    if head.is_empty() {
        return "this file is empty, or is no regular file".into();
    }
    if let Some(kind) = recognized(head, &name) {
        return format!("this is {}, which is not read; {}", kind.what, kind.way);
    }
    if head.starts_with(&[0x1f, 0x8b]) {
        return of_gzip(head, &name);
    }
    let packed = [
        (&b"PK\x03\x04"[..], "ZIP"),
        (b"\x28\xb5\x2f\xfd", "zstd"),
        (b"BZh", "bzip2"),
        (b"\xfd7zXZ", "xz"),
        (b"7z\xbc\xaf", "7-Zip"),
    ];
    if let Some((_, packer)) = packed.iter().find(|(mark, _)| head.starts_with(mark)) {
        return format!("this is compressed with {packer}; unpack it first");
    }
    format!("unknown kind of file; expected points in a file whose name ends in {known}")
}

fn recognized(head: &[u8], name: &str) -> Option<&'static Kind> {
    let marked = |kind: &&Kind| {
        kind.marks.iter().any(|(at, mark)| head.get(*at..).is_some_and(|h| h.starts_with(mark)))
    };
    let named = |kind: &&Kind| kind.extensions.iter().any(|e| name == *e || name.ends_with(&format!(".{e}")));
    KINDS.iter().find(marked).or_else(|| KINDS.iter().find(named))
}

/// What is in a file that is compressed with gzip, and not recognized by its name.
fn of_gzip(head: &[u8], name: &str) -> String {
    let mut plain = Vec::new();
    // The end is cut off, which is no error here.
    let _ = MultiGzDecoder::new(head).take(HEAD_BYTES).read_to_end(&mut plain);
    let inner = name.strip_suffix(".gz").unwrap_or(name);
    match recognized(&plain, inner) {
        Some(kind) => format!("this is {}, compressed with gzip, which is not read; {}", kind.what, kind.way),
        None => format!("this is compressed with gzip; `gunzip {}` makes what may open", excerpt(name)),
    }
}

fn of_folder(path: &Path, name: &str) -> String {
    let has = |file: &str| path.join(file).exists();
    let kind = if has("metadata.json") && has("octree.bin") || has("cloud.js") {
        recognized(&[], "cloud.js")
    } else if has(".zarray") || has(".zgroup") || has("zarr.json") {
        recognized(&[], "zarr.json")
    } else if has("ept.json") {
        recognized(&[], "ept.json")
    } else {
        recognized(&[], name)
    };
    match kind {
        Some(kind) => format!("this is {}, which is not read; {}", kind.what, kind.way),
        None => "this is a folder; give the files in it that are to be read".into(),
    }
}

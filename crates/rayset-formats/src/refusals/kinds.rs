//! The kinds of files that are recognized but not read.

/// A kind of files that are not read.
pub(super) struct Kind {
    /// What it is, as in "this is a molecule in PDB".
    pub(super) what: &'static str,
    /// Bytes by which it is recognized, each with its place; any of these.
    pub(super) marks: &'static [(usize, &'static [u8])],
    /// Endings of the names of its files, without the dot, in lower case.
    pub(super) extensions: &'static [&'static str],
    /// What makes a file that opens.
    pub(super) way: &'static str,
}

const ATOMS: &str = "write positions as an array, as in `numpy.save(\"atoms.npy\", MDAnalysis.Universe(\"…\").atoms.positions)`";
const FROM_BLENDER: &str = "Blender's File, Export, Stanford PLY makes a PLY of it";
const FROM_TABLE: &str =
    "write positions and columns as NPZ, as in `numpy.savez(\"points.npz\", positions=…, intensity=…)`";
const FROM_YT: &str = "from Python with yt, `numpy.save(\"volume.npy\", g[\"density\"])` of `g = \
                        yt.load(\"FILE\").arbitrary_grid(left, right, dims=(256, 256, 256))` makes a volume that opens";
const FROM_SCANNER: &str = "the scanner's own program exports E57, LAS or PTS";
const FROM_CAD: &str = "a CAD program, FreeCAD for one, exports STL or OBJ";
const FROM_MESHES: &str =
    "from Python, `trimesh.load(\"FILE\", force=\"mesh\").export(\"mesh.ply\")` makes a PLY of it";
const FROM_RASTER: &str =
    "it has heights and no points; `gdal2xyz.py FILE points.xyz` makes points of them that open";
const PICTURE: &str = "points come in files of points, such as PLY, LAS or CSV";

/// What may be a volume: it is refused before it is tried as points.
pub(super) const VOLUMES: [Kind; 5] = [
    Kind {
        what: "DICOM, a slice in each file",
        marks: &[(128, b"DICM")],
        extensions: &["dcm", "dicom", "ima"],
        way: "`dcm2niix FOLDER` makes a NIfTI file of a series, and 3D Slicer an NRRD",
    },
    Kind {
        what: "Zarr",
        marks: &[],
        extensions: &["zarr", "zarr.zip", "n5", ".zarray", ".zgroup", ".zmetadata", "zarr.json"],
        way: "from Python, `numpy.save(\"array.npy\", zarr.open(\"FOLDER\")[:])` makes an array that opens, of one level",
    },
    Kind {
        what: "TIFF",
        marks: &[(0, b"II*\0"), (0, b"MM\0*"), (0, b"II+\0"), (0, b"MM\0+")],
        extensions: &["tif", "tiff"],
        way: "from Python, `numpy.save(\"volume.npy\", tifffile.imread(\"FILE\"))` makes an array that opens, of one \
              channel and time; of a map of heights, `gdal2xyz.py FILE points.xyz` makes points",
    },
    Kind {
        what: "Analyze, NIfTI in two files, or NIfTI-2",
        marks: &[(344, b"ni1\0"), (4, b"n+2\0"), (4, b"ni2\0")],
        extensions: &["hdr", "img"],
        way: "NIfTI-1 in one file is read; from Python, \
              `nibabel.Nifti1Image.from_image(nibabel.load(\"FILE\")).to_filename(\"volume.nii.gz\")` makes one",
    },
    Kind {
        what: "a grid of VTK that is not regular, or in several files",
        marks: &[],
        extensions: &["vts", "pvti", "pvtr", "pvts"],
        way: "ParaView's filter Resample To Image makes a regular one, and `.vti` of one piece is read",
    },
];

/// Recognized by content, in this order, and only then by name.
pub(super) const KINDS: &[Kind] = &[
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
        extensions: &["raw"],
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
        what: "a file of ADIOS, as openPMD writes them",
        marks: &[],
        extensions: &["bp", "bp4", "bp5"],
        way: "write positions and columns of an iteration with openpmd-api as NPZ, as in `numpy.savez(\"points.npz\", \
              positions=…, weighting=…)`",
    },
    Kind {
        what: "a grid of heights as text (ESRI, Surfer)",
        marks: &[
            (0, b"ncols"),
            (0, b"NCOLS"),
            (0, b"nrows"),
            (0, b"NROWS"),
            (0, b"DSAA"),
            (0, b"DSBB"),
            (0, b"DSRB"),
        ],
        extensions: &["hgt", "dem", "dt0", "dt1", "dt2", "grd", "bil", "flt", "vrt"],
        way: FROM_RASTER,
    },
    Kind {
        what: "a density map of microscopy (MRC, CCP4)",
        marks: &[(208, b"MAP ")],
        extensions: &["mrc", "map", "ccp4", "rec", "st"],
        way: "from Python, `numpy.save(\"volume.npy\", mrcfile.read(\"FILE\"))` makes a volume that opens",
    },
    Kind {
        what: "a volume of FreeSurfer or MINC",
        marks: &[],
        extensions: &["mgz", "mgh", "mnc"],
        way: "`mri_convert FILE volume.nii.gz` (FreeSurfer), or from Python `nibabel.Nifti1Image(i.get_fdata(), \
              i.affine).to_filename(\"volume.nii.gz\")` of `i = nibabel.load(\"FILE\")`, makes a NIfTI file that opens",
    },
    Kind {
        what: "a volume in a format of Amira, Inrimage, Voreen or PVM",
        marks: &[
            (0, b"# AmiraMesh"),
            (0, b"# Avizo"),
            (0, b"#INRIMAGE"),
            (0, b"PVM"),
            (0, b"ObjectFileName:"),
            (0, b"DDS v3d"),
        ],
        extensions: &["am", "inr", "pvm", "hx"],
        way: "where the voxels lie as they are, `rayset build --raw 256x256x128,u8,skip=HEADER-BYTES FILE -o volume.rset` \
              reads them; else Fiji saves it as NRRD",
    },
    Kind {
        what: "the data of a volume whose header is another file",
        marks: &[],
        extensions: &["zraw", "raw.gz"],
        way: "name the header that comes with it (.mhd, .nhdr)",
    },
    Kind {
        what: "a table or an image of astronomy (FITS)",
        marks: &[(0, b"SIMPLE  =")],
        extensions: &["fits", "fit", "fits.gz"],
        way: "from Python with astropy.io.fits, `numpy.save(\"volume.npy\", fits.getdata(\"FILE\").astype(\"f4\"))` makes \
              a volume of a cube, and `numpy.savez(\"points.npz\", positions=…)` points of a table",
    },
    Kind {
        what: "an archive of Gaussian splats (LCC)",
        marks: &[],
        extensions: &["lcc"],
        way: "`splat-transform FILE splats.ply` (PlayCanvas) makes a PLY that opens",
    },
    Kind {
        what: "a package of PyTorch",
        marks: &[],
        extensions: &["pth", "pt", "ckpt"],
        way: "from Python, `numpy.savez(\"points.npz\", positions=torch.load(\"FILE\")[…].numpy())` makes points of a \
              tensor in it",
    },
    Kind {
        what: "a reconstruction of COLMAP in its binary form",
        marks: &[],
        extensions: &["points3d.bin", "images.bin", "cameras.bin", "frames.bin", "rigs.bin"],
        way: "`colmap model_converter --input_path FOLDER --output_path points.ply --output_type PLY` makes a PLY of it",
    },
    Kind {
        what: "a reconstruction of cameras and points (OpenSfM, Bundler, VisualSFM)",
        marks: &[(0, b"# Bundle file"), (0, b"NVM_V3")],
        extensions: &["nvm", "reconstruction.json", "transforms.json", "sfm", "mvs"],
        way: "the program that made it exports its points as PLY (`opensfm export_ply`, MeshLab, `colmap model_converter`)",
    },
    Kind {
        what: "a map of vectors",
        marks: &[],
        extensions: &["geojson", "topojson", "kml", "kmz", "gpx", "shp", "shx", "dbf", "gml", "gpkg"],
        way: "`ogr2ogr -f CSV points.csv FILE -lco GEOMETRY=AS_XYZ` makes a table of points that opens",
    },
    Kind {
        what: "a drawing or a solid of CAD",
        marks: &[(0, b"ISO-10303-21"), (0, b"AutoCAD Binary DXF")],
        extensions: &[
            "step", "stp", "iges", "igs", "ifc", "dxf", "dwg", "dgn", "skp", "sat", "x_t", "3dm", "rvt",
            "nwd",
        ],
        way: FROM_CAD,
    },
    Kind {
        what: "a mesh in 3MF, VRML, X3D, Draco, Gmsh or the like",
        marks: &[(0, b"#VRML"), (0, b"DRACO"), (0, b"$MeshFormat"), (0, b"solid_3mf")],
        extensions: &[
            "3mf", "wrl", "vrml", "x3d", "drc", "msh", "amf", "ctm", "inp", "ac", "nas", "bdf", "mesh",
        ],
        way: FROM_MESHES,
    },
    Kind {
        what: "tiles of 3D Tiles, or of Cesium",
        marks: &[(0, b"b3dm"), (0, b"pnts"), (0, b"i3dm"), (0, b"cmpt")],
        extensions: &["b3dm", "pnts", "i3dm", "cmpt", "tileset.json", "3tz", "i3s", "slpk"],
        way: "open the points or meshes that they were made of",
    },
    Kind {
        what: "materials of an OBJ",
        marks: &[(0, b"newmtl ")],
        extensions: &["mtl"],
        way: "open the OBJ that names it",
    },
    Kind {
        what: "recordings of ROS, or packets of a LiDAR",
        marks: &[(0, b"#ROSBAG"), (0, b"\x89MCAP0"), (0, b"\xd4\xc3\xb2\xa1"), (0, b"\n\r\r\n")],
        extensions: &["bag", "mcap", "db3", "pcap", "pcapng"],
        way: "`rosrun pcl_ros bag_to_pcd FILE /points FOLDER` makes PCD files of the clouds in a bag; the scanner's own viewer \
              exports packets",
    },
    Kind {
        what: "output of an AMR code (AMReX, Enzo, RAMSES, FLASH)",
        marks: &[(0, b"HyperCLaw"), (0, b"FAB ((")],
        extensions: &["athdf", "hierarchy", "boundary"],
        way: FROM_YT,
    },
    Kind {
        what: "a snapshot in TIPSY",
        marks: &[],
        extensions: &["std", "tipsy", "bin.tipsy"],
        way: "from Python with pynbody, `numpy.savez(\"points.npz\", positions=s.dm[\"pos\"], mass=s.dm[\"mass\"])` of \
              `s = pynbody.load(\"FILE\")` makes points that open",
    },
    Kind {
        what: "a description of data in other files (XDMF, Exodus, EnSight)",
        marks: &[(0, b"<?xml version=\"1.0\" ?>\n<!DOCTYPE Xdmf")],
        extensions: &["xmf", "xdmf", "xmf3", "ex2", "exo", "e", "case", "foam", "cgns", "silo", "plt", "tec"],
        way: "ParaView opens it and saves VTU, VTP or, behind the filter Resample To Image, VTI",
    },
    Kind {
        what: "a document",
        marks: &[(0, b"%PDF"), (0, b"<!DOCTYPE html"), (0, b"<html")],
        extensions: &[
            "md", "pdf", "rst", "html", "htm", "doc", "docx", "py", "ipynb", "xml", "yaml", "yml", "toml",
            "ini", "log", "prj", "wkt",
        ],
        way: PICTURE,
    },
    Kind {
        what: "a film",
        marks: &[(4, b"ftyp"), (0, b"RIFF"), (0, b"\x1aE\xdf\xa3")],
        extensions: &["mp4", "mov", "avi", "mkv", "webm", "webp"],
        way: PICTURE,
    },
    Kind {
        what: "a table of columns",
        marks: &[
            (0, b"PAR1"),
            (0, b"ARROW1"),
            (0, b"SQLite format 3"),
            (0, b"MATLAB 5.0"),
            (0, b"CDF\x01"),
            (0, b"CDF\x02"),
            (0, b"CDF\x05"),
        ],
        extensions: &["parquet", "feather", "arrow", "pkl", "pickle", "mat", "nc", "root", "h5ad"],
        way: FROM_TABLE,
    },
    Kind {
        what: "a scan in a scanner's own format",
        marks: &[],
        extensions: &[
            "rcp",
            "rcs",
            "fls",
            "lsproj",
            "zfs",
            "zfc",
            "rdbx",
            "pod",
            "3dd",
            "rxp",
            "rdb",
            "ptg",
            "imp",
            "lgs",
            "cl3",
            "clr",
            "bin.riegl",
        ],
        way: FROM_SCANNER,
    },
    Kind {
        what: "a picture",
        marks: &[(0, b"\x89PNG"), (0, b"\xff\xd8\xff"), (0, b"GIF8"), (0, b"\x76\x2f\x31\x01")],
        extensions: &["png", "jpg", "jpeg", "exr"],
        way: PICTURE,
    },
    Kind {
        what: "a cloud or a grid that is built already, by its name",
        marks: &[],
        extensions: &["rset"],
        way: "`rayset render` and `rayset info` open it",
    },
    Kind {
        what: "a pointer of Git LFS in place of a file",
        marks: &[(0, b"version https://git-lfs")],
        extensions: &[],
        way: "`git lfs pull` in its repository fetches the file itself",
    },
    Kind {
        what: "an archive (tar)",
        marks: &[(257, b"ustar")],
        extensions: &["tar", "tgz", "tar.gz", "tar.bz2", "tar.xz", "tar.zst"],
        way: "`tar xf FILE` unpacks it, and the folder opens",
    },
    Kind {
        what: "a program",
        marks: &[(0, b"\x7fELF"), (0, b"MZ\x90"), (0, b"\xcf\xfa\xed\xfe"), (0, b"#!/")],
        extensions: &["exe", "dll", "so", "dylib"],
        way: PICTURE,
    },
    Kind {
        what: "a spreadsheet",
        marks: &[],
        extensions: &["xlsx", "xls", "ods"],
        way: "save the sheet as CSV, with x, y and z in its header",
    },
    Kind {
        what: "seismic traces (SEG-Y)",
        marks: &[],
        extensions: &["sgy", "segy"],
        way: "from Python, `numpy.save(\"volume.npy\", segyio.tools.cube(\"FILE\"))` makes a volume that opens",
    },
    Kind {
        what: "a model of a city (CityJSON)",
        marks: &[],
        extensions: &["city.json", "city.jsonl"],
        way: "`cjio FILE export obj city.obj` makes a mesh that opens",
    },
    Kind {
        what: "JSON, and no scene of rayset, which is an object with the key `rayset`",
        marks: &[],
        extensions: &["json", "jsonl", "ndjson"],
        way: "from Python, `numpy.savez(\"points.npz\", positions=…)` of `json.load(open(\"FILE\"))` makes points that open",
    },
];

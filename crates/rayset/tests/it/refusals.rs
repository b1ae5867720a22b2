//! Files that are not read say what they are and what to do, whether they are recognized by content
//! or by name.

use rayset::points::{self, ReadOptions};

use crate::common::{folder, real_data};

fn said(path: &std::path::Path) -> String {
    points::open(path, &ReadOptions::default()).err().expect("no points").to_string()
}

#[test]
fn files_are_recognized_by_their_first_bytes_under_any_name() {
    let folder = folder();
    let path = folder.path().join("thing");
    let dicom = [&[0; 128][..], b"DICM"].concat();
    for (bytes, what, way) in [
        (&b"HEADER    OXYGEN"[..], "a molecule in PDB", "MDAnalysis"),
        (b"ITEM: TIMESTEP\n0\n", "a dump of LAMMPS", "numpy.loadtxt"),
        (b"\x7fNSJb\0\0", "geometry of Houdini", "splashsurf convert"),
        (&dicom, "DICOM, a slice in each file", "dcm2niix"),
        (b"PXR-USDC\0\0", "a scene in USD", "Stanford PLY"),
        (b"BLENDER-v300", "a file of Blender", "Stanford PLY"),
        (b"PAR1\x15\x04", "a table of columns", "numpy.savez"),
        (b"\x89PNG\r\n\x1a\n", "a picture", "PLY, LAS or CSV"),
        (b"PK\x03\x04\0\0", "compressed with ZIP", "unpack it"),
        (b"\0\x01\x02\x03", "unknown kind of file", "ply, "),
        (b"", "this file is empty", "regular file"),
    ] {
        std::fs::write(&path, bytes).expect("a write");
        let said = said(&path);
        assert!(said.contains(what) && said.contains(way), "{said}");
    }
}

#[test]
fn files_without_a_mark_are_recognized_by_their_names() {
    let folder = folder();
    for (name, what) in [
        ("a.gro", "a molecule"),
        ("a.XTC", "a molecule"),
        ("a.lammpstrj", "a dump of LAMMPS"),
        ("ept.json", "an Entwine Point Tile set"),
        ("octree.bin", "an octree of Potree"),
        ("data.bp", "openPMD"),
        ("a.rcp", "a scan in a scanner's own format"),
        ("a.raw", "a volume without a header"),
        ("a.rset", "built already"),
    ] {
        let path = folder.path().join(name);
        std::fs::write(&path, "contents\n").expect("a write");
        assert!(said(&path).contains(what), "{}", said(&path));
    }
}

#[test]
fn kinds_that_others_bring_are_refused_with_what_converts_them() {
    let folder = folder();
    for (name, bytes, what, way) in [
        ("dem.asc", &b"ncols 3\nnrows 2\n1 2 3\n4 5 6\n"[..], "a grid of heights", "gdal2xyz.py"),
        ("ethanol.xyz", b"2\na remark\nC 0.1 0.2 0.3\nH 1 2 3\n", "a molecule", "MDAnalysis"),
        ("emd.map", b"\0\0", "a density map of microscopy", "mrcfile.read"),
        ("orig.mgh", b"\0\0\0\x01", "FreeSurfer", "mri_convert"),
        ("points3D.bin", b"\0\0\0", "COLMAP", "model_converter"),
        ("a.fits", b"SIMPLE  =   T", "FITS", "astropy"),
        ("a.lcc", b"1234", "LCC", "splat-transform"),
        ("a.pth", b"PK\x03\x04", "PyTorch", "torch.load"),
        ("a.geojson", b"{\"type\"", "a map of vectors", "ogr2ogr"),
        ("a.ifc", b"ISO-10303-21;", "CAD", "STL or OBJ"),
        ("a.3mf", b"PK\x03\x04", "a mesh in 3MF", "trimesh.load"),
        ("a.drc", b"DRACO\x02", "a mesh in 3MF", "trimesh.load"),
        ("tileset.json", b"{}", "3D Tiles", "made of"),
        ("a.bag", b"#ROSBAG V2.0\n", "recordings of ROS", "bag_to_pcd"),
        ("a.mtl", b"newmtl a\n", "materials of an OBJ", "OBJ"),
        ("a.pvm", b"PVM3\n", "Amira, Inrimage", "--raw"),
        ("plt/Header", b"HyperCLaw-V1.1\n", "AMR code", "yt.load"),
        ("readme.md", b"# Words\n", "a document", "PLY, LAS or CSV"),
        ("lfs.ply", b"version https://git-lfs.github.com/spec/v1\noid sha256:1\n", "Git LFS", "git lfs pull"),
        ("empty.las", b"", "this file is empty", "not copied"),
        ("scans.tar", b"\0", "an archive (tar)", "tar xf"),
        ("program", b"\x7fELF\x02\x01", "a program", "PLY, LAS or CSV"),
        ("line.sgy", b"\0", "SEG-Y", "segyio"),
        ("survey.xlsx", b"PK\x03\x04", "a spreadsheet", "as CSV"),
        ("trees.json", b"{\"type\": \"FeatureCollection\", \"features\": []}", "a map of vectors", "ogr2ogr"),
        ("model.json", b"{\"type\": \"CityJSON\"}", "CityJSON", "cjio"),
        ("list.json", b"[[1, 2, 3], [4, 5, 6]]", "JSON, and no scene", "numpy.savez"),
        ("points.json", b"{\"points\": [[1, 2, 3]]}", "JSON, and no scene", "numpy.savez"),
    ] {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
        std::fs::write(&path, bytes).expect("a write");
        let said = said(&path);
        assert!(said.contains(what) && said.contains(way), "{said}");
    }
}

#[test]
fn folders_of_potree_and_zarr_are_recognized_and_others_are_folders() {
    let folder = folder();
    assert!(said(folder.path()).contains("this is a folder"), "{}", said(folder.path()));
    std::fs::write(folder.path().join("zarr.json"), "{}").expect("a write");
    assert!(said(folder.path()).contains("this is Zarr"), "{}", said(folder.path()));
    for name in ["metadata.json", "octree.bin"] {
        std::fs::write(folder.path().join(name), "{}").expect("a write");
    }
    assert!(said(folder.path()).contains("an octree of Potree"), "{}", said(folder.path()));
}

#[test]
fn what_is_in_gzip_is_recognized_too() {
    let folder = folder();
    let path = folder.path().join("thing.gz");
    let zipped = |bytes: &[u8]| {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        std::io::Write::write_all(&mut encoder, bytes).expect("a write");
        encoder.finish().expect("it ends")
    };
    std::fs::write(&path, zipped(b"ITEM: TIMESTEP\n0\n")).expect("a write");
    assert!(said(&path).contains("a dump of LAMMPS, compressed with gzip"), "{}", said(&path));
    std::fs::write(&path, zipped(b"anything")).expect("a write");
    assert!(said(&path).contains("gunzip thing.gz"), "{}", said(&path));
    let archive = [&[b'a'; 100][..], &[0; 157], b"ustar"].concat();
    for name in ["scans.tar.gz", "scans"] {
        let path = folder.path().join(name);
        std::fs::write(&path, zipped(&archive)).expect("a write");
        assert!(said(&path).contains("an archive (tar)"), "{}", said(&path));
    }
}

#[test]
fn real_files_that_are_not_read_say_what_they_are() {
    for (name, what) in [
        ("particles/3GQP.pdb", "a molecule in PDB"),
        ("particles/YiiP_lipids.gro.gz", "a molecule, or a trajectory of one, compressed with gzip"),
        ("particles/dump.meoh", "a dump of LAMMPS"),
        ("particles/dam_break_frame_23_24389_particles.bgeo", "geometry of Houdini"),
    ] {
        if let Some(path) = real_data(name) {
            assert!(said(&path).contains(what), "{}", said(&path));
        }
    }
}

//! Inputs that the fuzzers begin with: small files of every kind, made by writers of ours, and read
//! here as they are.
//!
//! With `RAYSET_CORPUS` they are left in that folder, one folder a target. An input for points or
//! volumes begins with a byte that chooses the name of the file, as in `fuzz/src/lib.rs`.

use std::io::Write;
use std::path::Path;

use rayset::octree::build::BuildOptions;
use rayset::points::{self, MeshSource, PointBatch, PointSource, ReadOptions};
use rayset::scene_file::SceneFile;
use rayset::volumes::{self, RawLayout};

use crate::common::{build_at, folder, mixed_points};
use crate::fixtures;
use crate::las_writer::{Chunks, LasFile};
use crate::volume_fixtures::{fixtures as volume_fixtures, unzipped};
use crate::vti_text::{base64, vti, words};

const POINTS: [&str; 28] = [
    "p.ply", "p.las", "p.laz", "p.csv", "p.xyz", "p.pts", "p.txt", "mesh.ply", "s.spz", "s.splat",
    "s.ksplat", "m.obj", "m.stl", "p.hdf5", "p.gadget", "p.npy", "p.npz", "p.vtk", "p.vtp", "p.vtu", "p.e57",
    "p.pcd", "p.ptx", "p.csv.gz", "m.off", "p.bin", "s.glb", "s.sog",
];
const VOLUMES: [&str; 12] = [
    "v.nrrd", "v.mha", "v.nii", "v.nii.gz", "v.vti", "v.mhd", "v.vdb", "v.npy", "v.npz", "v.slc", "v.vtk",
    "v.dx",
];

fn ply(format: &str) -> Vec<u8> {
    let mut bytes = format!(
        "ply\nformat {format} 1.0\ncomment made up\nelement vertex 3\nproperty float x\nproperty double y\nproperty \
         float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nproperty list uchar int rest\n\
         element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    )
    .into_bytes();
    for i in 0..3_u8 {
        let v = f32::from(i) + 0.5;
        match format {
            "ascii" => bytes.extend(format!("{v} {} {v} {i} 200 7 2 1 2\n", i * i).bytes()),
            "binary_little_endian" => {
                bytes.extend(v.to_le_bytes());
                bytes.extend(f64::from(i * i).to_le_bytes());
                bytes.extend(v.to_le_bytes());
                bytes.extend([i, 200, 7, 1]);
                bytes.extend(5_i32.to_le_bytes());
            }
            _ => {
                bytes.extend(v.to_bits().to_be_bytes_of());
                bytes.extend(f64::from(i * i).to_bits().to_be_bytes_of());
                bytes.extend(v.to_bits().to_be_bytes_of());
                bytes.extend([i, 200, 7, 1]);
                bytes.extend(5_u32.to_be_bytes_of());
            }
        }
    }
    match format {
        "ascii" => bytes.extend(b"3 0 1 2\n"),
        "binary_little_endian" => {
            bytes.push(3);
            [0_i32, 1, 2].iter().for_each(|i| bytes.extend(i.to_le_bytes()));
        }
        _ => {
            bytes.push(3);
            [0_u32, 1, 2].iter().for_each(|i| bytes.extend(i.to_be_bytes_of()));
        }
    }
    bytes
}

/// Big-endian bytes, for the files that have them.
trait BigEndian {
    fn to_be_bytes_of(self) -> Vec<u8>;
}

impl BigEndian for u32 {
    fn to_be_bytes_of(self) -> Vec<u8> {
        self.to_le_bytes().into_iter().rev().collect()
    }
}

impl BigEndian for u64 {
    fn to_be_bytes_of(self) -> Vec<u8> {
        self.to_le_bytes().into_iter().rev().collect()
    }
}

fn point_files() -> Vec<(&'static str, Vec<u8>)> {
    let mut files = vec![
        ("p.ply", ply("ascii")),
        ("p.ply", ply("binary_little_endian")),
        ("p.ply", ply("binary_big_endian")),
        ("mesh.ply", ply("ascii")),
        ("p.csv", b"x,y,z,\"a b\",r,g,b\n1,2,3,4.5,0,128,255\n4,5,6,,1,2,3\n".to_vec()),
        ("p.csv", b"\xef\xbb\xbfx;y;z;class\n1,5;2,5;3,5;2\n4,5;5,5;6,5;6\n".to_vec()),
        ("p.xyz", b"# made up\n1 2 3 0.5\n-1e3\t2.0D+01 3 nan\n".to_vec()),
        ("p.txt", b"//x y z radius\n0 0 0 1\n1 1 1 2\n".to_vec()),
        ("p.pts", b"2\n1 2 3 -100 1 2 3\n4 5 6 200 4 5 6\n1\n7 8 9 0 0 0 0\n".to_vec()),
        ("p.xyz", b"1 2 3\r4 5 6\r".to_vec()),
        ("p.xyz", b"1 2 3\n4 5 6\n\0\0\0\0\0\0\0\0".to_vec()),
        ("p.csv", b"x,y,z\n\"0,473\",\"-11,542\",\"0,047\"\n\"1,5\",2,\"3,25\"\n".to_vec()),
        ("p.txt", b"1 2 3 200 90 40 7\n4 5 6 100 50 20 9\n5 5 6 90 45 18 200\n".to_vec()),
        (
            "p.pcd",
            b"VERSION .7\nFIELDS x y z rgb\nWIDTH 2\nDATA ascii\n1 2 3 13132850\n4 5 6 4.2e-39\n".to_vec(),
        ),
    ];
    for format in 0..=10 {
        let file = LasFile::random(format, 40, usize::from(format % 3), u64::from(format));
        files.push(("p.las", file.las()));
        files.push(("p.laz", file.laz(Chunks::Fixed(16))));
    }
    for name in ["one_scan.e57", "two_scans.e57"] {
        files.push(("p.e57", fixtures::bytes(name)));
    }
    for name in
        ["ascii_uint32.pcd", "binary_uint32.pcd", "binary_compressed_uint32.pcd", "binary_uint32.pcd.zst"]
    {
        files.push(("p.pcd", fixtures::bytes(name)));
    }
    for name in ["scans.ptx", "scans.ptx.zst"] {
        files.push(("p.ptx", fixtures::bytes(name)));
    }
    files.push(("p.csv.gz", gzipped(b"x,y,z,class\n1,2,3,4\n5,6,7,8\n")));
    let file = LasFile::random(3, 60, 0, 3);
    for chunks in [Chunks::Variable(&[7, 20]), Chunks::NoTable(25), Chunks::Streamed(25), Chunks::One] {
        files.push(("p.laz", file.laz(chunks)));
    }
    for (name, folder, fixtures) in FIXTURES {
        let bytes =
            |file: &&str| std::fs::read(crate::fixture::fixtures(folder).join(file)).expect("a fixture");
        files.extend(fixtures.iter().map(|file| (*name, bytes(file))));
    }
    files
}

/// Splats and meshes, which have fixtures.
fn splats_and_meshes() -> Vec<(&'static str, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures");
    let read = |(name, path): (&'static str, &str)| {
        (name, std::fs::read(folder.join(path)).unwrap_or_else(|e| panic!("{path}: {e}")))
    };
    let files = [
        ("p.ply", "splats/inria.ply"),
        ("p.ply", "splats/packed.compressed.ply"),
        ("s.spz", "splats/v1.spz"),
        ("s.spz", "splats/v2.spz"),
        ("s.spz", "splats/v3.spz"),
        ("s.spz", "splats/v4.spz"),
        ("s.glb", "splats/khronos.glb"),
        ("s.sog", "splats/bundle.sog"),
        ("s.splat", "splats/records.splat"),
        ("s.ksplat", "splats/level0.ksplat"),
        ("s.ksplat", "splats/level1.ksplat"),
        ("s.ksplat", "splats/level2.ksplat"),
        ("mesh.ply", "meshes/square.ply"),
        ("m.obj", "meshes/square.obj"),
        ("m.obj", "meshes/ball.obj"),
        ("m.stl", "meshes/ball.stl"),
        ("m.stl", "meshes/ball-ascii.stl"),
    ];
    let off = b"OFF\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 1\n3 0 1 2\n4 0 1 2 3 255 0 0\n".to_vec();
    let faces = b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
                  element face 1\nproperty list uchar int vertex_indices\nproperty uchar red\nproperty uchar green\n\
                  property uchar blue\nend_header\n0 0 0\n1,5 0 0\n1 1 0\n3 0 1 2 200 40 30\n"
        .to_vec();
    let scan = (0..40_u16).flat_map(|i| f32::from(i % 7 * (i + 1) % 11).to_le_bytes()).collect();
    files.into_iter().map(read).chain([("m.off", off), ("p.bin", scan), ("mesh.ply", faces)]).collect()
}

/// Files that other programs wrote: the name of the input, their folder, and they.
const FIXTURES: &[(&str, &str, &[&str])] = &[
    ("p.hdf5", "snapshots", &["gadget.hdf5", "swift.hdf5", "eagle.hdf5", "halves.hdf5"]),
    ("p.gadget", "gadget", &["format1", "format2_big"]),
    ("p.npy", "npy", &["four_big.npy", "fortran.npy", "structured.npy", "halves.npy"]),
    ("p.npz", "npy", &["stored.npz", "deflated.npz", "halves.npz"]),
    ("p.vtk", "vtk", &["poly_text_42.vtk", "poly_binary_51.vtk", "grid_binary_42.vtk"]),
    ("p.vtp", "vtk", &["ascii.vtp", "binary_zlib.vtp", "pieces.vtp"]),
    ("p.vtu", "vtk", &["raw_big.vtu", "base64_zlib.vtu"]),
];

fn gzipped(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(bytes).expect("a write");
    encoder.finish().expect("it ends")
}

fn nifti() -> Vec<u8> {
    let mut bytes = vec![0; 352];
    bytes[..4].copy_from_slice(&348_i32.to_le_bytes());
    for (i, n) in [3_i16, 5, 4, 3, 1, 1, 1, 1].into_iter().enumerate() {
        bytes[40 + 2 * i..42 + 2 * i].copy_from_slice(&n.to_le_bytes());
    }
    bytes[70..72].copy_from_slice(&4_i16.to_le_bytes());
    bytes[72..74].copy_from_slice(&16_i16.to_le_bytes());
    for (i, v) in [1_f32, 1.0, 2.0, 3.0].into_iter().enumerate() {
        bytes[76 + 4 * i..80 + 4 * i].copy_from_slice(&v.to_le_bytes());
    }
    bytes[108..112].copy_from_slice(&352_f32.to_le_bytes());
    bytes[344..348].copy_from_slice(b"n+1\0");
    (0..60_i16).for_each(|v| bytes.extend(v.to_le_bytes()));
    bytes
}

fn volume_files() -> Vec<(&'static str, Vec<u8>)> {
    let voxels: Vec<u8> = (0..60).collect();
    let with = |head: &str, data: &[u8]| [head.as_bytes(), data].concat();
    let nrrd = |encoding: &str| {
        format!(
            "NRRD0004\ntype: uchar\ndimension: 3\nsizes: 5 4 3\nspace: left-posterior-superior\nspace directions: \
             (1,0,0) (0,2,0) (0,0,3)\nspace origin: (0,0,0)\nencoding: {encoding}\n\n"
        )
    };
    let meta = |more: &str| {
        format!(
            "ObjectType = Image\nNDims = 3\nDimSize = 5 4 3\nElementSpacing = 1 2 3\nOffset = 0 0 0\n{more}ElementType = \
             MET_UCHAR\nElementDataFile = LOCAL\n"
        )
    };
    let shorts: Vec<u8> = (0..60_i16).flat_map(i16::to_le_bytes).collect();
    let fixture = |name: &str| std::fs::read(volume_fixtures("volumes").join(name)).expect("a fixture");
    let inline = base64(&[words(&[shorts.len() as u64], 4), shorts].concat());
    let ascii: Vec<String> = (0..60).map(|i| i.to_string()).collect();
    let series = |sizes: &str| format!("NRRD0004\ntype: uchar\nsizes: {sizes}\nencoding: raw\n");
    let interleaved = series("3 5 2 2") + "kinds: list domain domain domain\n\n";
    let slice = b"6X\x03\x07\x82\x01\x09\x00";
    let short = [&b"11111 3 2 2 8 1 1 1 0 0 0 1 0 0 X"[..], slice, slice].concat();
    vec![
        ("v.nrrd", with(&nrrd("raw"), &voxels)),
        ("v.nrrd", with(&nrrd("gzip"), &gzipped(&voxels))),
        ("v.nrrd", with(&(series("5 2 2 3") + "\n"), &voxels)),
        ("v.nrrd", with(&interleaved, &voxels)),
        ("v.slc", short),
        ("v.mha", with(&meta(""), &voxels)),
        ("v.mha", with(&meta("BinaryDataByteOrderMSB = False\n"), &voxels)),
        ("v.nii", nifti()),
        ("v.nii.gz", gzipped(&nifti())),
        ("v.vdb", unzipped("vdb", "two.vdb")),
        ("v.vdb", unzipped("vdb", "sphere_half.vdb")),
        ("v.npy", fixture("c_little_i2.npy")),
        ("v.npy", fixture("fortran.npy")),
        ("v.npz", fixture("stored.npz")),
        ("v.npz", fixture("deflated.npz")),
        ("v.slc", fixture("plain.slc")),
        ("v.slc", fixture("runs.slc")),
        ("v.vtk", fixture("ascii_i2.vtk")),
        ("v.vtk", fixture("binary_cells.vtk")),
        ("v.dx", fixture("plain.dx")),
        ("v.dx", fixture("double.dx")),
        ("v.vti", vti(&format!("format=\"ascii\">{}</DataArray>", ascii.join(" ")), "", "").into_bytes()),
        ("v.vti", vti(&format!("format=\"binary\">{inline}</DataArray>"), "", "").into_bytes()),
    ]
}

/// An input of a fuzzer: the target, and the bytes.
pub(crate) type Input = (&'static str, Vec<u8>);

/// All inputs, each of which is read here.
pub(crate) fn inputs() -> Vec<Input> {
    let folder = folder();
    let mut inputs = of_readers(folder.path());
    inputs.extend(files(folder.path()));
    inputs.extend(scenes(folder.path()));
    inputs
}

#[test]
fn every_input_that_the_fuzzers_begin_with_is_read() {
    let inputs = inputs();
    assert!(inputs.len() > 60);
    let Some(root) = std::env::var_os("RAYSET_CORPUS") else { return };
    for (number, (target, bytes)) in inputs.iter().enumerate() {
        let folder = Path::new(&root).join(target);
        std::fs::create_dir_all(&folder).expect("a folder");
        std::fs::write(folder.join(format!("seed-{number:03}")), bytes).expect("a write");
    }
}

/// Points, meshes and volumes.
fn of_readers(folder: &Path) -> Vec<Input> {
    let mut inputs = Vec::new();
    for (name, bytes) in point_files().into_iter().chain(splats_and_meshes()) {
        let path = folder.join(name);
        std::fs::write(&path, &bytes).expect("a write");
        let mut source: Box<dyn PointSource> = if name == "mesh.ply" {
            Box::new(MeshSource::open(&path, 10).expect("a mesh"))
        } else {
            points::open(&path, &ReadOptions::default()).unwrap_or_else(|e| panic!("{e}"))
        };
        let mut batch = PointBatch::default();
        source.fill(&mut batch, 100).unwrap_or_else(|e| panic!("{e}"));
        assert!(batch.len() > 1, "{name}");
        let choice = POINTS.iter().position(|n| *n == name).expect("a name") as u8;
        inputs.push(("points", [&[choice], &*bytes].concat()));
    }
    for (name, bytes) in volume_files() {
        let path = folder.join(name);
        std::fs::write(&path, &bytes).expect("a write");
        let mut source = volumes::open(&path, None).unwrap_or_else(|e| panic!("{e}"));
        let mut voxels = vec![0; source.size.iter().product::<u64>() as usize * source.kind.bytes()];
        source.read(&mut voxels).unwrap_or_else(|e| panic!("{e}"));
        let choice = VOLUMES.iter().position(|n| *n == name).expect("a name") as u8;
        inputs.push(("volumes", [&[choice], &*bytes].concat()));
    }
    inputs
}

/// Clouds and grids.
fn files(folder: &Path) -> Vec<Input> {
    use rayset::grid::build::{GridBuildOptions, build};
    let mut inputs = Vec::new();
    let path = folder.join("cloud.rset");
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures");
    for points in [0, 1, 40, 5000] {
        let options = BuildOptions { attributes: vec!["weight".into()], ..BuildOptions::default() };
        build_at(&path, Box::new(mixed_points(points, 3.0, 1)), &options);
        let bytes = std::fs::read(&path).expect("a read");
        if bytes.len() < 131_072 {
            inputs.push(("files", bytes));
        }
    }
    for splats in ["splats/inria.ply", "splats/records.splat"] {
        let source = points::open(fixtures.join(splats), &ReadOptions::default()).expect("it opens");
        let path = folder.join("splats.rset");
        build_at(&path, source, &BuildOptions::default());
        inputs.push(("files", std::fs::read(&path).expect("a read")));
    }
    let raw = folder.join("voxels.raw");
    std::fs::write(&raw, (0..1000).map(|i| (i * 7) as u8).collect::<Vec<u8>>()).expect("a write");
    let source = "10x10x10,u8".parse::<RawLayout>().expect("a layout").open(&raw).expect("it opens");
    let path = folder.join("grid.rset");
    build(source, &path, &GridBuildOptions::default(), &rayset::build::BuildControl::default())
        .expect("it builds");
    inputs.push(("files", std::fs::read(&path).expect("a read")));
    inputs
}

fn scenes(folder: &Path) -> Vec<Input> {
    let maps = r#"[{"Name": "Fire", "RGBPoints": [0, 0, 0, 0, 1, 1, 0.5, 0], "Points": [0, 0, 0.5, 0, 1, 1, 0.5, 0]}]"#;
    std::fs::write(folder.join("maps.json"), maps).expect("a write");
    let examples = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples");
    let mirrors = std::fs::read_to_string(examples.join("mirrors.json")).expect("an example");
    let own = [
        r#"{"rayset": 1, "root": {"type": "difference", "children": [{"type": "cloud", "file": "cloud.rset", "transferFunction": {"opacity": {"extinction": 3}, "color": "viridis", "input": "weight", "valueRange": [0, 1]}}, {"type": "box", "size": [1, 1, 1], "transform": [{"translate": [0.5, 0, 0]}, {"rotate": {"axis": [0, 1, 0], "degrees": 30}}]}]}}"#,
        r#"{"rayset": 1, "camera": {"position": [9, 4, 30], "direction": [0, 0, -1]}, "lights": [{"type": "point", "position": [5, 20, 5]}, {"type": "directional", "direction": [0, -1, 0]}], "rendering": {"shadows": "exact"}, "root": {"type": "blend", "children": [{"type": "grid", "file": "grid.rset", "transferFunction": {"opacity": [[0, 0], [200, 0.9]], "preset": {"file": "maps.json", "name": "Fire"}}}, {"type": "noise", "radii": [3, 2, 1], "scale": 1}]}}"#,
        r#"{"rayset": 1, "rendering": {"compositing": "display", "step": 0.1}, "lights": [{"type": "headlight"}], "root": {"type": "union", "children": [{"type": "box", "size": [1, 1, 1]}, {"type": "difference", "children": [{"type": "cloud", "file": "cloud.rset", "kernel": "splat", "splatFilter": "mip", "radiusScale": 2, "transferFunction": {"opacity": {"extinction": 1}}, "transform": {"scale": [1, -2, 3]}}, {"type": "sphere", "radius": 1}]}]}}"#,
        r##"{"rayset": 1, "animation": {"keys": [{"frame": 0, "camera": {"position": [0, 0, 5]}}, {"frame": 9, "camera": {"position": [0, 5, 5]}}]}, "define": {"ball": {"type": "sphere", "radius": 1, "edge": 0.1, "color": "#ff8000", "material": {"reflectance": 0.4}}}, "root": {"type": "union", "children": [{"ref": "ball"}, {"ref": "ball", "transform": {"scale": 2, "translate": [2, 0, 0]}}, {"type": "torus", "majorRadius": 1, "minorRadius": 0.2, "material": {"refractiveIndex": 1.5}}]}}"##,
    ];
    let parsed = own.into_iter().chain([mirrors.as_str()]).map(|text| {
        SceneFile::parse(&folder.join("scene.json"), text).unwrap_or_else(|e| panic!("{e}"));
        ("scenes", text.as_bytes().to_vec())
    });
    parsed.collect()
}

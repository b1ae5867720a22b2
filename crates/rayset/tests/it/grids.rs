//! Grid volumes: formats in, files out, and pictures against the reference renderer.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rayset::geometry::{DAffine3, DQuat, DVec3};
use rayset::grid::build::{GridBuildError, GridBuildOptions, build};
use rayset::grid::{Grid, VoxelKind};
use rayset::scene::{
    ColorMap, ColorRule, Compositing, Form, GridObject, Lighting, MapInput, Node, OpacityRule, Operator,
    RenderSettings, Scene, Shape, Solid, Step,
};
use rayset::trace::ExecSettings;
use rayset::trace::reference::{ReferenceRenderer, ReferenceSteps};
use rayset::volumes::{self, RawLayout};

use crate::common::{Random, bits, camera, folder, paged, picture, plain_picture, real_data, settings};

const SIZE: [u64; 3] = [45, 37, 52];

/// A lumpy ball with values from 0 to 250.
fn value(i: u64, j: u64, k: u64) -> f64 {
    let p = DVec3::new(i as f64 / 44.0, j as f64 / 36.0, k as f64 / 51.0) * 2.0 - 1.0;
    let lumps = (p.x * 9.0).sin() * (p.y * 8.0).cos() * (p.z * 7.0).sin();
    (250.0 * (1.0 - p.length() + 0.15 * lumps)).clamp(0.0, 250.0).round()
}

fn voxels(kind: VoxelKind, big_endian: bool) -> Vec<u8> {
    let mut bytes = Vec::new();
    for k in 0..SIZE[2] {
        for j in 0..SIZE[1] {
            for i in 0..SIZE[0] {
                let v = value(i, j, k);
                let mut one = match kind {
                    VoxelKind::U8 => vec![v as u8],
                    VoxelKind::I16 => (v as i16 - 100).to_le_bytes().to_vec(),
                    VoxelKind::U16 => (v as u16).to_le_bytes().to_vec(),
                    VoxelKind::F32 => (v as f32).to_le_bytes().to_vec(),
                };
                if big_endian {
                    one.reverse();
                }
                bytes.extend(one);
            }
        }
    }
    bytes
}

pub(crate) fn grid(folder: &Path, kind: VoxelKind) -> Arc<Grid> {
    let (raw, path) = (folder.join("v.raw"), folder.join(format!("{}.rset", kind.name())));
    std::fs::write(&raw, voxels(kind, false)).expect("a write");
    let layout: RawLayout =
        format!("45x37x52,{},spacing=0.03x0.035x0.028", kind.name()).parse().expect("a layout");
    let source = layout.open(&raw).expect("it opens");
    build(source, &path, &GridBuildOptions::default(), &rayset::build::BuildControl::default())
        .expect("it builds");
    Arc::new(Grid::open(&path).expect("it opens"))
}

pub(crate) fn object(grid: &Arc<Grid>, shift: f64) -> Node {
    let opacity = OpacityRule::Curve(vec![(40.0 + shift, 0.0), (120.0 + shift, 0.4), (200.0 + shift, 0.9)]);
    let map = ColorMap::named("viridis".parse().expect("a map"), (40.0 + shift, 200.0 + shift));
    let transfer =
        rayset::scene::TransferFunction { opacity, color: ColorRule::Map { map, input: MapInput::Density } };
    let turn = DQuat::from_axis_angle(DVec3::new(0.3, 1.0, 0.2).normalize(), 0.6);
    Node::new(Shape::Grid(GridObject { grid: grid.clone(), transfer, labels: false }))
        .moved(DAffine3::from_translation(DVec3::splat(-0.7)))
        .moved(DAffine3::from_scale_rotation_translation(DVec3::new(1.0, 1.2, 0.9), turn, DVec3::ZERO))
}

fn scene(root: Node) -> Scene {
    Scene {
        root: Arc::new(root),
        lighting: Lighting::headlight(),
        background: None,
        unit_distance: 0.1,
        compositing: Compositing::Linear,
    }
}

#[test]
fn a_grid_is_the_same_whatever_memory_it_is_built_in() {
    let folder = folder();
    let raw = folder.path().join("v.raw");
    let built = |kind: VoxelKind, memory_bytes: u64| {
        let layout: RawLayout = format!("45x37x52,{}", kind.name()).parse().expect("a layout");
        let source = layout.open(&raw).expect("it opens");
        let options = GridBuildOptions { memory_bytes, temp_dir: Some(folder.path().to_owned()) };
        let path = folder.path().join("v.rset");
        build(source, &path, &options, &rayset::build::BuildControl::default())
            .map(|_| std::fs::read(&path).expect("a read"))
    };
    for &kind in VoxelKind::ALL {
        std::fs::write(&raw, voxels(kind, false)).expect("a write");
        let Err(GridBuildError::Memory { needed, budget: 1 }) = built(kind, 1) else {
            panic!("a grid was built in a byte");
        };
        let brick = (kind.brick_voxels().pow(3) * kind.bytes()) as u64;
        let reference = built(kind, 256 << 20).expect("a grid");
        // Of the least, a brick at a time from the disk; of the next ones, more at a time, and
        // whole rows; then memory.
        for more in [0, 2 * brick, 3 * brick, 4 * brick, 16 * brick] {
            let found = built(kind, needed + more).expect("a grid");
            assert!(found == reference, "{} with {more} bytes more", kind.name());
        }
    }
}

#[test]
fn grids_of_every_kind_of_voxel_agree_with_the_reference_renderer() {
    const SIDE: u32 = 40;
    let folder = folder();
    for &kind in VoxelKind::ALL {
        let grid = grid(folder.path(), kind);
        let shift = if kind == VoxelKind::I16 { -100.0 } else { 0.0 };
        let ball = Solid::new(Form::Sphere { radius: 0.35 }).colored([0.8, 0.3, 0.2]);
        let ball =
            Node::new(Shape::Procedural(Arc::new(ball))).moved(DAffine3::from_translation(DVec3::Z * 0.4));
        for root in [object(&grid, shift), Node::operator(Operator::Difference, [object(&grid, shift), ball])]
        {
            let scene = scene(root);
            let settings = RenderSettings { step: Step::Fixed(0.02), ..settings(SIDE, SIDE) };
            let found = plain_picture(&scene, &settings);
            let reference_renderer = ReferenceRenderer::load(&scene).expect("it loads");
            let (mut covered, mut wrong) = (0, 0);
            for (at, pixel) in found.iter().enumerate() {
                let (x, y) = (at as u32 % SIDE, at as u32 / SIDE);
                let exact = reference_renderer
                    .pixel(&camera(), &settings, &ReferenceSteps::same(0.02), x, y)
                    .expect("a camera");
                covered += usize::from(exact[3] > 0.1);
                wrong +=
                    usize::from((0..4).any(|c| !((f64::from(pixel[c]) - exact[c]).abs() <= 1.0 / 1024.0)));
            }
            assert!(covered > 200 && wrong <= 2, "{}: {wrong} of {covered} pixels differ", kind.name());
        }
    }
}

#[test]
fn a_grid_is_the_same_picture_for_every_budget_and_thread_count() {
    let folder = folder();
    let grid = grid(folder.path(), VoxelKind::F32);
    let scene = scene(object(&grid, 0.0));
    let expected = bits(&plain_picture(&scene, &settings(48, 48)));
    for (threads, pages) in [(1, 6), (2, 8), (3, 12), (2, 1000)] {
        let exec = ExecSettings { threads, ..ExecSettings::default() };
        let set = paged(&scene, pages * (32 << 10));
        let found = picture(&scene, &camera(), &settings(48, 48), &exec, &set).expect("a picture");
        assert!(bits(&found) == expected, "{threads} threads, {pages} pages");
        assert!(set.pages.statistics().peak_bytes <= pages * (32 << 10));
    }
}

#[test]
fn every_flipped_byte_of_a_grid_file_is_noticed() {
    let folder = folder();
    let grid = grid(folder.path(), VoxelKind::U8);
    let bytes = std::fs::read(grid.path()).expect("a read");
    let path = folder.path().join("flipped.rset");
    let mut random = Random(5);
    for _ in 0..300 {
        let at = (random.unit() * bytes.len() as f64) as usize;
        let mut damaged = bytes.clone();
        damaged[at] ^= 1 << (at % 8);
        std::fs::write(&path, &damaged).expect("a write");
        let checked = Grid::open(&path)
            .map_err(|e| e.to_string())
            .and_then(|grid| grid.verify().map_err(|e| e.to_string()));
        assert!(checked.is_err(), "byte {at}");
    }
    std::fs::write(&path, &bytes[..bytes.len() - 1]).expect("a write");
    assert!(Grid::open(&path).is_err());
}

fn written(folder: &Path, name: &str, parts: &[&[u8]]) -> PathBuf {
    let path = folder.join(name);
    let mut file = std::fs::File::create(&path).expect("a file");
    parts.iter().for_each(|part| file.write_all(part).expect("a write"));
    path
}

fn gzipped(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(bytes).expect("a write");
    encoder.finish().expect("it ends")
}

fn zipped(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(bytes).expect("a write");
    encoder.finish().expect("it ends")
}

fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::new();
    for chunk in bytes.chunks(3) {
        let bits = (0..3).fold(0_u32, |bits, i| bits << 8 | u32::from(chunk.get(i).copied().unwrap_or(0)));
        for i in 0..4 {
            let letter = LETTERS[(bits >> (18 - 6 * i)) as usize & 63];
            text.push(if i <= chunk.len() { letter as char } else { '=' });
        }
    }
    text
}

#[test]
fn the_same_voxels_come_out_of_every_format() {
    let folder = folder();
    let f = folder.path();
    let short = voxels(VoxelKind::I16, false);
    let big = voxels(VoxelKind::I16, true);
    let nrrd = |encoding: &str, endian: &str| {
        format!(
            "NRRD0004\n# a comment\ntype: short\ndimension: 3\nsizes: 45 37 52\nendian: {endian}\nencoding: {encoding}\n\
             space directions: (2,0,0) (0,3,0) (0,0,4)\nspace origin: (1,2,3)\nkey:=value\n\n"
        )
    };
    let meta = |local: &str, zip: bool| {
        format!(
            "ObjectType = Image\nNDims = 3\nDimSize = 45 37 52\nElementType = MET_SHORT\nElementSpacing = 2 3 4\n\
             Offset = 1 2 3\nCompressedData = {}\nElementDataFile = {local}\n",
            if zip { "True" } else { "False" }
        )
    };
    let mut nifti = vec![0_u8; 352];
    nifti[0..4].copy_from_slice(&348_i32.to_le_bytes());
    for (i, n) in [3_i16, 45, 37, 52, 1].into_iter().enumerate() {
        nifti[40 + 2 * i..42 + 2 * i].copy_from_slice(&n.to_le_bytes());
    }
    nifti[70..72].copy_from_slice(&4_i16.to_le_bytes());
    nifti[108..112].copy_from_slice(&352_f32.to_le_bytes());
    nifti[254..256].copy_from_slice(&1_i16.to_le_bytes());
    let rows = [[2.0, 0.0, 0.0, 1.0], [0.0, 3.0, 0.0, 2.0], [0.0, 0.0, 4.0, 3.0_f32]];
    for (i, v) in rows.into_iter().flatten().enumerate() {
        nifti[280 + 4 * i..284 + 4 * i].copy_from_slice(&v.to_le_bytes());
    }
    nifti[344..348].copy_from_slice(b"n+1\0");
    let vti = |file: &str, array: &str, tail: &str| {
        format!(
            "<?xml version=\"1.0\"?>\n<VTKFile type=\"ImageData\" byte_order=\"LittleEndian\" header_type=\"UInt32\"{file}>\n\
             <ImageData WholeExtent=\"0 44 0 36 0 51\" Origin=\"1 2 3\" Spacing=\"2 3 4\">\n<Piece Extent=\"0 44 0 36 0 51\">\n\
             <PointData Scalars=\"v\">\n<DataArray type=\"Int16\" Name=\"v\" {array}</PointData></Piece></ImageData>{tail}</VTKFile>"
        )
    };
    let length = (short.len() as u32).to_le_bytes();
    let inline = base64(&[&length[..], &short].concat());
    let block = 40_000;
    let blocks: Vec<Vec<u8>> = short.chunks(block).map(zipped).collect();
    let mut head: Vec<u32> = vec![blocks.len() as u32, block as u32, (short.len() % block) as u32];
    head.extend(blocks.iter().map(|b| b.len() as u32));
    let head: Vec<u8> = head.iter().flat_map(|n| n.to_le_bytes()).collect();
    let compressed = format!("{}{}", base64(&head), base64(&blocks.concat()));
    let appended = vti("", "format=\"appended\" offset=\"0\"/>", "<AppendedData encoding=\"raw\">_");
    let appended = appended.trim_end_matches("</VTKFile>");
    written(f, "beside.raw", &[&short]);
    let paths = [
        written(f, "a.nrrd", &[nrrd("raw", "little").as_bytes(), &short]),
        written(f, "b.nrrd", &[nrrd("raw", "big").as_bytes(), &big]),
        written(f, "c.nrrd", &[nrrd("gzip", "little").as_bytes(), &gzipped(&short)]),
        written(
            f,
            "d.nhdr",
            &[nrrd("raw", "little").replace("key:=value", "data file: beside.raw").as_bytes()],
        ),
        written(f, "e.mha", &[meta("LOCAL", false).as_bytes(), &short]),
        written(f, "f.mha", &[meta("LOCAL", true).as_bytes(), &zipped(&short)]),
        written(f, "g.mhd", &[meta("beside.raw", false).as_bytes()]),
        written(f, "h.nii", &[&nifti, &short]),
        written(f, "i.nii.gz", &[&gzipped(&[&nifti[..], &short].concat())]),
        written(
            f,
            "j.vti",
            &[vti("", &format!("format=\"binary\">\n{inline}\n</DataArray>"), "").as_bytes()],
        ),
        written(
            f,
            "k.vti",
            &[vti(
                " compressor=\"vtkZLibDataCompressor\"",
                &format!("format=\"binary\">\n  {compressed}\n</DataArray>"),
                "",
            )
            .as_bytes()],
        ),
        written(f, "l.vti", &[appended.as_bytes(), &length, &short]),
    ];
    let mut identities = Vec::new();
    for path in &paths {
        let source = volumes::open(path, None).unwrap_or_else(|e| panic!("{e}"));
        let built = path.with_extension("rset");
        let header =
            build(source, &built, &GridBuildOptions::default(), &rayset::build::BuildControl::default())
                .unwrap_or_else(|e| panic!("{e}"));
        assert_eq!((header.size, header.kind), (SIZE, VoxelKind::I16), "{}", path.display());
        let corner = header.space_from_voxel.transform_point3(header.last_voxel());
        assert_eq!(corner, DVec3::new(89.0, 110.0, 207.0), "{}", path.display());
        // Of placement and voxels. Formats differ in what else they say, such as what is up.
        identities.push(header.identity);
    }
    assert!(identities.iter().all(|identity| *identity == identities[0]), "the formats differ");
    let grid = Grid::open(paths[0].with_extension("rset")).expect("it opens");
    let loaded = grid.load().expect("it loads");
    for (at, v) in loaded.iter().enumerate() {
        let at = at as u64;
        let (i, j, k) = (at % SIZE[0], at / SIZE[0] % SIZE[1], at / SIZE[0] / SIZE[1]);
        assert_eq!(f64::from(*v), value(i, j, k) - 100.0);
    }
}

#[test]
fn malformed_volumes_are_errors_that_say_where() {
    let folder = folder();
    let f = folder.path();
    for (name, text, expected) in [
        ("a.nrrd", "NRRD0004\ntype: short\nsizes: 4 4\n\n", "line 3, sizes"),
        ("b.nrrd", "P6\n", "line 1"),
        ("c.nrrd", "NRRD0004\ntype: uchar\ndimension: 3\nsizes: 4 4 4\nencoding: raw\n\n", "ends before"),
        ("d.mha", "ObjectType = Image\nDimSize = 4 4 4\nElementType = MET_FLOUR\n", "line 3, ElementType"),
        ("e.mhd", "DimSize = 4 4 4\n", "ElementDataFile"),
        ("f.nii", "short", "348"),
        (
            "g.vti",
            "<VTKFile><ImageData WholeExtent=\"0 1\"><Piece/></ImageData></VTKFile>",
            "six whole numbers",
        ),
        ("h.nrrd", "NRRD0004\ntype: uchar\ndimension: 3\nsizes: 1 4 4\nencoding: raw\n\n", "2 to"),
    ] {
        let path = written(f, name, &[text.as_bytes()]);
        let outcome = volumes::open(&path, None).map_err(|e| e.to_string()).and_then(|source| {
            build(
                source,
                f.join("out.rset"),
                &GridBuildOptions::default(),
                &rayset::build::BuildControl::default(),
            )
            .map_err(|e| e.to_string())
        });
        let message = outcome.expect_err("it is malformed");
        assert!(message.contains(expected), "{name}: {message}");
        assert!(!f.join("out.rset").exists());
    }
}

#[test]
fn real_volumes_read() {
    for (name, size) in [
        ("volume/CT_AVM.nii.gz", None),
        ("volume/FLAIR.nrrd", Some([124, 160, 140])),
        ("volume/hydrogen.vti", Some([64, 64, 64])),
        ("volume/brainweb1e5a10f17.mha", Some([181, 217, 180])),
        ("volume/headsq.mhd", Some([64, 64, 93])),
    ] {
        let Some(path) = real_data(name) else { return };
        let folder = folder();
        let source = volumes::open(&path, None).unwrap_or_else(|e| panic!("{e}"));
        let header = build(
            source,
            folder.path().join("v.rset"),
            &GridBuildOptions::default(),
            &rayset::build::BuildControl::default(),
        );
        let header = header.unwrap_or_else(|e| panic!("{name}: {e}"));
        assert!(size.is_none_or(|size| size == header.size), "{name}: {:?}", header.size);
        assert!(header.range.0 < header.range.1, "{name}: {:?}", header.range);
    }
}

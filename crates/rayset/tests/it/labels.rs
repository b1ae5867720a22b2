//! Grids whose values are labels: counted and named as they are built, never mixed as they are
//! seen.

use std::path::Path;
use std::sync::Arc;

use rayset::build::BuildControl;
use rayset::geometry::{DAffine3, DQuat, DVec3};
use rayset::grid::build::{GridBuildOptions, build};
use rayset::grid::{Grid, VoxelKind};
use rayset::scene::{
    ColorMap, ColorRule, Compositing, Form, GridObject, Lighting, MapInput, Node, OpacityRule, Operator,
    Palette, RenderSettings, Scene, Shape, Solid, Step, TransferFunction,
};
use rayset::trace::reference::{ReferenceRenderer, ReferenceSteps};
use rayset::volumes::{self, RawLayout, VolumeSource};

use crate::common::{camera, folder, plain_picture, settings};

const SIZE: [u64; 3] = [33, 28, 30];
/// With gaps, as atlases have them.
const LABELS: [f64; 5] = [0.0, 2.0, 17.0, 41.0, 200.0];

/// A ball of four parts, with a bite.
fn label(i: u64, j: u64, k: u64) -> f64 {
    let p = DVec3::new(i as f64 / 32.0, j as f64 / 27.0, k as f64 / 29.0) * 2.0 - 1.0;
    let is_bitten = p.x > 0.1 && p.y > 0.05 && p.z > 0.0;
    if p.length() > 0.85 || is_bitten {
        return LABELS[0];
    }
    LABELS[1 + usize::from(p.x + 0.3 * p.y > 0.0) + 2 * usize::from(p.z - 0.2 * p.x > 0.1)]
}

fn voxels(kind: VoxelKind) -> Vec<u8> {
    let mut bytes = Vec::new();
    for k in 0..SIZE[2] {
        for j in 0..SIZE[1] {
            for i in 0..SIZE[0] {
                let v = label(i, j, k);
                match kind {
                    VoxelKind::U8 => bytes.push(v as u8),
                    VoxelKind::I16 => bytes.extend((v as i16).to_le_bytes()),
                    VoxelKind::U16 => bytes.extend((v as u16).to_le_bytes()),
                    _ => bytes.extend((v as f32).to_le_bytes()),
                }
            }
        }
    }
    bytes
}

fn built(source: VolumeSource, path: &Path) -> Arc<Grid> {
    build(source, path, &GridBuildOptions::default(), &BuildControl::default()).expect("it builds");
    Arc::new(Grid::open(path).expect("it opens"))
}

fn grid(folder: &Path, kind: VoxelKind) -> Arc<Grid> {
    let (raw, path) = (folder.join("v.raw"), folder.join(format!("{}.rset", kind.name())));
    std::fs::write(&raw, voxels(kind)).expect("a write");
    let layout: RawLayout =
        format!("33x28x30,{},spacing=0.05x0.05x0.05", kind.name()).parse().expect("a layout");
    built(layout.open(&raw).expect("it opens"), &path)
}

/// One colour for each label but the background, which is transparent.
fn transfer(opacities: [f64; 4]) -> TransferFunction {
    let palette = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 1.0, 0.0]];
    let (low, high) = (LABELS[0], LABELS[4] + 1.0);
    let stops = LABELS[1..]
        .iter()
        .zip(palette)
        .flat_map(|(label, color)| [-0.5, 0.5].map(|by| ((label + by - low) / (high - low), color)));
    let map = ColorMap { palette: Palette::Stops(stops.collect()), range: (low, high) };
    let curve = LABELS[1..]
        .iter()
        .zip(opacities)
        .flat_map(|(label, opacity)| [(label - 0.5, opacity), (label + 0.5, opacity)]);
    TransferFunction {
        opacity: OpacityRule::Curve([(0.5, 0.0)].into_iter().chain(curve).collect()),
        color: ColorRule::Map { map, input: MapInput::Density },
    }
}

fn node(grid: &Arc<Grid>, opacities: [f64; 4]) -> Node {
    let turn = DQuat::from_axis_angle(DVec3::new(0.3, 1.0, 0.2).normalize(), 0.6);
    Node::new(Shape::Grid(GridObject { grid: grid.clone(), transfer: transfer(opacities), labels: true }))
        .moved(DAffine3::from_translation(DVec3::new(-0.8, -0.7, -0.7)))
        .moved(DAffine3::from_scale_rotation_translation(DVec3::new(1.0, 1.2, 0.9), turn, DVec3::ZERO))
}

#[test]
fn labels_agree_with_the_reference_renderer_alone_and_cut_open() {
    const SIDE: u32 = 40;
    let folder = folder();
    for &kind in VoxelKind::ALL {
        let grid = grid(folder.path(), kind);
        let ball = || {
            let ball = Solid::new(Form::Sphere { radius: 0.4 }).colored([0.8, 0.3, 0.2]);
            Node::new(Shape::Procedural(Arc::new(ball))).moved(DAffine3::from_translation(DVec3::Z * 0.5))
        };
        let (solid, faint) = ([0.95; 4], [0.1, 0.3, 0.8, 0.05]);
        let roots = [
            node(&grid, solid),
            node(&grid, faint),
            Node::operator(Operator::Difference, [node(&grid, solid), ball()]),
            Node::operator(Operator::Intersection, [node(&grid, faint), ball()]),
            Node::operator(Operator::Union, [node(&grid, faint), ball()]),
        ];
        for (number, root) in roots.into_iter().enumerate() {
            let scene = Scene {
                root: Arc::new(root),
                lighting: Lighting::headlight(),
                background: None,
                unit_distance: 0.05,
                compositing: Compositing::Linear,
            };
            let settings = RenderSettings { step: Step::Fixed(0.02), ..settings(SIDE, SIDE) };
            let found = plain_picture(&scene, &settings);
            let reference = ReferenceRenderer::load(&scene).expect("it loads");
            let (mut covered, mut wrong) = (0, Vec::new());
            for (at, pixel) in found.iter().enumerate() {
                let (x, y) = (at as u32 % SIDE, at as u32 / SIDE);
                let exact = reference
                    .pixel(&camera(), &settings, &ReferenceSteps::same(0.02), x, y)
                    .expect("a camera");
                covered += usize::from(exact[3] > 0.1);
                if (0..4).any(|c| !((f64::from(pixel[c]) - exact[c]).abs() <= 1.0 / 1024.0)) {
                    wrong.push((x, y, *pixel, exact));
                }
            }
            assert!(covered > 100 && wrong.len() <= 2, "{}, {number}: of {covered}, {wrong:?}", kind.name());
        }
    }
}

#[test]
fn no_sample_has_a_colour_between_two_labels() {
    let folder = folder();
    let grid = grid(folder.path(), VoxelKind::I16);
    let root = Arc::new(node(&grid, [1.0; 4]));
    let scene = Scene {
        root,
        lighting: Lighting::Unlit,
        background: None,
        unit_distance: 1e-4,
        compositing: Compositing::Linear,
    };
    let found = plain_picture(&scene, &settings(64, 64));
    let opaque = || found.iter().filter(|pixel| pixel[3] > 0.999);
    let of_colors = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 1.0, 0.0]]
        .map(|color| opaque().filter(|pixel| (0..3).all(|c| (pixel[c] - color[c]).abs() < 1e-3)).count());
    assert_eq!(of_colors.iter().sum::<usize>(), opaque().count(), "{of_colors:?}");
    assert!(of_colors.iter().all(|count| *count > 10), "{of_colors:?}");
}

#[test]
fn the_values_of_voxels_are_counted_whatever_memory_a_grid_is_built_in() {
    let folder = folder();
    for &kind in VoxelKind::ALL {
        let found = grid(folder.path(), kind).header().labels.clone();
        assert!(!found.said);
        let mut counts = LABELS.map(|value| (value, 0_u64));
        for i in 0..SIZE.iter().product::<u64>() {
            let value = label(i % SIZE[0], i / SIZE[0] % SIZE[1], i / SIZE[0] / SIZE[1]);
            counts.iter_mut().filter(|count| count.0 == value).for_each(|count| count.1 += 1);
        }
        let values: Vec<(f64, u64)> = found.values.iter().map(|label| (label.value, label.voxels)).collect();
        assert_eq!(values, counts, "{}", kind.name());
        assert!(found.mean_run_without(Some(0.0)) > 4.0);
    }
}

/// A header of NRRD, and the voxels.
fn nrrd(folder: &Path, more: &str, sizes: &str, voxels: &[u8]) -> VolumeSource {
    let head = format!("NRRD0004\ntype: unsigned char\nencoding: raw\nsizes: {sizes}\n{more}\n");
    let path = folder.join("v.seg.nrrd");
    std::fs::write(&path, [head.as_bytes(), voxels].concat()).expect("a write");
    volumes::open(&path, Some(if sizes.starts_with("2 ") { 1 } else { 0 })).expect("it opens")
}

#[test]
fn segments_of_nrrd_name_and_colour_the_labels_of_their_layer() {
    let folder = folder();
    let more = "dimension: 3\nspacings: 1 1 1\nSegment0_Name:=liver\nSegment0_LabelValue:=2\nSegment0_Color:=0.2 0.4 1\n\
                Segment1_Name:=vena cava\u{7}\nSegment1_LabelValue:=17\nSegment1_Extent:=0 1 2 3 4 5\n\
                Segment2_Name:=nowhere\nSegment2_LabelValue:=99\n";
    let found =
        built(nrrd(folder.path(), more, "33 28 30", &voxels(VoxelKind::U8)), &folder.path().join("a.rset"));
    let labels = &found.header().labels;
    let named = |value: f64| labels.values.iter().find(|label| label.value == value).expect("a label");
    assert!(labels.said);
    assert_eq!((named(2.0).name.as_str(), named(2.0).color), ("liver", Some([51, 102, 255])));
    assert_eq!((named(17.0).name.as_str(), named(17.0).color), ("vena cava", None));
    assert_eq!(named(41.0).name, "");
    assert!(labels.values.iter().all(|label| label.value != 99.0));
    // Two layers, voxel by voxel: the second has the labels of its own.
    let layered: Vec<u8> = voxels(VoxelKind::U8).into_iter().flat_map(|v| [0, u8::from(v > 0)]).collect();
    let more = "dimension: 4\nkinds: list domain domain domain\nSegment0_Name:=liver\nSegment0_LabelValue:=1\n\
                Segment0_Layer:=0\nSegment1_Name:=all\nSegment1_LabelValue:=1\nSegment1_Layer:=1\n";
    let found = built(nrrd(folder.path(), more, "2 33 28 30", &layered), &folder.path().join("b.rset"));
    let names: Vec<&str> = found.header().labels.values.iter().map(|label| label.name.as_str()).collect();
    assert_eq!(names, ["", "all"]);
}

#[test]
fn nifti_says_that_values_are_labels_and_names_them_in_an_extension() {
    let folder = folder();
    let write = |intent: i16, extension: &str| {
        let mut head = vec![0_u8; 352];
        head[..4].copy_from_slice(&348_i32.to_le_bytes());
        for (at, v) in [(40, 3_i16), (42, 33), (44, 28), (46, 30), (68, intent), (70, 2), (72, 8)] {
            head[at..at + 2].copy_from_slice(&v.to_le_bytes());
        }
        let mut rest = Vec::new();
        if !extension.is_empty() {
            head[348] = 1;
            let bytes = (extension.len() + 8).next_multiple_of(16);
            rest.extend((bytes as u32).to_le_bytes());
            rest.extend(30_u32.to_le_bytes());
            rest.extend(extension.bytes());
            rest.resize(bytes, 0);
        }
        head[108..112].copy_from_slice(&((352 + rest.len()) as f32).to_le_bytes());
        head[344..348].copy_from_slice(b"n+1\0");
        let path = folder.path().join("v.nii");
        std::fs::write(&path, [head, rest, voxels(VoxelKind::U8)].concat()).expect("a write");
        let found = built(volumes::open(&path, None).expect("it opens"), &folder.path().join("n.rset"));
        found.header().labels.clone()
    };
    assert!(!write(0, "").said);
    assert!(write(1002, "").said);
    let table = "<CaretExtension><VolumeInformation><LabelTable><Label Key=\"2\" Red=\"1\" Green=\"0\" Blue=\"0.2\">\
                 <![CDATA[spleen]]></Label></LabelTable></VolumeInformation></CaretExtension>";
    let found = write(0, table);
    assert!(found.said);
    assert_eq!((found.values[1].name.as_str(), found.values[1].color), ("spleen", Some([255, 0, 51])));
}

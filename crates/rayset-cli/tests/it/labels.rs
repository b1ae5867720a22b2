//! Label maps as programs write them: a colour for each label, names and colours of the file, a
//! legend.

use std::collections::HashMap;
use std::fs;
use std::path::Path;

use serde_json::Value;

use crate::common::{Random, folder, program};

fn rayset(folder: &Path, arguments: &[&str]) -> String {
    let mut command = program();
    command.current_dir(folder).env("XDG_CACHE_HOME", folder.join("home")).args(arguments);
    let output = command.output().expect("the program runs");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{arguments:?}: {said}");
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// How many pixels of a picture have each colour; those that are transparent or of an edge have
/// none.
fn colors(path: &Path) -> HashMap<[u8; 3], usize> {
    let reader = std::io::BufReader::new(fs::File::open(path).expect("the picture"));
    let mut reader = png::Decoder::new(reader).read_info().expect("a PNG");
    let mut bytes = vec![0; reader.output_buffer_size().expect("a size")];
    reader.next_frame(&mut bytes).expect("a picture");
    let mut counts = HashMap::new();
    for [r, g, b, a] in bytes.as_chunks::<4>().0 {
        if *a == 255 {
            *counts.entry([*r, *g, *b]).or_default() += 1;
        }
    }
    counts
}

const SIDE: usize = 40;
/// Far apart, as those of atlases are.
const LABELS: [u16; 6] = [2, 10, 17, 41, 1001, 2035];

/// Six bars side by side, as 3D Slicer writes segments; the first three have names and colours.
fn segmentation(path: &Path) {
    let mut bytes = b"NRRD0004\ntype: unsigned short\ndimension: 3\nspace: left-posterior-superior\nsizes: 40 40 40\n\
        space directions: (1,0,0) (0,1,0) (0,0,1)\nkinds: domain domain domain\nendian: little\nencoding: raw\n\
        space origin: (0,0,0)\nSegment0_Name:=liver\nSegment0_LabelValue:=2\nSegment0_Color:=0.8 0.2 0\n\
        Segment1_Name:=spleen\nSegment1_LabelValue:=10\nSegment1_Color:=0 0.6 0.2\n\
        Segment2_Name:=kidney\nSegment2_LabelValue:=17\nSegment2_Color:=0.2 0.4 1\n\n"
        .to_vec();
    for i in 0..SIDE * SIDE * SIDE {
        let [x, y, z] = [i % SIDE, i / SIDE % SIDE, i / SIDE / SIDE];
        let is_inside = [x, y, z].iter().all(|v| (2..38).contains(v));
        let label = if is_inside { LABELS[(x - 2) / 6] } else { 0 };
        bytes.extend(label.to_le_bytes());
    }
    fs::write(path, bytes).expect("a write");
}

#[test]
fn every_label_has_a_colour_of_its_own_that_no_other_mixes_with() {
    let folder = folder();
    segmentation(&folder.path().join("s.seg.nrrd"));
    let told: Value =
        serde_json::from_str(&rayset(folder.path(), &["info", "--json", "s.seg.nrrd"])).expect("JSON");
    assert_eq!(told["look"], "labels");
    let labels = told["labels"].as_array().expect("a list");
    let values: Vec<f64> = labels.iter().filter_map(|label| label["value"].as_f64()).collect();
    assert_eq!(values, [0.0, 2.0, 10.0, 17.0, 41.0, 1001.0, 2035.0]);
    assert_eq!(labels[2]["name"], "spleen");
    let plain = ["--view", "front", "--shading", "none", "--ambient-occlusion", "0", "--background", "none"];
    let render = ["render", "s.seg.nrrd", "-o", "p.png", "--size", "120x120", "--samples", "1"];
    rayset(folder.path(), &[&render[..], &plain].concat());
    let found = colors(&folder.path().join("p.png"));
    assert_eq!(found.len(), 6, "{found:?}");
    assert!(found.values().all(|count| *count > 500), "{found:?}");
    for named in [[204, 51, 0], [0, 153, 51], [51, 102, 255]] {
        assert!(found.contains_key(&named), "{named:?} of {found:?}");
    }
    // The same, by the scene that says so.
    rayset(folder.path(), &[&render[..], &plain, &["--write-scene", "s.json"]].concat());
    let scene: Value =
        serde_json::from_slice(&fs::read(folder.path().join("s.json")).expect("a scene")).expect("JSON");
    assert_eq!(scene["root"]["interpolation"], "label");
    rayset(folder.path(), &["render", "s.json", "-o", "again.png"]);
    let [first, again] =
        ["p.png", "again.png"].map(|name| fs::read(folder.path().join(name)).expect("a picture"));
    assert!(first == again, "the written scene has another picture");
}

#[test]
fn a_legend_lists_labels_in_their_colours() {
    let folder = folder();
    segmentation(&folder.path().join("s.seg.nrrd"));
    let render = ["render", "s.seg.nrrd", "-o", "p.png", "--size", "320x240", "--view", "back", "--annotate"];
    rayset(folder.path(), &render);
    // Lit surfaces have these very colours nowhere.
    let found = colors(&folder.path().join("p.png"));
    for named in [[204, 51, 0], [0, 153, 51], [51, 102, 255]] {
        assert!(found.get(&named).is_some_and(|count| *count >= 40), "{named:?}");
    }
}

#[test]
fn intensities_are_no_labels_however_few_they_are() {
    let folder = folder();
    let write = |name: &str, value: &mut dyn FnMut(f64) -> u8| {
        let mut bytes =
            format!("NRRD0004\ntype: uchar\ndimension: 3\nsizes: {SIDE} {SIDE} {SIDE}\nencoding: raw\n\n")
                .into_bytes();
        for i in 0..SIDE * SIDE * SIDE {
            let p = [i % SIDE, i / SIDE % SIDE, i / SIDE / SIDE].map(|v| v as f64 / 20.0 - 1.0);
            bytes.push(value(p.iter().map(|v| v * v).sum::<f64>().sqrt()));
        }
        fs::write(folder.path().join(name), bytes).expect("a write");
        let told = rayset(folder.path(), &["info", "--json", name]);
        serde_json::from_str::<Value>(&told).expect("JSON")["look"].clone()
    };
    let mut random = Random(3);
    assert_eq!(write("smooth.nrrd", &mut |r| (255.0 * (1.0 - r).max(0.0)) as u8), "volume");
    assert_eq!(
        write("noisy.nrrd", &mut |r| if r < 0.8 { 20 + (12.0 * random.unit()) as u8 } else { 0 }),
        "volume"
    );
    // A mask is a label.
    assert_eq!(write("mask.nrrd", &mut |r| u8::from(r < 0.7)), "labels");
}

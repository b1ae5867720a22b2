//! Gaussian splats as glTF: how nodes place them, and what is refused.

use std::fs;
use std::path::Path;

use rayset::geometry::{DQuat, DVec3};
use rayset::points::{self, ReadOptions};
use serde_json::{Value, json};

use crate::common::folder;
use crate::tables::{Table, table};

/// Numbers of two splats of degree 1, attribute after attribute.
const POSITIONS: [f32; 6] = [1.0, 2.0, 3.0, -1.0, 0.5, 0.0];
const SCALES: [f32; 6] = [0.5, 0.25, 0.125, 1.0, 1.0, 1.0];
const OPACITIES: [f32; 2] = [0.75, 0.25];

/// Writes a file with its data beside it, and returns its JSON to be changed.
fn document(folder: &Path) -> Value {
    let mut data: Vec<u8> = Vec::new();
    let mut views = Vec::new();
    let mut accessors = Vec::new();
    let mut add = |values: &[f32], kind: &str| {
        let at = data.len();
        data.extend(values.iter().flat_map(|v| v.to_le_bytes()));
        views.push(json!({"buffer": 0, "byteOffset": at, "byteLength": data.len() - at}));
        accessors
            .push(json!({"bufferView": views.len() - 1, "componentType": 5126, "count": 2, "type": kind}));
        accessors.len() - 1
    };
    let mut attributes = json!({"POSITION": add(&POSITIONS, "VEC3")});
    let own = |name: &str| format!("KHR_gaussian_splatting:{name}");
    attributes[own("ROTATION")] = json!(add(&[0.0, 0.0, 0.0, 1.0, 0.6, 0.0, 0.0, 0.8], "VEC4"));
    attributes[own("SCALE")] = json!(add(&SCALES, "VEC3"));
    attributes[own("OPACITY")] = json!(add(&OPACITIES, "SCALAR"));
    attributes[own("SH_DEGREE_0_COEF_0")] = json!(add(&[0.5, 0.0, -0.5, 0.0, 0.0, 0.0], "VEC3"));
    for k in 0..3 {
        let coefficients = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6].map(|v: f32| v * (k + 1) as f32);
        attributes[own(&format!("SH_DEGREE_1_COEF_{k}"))] = json!(add(&coefficients, "VEC3"));
    }
    fs::write(folder.join("data.bin"), &data).expect("a write");
    json!({
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_gaussian_splatting"],
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "buffers": [{"byteLength": data.len(), "uri": "data.bin"}],
        "bufferViews": views,
        "accessors": accessors,
        "meshes": [{"primitives": [{
            "mode": 0,
            "attributes": attributes,
            "extensions": {"KHR_gaussian_splatting": {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}},
        }]}],
    })
}

fn read(folder: &Path, document: &Value) -> Result<Table, String> {
    let path = folder.join("splats.gltf");
    fs::write(&path, document.to_string()).expect("a write");
    table(&path, None).map_err(|error| error.to_string())
}

fn column(table: &Table, name: &str) -> Vec<f64> {
    table.1.iter().find(|(found, _)| found == name).unwrap_or_else(|| panic!("{name}")).1.clone()
}

#[test]
fn nodes_turn_move_and_scale_splats_and_their_colours_with_them() {
    let folder = folder();
    let plain = document(folder.path());
    let before = read(folder.path(), &plain).expect("it reads");
    assert_eq!(before.0, [[1.0, 2.0, 3.0], [-1.0, 0.5, 0.0]]);
    assert_eq!(column(&before, "scale_1"), [0.25, 1.0]);
    assert_eq!(column(&before, "weight"), [0.75, 0.25]);
    assert_eq!(column(&before, "f_rest_3")[0] as f32, 0.2);
    // Two nodes: a quarter of a turn about z below a scale, and the same mesh as it is.
    let mut placed = plain.clone();
    let half = std::f64::consts::FRAC_1_SQRT_2;
    placed["nodes"] = json!([
        {"scale": [2, 2, 2], "translation": [10, 0, 0], "children": [1]},
        {"rotation": [0, 0, half, half], "mesh": 0},
        {"mesh": 0},
    ]);
    placed["scenes"] = json!([{"nodes": [2]}, {"nodes": [0, 2]}]);
    placed["scene"] = json!(1);
    let found = read(folder.path(), &placed).expect("it reads");
    assert_eq!(found.0.len(), 4);
    for i in 0..2 {
        let [x, y, z] = before.0[i];
        let expected = DVec3::new(10.0 - 2.0 * y, 2.0 * x, 2.0 * z);
        assert!(DVec3::from_array(found.0[i]).distance(expected) < 1e-6, "{:?}", found.0[i]);
        assert_eq!(found.0[i + 2], before.0[i]);
        assert!((column(&found, "scale_0")[i] / column(&before, "scale_0")[i] - 2.0).abs() < 1e-9);
        let quaternion = |table: &Table, i: usize| {
            let names = ["rotation_x", "rotation_y", "rotation_z", "rotation_w"];
            DQuat::from_array(names.map(|name| column(table, name)[i]))
        };
        let turned = DQuat::from_rotation_z(std::f64::consts::FRAC_PI_2) * quaternion(&before, i);
        assert!(turned.dot(quaternion(&found, i)).abs() > 1.0 - 1e-6);
        // Of degree 1 the coefficients are those of -y, z and -x: what was along y is along -x.
        for channel in 0..3 {
            let of = |table: &Table, k: usize| column(table, &format!("f_rest_{}", 3 * channel + k))[i];
            let (y, z, x) = (of(&before, 0), of(&before, 1), of(&before, 2));
            for (found, expected) in [0, 1, 2].map(|k| of(&found, k)).into_iter().zip([x, z, -y]) {
                assert!((found - expected).abs() < 1e-6, "channel {channel}: {found} and {expected}");
            }
        }
    }
}

#[test]
fn colours_in_linear_light_become_those_of_displays_without_their_harmonics() {
    let folder = folder();
    let mut linear = document(folder.path());
    linear["meshes"][0]["primitives"][0]["extensions"]["KHR_gaussian_splatting"]["colorSpace"] =
        json!("lin_rec709_display");
    let found = read(folder.path(), &linear).expect("it reads");
    // A half, and what a display shows of it.
    assert!((column(&found, "red")[1] - 0.735_357).abs() < 1e-5, "{:?}", column(&found, "red"));
    let source = points::open(folder.path().join("splats.gltf"), &ReadOptions::default()).expect("it opens");
    assert_eq!((source.schema().harmonics().0, source.schema().warnings.len()), (0, 1));
}

#[test]
fn gltf_of_other_splats_or_without_their_data_is_refused_with_its_reason() {
    let folder = folder();
    let plain = document(folder.path());
    let refused = |change: &dyn Fn(&mut Value), said: &str| {
        let mut changed = plain.clone();
        change(&mut changed);
        let error = read(folder.path(), &changed).expect_err(said);
        let file = if said == "a scale below 0" { "data.bin, byte 56" } else { "splats.gltf" };
        assert!(error.contains(file) && error.contains(said), "{error}");
    };
    refused(&|d| d["nodes"][0]["scale"] = json!([1, 1, -1]), "mirrors splats");
    refused(&|d| d["nodes"][0]["scale"] = json!([1, 2, 1]), "differently along its axes");
    refused(&|d| d["nodes"][0]["rotation"] = json!([0, 0, 0, 0]), "a transform that is none");
    refused(&|d| d["nodes"][0]["matrix"] = json!([1, 2]), "a transform that is none");
    refused(&|d| d["nodes"][0]["children"] = json!([0]), "nested deeper");
    refused(&|d| d["nodes"] = json!([]), "`nodes` has no number 0");
    refused(&|d| d["accessors"][0]["count"] = json!(3), "which end behind the");
    refused(&|d| d["accessors"][0]["count"] = json!(u64::MAX), "which end behind the");
    refused(&|d| d["accessors"][0]["type"] = json!("VEC2"), "where VEC3 was expected");
    refused(&|d| d["accessors"][0]["componentType"] = json!(5125), "numbers of a type");
    refused(&|d| d["accessors"][3]["count"] = json!(1), "1 values of an attribute of 2 splats");
    refused(&|d| d["bufferViews"][0]["byteStride"] = json!(4), "expected 12 to 252");
    refused(&|d| d["bufferViews"][0]["byteStride"] = json!(u64::MAX), "expected 12 to 252");
    refused(&|d| d["accessors"][0]["sparse"] = json!({}), "a sparse accessor");
    refused(&|d| d["buffers"][0]["uri"] = json!("../data.bin"), "the name of a file beside this one");
    refused(&|d| d["buffers"][0]["uri"] = json!("data:;base64,AAAA"), "in the JSON itself");
    refused(&|d| drop(d["buffers"][0].as_object_mut().map(|b| b.remove("uri"))), "neither a `uri` nor data");
    let of_primitive = |key: &'static str, value: Value| {
        move |d: &mut Value| {
            d["meshes"][0]["primitives"][0]["extensions"]["KHR_gaussian_splatting"][key] = value.clone();
        }
    };
    refused(&of_primitive("kernel", json!("sheet")), "expected `ellipse`");
    refused(&of_primitive("colorSpace", json!("aces")), "in the colours `aces`");
    let spz = json!({"KHR_gaussian_splatting_compression_spz_2": {}});
    refused(&of_primitive("extensions", spz), "KHR_gaussian_splatting_compression_spz_2");
    // Logarithms, as drafts of the extension had them.
    let data = fs::read(folder.path().join("data.bin")).expect("the data");
    let mut draft = data.clone();
    draft[56..60].copy_from_slice(&(-5.5_f32).to_le_bytes());
    fs::write(folder.path().join("data.bin"), draft).expect("a write");
    refused(&|_| (), "a scale below 0");
    // Without splats, it is a file for renderers.
    let none = read(folder.path(), &json!({"asset": {"version": "2.0"}})).expect_err("refused");
    assert!(none.contains("a scene or a mesh for renderers"), "{none}");
}

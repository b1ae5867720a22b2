//! The JSON Schema of scene files says what the reader does.

use std::path::{Path, PathBuf};

use rayset::octree::build::BuildOptions;
use rayset::scene::{ColorRule, OpacityRule, Shape};
use rayset::scene_file::SceneFile;
use serde_json::Value;

use crate::common::{build_at, folder, mixed_points};

fn project() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn read(path: &Path) -> Value {
    let text = std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    serde_json::from_str(&text).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Whether a value is as a schema demands, in that part of the language (draft 2020-12) which ours
/// uses. Panics at a word that it does not know.
fn fits(schema: &Value, value: &Value, whole: &Value) -> bool {
    let Some(words) = schema.as_object() else { return schema.as_bool().expect("a schema") };
    let number = |v: &Value| v.as_f64().expect("a number");
    let count = |v: &Value| v.as_u64().expect("a count") as usize;
    words.iter().all(|(word, demand)| match word.as_str() {
        "$schema" | "$defs" | "title" | "description" | "default" => true,
        "$ref" => {
            let name = demand.as_str().and_then(|r| r.strip_prefix("#/$defs/")).expect("a reference");
            fits(&whole["$defs"][name], value, whole)
        }
        "type" => match demand.as_str().expect("a type") {
            "object" => value.is_object(),
            "array" => value.is_array(),
            "string" => value.is_string(),
            "boolean" => value.is_boolean(),
            "number" => value.is_number(),
            "integer" => value.is_u64() || value.is_i64(),
            "null" => value.is_null(),
            other => panic!("type {other}"),
        },
        "const" => value == demand,
        "enum" => demand.as_array().expect("words").contains(value),
        "anyOf" => demand.as_array().expect("schemas").iter().any(|s| fits(s, value, whole)),
        "required" => {
            let missing = |key: &Value| value.get(key.as_str().expect("a key")).is_none();
            !value.is_object() || !demand.as_array().expect("keys").iter().any(missing)
        }
        "properties" => value
            .as_object()
            .is_none_or(|o| o.iter().all(|(k, v)| demand.get(k).is_none_or(|s| fits(s, v, whole)))),
        "additionalProperties" => value.as_object().is_none_or(|o| {
            o.iter().all(|(k, v)| schema["properties"].get(k).is_some() || fits(demand, v, whole))
        }),
        "items" => value.as_array().is_none_or(|items| items.iter().all(|v| fits(demand, v, whole))),
        "minItems" => value.as_array().is_none_or(|items| items.len() >= count(demand)),
        "maxItems" => value.as_array().is_none_or(|items| items.len() <= count(demand)),
        "minimum" => value.as_f64().is_none_or(|v| v >= number(demand)),
        "maximum" => value.as_f64().is_none_or(|v| v <= number(demand)),
        "exclusiveMinimum" => value.as_f64().is_none_or(|v| v > number(demand)),
        // The only pattern is that of colours.
        "pattern" => value.as_str().is_none_or(|text| {
            let hex = text.strip_prefix('#').unwrap_or_default();
            hex.len() == 6 && hex.chars().all(|c| c.is_ascii_hexdigit())
        }),
        other => panic!("the schema says {other}, which this test does not know"),
    })
}

#[test]
fn every_example_fits_the_schema_and_mistakes_of_form_do_not() {
    let schema = read(&project().join("docs/scene.schema.json"));
    let mut examples = 0;
    for entry in std::fs::read_dir(project().join("examples")).expect("the examples") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            continue;
        }
        assert!(fits(&schema, &read(&path), &schema), "{} does not fit", path.display());
        examples += 1;
    }
    assert!(examples >= 8);
    // Mistakes that no schema can know: of names, of files, of relations between values.
    let beyond = [
        "a key given twice",
        "a half-space without end",
        "a normal of length zero",
        "a reference to nothing",
        "a reference where nothing has a name",
        "a node that contains itself",
        "a name given twice",
        "a scale of zero",
        "a matrix that flattens",
        "a transfer of nothing",
        "a transfer of an unknown channel",
        "an attribute that nothing here has",
        "a curve that goes back",
        "a curve with an opacity of 2",
        "a file that is not there",
        "a file that is no cloud",
        "points as they were scanned",
        "a cloud taken for a grid",
        "an attribute that is not stored",
        "an empty value range",
        "a preset that is not there",
        "a camera that looks up along its up",
        "a camera that looks at two things",
        "a camera that looks from nowhere",
        "frames out of order",
        "names nested without end",
        "a tower of names, from its foot",
        "more places than anyone could trace",
    ];
    let (mut refused, mut let_pass) = (0, Vec::<&str>::new());
    for (name, text) in crate::wrong_scenes::mistakes() {
        let Ok(value) = serde_json::from_str::<Value>(&text) else { continue };
        if fits(&schema, &value, &schema) {
            let_pass.push(name);
        } else {
            refused += 1;
        }
    }
    assert!(refused >= 40, "the schema finds {refused} mistakes");
    assert_eq!(let_pass, beyond, "what the schema lets pass");
}

#[test]
fn everything_that_the_schema_names_is_read() {
    let folder = folder();
    drop(build_at(
        &folder.path().join("p.rset"),
        Box::new(mixed_points(50, 1.0, 5)),
        &BuildOptions::default(),
    ));
    let preset = r#"[{"Name": "Fire", "RGBPoints": [0, 0, 0, 0, 1, 1, 0.5, 0, 2, 1, 1, 1], "Points": [0, 0, 0.5, 0, 2, 1, 0.5, 0]}]"#;
    std::fs::write(folder.path().join("maps.json"), preset).expect("a preset");
    let scene = r##"{
        "$schema": "x", "rayset": 1,
        "image": {"size": [8, 6], "samples": 2, "pattern": "stratified", "exposure": -1.5, "toneMapping": "filmic"},
        "camera": {"type": "orthographic", "position": [0, 0, 5], "direction": [0, 0, -1], "up": [0, 1, 0], "height": 3},
        "background": [0.1, 0.2, 0.3],
        "lights": [{"type": "ambient", "color": "#ffffff", "intensity": 0.5}, {"type": "headlight"},
            {"type": "directional", "direction": [0, -1, 0], "shadow": false},
            {"type": "point", "position": [1, 2, 3], "decay": false, "shadow": true}],
        "rendering": {"step": 0.01, "stepFraction": 0.5, "phase": "hashed", "stopTransmittance": 0.05, "unitDistance": 0.1,
            "shadows": "exact", "shadowResolution": 64, "maxDepth": 2, "lod": 0.5},
        "animation": {"keys": [{"frame": 0, "camera": {"position": [0, 0, 5], "lookAt": [0, 0, 0], "fovy": 30}},
            {"frame": 9, "camera": {"position": [5, 0, 0], "lookAt": [0, 0, 0]}}]},
        "define": {"ball": {"type": "sphere", "radius": 1, "id": "ball", "comment": "a ball"}},
        "root": {"type": "union", "children": [
            {"ref": "ball", "comment": "again", "transform": [{"matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,0]]}, {"scale": [1,2,1]}],
                "transfers": [{"input": "red", "opacity": [[0, 0], [1, 1]], "color": "plasma_r", "valueRange": [0, 1]}],
                "material": {"ambient": 0.1, "diffuse": 0.2, "specular": 0.3, "shininess": 4, "reflectance": 0.5, "refractiveIndex": 1.2}},
            {"type": "cloud", "file": "p.rset", "kernel": "gaussian", "normalised": true,
                "transferFunction": {"opacity": {"extinction": 2}, "color": "points"}},
            {"type": "cloud", "file": "p.rset", "kernel": "splat", "splatFilter": "3dgs", "transferFunction": {"opacity": {"extinction": 1}}},
            {"type": "cloud", "file": "p.rset", "transferFunction": {"preset": {"file": "maps.json", "name": "Fire"}, "input": "density"}},
            {"type": "blend", "children": [
                {"type": "box", "size": [1, 1, 1], "opacity": 0.5, "edge": 0.1, "color": {"type": "checker", "colors": ["#000000", [1, 1, 1]], "size": 0.5}},
                {"type": "cylinder", "radius": 1, "height": 1, "color": {"type": "gradient", "from": [0,0,0], "to": [1,0,0], "color": [[0, "#000000"], [1, "#ffffff"]], "valueRange": [0, 1]}},
                {"type": "cone", "radius": 1, "height": 1}, {"type": "torus", "majorRadius": 1, "minorRadius": 0.2},
                {"type": "ellipsoid", "radii": [1, 2, 3]},
                {"type": "noise", "radii": [1, 1, 1], "scale": 0.5, "octaves": 2, "roughness": 0.4, "opacity": 0.3, "cover": 0.5, "seed": 9, "color": "#ffffff"}]},
            {"type": "intersection", "children": [{"type": "halfSpace", "normal": [0, 1, 0], "offset": 0.2}, {"ref": "ball"}]},
            {"type": "difference", "children": [{"ref": "ball"}, {"ref": "ball", "transform": {"rotate": {"axis": [0, 1, 0], "degrees": 3}, "translate": [1, 0, 0], "scale": 0.5}}]}
        ]}}"##;
    let schema = read(&project().join("docs/scene.schema.json"));
    assert!(fits(&schema, &serde_json::from_str(scene).expect("JSON"), &schema), "the schema refuses it");
    let made = SceneFile::parse(&folder.path().join("scene.json"), scene).expect("the reader takes it");
    assert_eq!(made.path.expect("an animation").ends(), (0, 9));
    // Of the preset: its colours over its own range, and its opacities.
    let mut presets = 0;
    made.scene.root.for_each(&mut |node| {
        if let Shape::Cloud(object) = &node.shape
            && let (ColorRule::Map { map, .. }, OpacityRule::Curve(curve)) =
                (&object.transfer.color, &object.transfer.opacity)
        {
            presets += 1;
            assert_eq!((map.range, curve.as_slice()), ((0.0, 2.0), &[(0.0, 0.0), (2.0, 1.0)][..]));
            let [red, _, blue] = map.color(1.0);
            assert!(red > 0.99 && blue < 0.01, "{red} {blue}");
        }
    });
    assert_eq!(presets, 1);
}

#[test]
fn a_scene_without_a_setting_is_as_the_schema_says_it_is_by_default() {
    let parse = |scene: &Value| {
        let text = scene.to_string();
        SceneFile::parse(Path::new("scene.json"), &text).unwrap_or_else(|e| panic!("{text}: {e}"))
    };
    let bare = serde_json::json!({"rayset": 1, "root": {"type": "sphere", "radius": 1}});
    let [with_nothing, with_empty, with_all] = [0, 1, 2].map(|kind| {
        let mut scene = bare.clone();
        for group in ["image", "rendering"] {
            let schema = read(&project().join("docs/scene.schema.json"));
            let known = schema["properties"][group]["properties"].as_object().expect("settings").clone();
            let defaults =
                known.into_iter().filter_map(|(name, of)| Some((name, of.get("default")?.clone())));
            let defaults: serde_json::Map<String, Value> = defaults.collect();
            assert!(defaults.len() >= 5, "{group}: {defaults:?}");
            match kind {
                0 => continue,
                1 => scene[group] = serde_json::json!({}),
                _ => scene[group] = defaults.into(),
            }
        }
        parse(&scene)
    });
    for other in [with_empty, with_all] {
        assert_eq!(other.settings, with_nothing.settings);
        assert_eq!(format!("{:?}", other.display_transform), format!("{:?}", with_nothing.display_transform));
    }
}

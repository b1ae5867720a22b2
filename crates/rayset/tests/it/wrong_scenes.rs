//! Mistakes in scene files, and what is said of each: a golden file of messages that a newcomer can
//! act on.

use std::fmt::Write as _;
use std::path::Path;

use rayset::octree::build::BuildOptions;
use rayset::scene_file::SceneFile;

use crate::common::{build_at, folder, mixed_points};
use crate::golden::expected;

/// A scene around one root.
fn with_root(root: &str) -> String {
    format!("{{\n  \"rayset\": 1,\n  \"root\": {root}\n}}")
}

/// A scene of one ball, with more.
fn with(more: &str) -> String {
    format!("{{\n  \"rayset\": 1,\n  {more},\n  \"root\": {{\"type\": \"sphere\", \"radius\": 1}}\n}}")
}

/// Mistakes by name.
pub(crate) fn mistakes() -> Vec<(&'static str, String)> {
    let ball = r#"{"type": "sphere", "radius": 1}"#;
    let operator = |children: &str| with_root(&format!(r#"{{"type": "union", "children": {children}}}"#));
    let in_ball = |more: &str| with_root(&format!(r#"{{"type": "sphere", "radius": 1, {more}}}"#));
    let of_cloud = |more: &str| with_root(&format!(r#"{{"type": "cloud", "file": "points.rset", {more}}}"#));
    vec![
        ("an empty file", String::new()),
        ("a comma too many", "{\n  \"rayset\": 1,\n  \"root\": {\"type\": \"sphere\", \"radius\": 1,}\n}".into()),
        ("a brace too few", "{\"rayset\": 1, \"root\": {\"type\": \"sphere\", \"radius\": 1}".into()),
        ("a list instead of a scene", "[]".into()),
        ("no version", format!("{{\"root\": {ball}}}")),
        ("a version to come", format!("{{\"rayset\": 2, \"root\": {ball}}}")),
        ("no root", "{\"rayset\": 1}".into()),
        ("a key misspelt", with(r#""backgroud": "white""#)),
        ("a key of something else", with(r#""memory": "64MiB""#)),
        ("a key given twice", "{\"rayset\": 1,\n \"root\": {\"type\": \"sphere\", \"radius\": 1, \"radius\": 2}}".into()),
        ("no type", with_root(r#"{"radius": 1}"#)),
        ("a type misspelt", with_root(r#"{"type": "spehre", "radius": 1}"#)),
        ("a type unknown", with_root(r#"{"type": "teapot"}"#)),
        ("no radius", with_root(r#"{"type": "sphere"}"#)),
        ("a negative radius", with_root(r#"{"type": "sphere", "radius": -1}"#)),
        ("a radius in words", with_root(r#"{"type": "sphere", "radius": "one"}"#)),
        ("a key of another solid", with_root(r#"{"type": "sphere", "radius": 1, "height": 2}"#)),
        ("a box with two sides", with_root(r#"{"type": "box", "size": [1, 2]}"#)),
        ("a box without depth", with_root(r#"{"type": "box", "size": [1, 2, 0]}"#)),
        ("an opacity above 1", in_ball(r#""opacity": 1.5"#)),
        ("a colour by name", in_ball(r#""color": "red""#)),
        ("a colour of three digits", in_ball(r##""color": "#fff""##)),
        ("a checker of three colours", in_ball(r##""color": {"type": "checker", "colors": ["#000000", "#ffffff", "#ff0000"], "size": 1}"##)),
        ("a cap of a union", with_root(&format!(r##"{{"type": "union", "cap": "#ff0000", "children": [{ball}]}}"##))),
        ("a cap without a colour", with_root(&format!(r#"{{"type": "difference", "cap": true, "children": [{ball}, {ball}]}}"#))),
        ("a difference of one", with_root(&format!(r#"{{"type": "difference", "children": [{ball}]}}"#))),
        ("a union of none", operator("[]")),
        ("children that are no list", operator(ball)),
        ("a child that is no object", operator(r#"["sphere"]"#)),
        ("a half-space without end", with_root(r#"{"type": "halfSpace", "normal": [0, 1, 0]}"#)),
        ("a normal of length zero", with_root(r#"{"type": "halfSpace", "normal": [0, 0, 0]}"#)),
        ("a reference to nothing", with_root(r#"{"type": "union", "children": [{"type": "sphere", "radius": 1, "id": "ball"}, {"ref": "bal"}]}"#)),
        ("a reference where nothing has a name", operator(r#"[{"ref": "ball"}]"#)),
        ("a node that contains itself", "{\"rayset\": 1, \"define\": {\n  \"a\": {\"type\": \"union\", \"children\": [{\"ref\": \"b\"}]},\n  \"b\": {\"type\": \"union\", \"children\": [{\"ref\": \"a\"}]}},\n  \"root\": {\"ref\": \"a\"}}".into()),
        ("a name given twice", with_root(r#"{"type": "union", "children": [{"type": "sphere", "radius": 1, "id": "ball"}, {"type": "sphere", "radius": 2, "id": "ball"}]}"#)),
        ("a reference with a radius", "{\"rayset\": 1, \"define\": {\"a\": {\"type\": \"sphere\", \"radius\": 1}}, \"root\": {\"ref\": \"a\", \"radius\": 2}}".into()),
        ("a scale of zero", in_ball(r#""transform": {"scale": [1, 0, 1]}"#)),
        ("a matrix of two rows", in_ball(r#""transform": {"matrix": [[1, 0, 0, 0], [0, 1, 0, 0]]}"#)),
        ("a matrix that flattens", in_ball(r#""transform": {"matrix": [[1, 0, 0, 0], [2, 0, 0, 0], [0, 0, 1, 0]]}"#)),
        ("a turn about no axis", in_ball(r#""transform": {"rotate": {"degrees": 30}}"#)),
        ("a turn in radians", in_ball(r#""transform": {"rotate": {"axis": [0, 1, 0], "radians": 1}}"#)),
        ("a move in two dimensions", in_ball(r#""transform": [{"translate": [1, 2]}]"#)),
        ("a reflectance above 1", in_ball(r#""material": {"reflectance": 2}"#)),
        ("an index of refraction misspelt", in_ball(r#""material": {"refractiveIndx": 1.5}"#)),
        ("a transfer of nothing", in_ball(r#""transfers": [{"input": "red"}]"#)),
        ("a transfer of an unknown channel", in_ball(r#""transfers": [{"input": "alpha", "opacity": [[0, 0], [1, 1]]}]"#)),
        ("an attribute that nothing here has", with_root(r#"{"type": "union", "transfers": [{"input": "temperatur", "color": "viridis"}], "children": [{"type": "cloud", "file": "points.rset"}]}"#)),
        ("a curve that goes back", in_ball(r#""transfers": [{"opacity": [[0, 0], [0.5, 1], [0.25, 0]]}]"#)),
        ("a curve with an opacity of 2", in_ball(r#""transfers": [{"opacity": [[0, 0], [1, 2]]}]"#)),
        ("a file that is not there", with_root("{\n    \"type\": \"cloud\",\n    \"file\": \"poinst.rset\"\n  }")),
        ("a file that is no cloud", with_root(r#"{"type": "cloud", "file": "notes.txt"}"#)),
        ("points as they were scanned", with_root(r#"{"type": "cloud", "file": "scan.ply"}"#)),
        ("a cloud taken for a grid", with_root(r#"{"type": "grid", "file": "points.rset"}"#)),
        ("an attribute that is not stored", of_cloud(r#""transferFunction": {"input": "temperature", "color": "viridis"}"#)),
        ("a colour map misspelt", of_cloud(r#""transferFunction": {"color": "virdis"}"#)),
        ("a kernel misspelt", of_cloud(r#""kernel": "gausian""#)),
        ("an opacity rule misspelt", of_cloud(r#""transferFunction": {"opacity": "clmap"}"#)),
        ("an empty value range", of_cloud(r#""transferFunction": {"color": "viridis", "valueRange": [1, 1]}"#)),
        ("a preset that is not there", of_cloud(r#""transferFunction": {"preset": {"file": "maps.json"}}"#)),
        ("a picture without rows", with(r#""image": {"size": [640, 0]}"#)),
        ("a picture with one side", with(r#""image": {"size": [640]}"#)),
        ("a third of a ray", with(r#""image": {"samples": 0.33}"#)),
        ("a field of view of half a circle", with(r#""camera": {"position": [0, 0, 3], "fovy": 180}"#)),
        ("a camera that looks up along its up", with(r#""camera": {"position": [0, -3, 0], "direction": [0, 1, 0]}"#)),
        ("a camera that looks at two things", with(r#""camera": {"position": [0, 0, 3], "lookAt": [0, 0, 0], "direction": [0, 0, 1]}"#)),
        ("a camera that looks from nowhere", with(r#""camera": {"lookAt": [0, 0, 0]}"#)),
        ("a height of a perspective camera", with(r#""camera": {"position": [0, 0, 3], "height": 2}"#)),
        ("a light of unknown type", with(r#""lights": [{"type": "spot"}]"#)),
        ("a light without a place", with(r#""lights": [{"type": "point"}]"#)),
        ("a light that is no list", with(r#""lights": {"type": "ambient"}"#)),
        ("a shadow of ambient light", with(r#""lights": [{"type": "ambient", "shadow": true}]"#)),
        ("a step of nothing", with(r#""rendering": {"step": 0}"#)),
        ("shadows of an unknown kind", with(r#""rendering": {"shadows": "soft"}"#)),
        ("a depth without end", with(r#""rendering": {"maxDepth": 1000}"#)),
        ("frames out of order", with(r#""animation": {"keys": [{"frame": 5, "camera": {"position": [0, 0, 3]}}, {"frame": 5, "camera": {"position": [0, 0, 4]}}]}"#)),
        ("names nested without end", {
            let link = |i: usize| format!("\"n{i}\": {{\"type\": \"union\", \"children\": [{{\"ref\": \"n{}\"}}]}}", i + 1);
            let links: Vec<String> = (0..5000).map(link).collect();
            format!("{{\"rayset\": 1, \"define\": {{{}, \"n5000\": {ball}}}, \"root\": {{\"ref\": \"n0\"}}}}", links.join(","))
        }),
        ("a tower of names, from its foot", {
            let link = |i: usize| format!("\"n{i}\": {{\"type\": \"union\", \"children\": [{{\"ref\": \"n{}\"}}]}}", i - 1);
            let links: Vec<String> = (1..=5000).map(link).collect();
            let uses: Vec<String> = (1..=5000).map(|i| format!("{{\"ref\": \"n{i}\"}}")).collect();
            format!("{{\"rayset\": 1, \"define\": {{\"n0\": {ball}, {}}}, \"root\": {{\"type\": \"union\", \"children\": [{}]}}}}", links.join(","), uses.join(","))
        }),
        ("more places than anyone could trace", {
            let link = |i: usize| format!("\"n{i}\": {{\"type\": \"union\", \"children\": [{{\"ref\": \"n{}\"}}, {{\"ref\": \"n{}\"}}]}}", i - 1, i - 1);
            let links: Vec<String> = (1..=60).map(link).collect();
            format!("{{\"rayset\": 1, \"define\": {{\"n0\": {ball}, {}}}, \"root\": {{\"ref\": \"n60\"}}}}", links.join(","))
        }),
        ("an animation of nothing", with(r#""animation": {"keys": []}"#)),
    ]
}

#[test]
fn every_mistake_is_named_with_its_place_and_what_was_expected() {
    let folder = folder();
    let options = BuildOptions::default();
    drop(build_at(&folder.path().join("points.rset"), Box::new(mixed_points(200, 1.0, 3)), &options));
    std::fs::write(folder.path().join("notes.txt"), "a shopping list\n").expect("a file");
    std::fs::write(folder.path().join("scan.ply"), "ply\nformat ascii 1.0\n").expect("a file");
    let place = folder.path().display().to_string();
    let mut found = String::new();
    let mut distinct = std::collections::BTreeSet::new();
    for (name, text) in mistakes() {
        let path = folder.path().join("scene.json");
        let error = SceneFile::parse(Path::new(&path), &text).expect_err(name).to_string();
        let said = error.replace(&format!("{place}/"), "").replace(&place, ".");
        assert!(said.starts_with("scene.json:"), "{name}: {said}");
        distinct.insert(said.split_once(": ").map_or(said.clone(), |(_, what)| what.to_owned()));
        writeln!(found, "{name}\n    {said}").expect("text grows");
    }
    assert!(distinct.len() >= 60, "{} distinct messages", distinct.len());
    assert_eq!(found, expected("wrong_scenes.txt", &found), "RAYSET_BLESS=1 accepts what is said now");
}

//! Pictures as the program writes them.

use crate::common::folder;

#[test]
fn pictures_of_layers_read_back_as_they_were_and_crops_fit_into_them() {
    let folder = folder();
    let file = |name: &str| folder.path().join(name);
    let scene = r##"{"rayset": 1, "image": {"size": [70, 50]}, "root": {"type": "union", "children": [
        {"type": "sphere", "radius": 1, "color": "#c04030"}, {"type": "box", "size": [3, 0.2, 3]}]}}"##;
    std::fs::write(file("s.json"), scene).expect("a scene");
    let rayset = |arguments: &[&str]| {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_rayset"));
        let output = command.current_dir(folder.path()).args(arguments).output().expect("rayset runs");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    };
    rayset(&["render", "s.json", "-o", "whole.exr", "--memory", "64MiB"]);
    rayset(&["render", "s.json", "-o", "part.exr", "--crop", "20,10,30,35", "--threads", "1"]);
    let read = |name: &str| {
        let image = exr::prelude::read_first_flat_layer_from_file(file(name)).expect("an EXR file");
        let (size, at) = (image.layer_data.size, image.layer_data.attributes.layer_position);
        let channels: Vec<(String, Vec<u32>)> = (image.layer_data.channel_data.list.iter())
            .map(|c| (c.name.to_string(), c.sample_data.values_as_f32().map(f32::to_bits).collect()))
            .collect();
        ((size.0, size.1), (at.0, at.1), channels)
    };
    let (size, at, whole) = read("whole.exr");
    assert_eq!((size, at), ((70, 50), (0, 0)));
    let names: Vec<&str> = whole.iter().map(|(name, _)| name.as_str()).collect();
    for name in [
        "R",
        "A",
        "depth.Z",
        "normal.X",
        "albedo.G",
        "opacity.Y",
        "instanceId.Y",
        "samples.Y",
        "bytes.Y",
        "lodError.Y",
    ] {
        assert!(names.contains(&name), "{names:?}");
    }
    let (size, at, part) = read("part.exr");
    assert_eq!((size, at), ((30, 35), (20, 10)));
    for ((name, whole), (_, part)) in whole.iter().zip(&part) {
        if name == "bytes.Y" {
            continue;
        }
        for (i, value) in part.iter().enumerate() {
            let (x, y) = (20 + i % 30, 10 + i / 30);
            assert!(*value == whole[y * 70 + x], "{name} at {x}, {y}");
        }
    }
}

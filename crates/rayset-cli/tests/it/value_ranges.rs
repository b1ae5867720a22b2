//! Ranges of colour maps: numbers, percentiles, logarithms.

use std::fs;
use std::path::Path;

use serde_json::Value;

use crate::common::{folder, program};

fn rayset(folder: &Path, arguments: &[&str]) -> Result<String, String> {
    let output = program().current_dir(folder).args(arguments).output().expect("the program runs");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    if output.status.success() { Ok(said) } else { Err(said) }
}

/// The transfer function of the scene that is chosen for a file.
fn transfer(folder: &Path, input: &str, options: &[&str]) -> Value {
    let plain = ["render", input, "-o", "a.png", "--size", "8x8", "--write-scene", "s.json"];
    rayset(folder, &[&plain[..], options].concat()).expect("it renders");
    let text = fs::read(folder.join("s.json")).expect("a scene");
    let scene: Value = serde_json::from_slice(&text).expect("JSON");
    scene["root"]["transferFunction"].clone()
}

fn range(transfer: &Value) -> [f64; 2] {
    [0, 1].map(|i| transfer["valueRange"][i].as_f64().expect("a number"))
}

/// A thousand points whose column `v` goes from 0.01 to 1000, each at another power of ten.
fn cloud(folder: &Path) {
    let mut text = "x y z v\n".to_owned();
    for i in 0..1001 {
        let v = 10_f64.powf(f64::from(i) / 200.0 - 2.0);
        text += &format!("{} {} {} {v}\n", i % 10, i / 10 % 10, i / 100);
    }
    fs::write(folder.join("p.txt"), text).expect("a write");
    rayset(folder, &["build", "p.txt", "-o", "c.rset"]).expect("it builds");
}

#[test]
fn percentiles_and_logarithms_of_an_attribute_become_a_range_and_stops() {
    let folder = folder();
    let f = folder.path();
    cloud(f);
    let by_v = ["--look", "surface", "--color-by", "v"];
    let of = |options: &[&str]| transfer(f, "c.rset", &[&by_v[..], options].concat());
    let [low, high] = range(&of(&["--value-range", "20%:80%"]));
    assert!((low - 0.1).abs() < 2e-3 && (high - 100.0).abs() < 2.0, "{low} {high}");
    let [low, high] = range(&of(&["--value-range", "-3:80%"]));
    assert!(low == -3.0 && (high - 100.0).abs() < 2.0, "{low} {high}");
    // Of a coordinate, too.
    let by_x = transfer(f, "c.rset", &["--look", "surface", "--color-by", "x", "--value-range", "15%:85%"]);
    assert_eq!(range(&by_x), [1.0, 8.0]);
    let logarithmic = of(&["--log", "--colormap", "magma"]);
    let [low, high] = range(&logarithmic);
    assert!((low / 0.011 - 1.0).abs() < 0.1 && (high / 891.0 - 1.0).abs() < 0.1, "{low} {high}");
    let stops = logarithmic["color"].as_array().expect("stops");
    // The colour of the middle of the map is that of the geometric mean.
    let middle = &stops[stops.len() / 2];
    let value = low + middle[0].as_f64().expect("a place") * (high - low);
    assert!((value / (low * high).sqrt() - 1.0).abs() < 1e-6, "{value}");
    assert_eq!(middle[1], "#b73779");
    let given = of(&["--log", "--value-range", "0.1:10"]);
    assert_eq!(range(&given), [0.1, 10.0]);
    // And the picture has other colours.
    let picture = |options: &[&str]| {
        let plain = ["render", "c.rset", "-o", "b.png", "--size", "24x24", "--threads", "1"];
        rayset(f, &[&plain[..], &by_v, options].concat()).expect("it renders");
        fs::read(f.join("b.png")).expect("a picture")
    };
    assert!(picture(&["--value-range", "0.1:10"]) != picture(&["--value-range", "0.1:10", "--log"]));
}

#[test]
fn gas_stays_over_the_logarithm_whatever_its_map_and_range() {
    let folder = folder();
    let f = folder.path();
    cloud(f);
    let stops = |options: &[&str]| {
        let transfer = transfer(f, "c.rset", &[&["--look", "gas"], options].concat());
        let stops = transfer["color"].as_array().expect("stops").clone();
        (stops.len(), stops[stops.len() - 1][1].clone(), range(&transfer))
    };
    let (_, last, _) = stops(&["--colormap", "viridis"]);
    assert_eq!(last, "#fde725");
    let (_, last, ends) = stops(&["--value-range", "0.5:50"]);
    assert_eq!((last, ends), ("#fcffa4".into(), [0.5, 50.0]));
}

#[test]
fn ranges_that_make_no_sense_are_errors_that_say_what_would() {
    let folder = folder();
    let f = folder.path();
    cloud(f);
    let said = |options: &[&str]| {
        let plain = ["render", "c.rset", "-o", "a.png", "--size", "8x8", "--look", "surface"];
        rayset(f, &[&plain[..], options].concat()).expect_err("an error")
    };
    let text = said(&["--color-by", "x", "--log", "--value-range", "0:5"]);
    assert!(text.contains("must be above 0"), "{text}");
    let text = said(&["--log"]);
    assert!(text.contains("density") || text.contains("--colormap"), "{text}");
    let text = said(&["--colormap", "viridis", "--value-range", "1%:99%"]);
    assert!(text.contains("density") && text.contains("--value-range LOW:HIGH"), "{text}");
    let text = said(&["--color-by", "x", "--value-range", "1%:400%"]);
    assert!(text.contains("0% to 100%"), "{text}");
    assert!(!f.join("a.png").exists());
}

#[test]
fn percentiles_of_voxels_are_of_what_is_shown() {
    let folder = folder();
    let f = folder.path();
    // Half of the voxels are background, the others go from 100 to 200.
    let values: Vec<u8> =
        (0..4096_u32).map(|i| if i % 2 == 0 { 0 } else { 100 + (i / 2 % 101) as u8 }).collect();
    fs::write(f.join("v.raw"), values).expect("a write");
    rayset(f, &["build", "v.raw", "-o", "g.rset", "--raw", "16x16x16,u8"]).expect("it builds");
    let [low, high] = range(&transfer(f, "g.rset", &["--value-range", "10%:90%"]));
    assert!((105.0..115.0).contains(&low) && (185.0..195.0).contains(&high), "{low} {high}");
    assert!(transfer(f, "g.rset", &["--log"])["color"].is_array());
}

#[test]
fn another_map_shows_what_the_look_shows() {
    let folder = folder();
    let f = folder.path();
    cloud(f);
    let height = transfer(f, "c.rset", &["--look", "height"]);
    let other = transfer(f, "c.rset", &["--look", "height", "--colormap", "terrain"]);
    assert_eq!(other["color"], "terrain");
    assert_eq!((&other["input"], &other["valueRange"]), (&height["input"], &height["valueRange"]));
    // Where nothing is shown in colours of a map, it is the density.
    assert!(transfer(f, "c.rset", &["--look", "surface", "--colormap", "terrain"])["input"].is_null());
}

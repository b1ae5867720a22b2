//! `rayset info`: histograms, units, what is up and why.

use std::fs;
use std::path::Path;

use crate::common::{folder, program};

fn info(folder: &Path, locale: &str, arguments: &[&str]) -> String {
    let mut command = program();
    command.current_dir(folder).env("XDG_CACHE_HOME", folder.join("home")).env("LC_ALL", locale);
    let output = command.arg("info").args(arguments).output().expect("the program runs");
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// Points on a plate whose column `count` has few whole numbers, and `energy` eight orders of
/// magnitude.
fn plate(folder: &Path) {
    let mut text = "x y z count energy\n".to_owned();
    for i in 0..1600_i32 {
        let count = if i % 8 == 0 { 3 } else { 1 };
        let energy = 10_f64.powf(f64::from(i % 800) / 100.0 - 4.0);
        text += &format!("{} {} {} {count} {energy}\n", i % 40, i / 40, f64::from(i % 7) * 0.1);
    }
    fs::write(folder.join("p.txt"), text).expect("a write");
}

#[test]
fn every_column_has_a_histogram_in_the_characters_of_the_terminal() {
    let folder = folder();
    let f = folder.path();
    plate(f);
    let said = info(f, "de_DE.UTF-8", &["p.txt"]);
    let below = |name: &str| {
        let mut lines = said.lines().skip_while(|line| !line.starts_with(&format!("attribute   {name}:")));
        lines.nth(1).unwrap_or_else(|| panic!("nothing below {name}: {said}")).to_owned()
    };
    assert_eq!(below("count"), format!("{:12}1 |█ ▆| 3", ""));
    assert!(below("energy").contains("(logarithmic)"), "{said}");
    for axis in ["x", "y", "z"] {
        let line = said.lines().find(|line| line.starts_with(&format!("{axis}  ")));
        assert!(line.is_some_and(|line| line.contains(['▁', '▇', '█'])), "{axis}: {said}");
    }
    let plain = info(f, "C", &["p.txt"]);
    assert!(plain.is_ascii() && plain.contains("1 |# *| 3"), "{plain}");
}

#[test]
fn json_has_the_counts_and_what_is_up_and_why() {
    let folder = folder();
    let f = folder.path();
    plate(f);
    let report: serde_json::Value =
        serde_json::from_str(&info(f, "C", &["p.txt", "--json"])).expect("a report");
    let counts = &report["histograms"]["count"]["counts"];
    assert_eq!(*counts, serde_json::json!([1400, 0, 200]));
    assert_eq!(report["histograms"]["x"]["counts"].as_array().map(Vec::len), Some(40));
    assert_eq!(report["histograms"]["energy"]["logarithmic"], true);
    assert_eq!((&report["up"], &report["up_reason"]), (&"z".into(), &"the thinnest extent".into()));
    assert_eq!(
        (&report["look"], &report["look_reason"]),
        (&"height".into(), &"terrain without colours".into())
    );
    let said = info(f, "C", &["p.txt"]);
    assert!(said.contains("up          z: the thinnest extent"), "{said}");
    assert!(said.contains("look        height: terrain without colours"), "{said}");
    // The same every time.
    assert_eq!(said, info(f, "C", &["p.txt"]));
}

#[test]
fn voxels_have_a_histogram_and_an_orientation_too() {
    let folder = folder();
    let f = folder.path();
    let text = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 8 8 8\nencoding: raw\nspace: right-anterior-superior\n\
                space directions: (1,0,0) (0,1,0) (0,0,1)\nspace origin: (0,0,0)\n\n";
    let voxels = (0..512_u32).map(|i| if i % 4 == 0 { 7_u8 } else { 2 });
    fs::write(f.join("v.nrrd"), text.bytes().chain(voxels).collect::<Vec<u8>>()).expect("a write");
    let said = info(f, "C", &["v.nrrd"]);
    assert!(said.contains("2 |#    -| 7") && said.contains("up          z: said by the file"), "{said}");
    let report: serde_json::Value =
        serde_json::from_str(&info(f, "C", &["v.nrrd", "--json"])).expect("a report");
    assert_eq!(report["histogram"]["counts"], serde_json::json!([384, 0, 0, 0, 0, 128]));
    assert_eq!((&report["look"], &report["up"]), (&"volume".into(), &"z".into()));
}

#[test]
fn positions_are_told_with_the_step_of_the_coordinates_that_were_read() {
    let folder = folder();
    let f = folder.path();
    plate(f);
    assert!(!info(f, "C", &["p.txt"]).contains("steps of"));
    let rows = (0..400).map(|i| format!("{}.25 {}.50 {}.125\n", 400_000 + i % 20, i / 20, i % 7));
    fs::write(f.join("fixed.xyz"), rows.collect::<String>()).expect("a write");
    let said = info(f, "C", &["fixed.xyz"]);
    assert!(said.contains("of those read, which have steps of 0.01, 0.01, 0.001, "), "{said}");
    let report: serde_json::Value =
        serde_json::from_str(&info(f, "C", &["fixed.xyz", "--json"])).expect("a report");
    assert_eq!(report["step"], serde_json::json!([0.01, 0.01, 0.001]));
}

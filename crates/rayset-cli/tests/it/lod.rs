//! `rayset lod`: a file with what stands for its points from afar is the same cloud, and making it
//! keeps to its memory.

use std::fs;

use crate::common::{folder, names, run, succeeds};

#[test]
fn a_file_gains_aggregates_in_place_within_the_memory_that_is_named_and_renders_as_before() {
    let folder = folder();
    let f = folder.path();
    succeeds(f, &["generate", "sphere-100k", "-o", "p.ply"]);
    succeeds(f, &["build", "p.ply", "-o", "c.rset", "--radius", "0.04"]);
    let render = |picture: &str| {
        succeeds(f, &["render", "c.rset", "--size", "64x64", "-o", picture]);
        fs::read(f.join(picture)).expect("a picture")
    };
    let before = render("before.png");
    let refused = run(f, &["lod", "c.rset", "--memory", "1MiB", "--threads", "2"]);
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    let least = said.split("the smallest that would do is ").nth(1).and_then(|rest| rest.split(' ').next());
    let least = least.unwrap_or_else(|| panic!("no number: {said}"));
    let made = run(f, &["lod", "c.rset", "--memory", least, "--threads", "2", "--json"]);
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    let made: serde_json::Value = serde_json::from_slice(&made.stdout).expect("JSON");
    let number = |key: &str| made[key].as_f64();
    assert!(number("aggregates").is_some_and(|count| (1000.0..20_000.0).contains(&count)), "{made}");
    if let Some(peak) = number("peak_rss_bytes") {
        assert!(peak <= least.parse::<f64>().expect("a number"), "{made} in {least}");
    }
    let checked = run(f, &["verify", "c.rset", "--deep"]);
    assert!(String::from_utf8_lossy(&checked.stdout).contains("aggregates"), "{checked:?}");
    assert!(before == render("after.png"), "the picture is another");
    let left: Vec<String> = names(f).into_iter().filter(|name| name.contains(".rset")).collect();
    assert_eq!(left, ["c.rset"], "something is left behind");
}

#[test]
fn what_is_no_cloud_is_refused_by_name() {
    let folder = folder();
    let f = folder.path();
    fs::write(f.join("x.rset"), b"no cloud").expect("a write");
    for file in ["x.rset", "absent.rset"] {
        let refused = run(f, &["lod", file]);
        let said = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(!refused.status.success() && said.contains(file), "{said}");
    }
}

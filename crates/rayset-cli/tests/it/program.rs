//! The program: what a person meets.

use std::path::Path;
use std::process::{Command, Output};

use crate::common::{folder, mebibytes};

fn rayset(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_rayset"))
        .current_dir(folder)
        .args(arguments)
        .output()
        .expect("the program runs")
}

fn succeeds(folder: &Path, arguments: &[&str]) -> String {
    let output = rayset(folder, arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// The one line that a failure is.
fn fails(folder: &Path, arguments: &[&str]) -> String {
    let output = rayset(folder, arguments);
    assert!(!output.status.success(), "{arguments:?} succeeds");
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    let errors: Vec<&str> = text.lines().filter(|l| l.starts_with("error: ")).collect();
    assert_eq!(errors.len(), 1, "{arguments:?}: {text}");
    errors[0].to_owned()
}

#[test]
fn the_demo_renders_a_cloud_larger_than_its_budget() {
    let folder = folder();
    let said = succeeds(
        folder.path(),
        &["demo", "--workload", "knot-1600k", "--memory", &mebibytes(18.5).0, "--size", "160x120"],
    );
    assert!(said.contains("times the memory"), "{said}");
    let picture = std::fs::read(folder.path().join("demo.png")).expect("the picture is there");
    assert!(picture.starts_with(b"\x89PNG") && picture.len() > 5000);
}

#[test]
fn points_become_a_cloud_a_report_and_a_picture() {
    let folder = folder();
    succeeds(folder.path(), &["generate", "galaxy-20k", "-o", "g.ply"]);
    succeeds(
        folder.path(),
        &["build", "g.ply", "-o", "g.rset", "--attributes", "weight", "--render-memory", "24MiB"],
    );
    let info: serde_json::Value =
        serde_json::from_str(&succeeds(folder.path(), &["info", "g.rset", "--json"])).expect("JSON");
    assert_eq!(info["points"], 20_000);
    assert_eq!(info["color"], true);
    assert_eq!(info["render_memory_stored"], 24 << 20);
    assert!(succeeds(folder.path(), &["info", "g.rset"]).contains("20 000"));
    for depth in [&[][..], &["--quick"], &["--deep"]] {
        assert!(succeeds(folder.path(), &[&["verify", "g.rset"], depth].concat()).starts_with("ok"));
    }
    let size = ["render", "g.rset", "-o", "g.png", "--size", "64x48"];
    let looks: [&[&str]; 6] = [
        &[],
        &["--shading", "none", "--background", "black", "--opacity", "extinction:40"],
        &["--colormap", "inferno_r", "--color-by", "weight", "--value-range", "0:2"],
        &["--color", "#ff8800", "--orthographic", "--direction", "0,0,-1"],
        &["--position", "0,-2,1", "--look-at", "0,0,0", "--up", "0,0,1", "--opacity", "0:0,1:0.2,9:1"],
        &["--step", "0.01", "--kernel", "gaussian", "--phase", "hashed", "--crop", "10,10,20,20"],
    ];
    let mut pictures: Vec<Vec<u8>> = Vec::new();
    for look in looks {
        succeeds(folder.path(), &[&size[..], look].concat());
        pictures.push(std::fs::read(folder.path().join("g.png")).expect("the picture is there"));
    }
    for (i, a) in pictures.iter().enumerate() {
        assert!(pictures[..i].iter().all(|b| a != b), "look {i} changes nothing");
    }
}

#[test]
fn failures_are_one_line_that_says_what_to_do() {
    let folder = folder();
    let f = folder.path();
    succeeds(f, &["generate", "sphere-5k", "-o", "p.ply"]);
    succeeds(f, &["build", "p.ply", "-o", "c.rset", "--radius", "0.2"]);
    assert!(fails(f, &["build", "absent.ply", "-o", "x.rset"]).contains("absent.ply"));
    assert!(
        fails(f, &["build", "p.ply", "-o", "x.rset", "--radius", "size"]).contains("it has: x, y, z only")
    );
    assert!(fails(f, &["build", "p.ply", "-o", "x.rset", "--radius=-1"]).contains("between 1e-18"));
    assert!(fails(f, &["build", "c.rset", "-o", "x.rset"]).contains("c.rset"));
    assert!(
        fails(f, &["render", "c.rset", "-o", "x.png", "--color-by", "heat"]).contains("stores none besides")
    );
    assert!(fails(f, &["render", "c.rset", "-o", "x.png", "--opacity", "thick"]).contains("extinction:2.5"));
    assert!(fails(f, &["render", "c.rset", "-o", "no/folder/x.png"]).contains("no/folder/x.png"));
    assert!(rayset(f, &["render", "c.rset", "-o", "x.png", "--size", "12"]).status.code() != Some(0));
    assert!(!f.join("x.rset").exists() && !f.join("x.png").exists());
}

#[test]
fn a_budget_too_small_is_an_error_that_names_one_that_does() {
    let folder = folder();
    let f = folder.path();
    succeeds(f, &["generate", "sphere-50k", "-o", "p.ply"]);
    for command in [
        &["build", "p.ply", "-o", "c.rset", "--radius", "0.06", "--threads", "2"][..],
        &["render", "c.rset", "-o", "c.png", "--threads", "2"],
    ] {
        let message = fails(f, &[command, &["--memory", "2MiB"]].concat());
        let smallest = message.split("smallest that would do is ").nth(1).expect("it names the smallest");
        let smallest = smallest.split(' ').next().expect("a number");
        let less = (smallest.parse::<u64>().expect("a number") - 1).to_string();
        fails(f, &[command, &["--memory", &less]].concat());
        succeeds(f, &[command, &["--memory", smallest]].concat());
    }
}

#[test]
fn help_teaches() {
    let folder = folder();
    let help = succeeds(folder.path(), &["--help"]);
    for command in ["demo", "generate", "build", "info", "verify", "render", "bench"] {
        assert!(help.contains(command), "{help}");
        assert!(succeeds(folder.path(), &[command, "--help"]).contains("Usage"));
    }
}

#[test]
fn the_benchmark_reports_what_anyone_would_compare() {
    let folder = folder();
    let text = succeeds(folder.path(), &["bench", "sphere-30k", "--translucent", "--repeat", "1", "--json"]);
    let report: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let results = report["results"].as_array().expect("results");
    assert_eq!(results.len(), 1);
    for result in results {
        for key in [
            "build_seconds",
            "render_seconds",
            "kernel_evaluations",
            "samples",
            "nonzero_samples",
            "file_bytes",
        ] {
            assert!(result[key].as_f64().is_some_and(|v| v > 0.0), "{key} in {result}");
        }
    }
    assert!(report["bare_evaluations_per_second"].as_f64().is_some_and(|v| v > 1e6));
}

#[test]
fn the_benchmark_of_pictures_measures_two_programs_and_stops_what_takes_too_long() {
    let folder = folder();
    succeeds(folder.path(), &["generate", "knot-5k", "-o", "p.ply"]);
    let bench = |more: &[&str]| {
        let arguments = [&["bench", "--pictures", "p.ply", "--repeat", "1", "--json"], more].concat();
        let text = succeeds(folder.path(), &arguments);
        let report: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        let pictures = report["pictures"].as_array().expect("pictures").clone();
        assert_eq!(pictures.len(), 1, "{report}");
        pictures[0].clone()
    };
    let both = bench(&["--beside", env!("CARGO_BIN_EXE_rayset")]);
    assert_eq!(
        (&both["picture"], &both["width"], &both["height"]),
        (&"p.ply".into(), &960.into(), &640.into())
    );
    for cost in [&both["cost"], &both["beside"]] {
        assert!(cost["seconds"].as_f64().is_some_and(|v| v > 0.0), "{both}");
        assert!(cost["peak_rss_bytes"].as_u64().is_some_and(|v| v > 1 << 20), "{both}");
        if cfg!(target_os = "linux") {
            assert!(cost["cpu_seconds"].as_f64().is_some_and(|v| v > 0.0), "{both}");
        }
    }
    if cfg!(target_os = "linux") {
        let stopped = bench(&["--limit", "0"]);
        assert!(stopped["cost"]["cpu_seconds"].is_null() && stopped["beside"].is_null(), "{stopped}");
    }
    let said = fails(folder.path(), &["bench", "--pictures", "none.ply"]);
    assert!(said.contains("there is no none.ply"), "{said}");
}

#[test]
fn the_benchmark_of_scenes_has_a_line_for_each_number_of_threads() {
    let folder = folder();
    let text = succeeds(
        folder.path(),
        &["bench", "--scenes", "grid-64", "--repeat", "1", "--json", "--dir", "scenes"],
    );
    let report: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let scenes = report["scenes"].as_array().expect("scenes");
    let lines: Vec<(&str, u64)> = scenes
        .iter()
        .map(|line| (line["scene"].as_str().expect("a name"), line["threads"].as_u64().expect("threads")))
        .collect();
    assert_eq!(lines, [("grid-64-unlit", 1), ("grid-64-unlit", 2), ("grid-64-lit", 1), ("grid-64-lit", 2)]);
    for line in scenes {
        for key in ["seconds", "cpu_seconds", "page_requests", "nonzero_samples"] {
            assert!(line[key].as_f64().is_some_and(|v| v > 0.0), "{key} in {line}");
        }
        // What is seen and asked for does not depend on threads.
        assert_eq!(line["nonzero_samples"], scenes[0]["nonzero_samples"]);
    }
    // What other programs read to compare themselves stays there.
    assert!(
        folder.path().join("scenes/grid-64.raw").exists()
            && folder.path().join("scenes/grid-64-lit.json").exists()
    );
}

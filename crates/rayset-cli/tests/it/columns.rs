//! What becomes of the columns of an input: radius, weight, colour; and of numbers that cannot be
//! stored.

use rayset::octree::Cloud;
use rayset::octree::build::{self, BuildControl, BuildError, BuildOptions, InvalidPolicy, Quantity, Rule};
use rayset::octree::format::Column;
use rayset::points::{ArraySource, PointSource};

use crate::common::{build_at, folder, program};

fn source(columns: Vec<(&str, Vec<f32>)>) -> Box<dyn PointSource> {
    let position = (0..columns[0].1.len()).map(|i| [i as f64, 0.0, 0.0]).collect();
    Box::new(ArraySource::new(position, columns))
}

#[test]
fn a_scale_without_a_rule_scales_the_column_that_is_there() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    let columns = || source(vec![("radius", vec![1.0, 2.0]), ("weight", vec![3.0, -4.0])]);
    let options = BuildOptions { radius_scale: 10.0, weight_scale: 0.5, ..BuildOptions::default() };
    let header = build_at(&path, columns(), &options).header().clone();
    assert_eq!(header.radius, Column::Varying { min: 10.0, max: 20.0 });
    assert_eq!(header.weight, Column::Varying { min: -2.0, max: 1.5 });
    // And numbers, where these are the rule, or where there is no column.
    let number = BuildOptions { radius: Some(Rule::Number(3.0)), ..options.clone() };
    assert_eq!(build_at(&path, columns(), &number).header().radius, Column::Constant(30.0));
    let bare = build_at(&path, source(vec![("intensity", vec![1.0, 1.0])]), &options);
    assert_eq!(bare.header().weight, Column::Constant(0.5));
}

#[test]
fn the_longest_semi_axis_is_the_radius_where_there_is_no_other() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    let axes = [("semi_axis_1", 1.0), ("semi_axis_2", 3.0), ("semi_axis_3", 0.5)];
    let rotation = [("rotation_x", 0.0), ("rotation_y", 0.0), ("rotation_z", 0.0), ("rotation_w", 1.0)];
    let columns = |more: &[(&'static str, f32)]| {
        let all = axes.iter().chain(&rotation).chain(more);
        source(all.map(|&(name, value)| (name, vec![value, 2.0 * value])).collect())
    };
    let options = BuildOptions { radius_scale: 10.0, length_scale: 0.5, ..BuildOptions::default() };
    let of = |more: &[(&'static str, f32)]| build_at(&path, columns(more), &options).header().radius;
    assert_eq!(of(&[]), Column::Varying { min: 15.0, max: 30.0 });
    assert_eq!(of(&[("radius", 0.2)]), Column::Varying { min: 1.0, max: 2.0 });
    let given = BuildOptions { radius: Some(Rule::SemiAxis), ..options };
    let bare = source(vec![("weight", vec![1.0])]);
    let refused = build::run_in_memory(vec![bare], &given, &BuildControl::default()).map(drop);
    let said = refused.expect_err("refused").to_string();
    assert!(said.contains("radius: not all inputs have semi-axes"), "{said}");
}

#[test]
fn the_program_scales_columns_without_being_told_their_names() {
    let folder = folder();
    std::fs::write(folder.path().join("p.csv"), "x,y,z,radius,weight\n0,0,0,1,3\n1,0,0,2,5\n")
        .expect("a write");
    let arguments = ["build", "p.csv", "-o", "c.rset", "--radius-scale", "10", "--weight-scale", "2"];
    let done = program().current_dir(folder.path()).args(arguments).output().expect("it runs");
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let header = Cloud::open(folder.path().join("c.rset")).expect("it opens").header().clone();
    assert_eq!(header.radius, Column::Varying { min: 10.0, max: 20.0 });
    assert_eq!(header.weight, Column::Varying { min: 6.0, max: 10.0 });
}

#[test]
fn colours_of_inputs_of_different_depths_stay_as_bright_as_they_were() {
    let folder = folder();
    let ply = |name: &str, kind: &str, color: &str| {
        let header =
            "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n";
        let colors: String =
            ["red", "green", "blue"].iter().map(|c| format!("property {kind} {c}\n")).collect();
        std::fs::write(folder.path().join(name), format!("{header}{colors}end_header\n0 0 0 {color}\n"))
            .expect("a write");
    };
    ply("bytes.ply", "uchar", "200 100 0");
    ply("words.ply", "ushort", "51400 25700 0");
    for order in [["bytes.ply", "words.ply"], ["words.ply", "bytes.ply"]] {
        let mut arguments = vec!["build", "-o", "c.rset", "--radius", "1"];
        arguments.extend(order);
        let done = program().current_dir(folder.path()).args(arguments).output().expect("it runs");
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        let cloud = Cloud::open(folder.path().join("c.rset")).expect("it opens");
        let mut colors = Vec::new();
        let read =
            cloud.for_each_run(|_, run| colors.extend(run.colors(cloud.header()).into_iter().flatten()));
        read.expect("it reads");
        assert_eq!(colors, [[200, 100, 0]; 2], "{order:?}");
    }
}

#[test]
fn numbers_too_large_to_be_stored_stop_a_build_with_the_factor_to_use() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    let at =
        |x: f64| Box::new(ArraySource::new(vec![[x, 0.0, 0.0], [0.0; 3]], vec![])) as Box<dyn PointSource>;
    let with = |name: &'static str, v: f32| {
        Box::new(ArraySource::new(vec![[0.0; 3]; 2], vec![(name, vec![v, 1.0])])) as Box<dyn PointSource>
    };
    let cases: [(Box<dyn Fn() -> Box<dyn PointSource>>, Quantity); 4] = [
        (Box::new(move || at(3.1e24)), Quantity::Position),
        (Box::new(move || with("radius", 2e20)), Quantity::Radius),
        (Box::new(move || with("radius", 2e-20)), Quantity::SmallRadius),
        (Box::new(move || with("weight", 2e33)), Quantity::Weight),
    ];
    for (source, expected) in cases {
        let error = build::run(vec![source()], &path, &BuildOptions::default(), &BuildControl::default());
        let error = error.expect_err("it cannot be stored");
        let BuildError::OutOfRange { quantity, count: 1, records: 2, factor, .. } = error else {
            panic!("{error}")
        };
        assert_eq!(quantity, expected);
        let scaled = match quantity {
            Quantity::Weight => {
                BuildOptions { weight_scale: factor.expect("one"), ..BuildOptions::default() }
            }
            _ => BuildOptions { length_scale: factor.expect("one"), ..BuildOptions::default() },
        };
        let report =
            build::run(vec![source()], &path, &scaled, &BuildControl::default()).expect("the factor helps");
        assert_eq!(report.points, 2, "{quantity}");
        let skipping = BuildOptions { invalid: InvalidPolicy::SkipAll, ..BuildOptions::default() };
        assert_eq!(
            build::run(vec![source()], &path, &skipping, &BuildControl::default()).expect("it skips").points,
            1
        );
    }
}

#[test]
fn lists_go_on_where_they_are_given_again_and_take_no_option_for_a_name() {
    let folder = folder();
    std::fs::write(folder.path().join("p.csv"), "x,y,z,a,b,c\n0,0,0,1,2,3\n1,0,0,4,5,6\n").expect("a write");
    let run = |more: &[&str]| {
        let done = program().current_dir(folder.path()).args(["build", "p.csv"]).args(more).output();
        let done = done.expect("it runs");
        (done.status.code(), String::from_utf8_lossy(&done.stderr).into_owned())
    };
    assert_eq!(run(&["-o", "c.rset", "--attributes", "a", "--attributes", "c"]).0, Some(0));
    let cloud = Cloud::open(folder.path().join("c.rset")).expect("it opens");
    let names: Vec<&str> = cloud.header().attributes.iter().map(|column| column.name.as_str()).collect();
    assert_eq!(names, ["a", "c"]);
    for list in ["--attributes", "--particles"] {
        let (code, said) = run(&[list, "-o", "d.rset"]);
        assert!(code == Some(2) && said.contains("a value is required") && said.contains(list), "{said}");
    }
    // `-` leaves a column out.
    assert_eq!(run(&["-o", "d.rset", "--columns", "-,x,y,z,b,c"]).0, Some(0));
    let (code, said) = run(&["-o", "d.rset", "--length-scale", "0"]);
    assert!(code == Some(2) && said.contains("--length-scale"), "{said}");
}

#[test]
fn the_program_names_the_option_that_helps() {
    let folder = folder();
    std::fs::write(folder.path().join("p.xyz"), "3.1e24 0 0\n0 0 0\n").expect("a write");
    let run = |more: &[&str]| {
        let done =
            program().current_dir(folder.path()).args(["build", "p.xyz", "-o", "c.rset"]).args(more).output();
        let done = done.expect("it runs");
        (done.status.code(), String::from_utf8_lossy(&done.stderr).into_owned())
    };
    let (code, said) = run(&[]);
    assert!(code == Some(1) && said.contains("--length-scale 1e-19") && said.contains("skip-all"), "{said}");
    assert_eq!(run(&["--length-scale", "1e-19"]).0, Some(0));
    assert_eq!(run(&["--invalid", "skip-all"]).0, Some(0));
}

#[test]
fn a_cloud_of_nothing_made_of_something_is_an_error() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    let error = build::run(
        vec![source(vec![("radius", vec![-1.0, f32::NAN])])],
        &path,
        &BuildOptions::default(),
        &BuildControl::default(),
    );
    let error = error.expect_err("nothing is valid");
    assert!(
        matches!(error, BuildError::NothingValid { records: 2, skipped } if skipped.radius == 2),
        "{error}"
    );
    assert!(!path.exists());
}

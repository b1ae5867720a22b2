use rayset::scene::OpacityRule;
use serde_json::{Value, json};

use super::*;

/// A value of each option, as one types it, without its dashes.
const TYPED: &[(&str, &str)] = &[
    ("samples", "3"),
    ("exposure", "-1.5"),
    ("lod", "0.5"),
    ("look", "gas"),
    ("kernel", "cubic-spline"),
    ("splat-filter", "mip"),
    ("normalised", ""),
    ("radius-scale", "2.5"),
    ("opacity", "0:0,1:0.5,4:1"),
    ("unit-distance", "0.25"),
    ("color", "#102030"),
    ("colormap", "magma_r"),
    ("color-by", "Temperature"),
    ("value-range", "-1:99%"),
    ("log", ""),
    ("shading", "none"),
    ("compositing", "display"),
    ("ambient-occlusion", "0.5"),
    ("background", "none"),
    ("step", "auto"),
    ("step-fraction", "0.5"),
    ("phase", "hashed"),
    ("stop", "0"),
    ("view", "left"),
    ("position", "1,-2,0.5"),
    ("look-at", "0,0,0"),
    ("direction", "0,0,-1"),
    ("up", "0,-1,0"),
    ("fovy", "35"),
    ("orthographic", ""),
    ("height", "12.5"),
];

fn with(name: &str, text: &str) -> Style {
    let mut style = Style::default();
    let option = StyleOption::find(name).unwrap_or_else(|| panic!("{name} is an option"));
    option.parse(text).unwrap_or_else(|what| panic!("{name}: {what}")).make(&mut style);
    style
}

#[test]
fn each_option_is_typed_and_sent_as_json_and_means_the_same() {
    assert!(OPTIONS.iter().map(|option| option.name).eq(TYPED.iter().map(|(name, _)| *name)), "one of each");
    for (name, text) in TYPED {
        let style = with(name, text);
        let option = StyleOption::find(name).expect("an option");
        assert_eq!(option.text(&style).as_deref(), Some(*text), "{name}");
        let word = if text.is_empty() { format!("--{name}") } else { format!("--{name}={text}") };
        assert_eq!(style.words(), [word]);
        for spelling in [Spelling::Camel, Spelling::Snake] {
            let mut object = serde_json::Map::new();
            object.insert(spelling.of(name).into_owned(), option.json(&style).expect("a value"));
            // Alone, some need others.
            let read = Style::from_object(&object, spelling);
            if option.needs.is_empty() {
                assert_eq!(read.as_ref(), Ok(&style), "{name}");
            } else {
                assert!(read.expect_err("it needs another").what.starts_with("needs "), "{name}");
            }
        }
    }
}

#[test]
fn values_of_json_are_what_people_write_in_it() {
    let read = |value: Value| serde_json::from_value::<Style>(value);
    let opacity = |value: Value| read(json!({ "opacity": value })).map(|style| style.opacity).ok().flatten();
    assert_eq!(opacity(json!([[0, 0], [1, 0.5]])), Some(OpacityRule::Curve(vec![(0.0, 0.0), (1.0, 0.5)])));
    assert_eq!(opacity(json!(2)), Some(OpacityRule::Extinction(2.0)));
    assert_eq!(opacity(json!("clamp")), Some(OpacityRule::Clamp));
    let range = read(json!({"valueRange": [0, 10]})).expect("a range");
    assert_eq!(range.words(), ["--value-range=0:10"]);
    assert_eq!(serde_json::to_value(&range).expect("JSON"), json!({"valueRange": [0.0, 10.0]}));
    assert_eq!(
        serde_json::to_value(with("value-range", "1%:99%")).expect("JSON"),
        json!({"valueRange": "1%:99%"})
    );
    assert_eq!(read(json!({"log": false, "look": null})).expect("nothing said"), Style::default());
    assert_eq!(
        read(json!({"up": [0, 0, 1], "fovy": "40"})).expect("a camera").words(),
        ["--up=0,0,1", "--fovy=40"]
    );
}

#[test]
fn a_value_that_an_option_does_not_have_is_said_by_its_name() {
    for (key, value) in [
        ("look", json!("gass")),
        ("look", json!("gas --background=red")),
        ("radiusScale", json!(1e9)),
        ("radiusScale", json!([1])),
        ("samples", json!(1.5)),
        ("color", json!("reddish")),
        ("opacity", json!([])),
        ("opacity", json!([[0]])),
        ("valueRange", json!([1])),
        ("position", json!([0, 0])),
        ("direction", json!([0, 0, 0])),
        ("log", json!("yes")),
        ("radius-scale", json!(1)),
        ("help", json!(true)),
    ] {
        let what =
            serde_json::from_value::<Style>(json!({ key: value })).expect_err("a wrong value").to_string();
        assert!(what.starts_with(&format!("{key}: ")), "{key}: {value}: {what}");
    }
}

#[test]
fn options_that_exclude_each_other_are_refused_whoever_says_them() {
    let refused = |object: Value, spelling| {
        Style::from_object(object.as_object().expect("an object"), spelling)
            .expect_err("no style")
            .to_string()
    };
    let two_colors = json!({"color": "#000000", "color_by": "T"});
    assert_eq!(refused(two_colors, Spelling::Snake), "color: cannot be used with color_by");
    let sides = json!({"view": "top", "direction": [0, 0, 1]});
    assert_eq!(refused(sides, Spelling::Camel), "view: cannot be used with direction");
    assert_eq!(refused(json!({"look_at": [0, 0, 1]}), Spelling::Snake), "look_at: needs position");
}

#[test]
fn what_one_style_does_not_say_another_does() {
    let one = with("look", "gas").or(&with("radius-scale", "2"));
    assert_eq!(one.words(), ["--look=gas", "--radius-scale=2"]);
    assert_eq!(with("look", "surface").or(&one).words(), ["--look=surface", "--radius-scale=2"]);
}

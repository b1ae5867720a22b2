//! Colour maps and curves are what their stops say, however near to each other these are: against
//! the reference renderer, which looks them up stop by stop.

use std::sync::Arc;

use rayset::geometry::DVec3;
use rayset::octree::build::{BuildOptions, Rule};
use rayset::points::{ArraySource, ColumnInfo, ColumnType, Values};
use rayset::scene::{
    Channel, CloudObject, ColorMap, ColorRule, Form, MapInput, Node, OpacityRule, Operator, Palette, Pattern,
    Procedural, RenderSettings, Scene, Shape, Solid, Step, Transfer, TransferFunction,
};
use rayset::trace::reference::{ReferenceRenderer, ReferenceSteps};

use crate::common::{Random, build_at, camera, folder, plain_picture, settings};
use crate::steps_by_place::unlit;

const RED: [f64; 3] = [1.0, 0.0, 0.0];
const GREEN: [f64; 3] = [0.0, 1.0, 0.0];
const BLUE: [f64; 3] = [0.0, 0.0, 1.0];
const WHITE: [f64; 3] = [1.0; 3];

fn map(stops: &[(f64, [f64; 3])], range: (f64, f64)) -> ColorMap {
    ColorMap { palette: Palette::Stops(stops.into()), range }
}

/// A block with an attribute, `gradient`, from 0 on its left to 1 on its right.
fn block(opacity: f64) -> Node {
    let (from, to) = (DVec3::new(-1.0, 0.0, 0.0), DVec3::new(1.0, 0.0, 0.0));
    let pattern = Pattern::Gradient { from, to, map: map(&[(0.0, WHITE), (1.0, WHITE)], (0.0, 1.0)) };
    let form = Form::Box { size: DVec3::new(2.0, 2.0, 0.5) };
    Node::new(Shape::Procedural(
        Arc::new(Solid { opacity, pattern, ..Solid::new(form) }) as Arc<dyn Procedural>
    ))
}

fn with_transfer(mut node: Node, transfer: Transfer) -> Node {
    node.transfers.push(transfer);
    node
}

fn input() -> Channel {
    Channel::Attribute("gradient".into())
}

/// Pixels of a picture that are farther from the reference renderer's than 1/1024, of those that
/// show anything.
fn wrong_pixels(scene: &Scene, settings: &RenderSettings, step: f64) -> (usize, usize) {
    let fast = plain_picture(scene, settings);
    let reference_renderer = ReferenceRenderer::load(scene).expect("it reads");
    let (mut wrong, mut shown) = (0, 0);
    for y in (0..settings.height).step_by(3) {
        for x in 0..settings.width {
            let exact = reference_renderer
                .pixel(&camera(), settings, &ReferenceSteps::same(step), x, y)
                .expect("a camera");
            let found = fast[(y * settings.width + x) as usize];
            shown += usize::from(exact[3] > 0.0);
            wrong += usize::from((0..4).any(|c| (f64::from(found[c]) - exact[c]).abs() > 1.0 / 1024.0));
        }
    }
    (wrong, shown)
}

#[test]
fn thin_isolines_and_hard_edges_are_where_their_stops_are() {
    let step = 0.01;
    let settings = RenderSettings { step: Step::Fixed(step), ..settings(96, 24) };
    let isoline = [(0.0, WHITE), (0.62, WHITE), (0.62, RED), (0.6203, RED), (0.6203, WHITE), (1.0, WHITE)];
    let thin = [(0.0, BLUE), (0.4, BLUE), (0.4002, RED), (0.4004, BLUE), (1.0, BLUE)];
    let classes = [(0.0, RED), (0.3, RED), (0.3, GREEN), (0.7, GREEN), (0.7, BLUE), (1.0, BLUE)];
    for (stops, range) in [
        (&isoline[..], (0.0, 1.0)),
        (&thin, (0.0, 1.0)),
        (&classes, (0.0, 1.0)),
        (&classes, (1.0, 0.0)),
        // Nearly all of the map lies beyond the values.
        (&classes, (-2000.0, 1000.0)),
        (&classes, (-6.5, 16.5)),
    ] {
        let scene =
            unlit(with_transfer(block(0.7), Transfer::Color { input: input(), map: map(stops, range) }));
        let (wrong, shown) = wrong_pixels(&scene, &settings, step);
        assert!(shown > 100 && wrong * 1000 <= shown, "{range:?}: {wrong} of {shown} pixels are wrong");
    }
}

#[test]
fn a_class_has_its_own_colour_up_to_the_very_edge() {
    // All samples of a pixel of a thin sheet have nearly one value; the edge lies half a thousandth
    // beside it.
    let sheet = |edge: f64| {
        let form = Form::Box { size: DVec3::new(2.0, 2.0, 1e-4) };
        let (from, to) = (DVec3::new(-1.0, 0.0, 0.0), DVec3::new(1.0, 0.0, 0.0));
        let stops = [(0.0, RED), (edge, RED), (edge, GREEN), (1.0, GREEN)];
        let pattern = Pattern::Gradient { from, to, map: map(&stops, (0.0, 1.0)) };
        let node = Node::new(Shape::Procedural(Arc::new(Solid { pattern, ..Solid::new(form) })));
        // Read as an attribute, and as a colour of its own.
        let transfer = Transfer::Color { input: input(), map: map(&stops, (0.0, 1.0)) };
        let scene = Scene { unit_distance: 1e-6, ..unlit(with_transfer(node, transfer)) };
        let settings = RenderSettings { step: Step::Fixed(2e-5), ..settings(16, 16) };
        plain_picture(&scene, &settings)[8 * 16 + 9]
    };
    // The ray through the middle of pixel 9 of 16, at distance 3.
    let value = 0.5 + 0.5 * 3.0 * (1.5 / 8.0) * 22.5_f64.to_radians().tan();
    let [red, green, ..] = sheet(value + 5e-4);
    assert!(red > 0.98 && green < 1e-6, "before the edge: {red} {green}");
    let [red, green, ..] = sheet(value - 5e-4);
    assert!(green > 0.98 && red < 1e-6, "behind the edge: {red} {green}");
}

#[test]
fn of_stops_at_one_place_the_last_counts_there_and_above() {
    let edges = map(
        &[(0.0, WHITE), (0.0, RED), (0.5, RED), (0.5, WHITE), (0.5, GREEN), (1.0, GREEN), (1.0, BLUE)],
        (0.0, 2.0),
    );
    for (value, color) in [
        (-1.0, RED),
        (0.0, RED),
        (1.0 - 1e-12, RED),
        (1.0, GREEN),
        (2.0 - 1e-12, GREEN),
        (2.0, BLUE),
        (9.0, BLUE),
    ] {
        assert_eq!(edges.color(value), color, "of {value}");
    }
    let curve = OpacityRule::Curve(vec![(1.0, 0.0), (1.0, 0.5), (2.0, 0.5), (2.0, 0.25)]);
    assert!(curve.check().is_ok());
    for (density, opacity) in [(0.999, 0.0), (1.0, 0.5), (1.999, 0.5), (2.0, 0.25), (5.0, 0.25)] {
        assert_eq!(curve.opacity(density, 1.0), opacity, "at {density}");
    }
}

#[test]
fn attributes_through_a_blend_are_mapped_as_exactly_as_their_own() {
    let folder = folder();
    // Classes of points, in a cloud of many.
    let mut random = Random(4);
    let position: Vec<[f64; 3]> = (0..1500).map(|_| std::array::from_fn(|_| random.unit() - 0.5)).collect();
    let class: Vec<f32> = position.iter().map(|p| if p[0] < 0.0 { 2.0 } else { 9.0 }).collect();
    let options = BuildOptions {
        radius: Some(Rule::Number(0.12)),
        attributes: vec!["class".into()],
        ..BuildOptions::default()
    };
    let source = Box::new(ArraySource::new(position, vec![("class", class)]));
    let cloud = build_at(&folder.path().join("c.rset"), source, &options);
    let classes = [(0.0, RED), (0.51, RED), (0.51, GREEN), (0.5102, GREEN), (0.5102, BLUE), (1.0, WHITE)];
    let transfer = TransferFunction {
        opacity: OpacityRule::Curve(vec![(0.2, 0.0), (0.2, 0.3), (0.9, 0.5), (0.9, 0.8)]),
        color: ColorRule::Map { map: map(&classes, (0.0, 10.0)), input: MapInput::Attribute(0) },
    };
    let cloud = Node::new(Shape::Cloud(CloudObject { transfer, ..CloudObject::plain(cloud) }));
    let blend = Node::operator(Operator::Blend, [cloud, block(0.3)]);
    let by_class =
        Transfer::Color { input: Channel::Attribute("class".into()), map: map(&classes, (0.0, 10.0)) };
    let line = vec![(0.0, 0.1), (0.3, 0.2), (0.3, 0.6), (0.7, 0.6), (0.7, 0.1)];
    let by_gradient = Transfer::Opacity { input: input(), curve: line };
    let scene = unlit(with_transfer(with_transfer(blend, by_class), by_gradient));
    let step = 0.013;
    let settings = RenderSettings { step: Step::Fixed(step), ..settings(60, 60) };
    let (wrong, shown) = wrong_pixels(&scene, &settings, step);
    // A sample whose mean class rounds to the other side of an edge is another colour.
    assert!(shown > 300 && wrong * 100 <= shown, "{wrong} of {shown} pixels are wrong");
}

/// Points of two classes with radii of their own, far apart or close together.
fn two_classes(folder: &std::path::Path, extent: f64) -> Arc<rayset::Cloud> {
    let mut random = Random(14);
    let position: Vec<[f64; 3]> =
        (0..900).map(|_| std::array::from_fn(|_| extent * (random.unit() - 0.5))).collect();
    let class: Vec<u8> = (0..900).map(|_| if random.unit() < 0.5 { 2 } else { 9 }).collect();
    let radius: Vec<f32> = (0..900).map(|_| (0.05 + 0.1 * random.unit()) as f32).collect();
    let columns = vec![
        (ColumnInfo::new("classification", ColumnType::U8).of_classes(), Values::from(class)),
        (ColumnInfo::new("radius", ColumnType::F32), Values::from(radius)),
    ];
    let options = BuildOptions { attributes: vec!["classification".into()], ..BuildOptions::default() };
    build_at(&folder.join("c.rset"), Box::new(ArraySource::typed(position, columns)), &options)
}

#[test]
fn a_sample_has_the_class_of_the_point_that_contributes_most_and_never_one_in_between() {
    let folder = folder();
    let cloud = two_classes(folder.path(), 1.0);
    // Anything but 2 and 9 would be white.
    let classes = [(0.0, WHITE), (0.19, WHITE), (0.19, RED), (0.21, RED), (0.21, WHITE)];
    let classes = [&classes[..], &[(0.89, WHITE), (0.89, BLUE), (0.91, BLUE), (0.91, WHITE)]].concat();
    let transfer = TransferFunction {
        opacity: OpacityRule::Curve(vec![(0.3, 0.0), (0.3, 0.4)]),
        color: ColorRule::Map { map: map(&classes, (0.0, 10.0)), input: MapInput::Attribute(0) },
    };
    let scene = unlit(Node::new(Shape::Cloud(CloudObject { transfer, ..CloudObject::plain(cloud) })));
    let step = 0.011;
    let settings = RenderSettings { step: Step::Fixed(step), ..settings(60, 60) };
    let picture = plain_picture(&scene, &settings);
    let green = picture.iter().filter(|pixel| pixel[1] > 0.0).count();
    assert_eq!(green, 0, "pixels show a class that no point has");
    let (red, blue) = (picture.iter().any(|p| p[0] > 0.2), picture.iter().any(|p| p[2] > 0.2));
    assert!(red && blue, "both classes show");
    let (wrong, shown) = wrong_pixels(&scene, &settings, step);
    // Samples where two points contribute the same but for rounding may be either's.
    assert!(shown > 200 && wrong * 100 <= shown, "{wrong} of {shown} pixels are wrong");
}

#[test]
fn coordinates_are_shown_by_name_with_no_column_stored() {
    let folder = folder();
    let cloud = two_classes(folder.path(), 1.0);
    let header = cloud.header();
    let height = header.attribute_number("height").expect("every cloud has one");
    assert_eq!(header.attribute_number("z"), Some(height));
    assert_eq!(header.attribute_range(height), (header.bounds.min.z, header.bounds.max.z));
    let object = |input| {
        let transfer = TransferFunction {
            opacity: OpacityRule::Curve(vec![(0.1, 0.0), (0.1, 0.4)]),
            color: ColorRule::Map { map: map(&[(0.0, RED), (1.0, BLUE)], (-0.5, 0.5)), input },
        };
        Node::new(Shape::Cloud(CloudObject { transfer, ..CloudObject::plain(cloud.clone()) }))
    };
    let step = 0.011;
    let settings = RenderSettings { step: Step::Fixed(step), ..settings(60, 60) };
    for axis in 0..3 {
        let scene = unlit(object(MapInput::Attribute(1 + axis)));
        let (wrong, shown) = wrong_pixels(&scene, &settings, step);
        assert!(shown > 200 && wrong == 0, "axis {axis}: {wrong} of {shown} pixels are wrong");
    }
    // And by a transfer function anywhere above.
    let by_height = Transfer::Color {
        input: Channel::Attribute("height".into()),
        map: map(&[(0.0, GREEN), (0.5, GREEN), (0.5, RED), (1.0, RED)], (-0.5, 0.5)),
    };
    let scene = unlit(with_transfer(object(MapInput::Density), by_height));
    let (wrong, shown) = wrong_pixels(&scene, &settings, step);
    assert!(shown > 200 && wrong * 100 <= shown, "{wrong} of {shown} pixels are wrong");
}

#[test]
fn named_maps_are_as_near_to_the_published_tables_as_is_said() {
    let golden = include_str!("golden/colormaps.txt");
    let mut compared = 0;
    for line in golden.lines().filter(|line| !line.starts_with('#')) {
        let (name, digits) = line.split_once(' ').expect("a name");
        let map: rayset::scene::NamedPalette = name.parse().expect("a map");
        let reversed: rayset::scene::NamedPalette = format!("{name}_r").parse().expect("a map");
        let coarse = ["viridis", "inferno", "magma", "plasma", "turbo", "coolwarm"].contains(&name);
        let allowed = if coarse { 5.0 } else { 1.0 };
        for i in 0..256 {
            let published = u32::from_str_radix(&digits[6 * i..6 * i + 6], 16).expect("a colour");
            let x = i as f64 / 255.0;
            let found = map.display_color(x);
            for (shift, v) in [16, 8, 0].into_iter().zip(found) {
                let error = ((v * 255.0).round() - f64::from(published >> shift & 255)).abs();
                assert!(error <= allowed, "{name} at {i}: {error} of 255");
            }
            let other = reversed.display_color(1.0 - x);
            assert!((0..3).all(|c| (found[c] - other[c]).abs() < 1e-12), "{name}_r at {i}");
        }
        compared += 1;
    }
    assert_eq!(compared, 15);
    let schema = include_str!("../../../../docs/scene.schema.json");
    let documented = include_str!("../../../../docs/scene.md");
    for line in golden.lines().filter(|line| !line.starts_with('#')) {
        let name = line.split(' ').next().expect("a name");
        assert!(schema.contains(&format!("\"{name}_r\"")), "{name} is not in the schema");
        assert!(documented.contains(&format!("`{name}`")), "{name} is not documented");
    }
}

//! Ambient occlusion: what it darkens, what it leaves alone, and that regions and bands join
//! without a seam.

use rayset::geometry::{DAffine3, DVec3};
use rayset::scene::{Camera, Form, LightKind, Node, Operator, Projection, RenderSettings, Scene, Step};
use rayset::trace::{ExecSettings, Picture};
use rayset::{BandSink, CancelToken, Region, Session, SinkError};

use crate::common::{paged, settings};
use crate::graph::{light, scene, solid};

const WIDTH: u32 = 80;
const HEIGHT: u32 = 60;

/// A floor, a wall at right angles to it, and a ball in front, in ambient light alone.
fn corner() -> Scene {
    let block =
        |size: DVec3, at: DVec3| solid(Form::Box { size }, [0.6; 3]).moved(DAffine3::from_translation(at));
    let floor = block(DVec3::new(8.0, 0.2, 8.0), DVec3::new(0.0, -0.1, 0.0));
    let wall = block(DVec3::new(8.0, 4.0, 0.2), DVec3::new(0.0, 2.0, -1.0));
    let ball = solid(Form::Sphere { radius: 0.3 }, [0.6; 3])
        .moved(DAffine3::from_translation(DVec3::new(0.6, 0.3, -0.2)));
    let lights = vec![light(LightKind::Ambient, [1.0; 3], false)];
    scene(Node::operator(Operator::Union, [floor, wall, ball]), lights)
}

fn camera(orthographic: bool) -> Camera {
    let projection = if orthographic {
        Projection::Orthographic { height: 2.6 }
    } else {
        Projection::Perspective { fovy: 45_f64.to_radians() }
    };
    Camera {
        projection,
        ..Camera::look_at(DVec3::new(0.0, 1.6, 2.6), DVec3::new(0.0, 0.3, -0.6), DVec3::Y, 0.8)
    }
}

fn with(ambient_occlusion: f32) -> RenderSettings {
    RenderSettings { step: Step::Fixed(0.02), ambient_occlusion, ..settings(WIDTH, HEIGHT) }
}

fn rendered(settings: &RenderSettings, camera: &Camera, region: &Region, band_rows: u32) -> Picture {
    let scene = corner();
    let session = Session::over(paged(&scene, 1 << 20), ExecSettings::default()).expect("a session");
    let prepared = session.prepare(&scene, settings).expect("a scene");
    let view = prepared.view(camera).expect("a view");
    let mut picture = Picture::default();
    view.render_bands(region, band_rows, &CancelToken::new(), &mut picture).expect("a picture");
    picture
}

fn whole() -> Region {
    Region { columns: 0..WIDTH, rows: 0..HEIGHT }
}

#[test]
fn a_crease_and_what_is_behind_an_edge_are_darker_and_planes_are_not() {
    for orthographic in [false, true] {
        let camera = camera(orthographic);
        let bare = rendered(&with(0.0), &camera, &whole(), u32::MAX);
        let shaded = rendered(&with(1.0), &camera, &whole(), u32::MAX);
        let left = |x: u32, y: u32| {
            let at = (y * WIDTH + x) as usize;
            shaded.pixels[at][0] / bare.pixels[at][0]
        };
        // The column at a quarter of the width crosses the wall, the crease and the floor.
        let column: Vec<f32> = (0..HEIGHT).map(|y| left(WIDTH / 4, y)).collect();
        let darkest = column.iter().copied().fold(1.0, f32::min);
        assert!(darkest < 0.75, "the crease keeps {darkest} of its light");
        let at = column.iter().position(|&v| v == darkest).expect("a darkest pixel");
        assert!(column[..at - 6].iter().all(|&v| v > 0.97), "the wall, {column:?}");
        assert!(column[at + 6..].iter().all(|&v| v > 0.97), "the floor, {column:?}");
        // Everywhere light is only taken, and opacity is what it was.
        for (a, b) in bare.pixels.iter().zip(&shaded.pixels) {
            assert!(b[0] <= a[0] && b[0] > 0.05 * a[0] && a[3] == b[3]);
        }
    }
}

#[test]
fn a_single_pixel_that_is_deeper_than_all_around_it_is_no_pit() {
    // A wall with a shaft of one pixel, and another of three pixels square, straight ahead.
    let camera = Camera {
        projection: Projection::Orthographic { height: f64::from(HEIGHT) },
        ..Camera::look_at(DVec3::new(0.0, 0.0, 50.0), DVec3::ZERO, DVec3::Y, 0.8)
    };
    let block =
        |size: DVec3, at: DVec3| solid(Form::Box { size }, [0.6; 3]).moved(DAffine3::from_translation(at));
    let wall = block(DVec3::new(200.0, 200.0, 20.0), DVec3::new(0.0, 0.0, -10.0));
    let shaft = block(DVec3::new(1.0, 1.0, 16.0), DVec3::new(-19.5, 0.5, 0.0));
    let wide = block(DVec3::new(3.0, 3.0, 16.0), DVec3::new(20.5, 0.5, 0.0));
    let drilled = Node::operator(Operator::Difference, [wall, shaft, wide]);
    let scene = scene(drilled, vec![light(LightKind::Ambient, [1.0; 3], false)]);
    let picture = |strength: f32| {
        let session = Session::over(paged(&scene, 1 << 20), ExecSettings::default()).expect("a session");
        let settings = RenderSettings { step: Step::Fixed(0.5), ..with(strength) };
        let prepared = session.prepare(&scene, &settings).expect("a scene");
        let view = prepared.view(&camera).expect("a view");
        let mut picture = Picture::default();
        view.render_bands(&whole(), u32::MAX, &CancelToken::new(), &mut picture).expect("a picture");
        picture
    };
    let (bare, shaded) = (picture(0.0), picture(1.0));
    let left = |x: u32, y: u32| {
        let at = (y * WIDTH + x) as usize;
        shaded.pixels[at][0] / bare.pixels[at][0]
    };
    assert!(left(20, 29) > 0.95, "the shaft of one pixel keeps {}", left(20, 29));
    assert!(left(60, 29) < 0.9, "the wide one keeps {}", left(60, 29));
}

#[test]
fn regions_and_bands_of_a_picture_with_ambient_occlusion_join_without_a_seam() {
    let (camera, settings) = (camera(false), with(1.5));
    let all = rendered(&settings, &camera, &whole(), u32::MAX);
    for rows in [1, 3, 8, 17] {
        assert!(rendered(&settings, &camera, &whole(), rows).pixels == all.pixels, "bands of {rows} rows");
    }
    for (columns, rows) in [(30..31, 20..21), (0..7, 50..60), (11..64, 17..43)] {
        let region = Region { columns: columns.clone(), rows: rows.clone() };
        let part = rendered(&settings, &camera, &region, 5);
        assert_eq!((part.width, part.height), (columns.len() as u32, rows.len() as u32));
        let mut found = part.pixels.iter();
        for y in rows {
            for x in columns.clone() {
                assert!(found.next() == Some(&all.pixels[(y * WIDTH + x) as usize]), "pixel {x}, {y}");
            }
        }
    }
}

#[test]
fn layers_come_with_ambient_occlusion_only_where_they_are_asked_for() {
    struct Layers(usize);
    impl BandSink for Layers {
        fn band(&mut self, band: &rayset::image::Band) -> Result<(), SinkError> {
            self.0 += band.layers.len();
            Ok(())
        }
    }
    let scene = corner();
    for (layers, expected) in [(false, 0), (true, (WIDTH * HEIGHT) as usize)] {
        let settings = RenderSettings { layers, ..with(1.0) };
        let session = Session::over(paged(&scene, 1 << 20), ExecSettings::default()).expect("a session");
        let prepared = session.prepare(&scene, &settings).expect("a scene");
        let view = prepared.view(&camera(false)).expect("a view");
        let mut sink = Layers(0);
        view.render_bands(&whole(), 7, &CancelToken::new(), &mut sink).expect("a picture");
        assert_eq!(sink.0, expected);
    }
}

#[test]
fn strengths_out_of_range_are_refused() {
    let scene = corner();
    for strength in [-0.1, 4.5, f32::NAN, f32::INFINITY] {
        let session = Session::over(paged(&scene, 1 << 20), ExecSettings::default()).expect("a session");
        let error = session.prepare(&scene, &with(strength)).expect_err("refused");
        assert!(error.to_string().contains("ambient occlusion"), "{error}");
    }
}

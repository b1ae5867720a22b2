//! Where pictures vary: pixels with four rays instead of one, whatever region, band or part they
//! are rendered in.

use rayset::geometry::DVec3;
use rayset::scene::{
    Camera, Form, LightKind, Node, Operator, RenderSettings, Samples, Sampling, Scene, Step,
};
use rayset::trace::{ExecSettings, Picture};
use rayset::{CancelToken, Region, Session, View};

use crate::common::{paged, settings};
use crate::graph::{light, scene, solid};

const WIDTH: u32 = 61;
const HEIGHT: u32 = 45;

/// A ball on a rod that is thinner than a pixel.
fn ball_and_rod() -> Scene {
    let ball = solid(Form::Sphere { radius: 0.7 }, [0.8, 0.4, 0.2]);
    let rod = solid(Form::Cylinder { radius: 0.02, height: 3.0 }, [0.9; 3]);
    let lights = vec![
        light(LightKind::Ambient, [0.4; 3], false),
        light(LightKind::Directional { direction: DVec3::new(-1.0, -2.0, -0.5) }, [0.8; 3], true),
    ];
    scene(Node::operator(Operator::Union, [ball, rod]), lights)
}

fn with(samples: Samples) -> RenderSettings {
    let rendered = RenderSettings { step: Step::Fixed(0.01), ..settings(WIDTH, HEIGHT) };
    RenderSettings { ambient_occlusion: 0.5, layers: true, ..rendered }.with_samples(samples)
}

/// Calls `then` with the view of the scene.
fn viewed<R>(settings: &RenderSettings, exec: ExecSettings, then: impl FnOnce(&View) -> R) -> R {
    let scene = ball_and_rod();
    let session = Session::over(paged(&scene, 1 << 20), exec).expect("a session");
    let prepared = session.prepare(&scene, settings).expect("a scene");
    let camera = Camera::look_at(DVec3::new(0.5, 0.8, 3.0), DVec3::ZERO, DVec3::Y, 0.7);
    then(&prepared.view(&camera).expect("a view"))
}

fn rendered(view: &View, region: &Region, band_rows: u32) -> Picture {
    let mut picture = Picture::default();
    view.render_bands(region, band_rows, &CancelToken::new(), &mut picture).expect("a picture");
    picture
}

fn picture(settings: &RenderSettings) -> Picture {
    viewed(settings, ExecSettings::default(), |view| rendered(view, &view.region(), u32::MAX))
}

/// The same without what describes how the work was done.
fn comparable(mut picture: Picture) -> Picture {
    picture.layers.iter_mut().for_each(|layers| layers.bytes = 0.0);
    picture
}

/// Whether a pixel differs from the mean of two opposite neighbours, as docs/rendering.md has it.
fn varies(middles: &Picture, exposure: f32, x: usize, y: usize) -> bool {
    let (width, height) = (middles.width as i64, middles.height as i64);
    let compared = |i: i64, j: i64, channel: usize| {
        let value = middles.pixels[(j * width + i) as usize][channel];
        if channel == 3 { value } else { (value * exposure.exp2()).max(0.0).sqrt() }
    };
    let (x, y) = (x as i64, y as i64);
    [(1_i64, 0_i64), (0, 1), (1, 1), (-1, 1)].into_iter().any(|(i, j)| {
        let inside = x >= i.abs() && x + i.abs() < width && y >= j && y + j < height;
        inside
            && (0..4).any(|c| {
                let mean = 0.5 * (compared(x + i, y + j, c) + compared(x - i, y - j, c));
                (compared(x, y, c) - mean).abs() > 2.5 / 255.0
            })
    })
}

#[test]
fn a_pixel_that_is_not_midway_between_its_neighbours_has_the_bytes_of_four_rays_and_others_of_one() {
    for (pattern, exposure) in [(Sampling::Fixed, 0.0), (Sampling::Stratified, -3.0)] {
        let bare =
            |samples| RenderSettings { ambient_occlusion: 0.0, ..with(samples) }.with_sampling(pattern);
        let one = picture(&RenderSettings { sampling: Sampling::Fixed, ..bare(Samples::Fixed(1)) });
        let (four, auto) = (picture(&bare(Samples::Fixed(2))), picture(&bare(Samples::Auto { exposure })));
        let (one, four, auto) = (comparable(one), comparable(four), comparable(auto));
        let mut varying = 0;
        for y in 0..HEIGHT as usize {
            for x in 0..WIDTH as usize {
                let at = y * WIDTH as usize + x;
                let right = if varies(&one, exposure, x, y) { &four } else { &one };
                varying += usize::from(varies(&one, exposure, x, y));
                assert_eq!(auto.pixels[at], right.pixels[at], "{x}, {y}");
                assert_eq!(auto.layers[at], right.layers[at], "{x}, {y}");
            }
        }
        let all = one.pixels.len();
        assert!(varying > all / 20 && varying < all / 2, "{varying} of {all}");
    }
}

#[test]
fn pixels_that_vary_are_the_same_in_every_region_band_thread_and_tile_size() {
    let settings = with(Samples::Auto { exposure: 0.0 });
    let whole = comparable(picture(&settings));
    for (threads, tile_pixels, band_rows) in [(1, 8, 8), (3, 4, 17), (2, 5, 1), (2, 8, u32::MAX)] {
        let exec = ExecSettings { threads, tile_pixels, ..ExecSettings::default() };
        let again = viewed(&settings, exec, |view| rendered(view, &view.region(), band_rows));
        assert!(comparable(again) == whole, "{threads} threads, tiles of {tile_pixels}, {band_rows} rows");
    }
    for region in [
        Region { columns: 17..40, rows: 9..30 },
        Region { columns: 0..1, rows: 20..21 },
        Region { columns: 33..WIDTH, rows: 0..HEIGHT },
    ] {
        let part = viewed(&settings, ExecSettings::default(), |view| rendered(view, &region, 7));
        let part = comparable(part);
        for (row, y) in region.rows.clone().enumerate() {
            let width = region.columns.len();
            let at = (y * WIDTH + region.columns.start) as usize;
            assert_eq!(part.pixels[row * width..(row + 1) * width], whole.pixels[at..at + width], "row {y}");
            assert_eq!(part.layers[row * width..(row + 1) * width], whole.layers[at..at + width], "row {y}");
        }
    }
}

#[test]
fn progress_of_a_picture_that_varies_ends_with_all_pixels_and_never_goes_back() {
    struct Told(Vec<(u64, u64)>);
    impl rayset::BandSink for Told {
        fn band(&mut self, _: &rayset::image::Band) -> Result<(), rayset::SinkError> {
            Ok(())
        }
        fn progress(&mut self, done: u64, total: u64) {
            self.0.push((done, total));
        }
    }
    let mut told = Told(Vec::new());
    viewed(&with(Samples::Auto { exposure: 0.0 }), ExecSettings::default(), |view| {
        view.render_bands(&view.region(), 16, &CancelToken::new(), &mut told).expect("a picture");
    });
    let all = u64::from(WIDTH * HEIGHT);
    assert_eq!(told.0.last(), Some(&(all, all)));
    assert!(told.0.is_sorted() && told.0.iter().all(|&(done, total)| done <= all && total == all));
}

//! Parts in memory, as a caller of the library has them: rendered into bytes, joined to a picture,
//! stopped, refused.

use std::sync::Arc;
use std::time::Duration;

use rayset::geometry::DVec3;
use rayset::parts::{Joined, Part, PartError, PartOptions, Share};
use rayset::scene::{Camera, Form, LightKind, Node, Operator, RenderSettings, Samples, Scene, Step};
use rayset::storage::MemoryStorage;
use rayset::{CancelToken, RenderError, Session, View};
use rayset_lab::simulated::Behaviour;

use crate::common::{Random, settings};
use crate::graph::{light, scene, solid};
use crate::remote_storage::{quick, remote};

const MEMORY: u64 = 64 << 20;

/// A solid that appears twice.
fn pair(radius: f64) -> Scene {
    let ball = solid(Form::Sphere { radius }, [0.6, 0.3, 0.2]);
    let block = solid(Form::Box { size: DVec3::new(3.0, 0.2, 3.0) }, [0.5; 3]);
    let lights = vec![light(LightKind::Headlight, [1.0; 3], false)];
    scene(Node::operator(Operator::Union, [ball, block]), lights)
}

fn view(scene: &Scene, settings: &RenderSettings) -> View {
    let session = Session::builder().threads(2).build().expect("a session");
    let camera = Camera::look_at(DVec3::new(1.0, 2.0, 4.0), DVec3::ZERO, DVec3::Y, 0.8);
    session.prepare(scene, settings).expect("a scene").view(&camera).expect("a view")
}

fn small() -> RenderSettings {
    RenderSettings { step: Step::Fixed(0.05), ..settings(80, 70) }
}

fn rendered(view: &View, options: &PartOptions) -> Vec<u8> {
    let (mut bytes, mut last) = (Vec::new(), (0, 0));
    let mut progress = |done, total| last = (done, total);
    view.render_part(&view.region(), options, &CancelToken::new(), &mut progress, &mut bytes)
        .expect("a part");
    assert_eq!(last.0, last.1, "all pixels are reported");
    bytes
}

fn opened(bytes: Vec<u8>) -> Result<Part, PartError> {
    Part::from_storage("bytes", Arc::new(MemoryStorage::new(Arc::new(bytes))))
}

#[test]
fn parts_in_memory_make_the_picture_whatever_is_held_at_a_time_and_keep_the_note() {
    let one = Samples::Fixed(1);
    for (layers, ambient_occlusion, samples) in [
        (false, 0.0, one),
        (true, 0.0, one),
        (false, 1.0, one),
        (true, 1.0, one),
        (false, 0.0, Samples::Auto { exposure: 0.0 }),
        (true, 1.0, Samples::Auto { exposure: 0.0 }),
    ] {
        let settings = RenderSettings { layers, ambient_occlusion, samples, ..small() };
        let view = view(&pair(0.9), &settings);
        let expected = view.picture().expect("a picture");
        for held_pixels in [0, 1500, 1 << 20] {
            let part = |share| {
                let options =
                    PartOptions::new(share).with_held_pixels(held_pixels).with_note(b"a note".to_vec());
                opened(rendered(&view, &options))
            };
            let joined = Joined::join(Share::all(3).map(part), MEMORY).expect("all parts");
            assert_eq!(joined.note(), b"a note");
            assert_eq!(
                (joined.size(), joined.region(), joined.has_layers()),
                ((80, 70), view.region(), layers)
            );
            let picture = joined.picture().expect("a picture");
            let of = format!("{layers} {ambient_occlusion} {samples:?}");
            assert!(format!("{picture:?}") == format!("{expected:?}"), "{of}");
        }
    }
}

#[test]
fn parts_that_are_there_make_their_pixels_and_what_is_missing_is_transparent_and_told() {
    let settings = RenderSettings { layers: true, ..small() };
    let view = view(&pair(0.9), &settings);
    let expected = view.picture().expect("a picture");
    let part = |number| opened(rendered(&view, &PartOptions::new(Share::new(number, 3).expect("a share"))));
    let some = Joined::join_partly([part(3), part(1)], MEMORY).expect("two parts");
    let (missing, picture) = (some.missing(), some.picture().expect("a picture"));
    let is_missing = |x, y| missing.iter().any(|of| of.columns.contains(&x) && of.rows.contains(&y));
    for (at, pixel) in (0..).zip(&picture.pixels) {
        let is_there = !is_missing(at % 80, at / 80);
        assert_eq!(*pixel, if is_there { expected.pixels[at as usize] } else { [0.0; 4] });
    }
    let other = Joined::join_partly([part(2)], MEMORY).expect("a part");
    let pixels = |joined: &Joined| joined.missing().iter().map(|region| region.pixels()).sum::<u64>();
    assert_eq!(pixels(&some) + pixels(&other), 80 * 70);
    assert!(pixels(&some) > 0 && pixels(&some) < pixels(&other));
    assert!(Joined::join([part(1), part(2), part(3)], MEMORY).expect("all").missing().is_empty());
}

#[test]
fn remote_parts_make_the_picture_and_several_blocks_are_on_their_way_at_a_time() {
    let behaviour =
        Behaviour { latency: Duration::from_millis(60), failing: 0.1, cut: 0.1, ..Behaviour::default() };
    let mut options = quick();
    options.timeout = Duration::from_secs(20);
    let view = view(&pair(0.9), &RenderSettings { step: Step::Fixed(0.05), ..settings(300, 60) });
    let (mut objects, mut parts) = (Vec::new(), Vec::new());
    for share in Share::all(2) {
        let bytes = rendered(&view, &PartOptions::new(share));
        let (object, storage) = remote(&bytes, behaviour, options);
        objects.push(object);
        parts.push(Part::from_storage("remote", Arc::new(storage)));
    }
    let joined = Joined::join(parts, MEMORY).expect("all parts");
    let picture = joined.picture().expect("a picture");
    assert!(format!("{picture:?}") == format!("{:?}", view.picture().expect("a picture")));
    let counts: Vec<_> = objects.iter().map(|object| object.counts()).collect();
    assert!(counts.iter().any(|counts| counts.most_at_once > 1), "{counts:?}");
}

#[test]
fn the_bytes_of_a_part_depend_on_the_picture_alone() {
    let options = PartOptions::new(Share::new(2, 3).expect("a share"));
    let again = options.clone().with_held_pixels(1);
    assert!(rendered(&view(&pair(0.9), &small()), &options) == rendered(&view(&pair(0.9), &small()), &again));
    let part = |scene: &Scene, number| {
        opened(rendered(&view(scene, &small()), &PartOptions::new(Share::new(number, 2).expect("a share"))))
    };
    let other = Joined::join([part(&pair(0.9), 1), part(&pair(0.900_000_1), 2)], MEMORY);
    assert!(
        matches!(other.expect_err("another scene"), PartError::Foreign { what, .. } if what.contains("scene"))
    );
    let missing = Joined::join([part(&pair(0.9), 2)], MEMORY).expect_err("a part is missing");
    assert!(matches!(missing, PartError::Missing { missing, of: 2 } if missing == [1]));
    assert!(matches!(Joined::join([], MEMORY), Err(PartError::None)));
    let poor = Joined::join([part(&pair(0.9), 1)], 1000).expect_err("no memory");
    assert!(matches!(poor, PartError::Memory { given: 1000, needed } if needed < MEMORY));
}

/// A part whose render was cancelled once so many of its pixels were finished.
fn interrupted(view: &View, options: &PartOptions, pixels: u64) -> Vec<u8> {
    let (mut bytes, cancel) = (Vec::new(), CancelToken::new());
    let mut progress = |done, _| {
        if done >= pixels {
            cancel.cancel();
        }
    };
    let stopped = view.render_part(&view.region(), options, &cancel, &mut progress, &mut bytes);
    assert!(matches!(stopped, Err(PartError::Render(RenderError::Cancelled))));
    bytes
}

#[test]
fn a_part_that_was_interrupted_any_number_of_times_is_resumed_to_the_same_bytes() {
    for (layers, ambient_occlusion) in [(false, 0.0), (true, 1.0)] {
        let settings = RenderSettings { layers, ambient_occlusion, ..small() };
        let view = view(&pair(0.9), &settings);
        for share in [Share::new(1, 1), Share::new(2, 2)] {
            let options = PartOptions::new(share.expect("a share")).with_note(b"a note".to_vec());
            let whole = rendered(&view, &options);
            let all = opened(whole.clone()).expect("a part").finished_pixels();
            assert_eq!(all.0, all.1);
            // Square by square.
            let step_by_step = options.clone().with_kept_every(Some(Duration::ZERO)).with_held_pixels(1);
            let mut before = None;
            let mut reached = 0;
            for pixels in [0, 1, 2 * all.1 / 3, 2 * all.1 / 3] {
                let from = step_by_step.clone().with_resumed(before);
                let part = opened(interrupted(&view, &from, pixels)).expect("an unfinished part");
                let (finished, of) = part.finished_pixels();
                assert!(finished >= reached && finished < of && of == all.1, "{finished} after {reached}");
                let refused = Joined::join([Ok(part.clone())], MEMORY).expect_err("it is unfinished");
                assert!(matches!(refused, PartError::Unfinished { pixels, .. } if pixels == of), "{refused}");
                (before, reached) = (Some(part), finished);
            }
            assert!(reached > 0, "nothing was ever kept");
            assert!(rendered(&view, &options.clone().with_resumed(before)) == whole);
        }
    }
}

#[test]
fn what_an_unfinished_part_lacks_is_transparent_and_told() {
    let view = view(&pair(0.9), &small());
    let options = PartOptions::new(Share::new(1, 1).expect("a share")).with_held_pixels(1);
    let part = opened(interrupted(&view, &options, 80 * 70 / 2)).expect("an unfinished part");
    let (finished, of) = part.finished_pixels();
    let some = Joined::join_partly([Ok(part)], MEMORY).expect("a picture");
    assert!(finished > 0 && of == 80 * 70);
    assert_eq!(some.missing().iter().map(|region| region.pixels()).sum::<u64>(), of - finished);
    let (picture, whole) = (some.picture().expect("a picture"), view.picture().expect("a picture"));
    let is_missing = |x, y| some.missing().iter().any(|of| of.columns.contains(&x) && of.rows.contains(&y));
    for (at, pixel) in (0..).zip(&picture.pixels) {
        let is_there = !is_missing(at % 80, at / 80);
        assert_eq!(*pixel, if is_there { whole.pixels[at as usize] } else { [0.0; 4] });
    }
}

#[test]
fn a_part_of_another_render_and_a_damaged_one_are_not_gone_on_with() {
    let share = |number, of| PartOptions::new(Share::new(number, of).expect("a share")).with_held_pixels(1);
    let view_of = |radius: f64, settings: &RenderSettings| view(&pair(radius), settings);
    let view = view_of(0.9, &small());
    let bytes = interrupted(&view, &share(1, 2), 1000);
    let goes_on = |view: &View, options: PartOptions, bytes: Vec<u8>| {
        let part = opened(bytes).expect("an unfinished part");
        let options = options.with_resumed(Some(part));
        view.render_part(&view.region(), &options, &CancelToken::new(), &mut |_, _| {}, &mut std::io::sink())
    };
    let finer = RenderSettings { step: Step::Fixed(0.04), ..small() };
    for (view, options, named) in [
        (&view_of(0.91, &small()), share(1, 2), "scene"),
        (&view_of(0.9, &finer), share(1, 2), "step"),
        (&view, share(2, 2), "part 1/2"),
        (&view, share(1, 3), "in 2 parts"),
        (&view, share(1, 2).with_note(vec![1]), "exposure or annotations"),
        (&view, share(1, 2).with_build("another".into()), "another"),
    ] {
        let refused = goes_on(view, options, bytes.clone()).expect_err(named);
        assert!(matches!(&refused, PartError::OtherRender { what, .. } if what.contains(named)), "{refused}");
    }
    let blocks = bytes.len() - 28 - 8 * 2 - 60;
    let mut damaged = bytes;
    damaged[blocks] ^= 1;
    let refused = goes_on(&view, share(1, 2), damaged).expect_err("a damaged part");
    assert!(matches!(refused, PartError::Damaged { .. }), "{refused}");
}

#[test]
fn a_part_stops_when_it_is_cancelled_or_cannot_be_written() {
    struct Full;
    impl std::io::Write for Full {
        fn write(&mut self, _: &[u8]) -> std::io::Result<usize> {
            Err(std::io::ErrorKind::StorageFull.into())
        }
        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }
    let (view, options) = (view(&pair(0.9), &small()), PartOptions::new(Share::new(1, 1).expect("a share")));
    let cancel = CancelToken::new();
    let full = view.render_part(&view.region(), &options, &cancel, &mut |_, _| {}, &mut Full);
    assert!(matches!(full, Err(PartError::Write(error)) if error.kind() == std::io::ErrorKind::StorageFull));
    cancel.cancel();
    let stopped = view.render_part(&view.region(), &options, &cancel, &mut |_, _| {}, &mut Vec::new());
    assert!(matches!(stopped, Err(PartError::Render(RenderError::Cancelled))));
}

#[test]
fn no_byte_of_a_part_can_be_wrong_unseen() {
    let view = view(&pair(0.9), &small());
    let whole = rendered(&view, &PartOptions::new(Share::new(1, 1).expect("a share")).with_note(vec![7; 99]));
    let outcome = |bytes: Vec<u8>| Joined::join([opened(bytes)], MEMORY).and_then(|joined| joined.picture());
    assert!(outcome(whole.clone()).is_ok());
    let mut random = Random(5);
    for _ in 0..300 {
        let mut bytes = whole.clone();
        let at = (random.unit() * bytes.len() as f64) as usize;
        bytes[at] ^= 1 << (random.unit() * 8.0) as u32;
        assert!(outcome(bytes).is_err(), "byte {at}");
    }
    for length in 0..whole.len().min(400) {
        assert!(outcome(whole[..length].to_vec()).is_err(), "{length} bytes");
    }
}

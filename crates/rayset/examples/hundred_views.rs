//! A hundred views of one prepared scene: it is compiled once, and each block of its shadow tables
//! is computed once: `cargo run --release --example hundred_views -- [picture of the last]`.
#![allow(clippy::print_stdout, reason = "an example says what it did")]

use std::path::PathBuf;
use std::time::Instant;

use rayset::memory::Kind;
use rayset::scene::{RenderSettings, Shadows};
use rayset::{Picture, Session};

mod common;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let output = std::env::args_os().nth(1).map_or_else(|| PathBuf::from("views.png"), PathBuf::from);
    let scene = common::knot_under_a_lamp()?;
    let shadows = Shadows::Cached { resolution: 128 };
    let settings = RenderSettings::default().with_size(96, 72).with_shadows(shadows);
    let session = Session::builder().build()?;
    let prepared = session.prepare(&scene, &settings)?;
    let started = Instant::now();
    let (mut last, mut first_took) = (Picture::default(), None);
    for number in 0..100 {
        last = prepared.view(&common::camera(&scene, f64::from(number) / 100.0))?.picture()?;
        first_took.get_or_insert_with(|| started.elapsed());
    }
    let made = *session.statistics().kind(Kind::Shadows);
    println!(
        "the first view took {:.0?}, all hundred {:.1?}; {} blocks of shadows were made, {} of them different",
        first_took.unwrap_or_default(),
        started.elapsed(),
        made.computed,
        made.computed_unique
    );
    assert_eq!(made.computed, made.computed_unique, "none is made twice");
    last.save_png(&output)?;
    Ok(())
}

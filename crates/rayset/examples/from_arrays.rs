//! Builds a cloud in memory from arrays of points and renders a picture of it, without any file but
//! the picture: `cargo run --release --example from_arrays -- [picture.png]`.
#![allow(clippy::print_stdout, reason = "an example says what it did")]

use std::path::PathBuf;
use std::sync::Arc;

use rayset::build::BuildOptions;
use rayset::points::SliceSource;
use rayset::scene::{
    Camera, CloudObject, ColorMap, ColorRule, Lighting, MapInput, OpacityRule, RenderSettings, Scene,
    TransferFunction,
};
use rayset::{Cloud, Session};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let output = std::env::args_os().nth(1).map_or_else(|| PathBuf::from("arrays.png"), PathBuf::from);

    // A kind of spiral galaxy, as from a simulation: positions, smoothing lengths, masses,
    // temperatures.
    let numbers = 0..40_000_u32;
    let arm = |i: u32| (f64::from(i) / 40_000.0).sqrt();
    let positions: Vec<[f32; 3]> = numbers
        .clone()
        .map(|i| {
            let (r, jitter) = (arm(i), |k: u32| f64::from(i.wrapping_mul(k) % 1000) / 1000.0 - 0.5);
            let angle = 9.0 * r + f64::from(i % 2) * std::f64::consts::PI + 0.9 * jitter(7919);
            let height = 0.06 * jitter(104_729) * (1.2 - r);
            [r * angle.cos(), height, r * angle.sin()].map(|v| v as f32)
        })
        .collect();
    let smoothing_length: Vec<f32> = numbers.clone().map(|i| 0.015 + 0.03 * arm(i) as f32).collect();
    let temperature: Vec<f32> = numbers.map(|i| 1.0 - arm(i) as f32).collect();

    let source =
        SliceSource::new(&positions).radius(&smoothing_length)?.attribute("temperature", &temperature)?;
    let options = BuildOptions::default().with_attributes(vec!["temperature".into()]);
    let (cloud, report) = Cloud::builder().source(source).options(options).build_reported()?;
    assert_eq!(report.points, 40_000);

    let picture = picture_of(Arc::new(cloud))?;
    picture.save_png(&output)?;
    println!("{}: {} points", output.display(), report.points);
    Ok(())
}

fn picture_of(cloud: Arc<Cloud>) -> Result<rayset::Picture, Box<dyn std::error::Error>> {
    let map = ColorMap::named("inferno".parse()?, (-0.1, 1.0));
    let transfer = TransferFunction {
        opacity: OpacityRule::Extinction(6.0),
        color: ColorRule::Map { map, input: MapInput::Attribute(0) },
    };
    let scene = Scene {
        lighting: Lighting::Unlit,
        background: Some([0.0; 3]),
        ..Scene::of_cloud(CloudObject { transfer, ..CloudObject::plain(cloud) })
    };
    let (view, up) = ([0.0, -1.0, -0.9].into(), [0.0, 1.0, 0.0].into());
    let camera = Camera::framing(&scene.root.bounds(), view, up, 0.7, 4.0 / 3.0, false);
    let settings = RenderSettings::default().with_size(320, 240);
    let session = Session::builder().memory(64 << 20).build()?;
    let picture = session.prepare(&scene, &settings)?.view(&camera)?.picture()?;
    let bright = picture.pixels.iter().filter(|pixel| pixel[0] > 0.2).count();
    assert!(bright > 3000, "the galaxy shines in {bright} pixels");
    Ok(picture)
}

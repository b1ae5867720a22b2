//! A picture that improves pass by pass, from its centre outward; the last pass is bit for bit the
//! picture of a single pass: `cargo run --release --example progressive -- [folder]`.
#![allow(clippy::print_stdout, reason = "an example says what it did")]

use std::path::PathBuf;
use std::time::Instant;

use rayset::scene::RenderSettings;
use rayset::{CancelToken, FinishedTile, Picture, Session, SinkError, Work};

mod common;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = std::env::args_os().nth(1).map_or_else(|| PathBuf::from("."), PathBuf::from);
    let scene = common::knot_under_a_lamp()?;
    let settings = RenderSettings::default().with_size(320, 240).with_samples(4);
    let session = Session::builder().build()?;
    let view = session.prepare(&scene, &settings)?.view(&common::camera(&scene, 0.0))?;

    // Tiles in order of their distance from the centre of the picture.
    let mut tiles = view.tiles(&view.region());
    tiles.sort_by_key(|tile| (tile.x.abs_diff(160)).pow(2) + (tile.y.abs_diff(120)).pow(2));
    let work = Work::tiles(tiles).progressive();

    let started = Instant::now();
    let mut first_tile = None;
    let mut shown =
        Picture { width: 320, height: 240, pixels: vec![[0.0; 4]; 320 * 240], layers: Vec::new() };
    let mut passes = 0;
    let mut sink = |finished: &FinishedTile<'_>| -> Result<(), SinkError> {
        first_tile.get_or_insert_with(|| started.elapsed());
        if finished.pass == passes {
            println!("pass {} of {} begins at {:.0?}", finished.pass + 1, finished.passes, started.elapsed());
            if passes > 0 {
                shown.save_png(folder.join(format!("progressive.{passes}.png")))?;
            }
            passes += 1;
        }
        for (at, pixel) in finished.pixels.iter().enumerate() {
            let (column, row) = (at as u32 % finished.tile.width, at as u32 / finished.tile.width);
            shown.pixels[((finished.tile.y + row) * 320 + finished.tile.x + column) as usize] = *pixel;
        }
        Ok(())
    };
    view.render(&work, &CancelToken::new(), &mut sink)?;
    println!(
        "first tile after {:.1?}, the last after {:.0?}",
        first_tile.unwrap_or_default(),
        started.elapsed()
    );
    shown.save_png(folder.join("progressive.png"))?;
    assert_eq!(shown.pixels, view.picture()?.pixels, "the last pass is the batch picture");
    Ok(())
}

//! Renders a scene file:
//! `cargo run --release --example render_scene -- [scene.json [picture.png]]`.
//!
//! Without arguments it renders a small built-in scene: a sphere cut open under a lamp that casts
//! shadows.
#![allow(clippy::print_stdout, reason = "an example says what it did")]

use std::path::PathBuf;

use rayset::Session;
use rayset::scene_file::SceneFile;

const SCENE: &str = r##"{
  "rayset": 1,
  "image": {"size": [320, 240], "samples": 2},
  "camera": {"position": [1.9, 1.5, 2.4], "lookAt": [0, -0.1, 0], "fovy": 40},
  "background": "#20242c",
  "lights": [
    {"type": "ambient", "intensity": 0.6},
    {"type": "directional", "direction": [-0.5, -1, -0.6], "intensity": 1, "shadow": true}
  ],
  "rendering": {"unitDistance": 0.01},
  "root": {"type": "union", "children": [
    {"type": "difference", "children": [
      {"type": "sphere", "radius": 0.8, "color": "#d08040"},
      {"type": "box", "size": [1, 1, 1], "transform": {"translate": [0.5, 0.5, 0.5]}}
    ]},
    {"type": "box", "size": [4, 0.1, 4], "color": "#707880", "transform": {"translate": [0, -0.85, 0]}}
  ]}
}"##;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let file = match arguments.next() {
        Some(path) => SceneFile::load(&path)?,
        None => SceneFile::parse("a scene of its own".as_ref(), SCENE)?,
    };
    let output = arguments.next().unwrap_or_else(|| "scene.png".into());
    let session = Session::builder().memory(512 << 20).build()?;
    let picture = session.prepare(&file.scene, &file.settings)?.view(&file.camera)?.picture()?;
    picture.save_png(&output)?;
    let lit = picture.pixels.iter().filter(|pixel| pixel[..3].iter().sum::<f32>() > 0.3).count();
    assert!(lit > 1000, "there is something to be seen");
    println!("{}: {} x {} pixels", output.display(), picture.width, picture.height);
    Ok(())
}

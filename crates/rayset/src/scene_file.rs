//! Scene files: a strict, versioned JSON format. `docs/scene.md` describes it for people,
//! `docs/scene.schema.json` for editors.
//!
//! A scene file contains what determines pixels and nothing else: camera, image, lights, render
//! settings and the graph. Memory and threads are up to the program that renders it.

pub use rayset_render::scene_file::{LoadError, SceneFile, SceneFileError, VERSION};

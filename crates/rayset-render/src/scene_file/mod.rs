//! Scene files: a strict, versioned JSON format. `docs/scene.md` describes it for people,
//! `docs/scene.schema.json` for editors.
//!
//! A scene file contains what determines pixels and nothing else: camera, image, lights, render
//! settings and the graph. Memory and threads are up to the program that renders it.

mod data_files;
mod error;
mod graph;
mod json;
mod locate;
mod preset;
mod reader;
mod text;
mod transfers;
mod view;

use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use self::data_files::DataFiles;
pub use self::error::{LoadError, SceneFileError};
use self::graph::GraphReader;
use self::json::Json;
use self::reader::{Cursor, Document, Object};
use self::text::read_text;
use crate::image::DisplayTransform;
use crate::scene::{
    BRIGHTEST, Camera, CameraPath, Light, LightKind, Lighting, RenderSettings, Scene, SceneError,
};
use rayset_files::grid::Grid;
use rayset_files::octree::Cloud;

/// Version of the format that this code reads.
pub const VERSION: u32 = 1;

/// Most lights of a scene.
const MOST_LIGHTS: usize = 1024;

/// The contents of a scene file.
#[derive(Clone, Debug)]
#[cfg_attr(not(feature = "internals"), non_exhaustive)]
pub struct SceneFile {
    /// The graph and its lighting.
    pub scene: Scene,
    /// The camera; by default, one that shows the whole scene, slightly from above.
    pub camera: Camera,
    /// The camera path of an animation, if the file has one.
    pub path: Option<CameraPath>,
    /// Size of the picture and all other settings that determine pixels.
    pub settings: RenderSettings,
    /// Exposure and tone mapping.
    pub display_transform: DisplayTransform,
    /// Files that the scene refers to: clouds, grids and colour-map presets.
    pub files: Vec<PathBuf>,
    /// An upper bound of the memory that reading took, in bytes, for the memory plan of the whole
    /// process; most of it has been freed since.
    pub loading_bytes: u64,
}

impl SceneFile {
    /// Reads a scene and opens the data files it refers to; relative paths are relative to the
    /// folder of the scene file.
    ///
    /// # Errors
    /// [`LoadError`] if the file cannot be read or is invalid; in the latter case it gives line,
    /// column, key and what was expected.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, LoadError> {
        let path = path.as_ref();
        let text = read_text(path).map_err(|source| LoadError::Io { path: path.to_owned(), source })?;
        Ok(Self::parse(path, &text)?)
    }

    /// Reads a scene from a string. `path` is the file named in errors, and data files are opened
    /// relative to its folder.
    ///
    /// # Errors
    /// [`SceneFileError`] if the text is invalid, with line, column, key and what was expected.
    pub fn parse(path: &Path, text: &str) -> Result<Self, SceneFileError> {
        Self::parse_with(path, text, DataFiles::default())
    }

    /// Reads a changed scene from a string, as [`parse`](Self::parse). Data files that are open in
    /// this scene are not opened again: a session that renders both keeps their pages.
    ///
    /// # Errors
    /// As [`parse`](Self::parse).
    pub fn parse_changed(&self, path: &Path, text: &str) -> Result<Self, SceneFileError> {
        let mut open = DataFiles::default();
        open.share(&self.scene.root);
        Self::parse_with(path, text, open)
    }

    /// Reads a scene from a string, as [`parse`](Self::parse), that refers to clouds and grids
    /// which are open already, perhaps in memory, by the very names of their
    /// [`path`](Cloud::path)s.
    ///
    /// # Errors
    /// As [`parse`](Self::parse).
    pub fn parse_using(
        path: &Path,
        text: &str,
        clouds: &[Arc<Cloud>],
        grids: &[Arc<Grid>],
    ) -> Result<Self, SceneFileError> {
        let mut open = DataFiles::default();
        open.know(clouds, grids);
        Self::parse_with(path, text, open)
    }

    fn parse_with(path: &Path, text: &str, open: DataFiles) -> Result<Self, SceneFileError> {
        let document = Document { file: path, text, named: RefCell::default() };
        let value = document.parse()?;
        let whole = Cursor::root(&document, &value);
        let known = [
            "$schema",
            "rayset",
            "image",
            "camera",
            "background",
            "lights",
            "rendering",
            "animation",
            "define",
            "root",
        ];
        let file = whole.object(&known)?;
        check_version(&file)?;
        let root_at = file.require("root")?;
        let mut graph = GraphReader::new(&file, open)?;
        let root = graph.node(&root_at)?;
        // Checked before anything else walks the graph: with sharing, a graph of few nodes can have
        // more places than there is time to visit.
        root.check().map_err(|e| root_at.error(e.to_string()))?;
        let (settings, display_transform) = view::settings(&file)?;
        let bounds = root.bounds();
        let scene = Scene {
            lighting: lighting(&file)?,
            background: match file.get("background") {
                Some(cursor) if *cursor.value != Json::Null => Some(cursor.color()?.map(|v| v as f32)),
                _ => None,
            },
            unit_distance: view::unit_distance(&file, &bounds)?,
            compositing: view::compositing(&file)?,
            root,
        };
        scene.check().map_err(|e| match e {
            SceneError::UnitDistance => whole.error(e.to_string()),
            _ => root_at.error(e.to_string()),
        })?;
        let in_rendering = |key: &str, e: SceneError| view::in_rendering(&file, key).error(e.to_string());
        scene.check_step(settings.step).map_err(|e| in_rendering("step", e))?;
        scene.check_compositing(&settings).map_err(|e| in_rendering("compositing", e))?;
        let camera = view::camera(&file, &bounds, &settings)?;
        let path = view::path(&file, &bounds, &settings)?;
        let files = document.named.take().into_iter().collect();
        let loading_bytes = loading_bytes(text, &value);
        Ok(Self { scene, camera, path, settings, display_transform, files, loading_bytes })
    }
}

/// An upper bound of the memory that reading a scene takes, in bytes.
fn loading_bytes(text: &str, value: &Json<'_>) -> u64 {
    /// A cursor with its step.
    const CURSOR_BYTES: u64 = 128;
    /// What is stored for a node: its name, the node itself, and its height.
    const NODE_BYTES: u64 = 640;
    let nodes = text.matches("\"type\"").count() + text.matches("\"ref\"").count();
    // Growing vectors double their capacity.
    2 * text.len() as u64 + 2 * value.bytes() + CURSOR_BYTES * value.widest_way() + NODE_BYTES * nodes as u64
}

fn check_version(file: &Object<'_>) -> Result<(), SceneFileError> {
    let at = file.get("rayset").ok_or_else(|| {
        file.cursor.error(format!("\"rayset\" is missing; a scene begins with {{\"rayset\": {VERSION}"))
    })?;
    if at.value.as_u64() == Some(u64::from(VERSION)) {
        return Ok(());
    }
    Err(at.expected(&format!("{VERSION}, the version of scene files that this program reads")))
}

fn lighting(file: &Object<'_>) -> Result<Lighting, SceneFileError> {
    let Some(at) = file.get("lights") else { return Ok(Lighting::headlight()) };
    if at.value.as_str() == Some("none") {
        return Ok(Lighting::Unlit);
    }
    if !at.value.is_list() {
        return Err(at.expected("a list of lights, or \"none\""));
    }
    Ok(Lighting::Lit(at.list(MOST_LIGHTS)?.iter().map(light).collect::<Result<_, _>>()?))
}

fn light(at: &Cursor<'_>) -> Result<Light, SceneFileError> {
    let of_type = at.any_object()?.require("type")?;
    let common = ["type", "color", "intensity"];
    let with = |more: &[&str]| at.object(&[&common[..], more].concat());
    let (object, kind) =
        match of_type.one_of(&[("ambient", 0), ("headlight", 1), ("directional", 2), ("point", 3)])? {
            0 => (with(&[])?, LightKind::Ambient),
            1 => (with(&[])?, LightKind::Headlight),
            2 => {
                let object = with(&["direction", "shadow"])?;
                let direction = object.require("direction")?.direction()?;
                (object, LightKind::Directional { direction })
            }
            _ => {
                let object = with(&["position", "decay", "shadow"])?;
                let position = object.require("position")?.vector()?;
                let decays = object.read_or("decay", true, Cursor::boolean)?;
                (object, LightKind::Point { position, decays })
            }
        };
    let color = object.read_or("color", [1.0; 3], Cursor::color)?;
    let intensity = object.read_or("intensity", 1.0, |at| at.number(0.0, BRIGHTEST))?;
    let color = color.map(|v| v * intensity);
    if color.iter().any(|&v| v > BRIGHTEST) {
        return Err(at.error(format!("color times intensity is above {BRIGHTEST:e}")));
    }
    let color = color.map(|v| v as f32);
    Ok(Light { kind, color, shadow: object.read_or("shadow", true, Cursor::boolean)? })
}

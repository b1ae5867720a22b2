//! What is to be rendered: a scene file, or a cloud or grid whose look is chosen.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail};
use rayset::image::DisplayTransform;
use rayset::output::Destination;
use rayset::scene::{Camera, CameraPath, RenderSettings, Scene};
use rayset::scene_file::SceneFile;
use rayset::storage::redacted;

use super::args::RenderArgs;
use super::warnings;
use super::work::DEFAULT_MEMORY;
use crate::annotate::Annotations;
use rayset_inputs::{Input, Opened};

use crate::input::{self, Resources};
use crate::{outputs, report};
use rayset_inputs::look::{self, Chosen};

/// A scene with its camera and settings.
pub(super) struct Shot {
    pub(super) scene: Scene,
    pub(super) camera: Camera,
    pub(super) path: Option<CameraPath>,
    pub(super) settings: RenderSettings,
    pub(super) display_transform: DisplayTransform,
    /// Every file that the scene was read from.
    pub(super) files: Vec<PathBuf>,
    /// An upper bound of the memory that reading the scene took.
    pub(super) loading_bytes: u64,
    /// The scene that was chosen for a cloud or grid.
    pub(super) chosen: Option<String>,
    /// The name of the look that was chosen.
    look: Option<&'static str>,
    /// Number of points of a cloud; `None` of anything else.
    pub(super) points: Option<u64>,
    /// Keeps what was built of the input.
    _input: Opened,
}

impl Shot {
    pub(super) fn new(args: &RenderArgs) -> Result<Self> {
        let resources = Resources {
            memory: args.work.memory.unwrap_or(DEFAULT_MEMORY),
            threads: args.work.threads,
            told: None,
        };
        let opened = input::open(&args.inputs, &args.cache, resources)?;
        let size = args.picture.size();
        let (mut file, chosen, look) = match &opened.input {
            Input::Scene(path) => (scene_file(args, path)?, None, None),
            Input::Cloud(cloud) => {
                let chosen = look::of_cloud(cloud, &args.look, &args.camera, size)?;
                let (file, text) = parsed(cloud.path(), &chosen)?;
                warnings::of_small_radii(cloud.header(), chosen.middle, &file.camera, file.settings);
                warnings::of_strays(cloud.header());
                (file, Some(text), Some(chosen.look))
            }
            Input::Grid(grid) => {
                let chosen = look::of_grid(grid, &args.look, &args.camera, size)?;
                let (file, text) = parsed(grid.path(), &chosen)?;
                (file, Some(text), Some(chosen.look))
            }
        };
        args.picture.apply(&mut file.settings, &mut file.display_transform);
        file.files.extend(opened.files.iter().cloned());
        // Errors in what was requested are reported before an output is created.
        file.scene.check()?;
        file.scene.check_step(file.settings.step)?;
        Ok(Self {
            scene: file.scene,
            camera: file.camera,
            path: file.path,
            settings: file.settings,
            display_transform: file.display_transform,
            files: file.files,
            loading_bytes: file.loading_bytes,
            chosen,
            look,
            points: if let Input::Cloud(cloud) = &opened.input { Some(cloud.header().points) } else { None },
            _input: opened,
        })
    }

    /// What is to be drawn over pictures of this scene, if anything.
    pub(super) fn annotations(&self, args: &RenderArgs) -> Result<Option<Annotations>> {
        if !args.annotate.annotate {
            return Ok(None);
        }
        let name = report::name_of(&args.inputs[0]);
        let name = match args.inputs.len() {
            1 => name,
            several => format!("{name} and {} more", several - 1),
        };
        let size = (self.settings.width, self.settings.height);
        Annotations::new(&args.annotate, &self.scene, size, self.display_transform, &name, self.look)
            .map(Some)
    }

    /// Writes the scene that was chosen.
    pub(super) fn write_scene(&self, to: &Destination) -> Result<()> {
        let text = self.chosen.as_ref().context("--write-scene: the input is a scene file already")?;
        outputs::write(to, text.as_bytes())?;
        if redacted(text) != text.as_str() {
            report::remark(format_args!(
                "{} names its data by addresses that grant access: whoever reads it can read them",
                to.path().display()
            ));
        }
        Ok(())
    }
}

/// Reads a scene file, which says itself what can be chosen for clouds and grids.
fn scene_file(args: &RenderArgs, path: &Path) -> Result<SceneFile> {
    if let Some(option) = args.look.given() {
        bail!("{option} is for clouds and grids; {} says itself what its objects look like", path.display());
    }
    if args.camera.is_given() {
        bail!("the camera stands in {}; change it there", path.display());
    }
    Ok(SceneFile::load(path)?)
}

/// The scene that was chosen for a file, and its text.
fn parsed(path: &Path, chosen: &Chosen) -> Result<(SceneFile, String)> {
    report::remark(&chosen.line);
    let text = serde_json::to_string_pretty(&chosen.scene)?;
    // The place in a text that nobody has written means nothing.
    let file = SceneFile::parse(path, &text).map_err(|error| anyhow!("{}", error.what))?;
    Ok((file, text))
}

//! What is to be rendered: a scene file, or a cloud or grid whose look is chosen.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail};
use rayset::Region;
use rayset::image::DisplayTransform;
use rayset::output::Destination;
use rayset::scene::{Camera, CameraPath, RenderSettings, Scene};
use rayset::scene_file::SceneFile;
use rayset::storage::redacted;

use super::args::RenderArgs;
use super::warnings;
use super::work::DEFAULT_MEMORY;
use crate::annotate::{Annotations, Mount, Sheet};
use rayset_inputs::{Input, Opened, Pixels};

use crate::input::{self, Resources};
use rayset_inputs::look::{self, Chosen, Picture, Turntable};
use rayset_inputs::style::Group;
use rayset_terminal::{outputs, report};

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
    pub(super) look: Option<&'static str>,
    /// The sheet that the picture has its place on, beside its annotations.
    pub(super) sheet: Option<Sheet>,
    /// What the cameras of a turntable turn about.
    pub(super) turntable: Turntable,
    /// Number of points of a cloud; `None` of anything else.
    pub(super) points: Option<u64>,
    /// Keeps what was built of the input.
    _input: Opened,
}

impl Shot {
    /// What its pixels are.
    pub(super) fn pixels(&self) -> Pixels {
        Pixels { display_transform: self.display_transform, compositing: self.scene.compositing }
    }

    pub(super) fn new(args: &RenderArgs) -> Result<Self> {
        let resources = Resources {
            memory: args.work.memory.unwrap_or(DEFAULT_MEMORY),
            threads: args.work.threads,
            told: None,
        };
        let opened = input::open(&args.inputs, &args.input.cache(), resources)?;
        let mut size = args.picture.size();
        let mut sheet = None;
        if !matches!(opened.input, Input::Scene(_)) {
            sheet = args.annotate.sheet(size);
        }
        let picture = sheet.map_or(size, |sheet| sheet.picture);
        let picture = Picture { size: picture, turns: args.turntable.is_some() };
        let style = &args.style.0;
        let (mut file, chosen, look, turntable) = match &opened.input {
            Input::Scene(path) => (scene_file(args, path)?, None, None, None),
            Input::Cloud(cloud) => {
                let chosen = look::of_cloud(cloud, style, picture)?;
                let (file, text) = parsed(cloud.path(), &chosen, size)?;
                warnings::of_small_radii(cloud.header(), chosen.middle, &file.camera, file.settings);
                warnings::of_strays(cloud.header());
                (file, Some(text), Some(chosen.look), chosen.turntable)
            }
            Input::Grid(grid) => {
                let chosen = look::of_grid(grid, style, picture)?;
                let (file, text) = parsed(grid.path(), &chosen, size)?;
                (file, Some(text), Some(chosen.look), chosen.turntable)
            }
        };
        args.picture.apply(style, &mut file.settings, &mut file.display_transform);
        if chosen.is_none() {
            size = (file.settings.width, file.settings.height);
            sheet = args.annotate.sheet(size);
        }
        if let Some(sheet) = sheet {
            (file.settings.width, file.settings.height) = sheet.picture;
        }
        let turntable = turntable.unwrap_or_else(|| {
            if args.turntable.is_some() && chosen.is_none() {
                let aspect = f64::from(file.settings.width) / f64::from(file.settings.height);
                file.camera = look::standing_back(&file.camera, &file.scene, aspect);
            }
            Turntable::of_scene(&file.scene, &file.camera)
        });
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
            sheet,
            turntable,
            points: if let Input::Cloud(cloud) = &opened.input { Some(cloud.header().points) } else { None },
            _input: opened,
        })
    }

    /// What is to be drawn over pictures of this scene, if anything.
    pub(super) fn annotations(&self, args: &RenderArgs) -> Result<Option<Annotations>> {
        if !args.annotate.is_wanted() {
            return Ok(None);
        }
        let name = report::name_of(&args.inputs[0]);
        let name = match args.inputs.len() {
            1 => name,
            several => format!("{name} and {} more", several - 1),
        };
        let size = (self.settings.width, self.settings.height);
        let (scene, display) = (&self.scene, self.display_transform);
        Annotations::new(&args.annotate, scene, size, self.sheet, display, &name, self.look).map(Some)
    }

    /// Width and height of what is written: of the picture, or of the sheet that it has its place
    /// on.
    pub(super) fn whole(&self) -> (u32, u32) {
        self.sheet.map_or((self.settings.width, self.settings.height), |sheet| sheet.size)
    }

    /// What of the picture a part of the sheet shows, and how it is mounted there.
    pub(super) fn mounted(&self, shown: Region) -> Result<(Region, Option<Mount>)> {
        let Some(sheet) = &self.sheet else { return Ok((shown, None)) };
        let within = sheet.picture_within(&shown).with_context(|| {
            "--crop: there is nothing of the picture in it, which --annotate leaves a margin; --annotate-over does not"
        })?;
        let mount = Mount::new(sheet, &shown, &within, self.scene.background);
        Ok((within, Some(mount)))
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
    if let Some(option) = args.style.0.given(Group::Look) {
        let (name, path) = (option.name, path.display());
        bail!("--{name} is for clouds and grids; {path} says itself what its objects look like");
    }
    if args.style.0.given(Group::Camera).is_some() {
        bail!("the camera stands in {}; change it there", path.display());
    }
    Ok(SceneFile::load(path)?)
}

/// The scene that was chosen for a file, and its text.
fn parsed(path: &Path, chosen: &Chosen, (width, height): (u32, u32)) -> Result<(SceneFile, String)> {
    report::remark(&chosen.line);
    let mut scene = chosen.scene.clone();
    // Of the sheet: with the same annotations, the scene makes the same picture.
    scene["image"]["size"] = serde_json::json!([width, height]);
    let text = serde_json::to_string_pretty(&scene)?;
    // The place in a text that nobody has written means nothing.
    let file = SceneFile::parse(path, &text).map_err(|error| anyhow!("{}", error.what))?;
    Ok((file, text))
}

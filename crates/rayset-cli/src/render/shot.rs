//! What is to be rendered: a scene file, or a cloud whose look is given on the command line.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use rayset::geometry::{DAffine3, DQuat, DVec3};
use rayset::image::DisplayTransform;
use rayset::scene::{Camera, CameraPath, RenderSettings, Scene};
use rayset::scene_file::SceneFile;

use super::args::RenderArgs;
use super::camera::warn_of_small_radii;
use crate::kinds;

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
}

impl Shot {
    pub(super) fn new(args: &RenderArgs) -> Result<Self> {
        let shot = if is_scene(&args.input) { Self::of_scene(args) } else { Self::of_cloud(args) }?;
        // Errors in what was requested are reported before an output is created.
        shot.scene.check()?;
        shot.scene.check_step(shot.settings.step)?;
        Ok(shot)
    }

    fn of_scene(args: &RenderArgs) -> Result<Self> {
        if let Some(option) = args.look.given() {
            bail!("{option} is for clouds; {} says itself what its objects look like", args.input.display());
        }
        if args.camera.is_given() {
            bail!("the camera stands in {}; change it there", args.input.display());
        }
        let mut file = SceneFile::load(&args.input)?;
        args.picture.apply(&mut file.settings, &mut file.display_transform);
        file.files.push(args.input.clone());
        Ok(Self {
            scene: file.scene,
            camera: file.camera,
            path: file.path,
            settings: file.settings,
            display_transform: file.display_transform,
            files: file.files,
            loading_bytes: file.loading_bytes,
        })
    }

    fn of_cloud(args: &RenderArgs) -> Result<Self> {
        let cloud = kinds::open_cloud(&args.input)?;
        let (mut settings, mut display_transform) = (args.look.settings()?, DisplayTransform::default());
        args.picture.apply(&mut settings, &mut display_transform);
        let camera = args.camera.camera(cloud.header(), settings)?;
        warn_of_small_radii(cloud.header(), &camera, settings);
        let (scene, files) = (args.look.scene(&cloud)?, vec![args.input.clone()]);
        Ok(Self { scene, path: None, camera, settings, display_transform, files, loading_bytes: 0 })
    }

    /// The camera, turned about the centre of the scene.
    pub(super) fn turned(&self, turns: f64) -> Camera {
        let bounds = self.scene.root.bounds();
        let center = if bounds.is_empty() { DVec3::ZERO } else { bounds.center() };
        let axis = self.camera.up.normalize_or(DVec3::Y);
        let turn = DAffine3::from_quat(DQuat::from_axis_angle(axis, turns * std::f64::consts::TAU));
        Camera {
            position: center + turn.transform_vector3(self.camera.position - center),
            direction: turn.transform_vector3(self.camera.direction),
            up: self.camera.up,
            ..self.camera
        }
    }
}

/// Scene files have the extension `.json`.
pub(crate) fn is_scene(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("json"))
}

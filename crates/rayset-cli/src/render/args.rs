//! The arguments of `rayset render`.

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::Args;

use super::picture::PictureArgs;
use super::work::WorkArgs;
use crate::annotate::AnnotateArgs;
use crate::input_args::InputArgs;
use crate::option_args::{OfInput, StyleArgs};
use rayset::parts::Share;
use rayset_inputs::style::Style;
use rayset_inputs::values::{self, Frames};

/// Render a scene, a cloud, a grid, or any file of points or voxels to a picture.
///
/// Points and voxels that have not been built are built first, into a cache. The picture depends on
/// the input and on the options under "Picture", "Look" and "Camera"; those under "Work" never
/// change a pixel.
#[derive(Args, Clone)]
pub(crate) struct RenderArgs {
    /// Scene file (.json), cloud or grid file, one volume, or files of points: several, folders and
    /// patterns make one cloud
    #[arg(required = true)]
    pub(super) inputs: Vec<PathBuf>,
    /// Picture to write: PNG, or OpenEXR (.exr) in linear light with layers: depth, normal, albedo,
    /// opacity, instanceId, samples, bytes, lodError. With --part, the part
    #[arg(short, long)]
    pub(super) output: PathBuf,
    /// As many pictures from all around: the camera turns about the scene, OUTPUT gets numbers
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub(super) turntable: Option<u32>,
    /// Pictures along the camera's path in the scene, or of the turntable: `all`, one, or
    /// FIRST..LAST; OUTPUT gets numbers
    #[arg(long, value_parser = values::frames)]
    pub(super) frames: Option<Frames>,
    /// Render only this part of the picture, as 3/8: the third of eight. `rayset merge` joins all
    /// of them
    #[arg(long, value_name = "PART/OF")]
    pub(super) part: Option<Share>,
    /// If a signal ends the render, as Ctrl-C does, or if it fails: write what is finished of the
    /// picture, which says so, and keep it in OUTPUT.unfinished for --resume
    #[arg(long)]
    pub(super) keep_partial: bool,
    /// Go on with what is in OUTPUT.unfinished, to the picture of a render that was not
    /// interrupted; from the beginning if there is no such file. Keeps what is finished, as
    /// --keep-partial
    #[arg(long)]
    pub(super) resume: bool,
    /// Parts for OpenEXR: with all layers
    #[arg(long, requires = "part", conflicts_with_all = ["annotate", "annotate_over"])]
    pub(super) layers: bool,
    /// Write the scene that a cloud or grid without one is rendered as, to this file
    #[arg(long)]
    pub(super) write_scene: Option<PathBuf>,
    #[command(flatten)]
    pub(super) input: InputArgs,
    #[command(flatten)]
    pub(super) picture: PictureArgs,
    #[command(flatten)]
    pub(super) annotate: AnnotateArgs,
    #[command(flatten)]
    pub(super) style: StyleArgs<OfInput>,
    #[command(flatten)]
    pub(super) work: WorkArgs,
    /// Write statistics to this file, as JSON
    #[arg(long)]
    pub(super) stats: Option<PathBuf>,
}

/// The options of a render with default values but a transparent background, for commands that
/// render as part of their work.
pub(crate) fn defaults(cloud: &Path, output: &Path) -> Result<RenderArgs> {
    #[derive(clap::Parser)]
    struct Wrapper {
        #[command(flatten)]
        args: RenderArgs,
    }
    let [command, to, background, none] = ["render", "--output", "--background", "none"].map(Path::new);
    let words = [command, cloud, to, output, background, none];
    Ok(<Wrapper as clap::Parser>::try_parse_from(words.map(Path::as_os_str))?.args)
}

impl RenderArgs {
    /// Whether what is finished is kept if the render is interrupted.
    pub(super) fn keeps(&self) -> bool {
        self.keep_partial || self.resume
    }

    pub(crate) fn with_memory(mut self, memory: u64) -> Self {
        self.work.memory = Some(memory);
        self
    }

    /// With these options, where they were given.
    pub(crate) fn with_style(mut self, style: &Style) -> Self {
        self.style.0 = style.or(&self.style.0);
        self
    }

    pub(crate) fn with_size(mut self, width: u32, height: u32) -> Self {
        self.picture.size = Some((width, height));
        self
    }
}

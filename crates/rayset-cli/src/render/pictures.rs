//! Which pictures a command renders: one, or those of a turntable or of a path, each by its camera.

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use rayset::output::Destination;
use rayset::scene::Camera;

use super::args::RenderArgs;
use super::shot::Shot;
use rayset_inputs::values::Frames;
use rayset_terminal::outputs::Outputs;

/// A picture to write.
pub(super) struct Output {
    pub(super) destination: Destination,
    /// Where what is finished of it is kept, if that is wanted.
    pub(super) unfinished: Option<Destination>,
    /// Its number and the last, if it is one of several.
    frames: Option<(u32, u32)>,
}

impl Output {
    fn add(
        path: &Path,
        frames: Option<(u32, u32)>,
        args: &RenderArgs,
        outputs: &mut Outputs,
    ) -> Result<Self> {
        let destination = outputs.add(path, None)?;
        let unfinished = args.keeps().then(|| outputs.add(&beside(path), None)).transpose()?;
        Ok(Self { destination, unfinished, frames })
    }

    /// The options that go on with it, and with those after it.
    pub(super) fn resuming(&self) -> String {
        self.frames.map_or("--resume".into(), |(own, last)| format!("--resume and --frames {own}..{last}"))
    }
}

/// Every picture to render, and its camera.
pub(super) fn pictures(
    args: &RenderArgs,
    shot: &Shot,
    outputs: &mut Outputs,
) -> Result<Vec<(Output, Camera)>> {
    let mut of_frames = |frames: RangeInclusive<u32>, camera: &dyn Fn(u32) -> Camera| {
        let last = *frames.end();
        let picture = |frame| {
            let path = numbered(&args.output, frame);
            Ok((Output::add(&path, Some((frame, last)), args, outputs)?, camera(frame)))
        };
        frames.map(picture).collect()
    };
    match (args.turntable, args.frames) {
        (Some(turns), frames) => {
            let turn = |frame| f64::from(frame) / f64::from(turns);
            let frames = frames.unwrap_or(Frames::All).among((0, turns - 1), "turntable")?;
            of_frames(frames, &|frame| shot.turntable.turned(&shot.camera, turn(frame)))
        }
        (None, Some(frames)) => {
            let path = shot.path.as_ref().with_context(|| {
                format!("{} has no \"animation\"; --frames has nothing to follow", args.inputs[0].display())
            })?;
            of_frames(frames.of(path)?, &|frame| path.camera(frame))
        }
        (None, None) => Ok(vec![(Output::add(&args.output, None, args, outputs)?, shot.camera)]),
    }
}

/// `turn.png` becomes `turn.0007.png`.
fn numbered(path: &Path, frame: u32) -> PathBuf {
    let extension = path.extension().map_or_else(|| "png".into(), |e| e.to_string_lossy().into_owned());
    path.with_extension(format!("{frame:04}.{extension}"))
}

/// Where what is finished of an output is kept.
pub(super) fn beside(output: &Path) -> PathBuf {
    let mut path = output.as_os_str().to_owned();
    path.push(".unfinished");
    path.into()
}

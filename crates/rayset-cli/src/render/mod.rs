//! `rayset render`: [`run`] is the way from arguments to a picture.

mod advice;
mod args;
mod joined;
mod kept;
mod part;
mod picture;
mod pictures;
mod rendering;
mod report;
mod sanity;
mod shot;
mod sink;
mod warnings;
mod work;

use anyhow::{Result, ensure};
use rayset::memory::{MemoryPlan, SceneNeeds};
use rayset::output::Destination;
use rayset::{PreparedScene, RenderError};

pub(crate) use self::args::{RenderArgs, defaults};
pub(crate) use self::joined::{Joining, write_joined};
use self::kept::Keeping;
use self::pictures::pictures;
use self::rendering::Rendering;
use self::shot::Shot;
pub(crate) use self::sink::Format;
use self::work::Work;
use rayset_terminal::outputs::{self, Outputs};
use rayset_terminal::report::{json_text, remark};

pub(crate) fn run(args: &RenderArgs) -> Result<()> {
    // Reading the scene may take long: what can be refused before that is refused first.
    let has_layers = check_output(args)?;
    let mut shot = Shot::new(args)?;
    shot.settings.layers = has_layers;
    let (region, mount) = shot.mounted(args.picture.region(shot.whole())?)?;
    let mut outputs = Outputs::beside(&shot.files);
    let pictures = pictures(args, &shot, &mut outputs)?;
    let stats = args.stats.as_ref().map(|path| outputs.add(path, None)).transpose()?;
    if let Some(path) = &args.write_scene {
        shot.write_scene(&outputs.add(path, None)?)?;
    }
    let annotations = shot.annotations(args)?;
    let drawing_bytes = annotations.as_ref().map_or(0, |annotations| annotations.bytes(&shot.camera));
    // A part has a copy of what is drawn, and that compressed.
    let part_bytes = args.part.map_or(0, |share| share.index_bytes(&region) + 2 * drawing_bytes);
    let kept = args.keeps().then(|| kept::bytes(args.part, &shot.settings, &region, drawing_bytes));
    let loading_bytes = shot.loading_bytes + drawing_bytes + part_bytes + kept.unwrap_or(0);
    let needs = SceneNeeds::of(&shot.scene, &shot.settings).with_loading(loading_bytes);
    let (work, plan, prepared) = prepared(args, &shot, needs)?;
    prepared.remarks().iter().for_each(remark);
    let rendering = Rendering { shot: &shot, prepared, region, mount, work, plan, keeps: args.keeps() };
    let keeping = args.keeps().then(|| Keeping::new(args.resume));
    for (number, (output, camera)) in pictures.iter().enumerate() {
        let overlay = annotations.as_ref().map(|annotations| annotations.overlay(camera));
        let report = match (&keeping, args.part) {
            (Some(keeping), share) => rendering.kept(camera, overlay, share, keeping, output)?,
            (None, None) => rendering.picture(camera, overlay, &output.destination)?,
            (None, Some(share)) => rendering.part(camera, overlay, share, &output.destination)?,
        };
        if let Some(stats) = &stats {
            outputs::write(stats, json_text(&report)?.as_bytes())?;
        }
        if let (Some(keeping), Some((next, _))) = (&keeping, pictures.get(number + 1)) {
            let go_on = || format!("the same command with {} goes on", next.resuming());
            keeping.stopped(|| {
                format!("{} of {} pictures are finished; {}", number + 1, pictures.len(), go_on())
            })?;
        }
    }
    Ok(())
}

/// The scene ready to be rendered, with what renders it. How much its caps take may be known only
/// once they are counted; then all begins again with the right division of the memory, or its least
/// is said.
fn prepared(
    args: &RenderArgs,
    shot: &Shot,
    mut needs: SceneNeeds,
) -> Result<(Work, MemoryPlan, PreparedScene)> {
    loop {
        let (work, plan) = Work::prepare(&args.work, &needs)?;
        match work.session.prepare(&shot.scene, &shot.settings) {
            Err(RenderError::Memory { needed, .. }) if needed > plan.caps_bytes => {
                needs = needs.with_caps(needed);
            }
            prepared => return Ok((work, plan, prepared?)),
        }
    }
}

/// Refuses what cannot be written. Returns whether the output has layers.
fn check_output(args: &RenderArgs) -> Result<bool> {
    let destination = Destination::new(&args.output)?;
    if args.keeps() {
        kept::check_output(&destination)?;
    }
    ensure!(
        args.annotate.caption.is_none() || args.annotate.is_wanted(),
        "--caption is drawn by --annotate or --annotate-over; add one of them"
    );
    if args.part.is_some() {
        part::check_name(&destination)?;
        return Ok(args.layers);
    }
    let format = Format::of(&destination)?;
    ensure!(
        !args.annotate.is_wanted() || format == Format::Png,
        "--annotate draws on pictures for display; an OpenEXR file holds the light as computed: write a .png"
    );
    Ok(format == Format::Exr)
}

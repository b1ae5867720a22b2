//! Caps: what the first object of a difference encloses, as a solid that is cut together with it.
//!
//! A scan is a shell: cut open, it shows its hollow inside. Where a difference has a cap, its first
//! object is replaced by the union of itself and of everything that it encloses. *Enclosed* is a
//! place from which of six rays along the axes at least four cross the object's surface an odd
//! number of times. The surface is where the object is at least half opaque, and a ray crosses it
//! where it comes in on one side and leaves on the other, as the shading vectors say: a ray that
//! only grazes it does not. The rays are those through the centres of the cells of a lattice. Votes
//! are smoothed over neighbouring cells, pieces that are too small to be anything are left out, and
//! between cells votes are interpolated. All of it is a function of the scene and of the lattice's
//! resolution alone.
//!
//! How much memory is kept of a cap is not known before it is counted: of a solid, nothing. So
//! memory is set aside for counting one, and what is kept is taken from what else the scene may
//! have ([`CapMemory`]).
//!
//! Where along two axes more than a quarter of the rays that cross the surface do so an odd number
//! of times, it is open, and has no cap.

mod count;
mod field;
pub(super) mod graph;
mod inside;
mod lattice;
mod passes;
mod pieces;

use std::sync::Arc;

use self::count::AxisCount;
use self::field::{INSIDE_VOTES, Interior};
use self::inside::Inside;
use self::lattice::{Lattice, Votes};
use super::RenderError;
use super::engine::{CapMemory, Engine};
use super::program::{Program, Purpose};
use super::steps::StepRule;
use crate::scene::{Node, Procedural, RenderSettings, Scene};
use rayset_files::PagedFiles;

/// Of the rays along an axis that cross a closed surface, at most this share do so an odd number of
/// times: rays that pass through a pore.
const MOST_ODD: f64 = 0.25;

/// The scene with its caps, and a sentence on each that was left out.
///
/// # Errors
/// [`RenderError`] if a page cannot be obtained, a step is out of range, or the caps do not fit in
/// `memory`.
pub(super) fn with_caps(
    scene: &Scene,
    settings: &RenderSettings,
    files: &PagedFiles,
    memory: &CapMemory<'_>,
) -> Result<(Scene, Vec<String>), RenderError> {
    let (mut remarks, mut known) = (Vec::new(), Vec::new());
    let resolution = settings.cap_resolution;
    let Some((_, all)) = graph::sized(scene, settings) else { return Ok((scene.clone(), remarks)) };
    // Bytes of what is kept so far, and the most that were needed at a time. Where they are too
    // many, the rest is counted but not kept, to say how many there must be.
    let (mut kept, mut most, mut lacks) = (0, 0, false);
    let mut needs = |bytes: u64| {
        most = bytes.max(most);
        lacks = lacks || memory.take(bytes).is_err();
        !lacks
    };
    let root = graph::fill(&scene.root, &mut |node, color| {
        let counted = match known.iter().find(|(other, _)| Arc::ptr_eq(node, other)) {
            Some((_, inside)) => Option::clone(inside),
            None => {
                needs(all.caps + graph::bytes_for(node, resolution).0 + kept);
                let (inside, remark) = match votes_of(node, scene, settings, memory.engine, files)? {
                    Ok(votes) => {
                        kept += Inside::bytes_of(&votes);
                        let fits = needs(all.caps + votes.lattice.cells() as u64 + kept);
                        (fits.then(|| Arc::new(Inside::of(&votes))), None)
                    }
                    Err(why) => (None, Some(format!("a cap is left out: {why}"))),
                };
                remarks.extend(remark);
                known.push((node.clone(), inside.clone()));
                inside
            }
        };
        Ok(counted.map(|inside| Arc::new(Interior::new(inside, color)) as Arc<dyn Procedural>))
    })?;
    if lacks {
        memory.take(most)?;
    }
    Ok((Scene { root, ..scene.clone() }, remarks))
}

/// The votes for the inside of a node, in the space of its parent, or why it encloses nothing.
fn votes_of(
    node: &Arc<Node>,
    scene: &Scene,
    settings: &RenderSettings,
    engine: &Engine,
    files: &PagedFiles,
) -> Result<Result<Arc<Votes>, String>, RenderError> {
    let Some(lattice) = Lattice::over(&node.bounds(), settings.cap_resolution) else {
        return Ok(Err("what is cut is empty or has no end".into()));
    };
    let alone = Scene { root: node.clone(), ..scene.clone() };
    let program = Program::compile(&alone, Purpose::Surface, engine.exec.simd).open(files)?;
    let steps = StepRule::new(&program, settings, None)?;
    let (votes, axes) = count::count(engine, program, steps, lattice)?;
    if let Some(why) = why_open(axes) {
        return Ok(Err(why));
    }
    votes.smooth();
    pieces::drop_small(&votes, INSIDE_VOTES);
    if !votes.any(INSIDE_VOTES) {
        return Ok(Err("what is cut encloses nothing as large as the cells of \"capResolution\"".into()));
    }
    Ok(Ok(votes))
}

/// Why a surface encloses nothing; `None` if it does.
fn why_open(axes: [AxisCount; 3]) -> Option<String> {
    if axes.iter().all(|axis| axis.crossing == 0) {
        return Some("what is cut has no surface that is half opaque; give it a higher opacity".into());
    }
    let odd = axes.map(|axis| axis.odd as f64 / axis.crossing.max(1) as f64);
    let closed = odd.iter().zip(axes).filter(|(odd, axis)| axis.crossing > 0 && **odd <= MOST_ODD).count();
    if closed < 2 {
        let [x, y, z] = odd.map(|share| 100.0 * share);
        return Some(format!(
            "the surface is open: of the rays along x, y and z that meet it, {x:.0}, {y:.0} and {z:.0} % cross it an odd \
             number of times (of a closed surface, at most {:.0} % along two of them)",
            100.0 * MOST_ODD
        ));
    }
    None
}

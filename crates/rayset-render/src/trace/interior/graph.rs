//! A scene graph with its caps, and how large it is before they are made.

use std::collections::HashMap;
use std::sync::Arc;

use super::field::Interior;
use super::inside::Inside;
use super::lattice::Lattice;
use super::pieces;
use crate::scene::{Node, NoiseCloud, Operator, Pattern, Procedural, RenderSettings, Scene, Shape};
use crate::trace::RenderError;
use rayset_base::geometry::DVec3;

/// Makes what a node encloses, in a colour, in the space of the node's parent; `None` if it is
/// open.
pub(super) type MakeInside<'a> =
    dyn FnMut(&Arc<Node>, [f64; 3]) -> Result<Option<Arc<dyn Procedural>>, RenderError> + 'a;

/// Bytes for the caps of a scene.
#[derive(Clone, Copy, Debug)]
pub(in crate::trace) struct CapBytes {
    /// What all take besides what they enclose.
    pub(in crate::trace) caps: u64,
    /// With this, what they enclose can be counted, one after another.
    pub(in crate::trace) least: u64,
    /// An upper bound. How much is kept of what they enclose is known once it is counted.
    pub(in crate::trace) most: u64,
}

/// Bytes for what a node encloses: while it is counted, and at most of what is kept of it.
pub(super) fn bytes_for(node: &Node, resolution: u32) -> (u64, u64) {
    Lattice::over(&node.bounds(), resolution).map_or((0, 0), |lattice| {
        let cells = lattice.cells() as u64;
        (cells + pieces::bytes(cells), Inside::most_bytes(&lattice))
    })
}

/// Bytes of a cap besides what the node encloses.
pub(super) fn bytes_of_cap(node: &Node, resolution: u32) -> u64 {
    Lattice::over(&node.bounds(), resolution).map_or(0, |lattice| Interior::bytes(&lattice))
}

/// A scene whose graph has the size that caps give it, and what these take; `None` if it has no
/// caps.
pub(in crate::trace) fn sized(scene: &Scene, settings: &RenderSettings) -> Option<(Scene, CapBytes)> {
    let (mut caps, mut counting, mut kept, mut counted) = (0, 0, 0, Vec::new());
    let root = fill(&scene.root, &mut |node, _| {
        caps += bytes_of_cap(node, settings.cap_resolution);
        // Votes are of what is cut, whatever is taken away from it.
        if !counted.iter().any(|other| Arc::ptr_eq(node, other)) {
            counted.push(node.clone());
            let (to_count, most) = bytes_for(node, settings.cap_resolution);
            counting = counting.max(to_count);
            kept += most;
        }
        let stand_in = NoiseCloud {
            radii: DVec3::ONE,
            scale: 1.0,
            octaves: 1,
            roughness: 0.0,
            opacity: 1.0,
            cover: 1.0,
            seed: 0,
            pattern: Pattern::Uniform([0.0; 3]),
        };
        Ok(Some(Arc::new(stand_in)))
    });
    let root = root.ok().filter(|root| !Arc::ptr_eq(root, &scene.root))?;
    let bytes = CapBytes { caps, least: caps + counting, most: caps + counting + kept };
    Some((Scene { root, ..scene.clone() }, bytes))
}

/// A node with the caps of everything below it; the node itself if there are none.
pub(super) fn fill(node: &Arc<Node>, make: &mut MakeInside<'_>) -> Result<Arc<Node>, RenderError> {
    fill_known(node, &mut HashMap::new(), make)
}

/// `known` is what operators became.
fn fill_known(
    node: &Arc<Node>,
    known: &mut HashMap<*const Node, Arc<Node>>,
    make: &mut MakeInside<'_>,
) -> Result<Arc<Node>, RenderError> {
    let Shape::Operator(operator, children) = &node.shape else { return Ok(node.clone()) };
    if let Some(known) = known.get(&Arc::as_ptr(node)) {
        return Ok(known.clone());
    }
    let mut filled: Vec<Arc<Node>> =
        children.iter().map(|child| fill_known(child, known, make)).collect::<Result<_, _>>()?;
    if let (Some(color), Operator::Difference) = (node.cap, operator)
        && let Some(interior) = make(&filled[0], color)?
    {
        let inside = Arc::new(Node::new(Shape::Procedural(interior)));
        let both = vec![filled[0].clone(), inside];
        filled[0] = Arc::new(Node::new(Shape::Operator(Operator::Union, both)));
    }
    let same = children.iter().zip(&filled).all(|(before, after)| Arc::ptr_eq(before, after));
    let with_caps = if same {
        node.clone()
    } else {
        Arc::new(Node { shape: Shape::Operator(*operator, filled), cap: None, ..(**node).clone() })
    };
    known.insert(Arc::as_ptr(node), with_caps.clone());
    Ok(with_caps)
}

//! Octrees that grow beyond memory: those of Table 1, random points on a sphere.

use std::path::Path;

use anyhow::Result;
use rayset::points::Workload;

use super::{Setting, Subject};
use crate::index::{Index, Limits};

/// The radius, as in Table 1.
pub(super) const RADIUS: f64 = 0.1;

/// Octrees of this height make a line, by their points.
pub(super) const PLOTTED_HEIGHT: u32 = 6;

/// An octree of Table 1, or beyond.
#[derive(Clone, Copy, Debug)]
pub(super) struct Size {
    pub(super) points: u64,
    pub(super) height: u32,
}

/// Octrees of 1 to 64 times the memory of the experiments, 32 MiB (at quick size 1 MiB): by the
/// number of points, and then by the height.
pub(super) fn sizes(setting: &Setting) -> Vec<Size> {
    let size = |(points, height)| Size { points, height };
    let quick = [(2_000, 4), (2_000, 5), (2_000, 6)];
    let full = [
        (20_000, 6),
        (55_000, 6),
        (140_000, 6),
        (300_000, 6),
        (600_000, 6),
        (1_200_000, 6),
        (2_300_000, 6),
        (30_000, 7),
        (100_000, 7),
    ];
    setting.pick(&quick[..], &full[..]).iter().copied().map(size).collect()
}

/// A sphere, and its octree.
pub(super) struct Grown {
    pub(super) subject: Subject,
    pub(super) index: Index,
}

/// Builds both in a folder; the cloud is `c.rset` there.
pub(super) fn build(size: Size, side: u32, folder: &Path) -> Result<Grown> {
    std::fs::create_dir_all(folder)?;
    let workload: Workload = format!("sphere-{}", size.points).parse()?;
    let subject = Subject::build(workload.source(), Some(RADIUS), side, &folder.join("c.rset"))?;
    // Only the height limits how far nodes are divided.
    let index = subject.index(folder, Limits { height: size.height, leaf_points: 1 })?;
    Ok(Grown { subject, index })
}

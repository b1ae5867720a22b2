//! What rays will need of files that are remote, all along their way: it is asked for together.
//! Rays from the eye are looked ahead at square by square (`lookahead`); those that follow from
//! them (mirrored and bent rays, rays to lights, rays of lights that make tables of shadows) are
//! known only when these have been traced. So if an attempt at a tile has met a page that was not
//! there, the next one asks for all that its other rays will need before it is put off again: one
//! round trip for all of them, not one for each.

use std::collections::BTreeSet;
use std::sync::Arc;

use super::policy::{self, Policy};
use super::probe::{Expected, Gap, Needed, ProbeRays};
use crate::field::Sight;
use crate::scene::Operator;
use crate::trace::access::{Access, Lacking};
use crate::trace::cloud::{CloudVolume, FarAhead, NodesInMemory};
use crate::trace::grid::{GridVolume, PagesAhead};
use crate::trace::program::{Action, Program};
use rayset_base::geometry::Ray;
use rayset_files::octree::node::Node;
use rayset_store::working_set::{Object, PageClient};

/// What rays are expected to need of the files of a graph.
pub(in crate::trace) struct Foresight {
    /// Each file once.
    files: Vec<Arc<Object>>,
    /// Every cloud with points.
    clouds: Vec<CloudAhead>,
    /// Every grid whose pages are asked for together.
    grids: Vec<GridAhead>,
    /// How pages of these files are brought in.
    pub(in crate::trace) policy: &'static dyn Policy,
}

/// A cloud of the graph.
struct CloudAhead {
    /// Index of its instruction.
    at: usize,
    /// Index of its file.
    file: u32,
    expected: Expected,
}

/// A grid of the graph.
struct GridAhead {
    at: usize,
    file: u32,
    /// Optical depth with which rays are expected to have ended.
    opaque: f32,
}

impl Foresight {
    /// That of a graph in which rays end at a transmittance.
    pub(in crate::trace) fn new(program: &Program, stop_transmittance: f64) -> Self {
        let stop = stop_transmittance as f32;
        let policy = policy::of_files(program.files());
        let expects = policy.expects();
        let mut files: Vec<Arc<Object>> = Vec::new();
        let mut number = |pages: &Arc<Object>| {
            let known = files.iter().position(|file| Arc::ptr_eq(file, pages));
            known.unwrap_or_else(|| {
                files.push(pages.clone());
                files.len() - 1
            }) as u32
        };
        let mut ends = vec![false; program.instructions.len()];
        mark_where_rays_end(program, program.root(), &mut ends);
        let (mut clouds, mut grids) = (Vec::new(), Vec::new());
        for (at, instruction) in program.instructions.iter().enumerate() {
            match &instruction.action {
                // What is seen from afar needs few pages: they are looked for where each is a round
                // trip away.
                Action::Cloud(volume)
                    if volume.lod.is_some() && !policy.asks_together(&volume.placement.pages) => {}
                Action::Cloud(volume) if volume.placement.header().points > 0 => {
                    let stop = if expects.careful && !ends[at] { 0.0 } else { stop };
                    let expected = Expected::new(&volume.shading, stop, expects);
                    clouds.push(CloudAhead { at, file: number(&volume.placement.pages), expected });
                }
                Action::Grid(volume) if policy.asks_together(volume.pages()) => {
                    let opaque = if ends[at] { -stop.ln() } else { f32::INFINITY };
                    grids.push(GridAhead { at, file: number(volume.pages()), opaque });
                }
                _ => {}
            }
        }
        Self { files, clouds, grids, policy }
    }

    /// Its clouds: each with the index of its file, and its expected effect on light.
    pub(super) fn clouds<'a>(
        &'a self,
        program: &'a Program,
    ) -> impl Iterator<Item = (&'a CloudVolume, u32, &'a Expected)> {
        self.clouds.iter().filter_map(|CloudAhead { at, file, expected }| {
            program.cloud(*at).map(|volume| (volume, *file, expected))
        })
    }

    /// Its grids: each with the index of its file, and the optical depth with which rays are
    /// expected to have ended.
    pub(super) fn grids<'a>(
        &'a self,
        program: &'a Program,
    ) -> impl Iterator<Item = (&'a GridVolume, u32, f32)> {
        self.grids.iter().filter_map(|GridAhead { at, file, opaque }| {
            program.grid(*at).map(|volume| (volume, *file, *opaque))
        })
    }

    /// Whether there is nothing to look ahead at.
    pub(in crate::trace) fn is_empty(&self) -> bool {
        self.clouds.is_empty() && self.grids.is_empty()
    }

    /// The index of a file by its index in another program of the same scene.
    pub(super) fn number_of(&self, other: &Self, number: u32) -> Option<u32> {
        let pages = other.file(number)?;
        self.files.iter().position(|file| Arc::ptr_eq(file, pages)).map(|at| at as u32)
    }

    /// The pages of a file.
    pub(super) fn file(&self, number: u32) -> Option<&Arc<Object>> {
        self.files.get(number as usize)
    }

    /// Bytes of the largest page.
    pub(super) fn page_bytes(&self) -> u64 {
        self.files.iter().map(|pages| pages.bytes()).max().unwrap_or(1)
    }

    /// Asks for all pages that rays are expected to need and that are not in memory, at most 64
    /// rays at a time, if the attempt is one that does so. If any is absent, the attempt lacks it
    /// from now on.
    pub(in crate::trace) fn ask<'r>(
        &self,
        program: &Program,
        access: Access<'_>,
        packets: impl IntoIterator<Item = &'r [Ray]>,
    ) {
        /// One part in this many of the budget: of more, the first would have gone before the last
        /// are there.
        const MOST_OF_BUDGET: u64 = 8;
        let Some(reach) = access.foresees.filter(|_| self.policy.asks_along_rays()) else { return };
        let most = (access.pages.share_bytes() / MOST_OF_BUDGET / self.page_bytes()).max(1) as usize;
        let mut asked: Vec<BTreeSet<u32>> = vec![BTreeSet::new(); self.files.len()];
        for rays in packets {
            if !rays.is_empty() {
                self.each_page(program, (access.pages, access.sight.as_ref()), rays, reach, |file, page| {
                    if !self.files[file as usize].is_settled(page) {
                        asked[file as usize].insert(page);
                    }
                });
            }
            if asked.iter().map(BTreeSet::len).sum::<usize>() >= most {
                break;
            }
        }
        for (pages, asked) in self.files.iter().zip(asked) {
            let asked: Vec<u32> = asked.into_iter().take(most).collect();
            access.foreseen.asks(pages, asked.iter().copied().filter(|&page| pages.is_absent(page)));
            let hinted = access.pages.hint_knowing(pages, &asked, u64::MAX, Some(access.reuse));
            if let Some(&page) = asked[..hinted].iter().rev().find(|&&page| pages.is_under_way(page)) {
                access.lack(Lacking { object: pages.clone(), page });
            }
        }
    }

    /// Calls `want` with the pages of remote files that some rays, at most 64, are expected to
    /// need, and the indices of the files; `reach` is a factor on the optical depth with which they
    /// are expected to have ended, and with a sight they see what is far as it is seen from there.
    /// Returns whether that is all: not if pages are absent that say what lies behind them.
    pub(super) fn each_page(
        &self,
        program: &Program,
        (pages, sight): (&PageClient, Option<&Sight>),
        rays: &[Ray],
        reach: f32,
        mut want: impl FnMut(u32, u32),
    ) -> bool {
        let mut complete = true;
        let clouds = self.clouds(program);
        for (volume, file, expected) in
            clouds.filter(|(volume, ..)| self.policy.asks_together(&volume.placement.pages))
        {
            let cloud = &volume.placement;
            let mut want_of = |node: &Node, needed: Needed| match needed {
                Needed::Points => cloud.own_pages_at_most(node).for_each(|page| want(file, page)),
                Needed::Records(page) => want(file, page),
            };
            let (mut nodes, mut far) =
                (NodesInMemory::new(pages, cloud), FarAhead::new(pages, volume, sight));
            let local: Vec<Ray> = rays.iter().map(|ray| cloud.local_ray(ray)).collect();
            let mut probes = ProbeRays::new(program.simd, &local, Gap::NONE).reaching(reach);
            probes.explore(&mut nodes, far.as_mut(), expected, &mut want_of);
            let absent = nodes.absent.into_iter().chain(far.into_iter().flat_map(|far| far.absent));
            for page in absent {
                complete = false;
                want(file, page);
            }
        }
        for (grid, file, opaque) in self.grids(program) {
            let PagesAhead { bricks, absent_ranges, .. } =
                grid.pages_ahead(pages, rays, |_| 0.0, opaque * reach);
            complete &= absent_ranges.is_empty();
            bricks.into_iter().chain(absent_ranges).for_each(|page| want(file, page));
        }
        complete
    }
}

/// Marks the instructions that make rays end where they alone would: what a union or a blend has of
/// a child, it has at least.
fn mark_where_rays_end(program: &Program, at: usize, ends: &mut [bool]) {
    let instruction = &program.instructions[at];
    // What stands in several places has been gone through before.
    if ends[at] || !instruction.transfers.is_empty() {
        return;
    }
    ends[at] = true;
    if let Action::Operator(Operator::Union | Operator::Blend, children) = &instruction.action {
        children.iter().for_each(|&child| mark_where_rays_end(program, child, ends));
    }
}

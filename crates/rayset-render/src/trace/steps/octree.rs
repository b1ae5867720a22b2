//! The details of a cloud: the nodes of its octree, groups of points, and points.
//!
//! The detail of a point is its radius, of flat ellipsoids less (`StoredShape::detail`). A node
//! whose points all ask for about the same steps, or that is hardly wider than a cell of the finest
//! of them, is a detail of the least of theirs, within its bounds. Of others, groups of
//! [`GROUP_POINTS`](super::groups::GROUP_POINTS) points are, which follow each other in a run, each
//! of its least detail, within the box around the spheres of its points' radii. If a group's points
//! are scattered, most rays that meet its box meet no point: then a ray has a detail where it
//! passes through one.

use super::chords::{Chord, Part, Place};
use super::groups::{Group, GroupPoint, RunGroups};
use super::local_rays::{Clipped, LocalRays};
use super::{ASKED_THEMSELVES, CloudPlacement, CloudVolume, Packet, PixelDetail, SCATTERED, StepRule};
use crate::field::LANES;
use crate::trace::access::{Access, Halt};
use crate::trace::cloud::{RetainedNodes, each_own_page, run_bounds};
use crate::trace::node_samples::each_lane;
use rayset_base::geometry::Aabb;
use rayset_base::nearest_first::NearestFirst;
use rayset_files::octree::node::Node;
use rayset_files::octree::walk::{Visit, Visitor, Walk};

/// A node no wider than so many cells of the steps that its finest points ask for is not divided.
const LONGEST_WHOLE: f64 = 2.0;

/// What the nodes ahead of a packet take, as measured.
const AHEAD_BYTES: usize = 16 << 10;

/// The rays of a packet in a cloud, and the nodes whose details they have not come to yet.
pub(super) struct CloudDetails {
    rays: LocalRays,
    /// For each ray, where it is within the bounds of the object.
    within: Vec<Option<(f64, f64)>>,
    ahead: Ahead,
    walk: Walk,
}

/// Nodes that were met.
#[derive(Default)]
struct Ahead {
    /// By the first tick that they may reach.
    nodes: NearestFirst<u64, MetNode>,
    /// Those that do not matter in the part that is looked at, but may in another.
    aside: Vec<(u64, MetNode)>,
}

#[derive(Clone, Copy)]
struct MetNode {
    node: Node,
    /// Its box, as far as it is in those of the nodes above it: rounded, it may be larger. So a ray
    /// that comes to it comes to them, and who else is in the packet does not matter.
    bounds: Aabb,
    /// The last tick that it may reach.
    last: u64,
}

impl CloudDetails {
    /// Bytes, with lists as long as they mostly become.
    pub(super) const BYTES: usize =
        size_of::<Self>() + LocalRays::BYTES + LANES * size_of::<Option<(f64, f64)>>() + AHEAD_BYTES;

    /// Starts at the root.
    /// `bounds` are those of the object, world space.
    pub(super) fn begin(place: Place<'_>, volume: &CloudVolume, bounds: &Aabb) -> Result<Self, Halt> {
        let cloud = &volume.placement;
        let rays = LocalRays::new(place.rays, cloud, place.program.simd);
        let sight = place.access.sight.as_ref();
        let bounds = bounds.inflated(cloud.reach_world(sight, volume.lod.as_deref()));
        let within = place.rays.iter().map(|ray| bounds.clip(ray)).collect();
        let mut details = Self { rays, within, ahead: Ahead::default(), walk: Walk::new() };
        let Self { rays, ahead, walk, .. } = &mut details;
        let pixels = PixelDetail::of(volume, sight);
        let mut meeting = Meeting { packet: place.packet, rule: place.rule, cloud, rays, ahead, pixels };
        let mut nodes = RetainedNodes { access: place.access, cloud };
        walk.begin(
            &mut nodes,
            &mut Looking { meeting: &mut meeting, access: place.access, within: None, search: None },
        )?;
        Ok(details)
    }

    /// Adds the chords of details in a part of the rays, until all rays of `open`, some of those
    /// that have not ended, have finer steps there, or there are no more details.
    pub(super) fn look(
        &mut self,
        place: Place<'_>,
        volume: &CloudVolume,
        part: Part,
        (going, open): (u64, u64),
        chords: &mut Vec<Chord>,
    ) -> Result<(), Halt> {
        let Self { rays, within, ahead, walk } = self;
        let (cloud, pixels) = (&volume.placement, PixelDetail::of(volume, place.access.sight.as_ref()));
        let mut meeting = Meeting { packet: place.packet, rule: place.rule, cloud, rays, ahead, pixels };
        let mut nodes = RetainedNodes { access: place.access, cloud };
        let search =
            Some(Search { part, going, open, within, chords, latest: [usize::MAX; LANES], visited: None });
        let outcome = walk.go_on(
            &mut nodes,
            &mut Looking { meeting: &mut meeting, access: place.access, within: None, search },
        );
        let Ahead { nodes, aside } = &mut self.ahead;
        aside.drain(..).for_each(|(first, node)| nodes.push(first, node));
        outcome
    }
}

/// Nodes as rays come to them.
struct Meeting<'t> {
    packet: &'t Packet,
    rule: &'t StepRule,
    cloud: &'t CloudPlacement,
    rays: &'t LocalRays,
    ahead: &'t mut Ahead,
    /// If the cloud is seen from afar.
    pixels: Option<PixelDetail<'t>>,
}

/// What is looked for.
struct Search<'t> {
    part: Part,
    /// Lanes whose rays have not ended, and those of them whose rays are not known to have finer
    /// steps in the part.
    going: u64,
    open: u64,
    within: &'t [Option<(f64, f64)>],
    chords: &'t mut Vec<Chord>,
    /// For each lane, which of them was added last in this search.
    latest: [usize; LANES],
    /// The node that is visited.
    visited: Option<(u64, MetNode)>,
}

/// The walk to the details in a part of the rays.
struct Looking<'t, 'm, 'a> {
    meeting: &'t mut Meeting<'m>,
    access: Access<'a>,
    /// The box of the node that is opened.
    within: Option<Aabb>,
    search: Option<Search<'t>>,
}

impl<'a> Visitor<RetainedNodes<'a>> for Looking<'_, '_, 'a> {
    fn meet(&mut self, node: Node) {
        let Meeting { packet, cloud, rays, ahead, pixels, .. } = &mut *self.meeting;
        let bounds = node.bounds(cloud.root_cell);
        let bounds = pixels.map_or(bounds, |pixels| pixels.as_seen(bounds));
        let bounds = self.within.map_or(bounds, |within| bounds.intersection(within));
        if bounds.is_empty() {
            return;
        }
        if let Some((first, last)) = packet.ticks_in(&rays.beam, &bounds) {
            ahead.nodes.push(first, MetNode { node, bounds, last });
        }
    }

    fn next(&mut self) -> Option<Node> {
        let search = self.search.as_mut()?;
        while search.open != 0 {
            let (first, met) = self.meeting.ahead.nodes.pop_before(search.part.cell.end_tick())?;
            let finest = self.meeting.finest_in(&met.node);
            if finest >= 0 || met.last < search.part.cell.first_tick() {
                continue;
            }
            if finest >= search.part.k {
                self.meeting.ahead.aside.push((first, met));
                continue;
            }
            search.visited = Some((first, met));
            return Some(met.node);
        }
        None
    }

    fn visit(&mut self, node: &Node, walk: &mut Walk, _: &mut RetainedNodes<'a>) -> Result<Visit, Halt> {
        let Some(search) = &mut self.search else { return Ok(Visit::Stop) };
        let rays = self.meeting.rays;
        let Some(visited) = search.visited.take() else { return Ok(Visit::Stop) };
        let bounds = visited.1.bounds;
        let near = rays.clip(&bounds, search.going);
        if near.lanes & search.open == 0 {
            self.meeting.ahead.aside.push(visited);
            return Ok(Visit::Skip);
        }
        if self.meeting.is_one_from_afar(node, &bounds) {
            let detail = self.meeting.least_detail(node, f64::from(node.detail_min));
            self.meeting.add_box(&near, detail, search);
            return Ok(Visit::Skip);
        }
        self.within = Some(bounds);
        self.meeting.add_own(self.access, (node, &bounds), &near, walk, search)?;
        Ok(Visit::Open)
    }
}

impl Search<'_> {
    /// Adds the part of a chord that is within the bounds of the object.
    fn add(&mut self, mut chord: Chord) {
        let Some((enter, exit)) = self.within[usize::from(chord.lane)] else { return };
        (chord.enter, chord.exit) = (chord.enter.max(enter), chord.exit.min(exit));
        if chord.enter > chord.exit {
            return;
        }
        if self.part.is_refined_by(&chord) {
            self.open &= !(1 << chord.lane);
        }
        // Those that follow each other mostly overlap. One within another that asks for no coarser
        // steps says nothing; of two that ask for the same, both together are one.
        if let Some(last) = self.chords.get_mut(self.latest[usize::from(chord.lane)]) {
            if last.k <= chord.k && last.enter <= chord.enter && chord.exit <= last.exit {
                return;
            }
            let covers = chord.k <= last.k && chord.enter <= last.enter && last.exit <= chord.exit;
            let overlaps = last.k == chord.k && last.enter <= chord.exit && chord.enter <= last.exit;
            if covers || overlaps {
                (last.enter, last.exit) = (last.enter.min(chord.enter), last.exit.max(chord.exit));
                last.k = chord.k;
                return;
            }
        }
        self.latest[usize::from(chord.lane)] = self.chords.len();
        self.chords.push(chord);
    }
}

impl Meeting<'_> {
    /// The least k that a node and what is below it ask for on any ray.
    fn finest_in(&self, node: &Node) -> i32 {
        self.rule.scale.of(self.least_detail(node, f64::from(node.detail_min)) / self.rays.stretches.1)
    }

    /// A detail of a node, or that of a pixel if it is seen from afar.
    fn least_detail(&self, node: &Node, detail: f64) -> f64 {
        let Some(pixels) = &self.pixels else { return detail };
        pixels.least_in(&node.bounds(self.cloud.root_cell), node.radius_max.into(), detail)
    }

    /// The largest detail of a node's points.
    fn largest_detail(&self, node: &Node) -> f64 {
        let detail = f64::from(node.detail_max);
        let Some(pixels) = &self.pixels else { return detail };
        pixels.largest_in(&node.bounds(self.cloud.root_cell)).max(detail)
    }

    /// Whether a node and all that is below it ask for about the same steps in a box that is hardly
    /// wider than a cell of these, from afar.
    fn is_one_from_afar(&self, node: &Node, bounds: &Aabb) -> bool {
        let (scale, stretch) = (&self.rule.scale, self.cloud.least_stretch());
        let k = scale.of(self.least_detail(node, f64::from(node.detail_min)) / stretch);
        self.pixels.is_some()
            && k + 1 >= scale.of(self.largest_detail(node) / stretch)
            && bounds.size().max_element() <= LONGEST_WHOLE * self.rule.cell_world(k) * stretch
    }

    /// Adds the chords of a node's own points.
    fn add_own(
        &self,
        access: Access<'_>,
        (node, bounds): (&Node, &Aabb),
        near: &Clipped,
        walk: &mut Walk,
        search: &mut Search<'_>,
    ) -> Result<(), Halt> {
        let Self { rule: StepRule { scale, .. }, cloud, rays, .. } = self;
        if node.own.runs == 0 {
            return Ok(());
        }
        let mut own = f64::from(node.detail_min);
        if node.child_mask != 0 && cloud.header().shape.is_none() {
            // Own points of an inner node are wider than the cells of its children.
            let cell = cloud.root_cell.size * 2_f64.powi(-i32::from(node.level) - 1);
            own = f64::from(cell as f32).max(own);
        }
        own = self.least_detail(node, own);
        if scale.of(own / rays.stretches.1) >= 0 {
            return Ok(());
        }
        // Of all rays together: what is divided must not depend on who else is in the packet.
        let stretch = cloud.least_stretch();
        let k = scale.of(own / stretch);
        let is_one = k + 1 >= scale.of(self.largest_detail(node) / stretch);
        let is_short = bounds.size().max_element() <= LONGEST_WHOLE * self.rule.cell_world(k) * stretch;
        if (is_one || is_short) && !self.is_scattered(bounds, own) {
            self.add_box(near, own, search);
            return Ok(());
        }
        if !walk.may_look_at_runs_of(node, cloud.header()) {
            return Err(cloud.broken(node.own.first_page).into());
        }
        let mut groups = RunGroups::new(cloud, rays.simd);
        each_own_page(access, cloud, node, |_, points, runs| {
            for index in runs {
                let of_run = run_bounds(cloud, points, index);
                let of_run = self.pixels.map_or(of_run, |pixels| pixels.as_seen(of_run));
                let near = rays.clip(&of_run, near.lanes).lanes;
                if near != 0 {
                    groups.decode(&points.run(index));
                    groups.each(|group| self.add_group(&group, bounds, near, search));
                }
            }
        })
    }

    /// Whether most rays that meet a box of points are expected to meet none of them, and steps for
    /// them are far finer than others.
    fn is_scattered(&self, bounds: &Aabb, detail: f64) -> bool {
        let k = self.rule.scale.of(detail / self.cloud.least_stretch());
        bounds.size().max_element() > SCATTERED * detail && k <= ASKED_THEMSELVES
    }

    /// Adds the chords of rays through a box, as a detail of a length.
    fn add_box(&self, clipped: &Clipped, length: f64, search: &mut Search<'_>) {
        let (least, most) = self.rays.stretches;
        let of_all = (least == most).then(|| self.rule.scale.of(length / most));
        if of_all == Some(0) {
            return;
        }
        each_lane(clipped.lanes, |lane| {
            let k = of_all.unwrap_or_else(|| self.rule.scale.of(length / self.rays.stretch[lane]));
            if k < 0 {
                let (enter, exit) = (clipped.enter[lane], clipped.exit[lane]);
                search.add(Chord { lane: lane as u8, k: k as i8, enter, exit });
            }
        });
    }

    /// Adds the chords of a group of points.
    fn add_group(&self, group: &Group<'_>, of_node: &Aabb, near: u64, search: &mut Search<'_>) {
        let bounds = self.pixels.map_or(group.bounds, |pixels| pixels.as_seen(group.bounds));
        let bounds = bounds.intersection(*of_node);
        if bounds.is_empty() || self.rays.beam.span(&bounds).is_none() {
            return;
        }
        let near = self.rays.clip(&bounds, near);
        let least_detail = match &self.pixels {
            Some(pixels) => pixels.least_in(&bounds, group.largest_radius(), group.least_detail),
            None => group.least_detail,
        };
        if self.is_scattered(&bounds, least_detail) {
            group.points().for_each(|point| self.add_point(point, &near, search));
        } else {
            self.add_box(&near, least_detail, search);
        }
    }

    /// Adds the chords of rays through the sphere of a point's radius, in the cloud's space, as far
    /// as they are in the box of its group.
    fn add_point(&self, point: GroupPoint, group: &Clipped, search: &mut Search<'_>) {
        let GroupPoint { position, mut radius, mut detail } = point;
        if let Some(pixels) = &self.pixels {
            // A Gaussian as wide as a pixel is there, too.
            let place = Aabb::new(position, position);
            detail = pixels.least_in(&place, radius, detail);
            radius += 2.0 * pixels.sight.pixel_at(position);
        }
        each_lane(group.lanes, |lane| {
            // The unit direction in local space, for the squared distance to the ray's line.
            let (ray, stretch) = (&self.rays.rays[lane], self.rays.stretch[lane]);
            let (to, direction) = (position - ray.origin, ray.direction / stretch);
            let along = to.dot(direction);
            let inside = radius * radius - (to - direction * along).length_squared();
            let k = self.rule.scale.of(detail / stretch);
            if inside > 0.0 && along > -radius && k < 0 {
                let half = inside.sqrt();
                let enter = ((along - half) / stretch).max(group.enter[lane]);
                let exit = ((along + half) / stretch).min(group.exit[lane]);
                if enter <= exit {
                    search.add(Chord { lane: lane as u8, k: k as i8, enter, exit });
                }
            }
        });
    }
}

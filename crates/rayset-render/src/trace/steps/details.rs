//! The details that the rays of a packet come to, cell by cell.

use super::chords::{Chord, Part, Place};
use super::octree::CloudDetails;
use super::{
    ASKED_THEMSELVES, CloudVolume, GRID_DETAIL, Packet, Ray, SCATTERED, Scale, Slab, StepRule, is_solid,
};
use crate::field::LANES;
use crate::trace::access::{Access, Halt};
use crate::trace::node_samples::each_lane;
use crate::trace::program::{Action, Program};
use rayset_base::geometry::Aabb;

/// Chords of a packet, as many as there mostly are at a time.
const MOST_CHORDS: usize = 1024;

/// The details that the rays of a packet have come to, and those that lie ahead.
pub(in crate::trace) struct Details<'p> {
    program: &'p Program,
    rule: &'p StepRule,
    /// World space.
    rays: Vec<Ray>,
    /// The least k of each ray.
    floors: Vec<i32>,
    objects: Vec<DetailedObject>,
    /// Of details that were looked at, those that may still matter.
    chords: Vec<Chord>,
    /// The cell that was looked at last, behind those that it is part of.
    cells: Vec<KnownCell>,
    /// For one after the other of these, the chords that ask for finer steps in it.
    refining: Vec<Chord>,
}

/// A cell whose chords have been gathered.
struct KnownCell {
    cell: Slab,
    /// The first of its chords in [`Details::refining`], and how many chords were known of which
    /// they were chosen.
    first: usize,
    known: usize,
}

impl KnownCell {
    fn contains(&self, other: Slab) -> bool {
        self.cell.first_tick() <= other.first_tick() && other.end_tick() <= self.cell.end_tick()
    }
}

/// An object that some ray may meet and that may ask for finer steps than the coarsest.
struct DetailedObject {
    /// The number of its instruction.
    at: usize,
    /// First and last tick that may lie in its bounds.
    ticks: (u64, u64),
    looked_at: LookedAt,
}

enum LookedAt {
    Nothing,
    /// Its bounds.
    Whole,
    /// The nodes of a cloud.
    Nodes(Box<CloudDetails>),
}

impl<'p> Details<'p> {
    /// Bytes for one cloud, with lists as long as they mostly become.
    pub(in crate::trace) const BYTES_OF_CLOUD: usize = size_of::<DetailedObject>() + CloudDetails::BYTES;
    /// Bytes besides those of clouds, likewise.
    pub(in crate::trace) const BYTES: usize =
        size_of::<Self>() + LANES * (size_of::<Ray>() + size_of::<i32>()) + MOST_CHORDS * size_of::<Chord>();

    pub(in crate::trace) fn new(program: &'p Program, rule: &'p StepRule) -> Self {
        Self {
            program,
            rule,
            rays: Vec::new(),
            floors: Vec::new(),
            objects: Vec::new(),
            chords: Vec::new(),
            cells: Vec::new(),
            refining: Vec::new(),
        }
    }

    /// For packets from now on.
    pub(in crate::trace) fn set_rule(&mut self, rule: &'p StepRule) {
        self.rule = rule;
    }

    /// Starts a packet; `ticks` are those that may lie in the bounds of each instruction.
    pub(in crate::trace) fn begin(&mut self, packet: &Packet, ticks: &[Option<(u64, u64)>]) {
        self.chords.clear();
        self.cells.clear();
        self.refining.clear();
        self.objects.clear();
        self.rays.clear();
        self.rays.extend(packet.rays(packet.all()));
        for (at, (ticks, &least)) in ticks.iter().zip(&self.rule.least).enumerate() {
            if let Some(ticks) = ticks.filter(|_| least < 0) {
                self.objects.push(DetailedObject { at, ticks, looked_at: LookedAt::Nothing });
            }
        }
        let floors = self.rule.floors;
        self.floors.clear();
        self.floors.resize(self.rays.len(), floors.exponent);
        if floors.exponent_in_solids > self.rule.range.0 {
            self.hold_in_solids(floors.exponent_in_solids);
        }
    }

    /// Raises the lower limit of k for rays that meet the box of a solid, noise or a grid.
    fn hold_in_solids(&mut self, floor: i32) {
        let solids =
            self.program.instructions.iter().filter(|i| is_solid(&i.action) && !i.object_bounds.is_empty());
        for instruction in solids {
            for (least, ray) in self.floors.iter_mut().zip(&self.rays) {
                if *least < floor && instruction.object_bounds.clip(ray).is_some() {
                    *least = floor;
                }
            }
        }
    }

    /// Of some lanes, those whose rays have finer steps in a cell; `going` are all whose rays have
    /// not ended. No ray comes to anything before the cell any more.
    pub(in crate::trace) fn finer(
        &mut self,
        access: Access<'_>,
        packet: &Packet,
        cell: Slab,
        (going, lanes): (u64, u64),
    ) -> Result<u64, Halt> {
        let k = self.rule.exponent_at(cell.level);
        let mut open = lanes;
        each_lane(lanes, |lane| open &= !(u64::from(self.floors[lane] >= k) << lane));
        if k > 0 || open == 0 {
            return Ok(open);
        }
        let tick = self.rule.tick_world();
        let reach = (cell.first_tick() as f64 * tick, cell.end_tick() as f64 * tick);
        let part = Part { cell, k, reach };
        let mut finer = self.refined_by_known(part, open);
        for object in &mut self.objects {
            let is_ahead = object.ticks.0 < cell.end_tick() && object.ticks.1 >= cell.first_tick();
            if !is_ahead || self.rule.least[object.at] >= k || finer == open {
                continue;
            }
            let known = self.chords.len();
            let Self { program, rule, rays, chords, .. } = self;
            let place = Place { access, packet, program, rule, rays };
            object.look(place, part, (going, open & !finer), chords)?;
            let found = self.chords[known..].iter().filter(|chord| part.is_refined_by(chord));
            finer |= found.fold(0, |lanes, chord| lanes | 1 << chord.lane) & open;
        }
        Ok(finer)
    }

    /// Gathers the known chords that ask for finer steps in a part, of those of the cell that it is
    /// a half of. Returns their lanes.
    fn refined_by_known(&mut self, part: Part, open: u64) -> u64 {
        while let Some(last) = self.cells.pop_if(|last| !last.contains(part.cell)) {
            self.refining.truncate(last.first);
        }
        if self.cells.is_empty() {
            self.chords.retain(|chord| chord.exit >= part.reach.0);
        }
        let (before, known) = self.cells.last().map_or((0, 0), |of| (of.first, of.known));
        let first = self.refining.len();
        self.cells.push(KnownCell { cell: part.cell, first, known: self.chords.len() });
        let mut finer = 0;
        let mut refines = |chord: &Chord| {
            let refines = open >> chord.lane & 1 == 1 && part.is_refined_by(chord);
            finer |= u64::from(refines) << chord.lane;
            refines
        };
        for at in before..first {
            let chord = self.refining[at];
            if refines(&chord) {
                self.refining.push(chord);
            }
        }
        self.refining.extend(self.chords[known..].iter().filter(|chord| refines(chord)));
        finer
    }
}

impl DetailedObject {
    /// Looks at details in a part of the rays, until all rays of `open` are found to have finer
    /// steps there, or there are no more.
    fn look(
        &mut self,
        place: Place<'_>,
        part: Part,
        (going, open): (u64, u64),
        chords: &mut Vec<Chord>,
    ) -> Result<(), Halt> {
        let instruction = &place.program.instructions[self.at];
        let StepRule { scale, floors, .. } = *place.rule;
        match &instruction.action {
            Action::Cloud(volume) if !is_one_by_bounds(volume, &scale, place.access.sight.is_some()) => {
                if let LookedAt::Nodes(nodes) = &mut self.looked_at {
                    return nodes.look(place, volume, part, (going, open), chords);
                }
                let mut nodes = Box::new(CloudDetails::begin(place, volume, &instruction.object_bounds)?);
                let outcome = nodes.look(place, volume, part, (going, open), chords);
                self.looked_at = LookedAt::Nodes(nodes);
                return outcome;
            }
            _ if matches!(self.looked_at, LookedAt::Whole) => {}
            Action::Cloud(volume) => {
                let cloud = &volume.placement;
                let detail = f64::from(cloud.details.1);
                let length = |ray: &Ray| detail / cloud.stretch_along(ray.direction);
                add_whole(place.rays, &instruction.object_bounds, &scale, length, chords);
            }
            Action::Procedural(volume) => {
                let length = |ray: &Ray| volume.detail_world(ray).max(floors.detail);
                add_whole(place.rays, &instruction.object_bounds, &scale, length, chords);
            }
            Action::Grid(volume) => {
                let length = |ray: &Ray| (GRID_DETAIL * volume.spacing_world(ray)).max(floors.detail);
                add_whole(place.rays, &instruction.object_bounds, &scale, length, chords);
            }
            Action::Operator(..) => {}
        }
        self.looked_at = LookedAt::Whole;
        Ok(())
    }
}

/// Adds the chords of rays through a box, in which they have a detail of some length.
fn add_whole(
    rays: &[Ray],
    bounds: &Aabb,
    scale: &Scale,
    length: impl Fn(&Ray) -> f64,
    chords: &mut Vec<Chord>,
) {
    for (lane, ray) in rays.iter().enumerate() {
        let k = scale.of(length(ray));
        if let Some((enter, exit)) = bounds.clip(ray).filter(|_| k < 0) {
            chords.push(Chord { lane: lane as u8, k: k as i8, enter, exit });
        }
    }
}

/// Whether the bounds of a cloud say where which steps are needed: its points have one detail, and
/// are not both scattered and far finer than everything else.
fn is_one_by_bounds(volume: &CloudVolume, scale: &Scale, is_seen: bool) -> bool {
    if is_seen && volume.lod.is_some() {
        return false;
    }
    let cloud = &volume.placement;
    let header = cloud.header();
    let (least, most) = cloud.details;
    let scattered = !cloud.are_splats && header.bounds.size().max_element() > SCATTERED * f64::from(most);
    least == most && !(scattered && scale.of(cloud.largest_detail_world()) <= ASKED_THEMSELVES)
}

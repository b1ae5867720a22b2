//! Evaluation of the graph at the samples of a slab, from its root down.

use super::access::{Access, Halt};
use super::cloud::{CloudMarch, CloudScratch, Remaining, Request};
use super::counts::RenderCounts;
use super::grid::{GridMarch, GridRequest, GridScratch, GridVolume};
use super::node_samples::{Live, Measure, NodeSamples};
use super::procedural::{ProceduralMarch, ProceduralRequest, ProceduralVolume};
use super::program::{Action, Instruction, Program};
use crate::field::{LANES, Packet, Sight, Slab};
use crate::scene::Operator;

/// Most procedural fields of which it is remembered where a packet is in them. Of further ones it
/// is found for each slab.
pub(super) const MOST_FIELDS: usize = 64;

/// The samples of a graph on the rays of a packet, with scratch memory.
pub(super) struct GraphSamples<'p> {
    program: &'p Program,
    /// For each instruction: the first and last tick that may lie in its bounds.
    spans: Vec<Option<(u64, u64)>>,
    /// For each instruction that is a cloud: its march, and whether the packet has reached it.
    clouds: Vec<(Option<Box<CloudMarch>>, bool)>,
    /// For each instruction that is a grid: its march, once the packet has reached it.
    grids: Vec<Option<Box<GridMarch>>>,
    /// For each instruction that is a procedural field, likewise.
    fields: Vec<Option<Box<ProceduralMarch>>>,
    /// How many of them are there.
    known_fields: usize,
    /// The level at which these fields and grids were begun.
    level: u32,
    /// For each instruction with several uses: its block, once it has been computed for the current
    /// slab.
    shared: Vec<Option<NodeSamples>>,
    spare: Vec<NodeSamples>,
    scratch: CloudScratch,
    grid_scratch: GridScratch,
}

/// The lanes whose samples are in a slab, and those that come to it with finer steps.
#[derive(Clone, Copy)]
pub(super) struct Lanes {
    pub(super) here: u64,
    pub(super) waiting: u64,
    /// The first tick that any of them may still come to.
    pub(super) since: u64,
}

/// A slab of which samples are requested.
#[derive(Clone, Copy)]
pub(super) struct Asked<'a> {
    pub(super) access: Access<'a>,
    /// At the level of the slab.
    pub(super) packet: &'a Packet,
    pub(super) slab: Slab,
    pub(super) lanes: Lanes,
    /// Where the rays end, or `None` if that is not known beforehand.
    pub(super) ends: Option<&'a Remaining>,
}

/// What is requested of an instruction.
#[derive(Clone, Copy)]
struct Query<'a> {
    access: Access<'a>,
    packet: &'a Packet,
    slab: Slab,
    live: &'a Live,
    /// All samples of all lanes in the slab.
    all: &'a Live,
    lanes: Lanes,
    /// `None` if rays do not end where this instruction alone would end them.
    ends: Option<&'a Remaining>,
}

impl<'a> Query<'a> {
    /// For each ray, the sum of the optical depths of an instruction's samples with which it ends;
    /// `None` if that is not known, or its samples have no optical depths.
    fn ends_of(&self, instruction: &Instruction) -> Option<&'a [f32; LANES]> {
        let depths = instruction.measures.0 == Measure::OpticalDepth && instruction.transfers.is_empty();
        self.ends.filter(|_| depths).map(|ends| &ends.depth)
    }
}

// Marches are large. Where one is made by a function of its own, no instruction of any slab keeps
// room for it on its stack.

#[inline(never)]
fn new_march(packet: &Packet) -> Box<CloudMarch> {
    Box::new(CloudMarch::new(packet))
}

#[inline(never)]
fn begin_grid(volume: &GridVolume, packet: &Packet) -> Box<GridMarch> {
    Box::new(volume.begin(packet))
}

#[inline(never)]
fn begin_field(volume: &ProceduralVolume, packet: &Packet, outside: bool) -> Box<ProceduralMarch> {
    Box::new(volume.begin(packet, outside))
}

impl<'p> GraphSamples<'p> {
    pub(super) fn new(program: &'p Program) -> Self {
        let count = program.instructions.len();
        Self {
            program,
            spans: vec![None; count],
            clouds: (0..count).map(|_| (None, false)).collect(),
            grids: (0..count).map(|_| None).collect(),
            fields: (0..count).map(|_| None).collect(),
            known_fields: 0,
            level: 0,
            shared: (0..count).map(|_| None).collect(),
            spare: Vec::new(),
            scratch: CloudScratch::new(),
            grid_scratch: GridScratch::new(),
        }
    }

    /// For each instruction: the first and last tick that may lie in its bounds.
    pub(super) fn spans(&self) -> &[Option<(u64, u64)>] {
        &self.spans
    }

    /// A block to evaluate into.
    pub(super) fn node_samples(&mut self) -> NodeSamples {
        self.spare.pop().unwrap_or_else(|| NodeSamples::new(self.program.required))
    }

    /// Returns a block for reuse.
    pub(super) fn give_back(&mut self, node: NodeSamples) {
        self.spare.push(node);
    }

    /// Starts a packet, of which those see something who have a sight.
    pub(super) fn begin(&mut self, packet: &Packet, sight: Option<&Sight>) {
        let beam = packet.beam(packet.all());
        let instructions = &self.program.instructions;
        // Boxes of operators hold those of their operands: all are enlarged together.
        let reach = instructions.iter().map(|instruction| instruction.reach_world(sight)).fold(0.0, f64::max);
        for (span, instruction) in self.spans.iter_mut().zip(instructions) {
            let bounds = &instruction.bounds_as_seen(reach);
            *span = if bounds.is_empty() { None } else { packet.ticks_of_rays_in(&beam, bounds) };
        }
        self.clouds.iter_mut().for_each(|(_, begun)| *begun = false);
        self.forget_places();
    }

    /// Forgets where the packet is in grids and fields.
    fn forget_places(&mut self) {
        self.grids.fill_with(|| None);
        self.fields.fill_with(|| None);
        self.known_fields = 0;
    }

    /// Where a packet is in grids and fields is counted in samples of one level.
    fn come_to_level(&mut self, level: u32) {
        if self.level != level {
            self.level = level;
            self.forget_places();
        }
    }

    /// The first tick, from `from` on, at which the graph may not be empty.
    pub(super) fn next_tick(&self, from: u64) -> Option<u64> {
        self.next_tick_of(self.program.root(), from)
    }

    /// The same, of an instruction.
    fn next_tick_of(&self, at: usize, from: u64) -> Option<u64> {
        let (first, last) = self.spans[at]?;
        let from = from.max(first);
        if from > last {
            return None;
        }
        match &self.program.instructions[at].action {
            Action::Procedural(_) | Action::Grid(_) => Some(from),
            Action::Cloud(_) => match &self.clouds[at] {
                (Some(march), true) => march.next_tick(from),
                _ => Some(from),
            },
            Action::Operator(operator, children) => {
                let mut next = children.iter().map(|&child| self.next_tick_of(child, from));
                match operator {
                    Operator::Union | Operator::Blend => next.flatten().min(),
                    Operator::Difference => next.next().flatten(),
                    // Empty until all children have begun, and from where one of them has ended.
                    Operator::Intersection => next.try_fold(from, |latest, n| n.map(|n| latest.max(n))),
                }
            }
        }
    }

    /// Evaluates the graph at the samples of a slab. Opacities are given as optical depths.
    pub(super) fn evaluate(
        &mut self,
        asked: Asked<'_>,
        counts: &mut RenderCounts,
        out: &mut NodeSamples,
    ) -> Result<(), Halt> {
        let Asked { access, packet, slab, lanes, ends } = asked;
        access.check()?;
        self.come_to_level(slab.level);
        let all = Live::of(lanes.here);
        let query = Query { access, packet, slab, live: &all, all: &all, lanes, ends };
        let outcome = self.run(self.program.root(), query, Measure::OpticalDepth, counts, out);
        for node in self.shared.iter_mut().filter_map(Option::take) {
            self.spare.push(node);
        }
        outcome
    }

    /// Whether an instruction's bounds may hold samples of a slab.
    fn is_in(&self, at: usize, slab: Slab) -> bool {
        self.spans[at].is_some_and(|(first, last)| first < slab.end_tick() && last >= slab.first_tick())
    }

    /// Runs one instruction, with its opacity in a given measure.
    fn run(
        &mut self,
        at: usize,
        asked: Query<'_>,
        measure: Measure,
        counts: &mut RenderCounts,
        out: &mut NodeSamples,
    ) -> Result<(), Halt> {
        let program = self.program;
        let instruction = &program.instructions[at];
        out.touched = 0;
        if !self.is_in(at, asked.slab) {
            return Ok(());
        }
        if instruction.uses > 1 {
            let node = match self.shared[at].take() {
                Some(node) => node,
                None => {
                    // Other users may need samples that do not matter here.
                    let mut node = self.node_samples();
                    self.compute(at, Query { live: asked.all, ends: None, ..asked }, counts, &mut node)?;
                    node
                }
            };
            out.copy_from(&node, instruction.required);
            self.shared[at] = Some(node);
        } else {
            self.compute(at, asked, counts, out)?;
        }
        out.measure(instruction.measures.1, measure, program.simd);
        Ok(())
    }

    fn compute(
        &mut self,
        at: usize,
        asked: Query<'_>,
        counts: &mut RenderCounts,
        out: &mut NodeSamples,
    ) -> Result<(), Halt> {
        let program = self.program;
        let instruction = &program.instructions[at];
        let Instruction { measures, made: required, .. } = *instruction;
        match &instruction.action {
            Action::Cloud(volume) => {
                let (march, begun) = &mut self.clouds[at];
                let march = march.get_or_insert_with(|| new_march(asked.packet));
                if !*begun {
                    self.scratch.find_room(asked.access);
                    march.begin(asked.access, volume, asked.packet, program.simd)?;
                    *begun = true;
                }
                let Query { access, slab, live, lanes, ends, .. } = asked;
                let ends = ends.filter(|_| instruction.transfers.is_empty());
                let (measure, simd) = (measures.0, program.simd);
                let (going, waiting) = (lanes.here, (lanes.waiting, lanes.since));
                let request = Request { access, slab, live, going, waiting, measure, required, simd, ends };
                march.sample(volume, request, &mut self.scratch, counts, out)?;
            }
            Action::Grid(volume) => {
                let Query { access, packet, slab, live, .. } = asked;
                let march = self.grids[at].get_or_insert_with(|| begin_grid(volume, packet));
                let (simd, measure, ends) = (program.simd, measures.0, asked.ends_of(instruction));
                let request =
                    GridRequest { access, march, slab, live, measure, required, simd, ends, grid: at };
                volume.sample(&request, &mut self.grid_scratch, out)?;
            }
            Action::Procedural(volume) => self.sample_field(at, volume, asked, out),
            Action::Operator(operator, children) => {
                // Only what a union or a blend has of one child, it has at least.
                let keeps = matches!(operator, Operator::Union | Operator::Blend);
                let ends = asked.ends.filter(|_| keeps && instruction.transfers.is_empty());
                self.combine(*operator, children, instruction, Query { ends, ..asked }, counts, out)?;
            }
        }
        for transfer in &instruction.transfers {
            transfer.apply(out, instruction.required.color);
        }
        out.measure(measures.0, measures.1, program.simd);
        Ok(())
    }

    fn sample_field(
        &mut self,
        at: usize,
        volume: &ProceduralVolume,
        asked: Query<'_>,
        out: &mut NodeSamples,
    ) {
        let instruction = &self.program.instructions[at];
        let Instruction { measures, made: required, .. } = *instruction;
        let Query { packet, slab, live, .. } = asked;
        let begin = || begin_field(volume, packet, required.outside);
        let of_slab;
        let march = match &mut self.fields[at] {
            None if self.known_fields == MOST_FIELDS => {
                of_slab = begin();
                &*of_slab
            }
            known => {
                self.known_fields += usize::from(known.is_none());
                &**known.get_or_insert_with(begin)
            }
        };
        let (measure, ends, simd) = (measures.0, asked.ends_of(instruction), self.program.simd);
        volume.sample(&ProceduralRequest { packet, march, slab, live, measure, required, ends, simd }, out);
    }

    /// Evaluates the children of an operator where they can affect the result, and combines them.
    fn combine(
        &mut self,
        operator: Operator,
        children: &[usize],
        instruction: &Instruction,
        asked: Query<'_>,
        counts: &mut RenderCounts,
        out: &mut NodeSamples,
    ) -> Result<(), Halt> {
        let (measure, required) = (instruction.measures.0, instruction.made);
        if operator == Operator::Intersection {
            return self.intersect(children, instruction, asked, counts, out);
        }
        let mut other = self.node_samples();
        let mut live = *asked.live;
        // After the last child that may not be empty here, `live` is not needed any more.
        let last = children.iter().rposition(|&child| self.is_in(child, asked.slab)).unwrap_or(0);
        for (place, &child) in children.iter().enumerate().take(last + 1) {
            let asked = Query { live: &live, ..asked };
            let into = if place == 0 && operator != Operator::Blend { &mut *out } else { &mut other };
            if let Err(halt) = self.run(child, asked, measure, counts, into) {
                self.give_back(other);
                return Err(halt);
            }
            match operator {
                Operator::Union => {
                    if place > 0 {
                        out.unite(&other, required);
                    }
                    // Of two that are opaque, splats may be the more so.
                    if place < last && !self.program.has_splats {
                        live = out.not_opaque(&live, measure);
                    }
                }
                Operator::Difference => {
                    if place > 0 {
                        out.subtract(&other, (measure, required), self.program.reach as f32);
                    }
                    if place < last {
                        live = out.not_empty(&live);
                    }
                }
                Operator::Blend | Operator::Intersection => out.add(&other, required, place == 0),
            }
        }
        if operator == Operator::Blend {
            out.finish_blend(required);
        }
        self.give_back(other);
        Ok(())
    }

    /// Intersections evaluate the cheapest child first, but combine children in the order of the
    /// graph.
    fn intersect(
        &mut self,
        children: &[usize],
        instruction: &Instruction,
        asked: Query<'_>,
        counts: &mut RenderCounts,
        out: &mut NodeSamples,
    ) -> Result<(), Halt> {
        let (measure, required) = (instruction.measures.0, instruction.made);
        let mut blocks: Vec<NodeSamples> = children.iter().map(|_| self.node_samples()).collect();
        let mut order: Vec<usize> = (0..children.len()).collect();
        order.sort_by_key(|&place| self.cost(children[place]));
        let mut live = *asked.live;
        let mut outcome = Ok(());
        for place in order {
            blocks[place].touched = 0;
            if outcome.is_ok() {
                outcome = self.run(
                    children[place],
                    Query { live: &live, ..asked },
                    measure,
                    counts,
                    &mut blocks[place],
                );
                if !required.outside {
                    live = blocks[place].not_empty(&live);
                }
            }
        }
        if outcome.is_ok() {
            NodeSamples::intersect(&mut blocks, required);
            out.copy_from(&blocks[0], required);
        }
        blocks.into_iter().for_each(|node| self.give_back(node));
        outcome
    }

    /// Relative cost of an instruction: procedural fields cost less than grids, and grids less than
    /// clouds.
    fn cost(&self, at: usize) -> usize {
        match &self.program.instructions[at].action {
            Action::Procedural(_) => 1,
            Action::Grid(_) => 100,
            Action::Cloud(_) => 1000,
            Action::Operator(_, children) => children.iter().map(|&child| self.cost(child)).sum(),
        }
    }
}

//! The march of one packet through the whole graph: its samples, slab after slab.

use super::access::{Access, Halt};
use super::cloud::{CloudMarch, CloudScratch, Remaining, Request};
use super::counts::RenderCounts;
use super::grid::{GridMarch, GridRequest, GridScratch};
use super::node_samples::{Live, Measure, NodeSamples};
use super::procedural::{ProceduralMarch, ProceduralRequest, ProceduralVolume};
use super::program::{Action, Instruction, Program};
use crate::field::{BLOCK_SAMPLES, LANES, Packet, SLAB_SAMPLES, Slab};
use crate::scene::Operator;

/// Most procedural fields of which it is remembered where a packet is in them. Of further ones it
/// is found for each slab.
pub(super) const MOST_FIELDS: usize = 64;

/// The progress of a packet through a graph, with scratch memory.
pub(super) struct March<'p> {
    program: &'p Program,
    slab_samples: usize,
    /// For each instruction: the first and last sample that may lie in its bounds.
    spans: Vec<Option<(u64, u64)>>,
    /// For each instruction that is a cloud: its march, and whether the packet has reached it.
    clouds: Vec<(Option<Box<CloudMarch>>, bool)>,
    /// For each instruction that is a grid: its march, once the packet has reached it.
    grids: Vec<Option<Box<GridMarch>>>,
    /// For each instruction that is a procedural field, likewise.
    fields: Vec<Option<Box<ProceduralMarch>>>,
    /// How many of them are there.
    known_fields: usize,
    /// For each instruction with several uses: its block, once it has been computed for the current
    /// slab.
    shared: Vec<Option<NodeSamples>>,
    spare: Vec<NodeSamples>,
    scratch: CloudScratch,
    grid_scratch: GridScratch,
    /// Where the rays end, or `None` if that is not known beforehand.
    remaining: Option<Remaining>,
}

/// What is done with the samples of a packet: the light of rays from the eye, what is left of light
/// on its way, surfaces that are crossed.
pub(super) trait SlabVisitor {
    /// Called where samples are skipped that are empty on all rays, but not behind the last slab.
    /// Returns the lanes of those in `going` that end there.
    fn passed_nothing(&mut self, _going: u64) -> u64 {
        0
    }

    /// How much is left of the rays before the next slab: samples behind the end of a ray may then
    /// be left empty. `None` if rays do not end by what they pass.
    fn remaining(&self) -> Option<Remaining> {
        None
    }

    /// Where work is counted.
    fn counts(&mut self) -> &mut RenderCounts;

    /// Takes the samples of a slab, of the lanes in `going`. Opacities are optical depths. Returns
    /// the lanes that go on.
    fn sampled(&mut self, slab: Slab, going: u64, node: &mut NodeSamples) -> Result<u64, Halt>;
}

/// What is requested of an instruction.
#[derive(Clone, Copy)]
struct Query<'a> {
    access: Access<'a>,
    packet: &'a Packet,
    slab: Slab,
    live: &'a Live,
    /// All samples of all lanes in `going`.
    all: &'a Live,
    going: u64,
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

impl<'p> March<'p> {
    pub(super) fn new(program: &'p Program, slab_samples: usize) -> Self {
        let count = program.instructions.len();
        Self {
            program,
            slab_samples,
            spans: vec![None; count],
            clouds: (0..count).map(|_| (None, false)).collect(),
            grids: (0..count).map(|_| None).collect(),
            fields: (0..count).map(|_| None).collect(),
            known_fields: 0,
            shared: (0..count).map(|_| None).collect(),
            spare: Vec::new(),
            scratch: CloudScratch::new(),
            grid_scratch: GridScratch::new(),
            remaining: None,
        }
    }

    /// A block to evaluate into.
    fn node_samples(&mut self) -> NodeSamples {
        self.spare.pop().unwrap_or_else(|| NodeSamples::new(self.program.required))
    }

    /// Returns a block for reuse.
    fn give_back(&mut self, node: NodeSamples) {
        self.spare.push(node);
    }

    /// Follows the rays of a packet front to back, slab by slab, until all have ended or nothing is
    /// left ahead. Returns the lanes of the rays that have not ended.
    pub(super) fn slabs(
        &mut self,
        access: Access<'_>,
        packet: &Packet,
        visitor: &mut impl SlabVisitor,
    ) -> Result<u64, Halt> {
        self.begin(packet);
        let mut node = self.node_samples();
        let outcome = self.each_slab(access, packet, visitor, &mut node);
        self.give_back(node);
        outcome
    }

    fn each_slab(
        &mut self,
        access: Access<'_>,
        packet: &Packet,
        visitor: &mut impl SlabVisitor,
        node: &mut NodeSamples,
    ) -> Result<u64, Halt> {
        let (mut going, mut from) = (packet.all(), 0);
        while going != 0
            && let Some(slab) = self.next_slab(from)
        {
            if slab.first > from {
                going &= !visitor.passed_nothing(going);
            }
            from = slab.end();
            self.remaining = visitor.remaining();
            self.evaluate(access, packet, slab, going, visitor.counts(), node)?;
            going = visitor.sampled(slab, going, node)?;
        }
        Ok(going)
    }

    /// Starts a packet.
    fn begin(&mut self, packet: &Packet) {
        let beam = packet.beam(packet.all());
        for (span, instruction) in self.spans.iter_mut().zip(&self.program.instructions) {
            let bounds = &instruction.bounds;
            *span = if bounds.is_empty() { None } else { packet.samples_in(&beam, bounds) };
        }
        self.clouds.iter_mut().for_each(|(_, begun)| *begun = false);
        self.grids.fill_with(|| None);
        self.fields.fill_with(|| None);
        self.known_fields = 0;
    }

    /// The next slab, from sample `from` on, that may not be empty.
    fn next_slab(&self, from: u64) -> Option<Slab> {
        let sample = self.next_sample(self.program.root(), from)?;
        // From where there is something, so that it takes as few slabs as may be, but never back.
        let block = BLOCK_SAMPLES as u64;
        Some(Slab { first: (sample / block * block).max(from), samples: self.slab_samples })
    }

    /// The first sample, from `from` on, at which an instruction may not be empty.
    fn next_sample(&self, at: usize, from: u64) -> Option<u64> {
        let (first, last) = self.spans[at]?;
        let from = from.max(first);
        if from > last {
            return None;
        }
        match &self.program.instructions[at].action {
            Action::Procedural(_) | Action::Grid(_) => Some(from),
            Action::Cloud(_) => match &self.clouds[at] {
                (Some(march), true) => march.next_sample(from),
                _ => Some(from),
            },
            Action::Operator(operator, children) => {
                let mut next = children.iter().map(|&child| self.next_sample(child, from));
                match operator {
                    Operator::Union | Operator::Blend => next.flatten().min(),
                    Operator::Difference => next.next().flatten(),
                    // Empty until all children have begun, and from where one of them has ended.
                    Operator::Intersection => next.try_fold(from, |latest, n| n.map(|n| latest.max(n))),
                }
            }
        }
    }

    /// Evaluates the graph at the samples of a slab, for the lanes in `going`. Opacities are given
    /// as optical depths.
    fn evaluate(
        &mut self,
        access: Access<'_>,
        packet: &Packet,
        slab: Slab,
        going: u64,
        counts: &mut RenderCounts,
        out: &mut NodeSamples,
    ) -> Result<(), Halt> {
        access.check()?;
        let all = Live::of(going);
        let remaining = self.remaining.take();
        let asked = Query { access, packet, slab, live: &all, all: &all, going, ends: remaining.as_ref() };
        let outcome = self.run(self.program.root(), asked, Measure::OpticalDepth, counts, out);
        for node in self.shared.iter_mut().filter_map(Option::take) {
            self.spare.push(node);
        }
        outcome
    }

    /// Whether an instruction's bounds may hold samples of a slab.
    fn is_in(&self, at: usize, slab: Slab) -> bool {
        self.spans[at].is_some_and(|(first, last)| first < slab.end() && last >= slab.first)
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
                let march = march.get_or_insert_with(|| Box::new(CloudMarch::new(asked.packet)));
                if !*begun {
                    self.scratch.find_room(asked.access);
                    march.begin(asked.access, volume, asked.packet, program.simd)?;
                    *begun = true;
                }
                let Query { access, slab, live, going, ends, .. } = asked;
                let ends = ends.filter(|_| instruction.transfers.is_empty());
                let (measure, simd) = (measures.0, program.simd);
                let request = Request { access, slab, live, going, measure, required, simd, ends };
                march.sample(volume, request, &mut self.scratch, counts, out)?;
            }
            Action::Grid(volume) => {
                let Query { access, packet, slab, live, .. } = asked;
                let march = self.grids[at].get_or_insert_with(|| Box::new(volume.begin(packet)));
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
        let begin = || volume.begin(packet, required.outside);
        let of_slab;
        let march = match &mut self.fields[at] {
            None if self.known_fields == MOST_FIELDS => {
                of_slab = begin();
                &of_slab
            }
            known => {
                self.known_fields += usize::from(known.is_none());
                &**known.get_or_insert_with(|| Box::new(begin()))
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
                    if place < last {
                        live = out.not_opaque(&live, measure);
                    }
                }
                Operator::Difference => {
                    if place > 0 {
                        out.subtract(&other, required, self.program.reach as f32);
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

const _: () = assert!(SLAB_SAMPLES == 32, "a lane's samples are the bits of a u32");

//! The march of one packet through one cloud, slab by slab.

use super::frontier::{ActiveRuns, Frontier, PacketInCloud, Runs};
use super::live_rays::{LiveRays, bits_between};
use super::shading::CloudShading;
use super::volume::CloudVolume;
use crate::field::{
    Appended, BATCH_BYTES, FieldSamples, KEPT_BYTES, LANES, Packet, RayEnds, RunBatch, RunKey, SampleRow,
    Sight, SimdLevel, Slab, Splatter,
};
use crate::trace::access::{Access, Halt};
use crate::trace::counts::RenderCounts;
use crate::trace::node_samples::{Live, Measure, NodeSamples, RequiredOutputs};
use rayset_files::octree::page::PointPage;
use rayset_store::working_set::Loan;

/// What the part of an octree ahead of a packet takes, and the runs that it has reached. Lists that
/// double as they grow: 4 to 42 KiB as measured, 20 in the mean of many clouds in one scene.
const AHEAD_BYTES: usize = 24 << 10;

/// The march of one packet through one cloud.
pub(in crate::trace) struct CloudMarch {
    /// In the cloud's space.
    packet: Packet,
    /// In the cloud's space.
    sight: Option<Sight>,
    frontier: Frontier,
    active: Vec<ActiveRuns>,
    /// `None` until a packet has begun.
    rays: Option<LiveRays>,
}

/// Memory in which decoded runs are kept.
enum Room {
    NotAsked,
    Lent(Loan),
    None,
}

/// Scratch memory shared by all clouds of a thread.
pub(in crate::trace) struct CloudScratch {
    batch: RunBatch,
    /// After the batch, whose memory is gone before the loan is given back.
    room: Room,
    /// One for each set of channels used by any cloud.
    fields: Vec<FieldSamples>,
}

impl CloudScratch {
    /// The most bytes that it takes where a program has so many clouds, whose fields have so many
    /// channels besides density, gradient and colour.
    pub(in crate::trace) fn bytes(clouds: usize, channels: usize) -> usize {
        // Of class labels, the label and what speaks for it.
        let sums = 2 * channels * LANES * size_of::<SampleRow>();
        if clouds > 0 { BATCH_BYTES as usize + sums } else { 0 }
    }

    pub(in crate::trace) fn new() -> Self {
        Self { batch: RunBatch::default(), room: Room::NotAsked, fields: Vec::new() }
    }

    /// Borrows memory of the pages to keep decoded runs in, if there is much of it, or gives it
    /// back. To be called for each packet; it asks once.
    pub(in crate::trace) fn find_room(&mut self, access: Access<'_>) {
        let lent = match &self.room {
            Room::NotAsked => access.pages.lend(KEPT_BYTES as u64),
            Room::Lent(loan) if loan.is_due() => None,
            Room::Lent(_) | Room::None => return,
        };
        // Before the old loan goes.
        self.batch.set_room(lent.is_some());
        self.room = lent.map_or(Room::None, Room::Lent);
    }
}

/// What is requested of a cloud in a slab.
#[derive(Clone, Copy)]
pub(in crate::trace) struct Request<'a> {
    pub(in crate::trace) access: Access<'a>,
    pub(in crate::trace) slab: Slab,
    pub(in crate::trace) live: &'a Live,
    /// Lanes whose rays have not ended.
    pub(in crate::trace) going: u64,
    /// Lanes whose rays have not ended either, but come to the slab with finer steps, and the first
    /// tick that these may still come to.
    pub(in crate::trace) waiting: (u64, u64),
    pub(in crate::trace) measure: Measure,
    pub(in crate::trace) required: RequiredOutputs,
    pub(in crate::trace) simd: SimdLevel,
    /// Where rays end if no samples but the cloud's absorb light, or `None` if that is of no use.
    pub(in crate::trace) ends: Option<&'a Remaining>,
}

impl<'a> Request<'a> {
    /// Where rays end in a cloud of this shading at the latest, by its densities.
    fn ray_ends(&self, shading: &CloudShading) -> Option<RayEnds<'a>> {
        let absorption = shading.least_absorption?;
        self.ends.map(|ends| RayEnds { depth: &ends.depth, absorption })
    }
}

/// How much is left of each ray.
#[derive(Clone, Copy, Debug)]
pub(in crate::trace) struct Remaining {
    /// For each lane, the optical depth from the slab's beginning at which its ray ends, in steps
    /// at the optical depth of a unit distance. More than exact: a ray that comes to it has ended,
    /// whatever was rounded.
    pub(in crate::trace) depth: [f32; LANES],
}

impl CloudMarch {
    /// Bytes of a march, with its lists as long as they mostly become.
    pub(in crate::trace) const BYTES: usize = size_of::<Self>() + AHEAD_BYTES;

    /// Allocates a march for any packet; [`begin`](Self::begin) must be called first.
    pub(in crate::trace) fn new(packet: &Packet) -> Self {
        let packet = packet.clone();
        Self { packet, sight: None, frontier: Frontier::default(), active: Vec::new(), rays: None }
    }

    /// Starts a packet at the root of a cloud.
    pub(in crate::trace) fn begin(
        &mut self,
        access: Access<'_>,
        volume: &CloudVolume,
        packet: &Packet,
        simd: SimdLevel,
    ) -> Result<(), Halt> {
        self.packet = volume.placement.local(packet);
        self.active.clear();
        let rays = LiveRays::new(&self.packet, simd);
        let cloud = &volume.placement;
        self.sight = cloud.local_sight(access.sight.as_ref());
        let (packet, sight) = (&self.packet, self.sight.as_ref());
        self.frontier.begin(PacketInCloud { access, cloud, packet, rays: &rays, sight })?;
        self.rays = Some(rays);
        Ok(())
    }

    /// The first tick at or after `from` at which there may be points.
    pub(in crate::trace) fn next_tick(&self, from: u64) -> Option<u64> {
        if self.active.iter().any(|run| run.last >= from) {
            return Some(from);
        }
        self.frontier.next_tick().map(|tick| tick.max(from))
    }

    /// Evaluates a slab; fills the lanes that points reach.
    pub(in crate::trace) fn sample(
        &mut self,
        volume: &CloudVolume,
        request: Request<'_>,
        scratch: &mut CloudScratch,
        counts: &mut RenderCounts,
        out: &mut NodeSamples,
    ) -> Result<(), Halt> {
        let Request { access, slab, live, going, waiting, measure, required, simd, .. } = request;
        out.touched = 0;
        let lanes = live.lanes() & going;
        let Some(rays) = self.rays.as_mut().filter(|_| lanes != 0) else { return Ok(()) };
        self.packet.set_level(slab.level);
        let (waiting, since) = waiting;
        rays.become_rays(&self.packet, slab, live, (going, waiting));
        let (cloud, packet, sight) = (&volume.placement, &self.packet, self.sight.as_ref());
        let place = PacketInCloud { access, cloud, packet, rays, sight };
        self.frontier.advance(place, slab, since, &mut self.active)?;
        if access.follows_lines {
            self.frontier.precache(place);
        }
        self.active.retain(|run| run.last >= since);
        if self.active.is_empty() {
            return Ok(());
        }
        let channels = volume.shading.channels(required);
        let known = scratch.fields.iter().position(|field| field.channels() == channels);
        let at = known.unwrap_or_else(|| {
            scratch.fields.push(FieldSamples::new(channels));
            scratch.fields.len() - 1
        });
        let field = &mut scratch.fields[at];
        field.clear();
        let splatter = Splatter { kernel: volume.shading.kernel, channels, simd };
        scratch.batch.clear();
        scratch.batch.set_sight(self.sight);
        self.gather(volume, request, lanes, &splatter, &mut scratch.batch, counts, field)?;
        // Opacities are no depths: where a ray ends is not found by adding them.
        let ends = request.ends.filter(|_| measure == Measure::OpticalDepth).map(|ends| &ends.depth);
        volume.shading.transfer(field, (measure, required, simd), ends, out);
        Ok(())
    }

    /// Adds all active runs to the samples of a slab, in the order of the file, with one page
    /// retained at a time.
    #[expect(clippy::too_many_arguments, reason = "the inner loop, and the room to work in")]
    fn gather(
        &mut self,
        volume: &CloudVolume,
        request: Request<'_>,
        lanes: u64,
        splatter: &Splatter,
        batch: &mut RunBatch,
        counts: &mut RenderCounts,
        field: &mut FieldSamples,
    ) -> Result<(), Halt> {
        let Some(rays) = &self.rays else { return Ok(()) };
        let CloudVolume { placement: cloud, shading } = volume;
        self.active.sort_unstable();
        let (slab, sight) = (request.slab, self.sight.as_ref());
        let place = PacketInCloud { access: request.access, cloud, packet: &self.packet, rays, sight };
        let live = request.live.0.iter().fold(0, |samples, lane| samples | lane);
        let matters = |runs: &ActiveRuns| {
            let (first, last) = slab.samples_at(runs.first, runs.last);
            first < slab.samples as u64 && live & bits_between(first, last) != 0
        };
        // A run with several ranges of samples is added only once.
        let mut before = None;
        let mut at = 0;
        while let Some(&ActiveRuns { runs: Runs { page, .. }, .. }) = self.active.get(at) {
            let (count, needed, again) = of_first_page(&self.active[at..], slab, matters);
            if !needed {
                at += count;
                continue;
            }
            let guard = request.access.retain_in_turn(&cloud.pages, page, slab.first_tick(), again)?;
            let points = PointPage::trusted(&guard, cloud.header());
            while let Some(active) = self.active.get(at).filter(|a| a.runs.page == page) {
                let Runs { first, end, .. } = active.runs;
                let again = before == Some(active.runs) && end - first == 1;
                let end = if matters(active) && !again { end } else { first };
                if first < end {
                    before = Some(active.runs);
                }
                // A single run has been examined before, for all rays.
                let is_examined = end - first == 1 && !rays.some_wait();
                for index in usize::from(first)..usize::from(end) {
                    if !is_examined && !rays.reach(&self.packet, &place.run_bounds(&points, index), slab) {
                        continue;
                    }
                    let of = (&shading.decoder, &points.run(index), cloud.header());
                    let key = Some(RunKey { cloud: shading.number(), page, number: index as u16 });
                    let on = (&self.packet, slab, lanes);
                    let mut appended = batch.append(of, key, on, splatter.simd);
                    if appended == Appended::NoRoom {
                        counts.splats += splatter.splat(batch, &self.packet, slab, lanes, None, field);
                        appended = batch.append(of, key, on, splatter.simd);
                    }
                    counts.runs += u64::from(appended == Appended::Decoded);
                }
                at += 1;
            }
        }
        counts.splats += splatter.splat(batch, &self.packet, slab, lanes, request.ray_ends(shading), field);
        Ok(())
    }
}

/// Of active runs in the order of the file: how many are of the first one's page, whether any of
/// these matters, and whether any goes on behind the slab.
fn of_first_page(
    active: &[ActiveRuns],
    slab: Slab,
    matters: impl Fn(&ActiveRuns) -> bool,
) -> (usize, bool, bool) {
    let of_page = active.iter().take_while(|runs| runs.runs.page == active[0].runs.page);
    of_page.fold((0, false, false), |(count, needed, again), runs| {
        (count + 1, needed || matters(runs), again || runs.last >= slab.end_tick())
    })
}

//! The march of one packet through one cloud, slab by slab.

use super::ahead::{Active, PacketInCloud};
use super::frontier::Frontier;
use super::gather::{Gathering, Samples};
use super::leaf_cut::LeafCuts;
use super::live_rays::LiveRays;
use super::request::Request;
use super::volume::CloudVolume;
use crate::field::{
    BATCH_BYTES, Channels, FarScratch, FieldSamples, KEPT_BYTES, LANES, Packet, RunBatch, RunPart,
    SIGHTS_BYTES, SampleRow, Sight, SimdLevel, Splatter,
};
use crate::lod::SPREAD;
use crate::trace::access::{Access, Halt};
use crate::trace::counts::RenderCounts;
use crate::trace::node_samples::{Measure, NodeSamples};
use rayset_store::working_set::Loan;

/// What the part of an octree ahead of a packet takes, and the runs that it has reached. Lists that
/// double as they grow: 4 to 42 KiB as measured, 20 in the mean of many clouds in one scene.
const AHEAD_BYTES: usize = 24 << 10;

/// Rows of a field of what is seen from afar, besides attributes: the area that takes light, its
/// gradient, colours of points or densities, and what the closure needs.
const SPREAD_ROWS: usize = 1 + 3 + 3 + 10;

/// What is kept of the cut through a cloud that is seen from afar. As measured at most: 300 KiB of
/// a hundred million points on a surface, 430 to 1220 of five million of gas, in pictures of 256 to
/// 64 pixels.
const CUT_BYTES: usize = 1280 << 10;

/// Memory for decoded runs is borrowed if no more than one part in so many of that of pages is.
const KEPT_PART: u64 = 32;
/// The same for what is seen from afar by eyes, and by lights; and how much it is, or else.
const FAR_PART: u64 = 4;
const FAR_PART_OF_LIGHTS: u64 = 9;
const FAR_BYTES: [u64; 4] = [24 << 20, 10 << 20, 5 << 20, 3 << 19];

/// What the runs of a batch take of more columns than those of densities have.
const MORE_COLUMNS_BYTES: usize = 32 << 10;

/// The march of one packet through one cloud.
pub(in crate::trace) struct CloudMarch {
    /// In the cloud's space.
    packet: Packet,
    /// In the cloud's space.
    sight: Option<Sight>,
    frontier: Frontier,
    active: Active,
    /// `None` until a packet has begun.
    rays: Option<LiveRays>,
}

/// Memory in which decoded runs are kept.
enum Room {
    NotAsked,
    Lent(Loan),
    None,
}

impl Room {
    /// What becomes of it, if anything: it is asked for once, and given back when it is due.
    fn after(&self, lend: impl FnOnce() -> Option<Loan>) -> Option<Self> {
        match self {
            Self::NotAsked => Some(lend().map_or(Self::None, Self::Lent)),
            Self::Lent(loan) => loan.is_due().then_some(Self::None),
            Self::None => None,
        }
    }
}

/// Scratch memory shared by all clouds of a thread.
pub(in crate::trace) struct CloudScratch {
    batch: RunBatch,
    /// After the batch, whose memory is gone before the loan is given back.
    room: Room,
    /// One for each set of channels used by any cloud.
    fields: Vec<FieldSamples>,
    /// The same of what is seen from afar.
    spread: Vec<FieldSamples>,
    leaves: LeafCuts,
    /// After what takes it.
    far_room: Room,
    /// `None` until a cloud is seen from afar.
    far: Option<Box<FarScratch>>,
}

impl CloudScratch {
    /// The most bytes that it takes where a program has so many clouds, whose fields have so many
    /// channels besides density, gradient and colour.
    pub(in crate::trace) fn bytes(clouds: usize, channels: usize, from_afar: bool) -> usize {
        // Of class labels, the label and what speaks for it.
        let rows = 2 * channels + if from_afar { SPREAD_ROWS + 2 * channels } else { 0 };
        let sums = rows * LANES * size_of::<SampleRow>();
        let columns = if from_afar {
            MORE_COLUMNS_BYTES + SIGHTS_BYTES + LeafCuts::BYTES + size_of::<FarScratch>()
        } else {
            0
        };
        if clouds > 0 { BATCH_BYTES as usize + columns + sums } else { 0 }
    }

    pub(in crate::trace) fn new() -> Self {
        Self {
            batch: RunBatch::default(),
            room: Room::NotAsked,
            fields: Vec::new(),
            spread: Vec::new(),
            leaves: LeafCuts::default(),
            far_room: Room::NotAsked,
            far: None,
        }
    }

    /// Borrows memory of the pages to keep decoded runs in, if there is much of it, or gives it
    /// back. To be called for each packet; it asks once.
    pub(in crate::trace) fn find_room(&mut self, access: Access<'_>) {
        let Some(room) = self.room.after(|| access.pages.lend(KEPT_BYTES as u64, KEPT_PART)) else { return };
        // Before the old loan goes.
        self.batch.set_room(matches!(room, Room::Lent(..)));
        self.room = room;
    }

    /// The same for what is seen of a cloud from afar, which takes long to make.
    fn find_room_from_afar(&mut self, access: Access<'_>) {
        let is_of_light = access.sight.is_some_and(|sight| !sight.is_shown);
        let part = if is_of_light { FAR_PART_OF_LIGHTS } else { FAR_PART };
        // So much that there is as much for each thread: of its two marches to lights, for the one
        // that asks first.
        let most = access.pages.share_bytes() / (part * access.threads as u64);
        let bytes = FAR_BYTES.into_iter().find(|&bytes| bytes <= most);
        let lend = || bytes.and_then(|bytes| access.pages.lend(bytes, part));
        let Some(room) = self.far_room.after(lend) else { return };
        let bytes = match &room {
            Room::Lent(loan) => loan.bytes() as usize,
            Room::NotAsked | Room::None => 0,
        };
        self.batch.set_room_from_afar(bytes - bytes / 3);
        self.leaves.set_more(bytes / 3);
        self.far_room = room;
    }
}

impl CloudMarch {
    /// Bytes of a march, with its lists as long as they mostly become.
    pub(in crate::trace) const BYTES: usize = size_of::<Self>() + AHEAD_BYTES;

    /// Bytes besides, of a cloud that is seen from afar.
    pub(in crate::trace) const BYTES_FROM_AFAR: usize = CUT_BYTES;

    /// Allocates a march for any packet; [`begin`](Self::begin) must be called first.
    pub(in crate::trace) fn new(packet: &Packet) -> Self {
        let packet = packet.clone();
        Self { packet, sight: None, frontier: Frontier::default(), active: Active::default(), rays: None }
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
        let sight = cloud.local_sight(access.sight.as_ref());
        self.sight = match volume.lod.as_deref() {
            Some(lod) => sight.map(|sight| lod.sight(&sight)),
            None => sight,
        };
        let (packet, sight, lod) = (&self.packet, self.sight.as_ref(), volume.lod.as_deref());
        self.frontier.begin(PacketInCloud {
            access,
            cloud,
            number: volume.shading.number(),
            packet,
            rays: &rays,
            sight,
            lod,
        })?;
        self.rays = Some(rays);
        Ok(())
    }

    /// The first tick at or after `from` at which there may be points.
    pub(in crate::trace) fn next_tick(&self, from: u64) -> Option<u64> {
        if self.active.reaches(from) {
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
        let lod = volume.lod.as_deref();
        if lod.is_some() && self.sight.is_some() {
            scratch.find_room_from_afar(access);
        }
        let number = volume.shading.number();
        let place = PacketInCloud { access, cloud, number, packet, rays, sight, lod };
        self.frontier.advance(place, slab, since, (&mut self.active, &mut scratch.leaves))?;
        if access.follows_lines && lod.is_none() {
            self.frontier.precache(place);
        }
        self.active.pass(since);
        self.frontier.cut.pass(since);
        if self.active.is_empty() {
            return Ok(());
        }
        self.active.runs.sort_unstable();
        self.active.records.sort_unstable();
        let channels = volume.shading.channels(required);
        let CloudScratch { batch, fields, spread, far, .. } = scratch;
        batch.clear();
        batch.set_sight(self.sight);
        let gathering = Gathering { place, volume, request, lanes, cut: &self.frontier.cut };
        let on = (packet, slab, lanes);
        let field = field_of(fields, channels);
        let splatter = Splatter { kernel: volume.shading.kernel, channels, simd };
        let mut to = Samples {
            splatter,
            batch: &mut *batch,
            counts: &mut *counts,
            field: &mut *field,
            far: &mut *far,
        };
        gathering.runs(&self.active.runs, RunPart::Whole, &mut to)?;
        let Some(lod) = lod.filter(|_| self.active.some_from_afar()) else {
            to.splat(on, request.ray_ends(&volume.shading));
            // Opacities are no depths: where a ray ends is not found by adding them.
            let ends = request.ends.filter(|_| measure == Measure::OpticalDepth).map(|ends| &ends.depth);
            volume.shading.transfer(field, (measure, required, simd), ends, out);
            return Ok(());
        };
        to.splat(on, None);
        let channels = Channels { attributes: lod.decoder.channels(), ..channels };
        let spread = field_of(spread, channels);
        let splatter = Splatter { kernel: SPREAD, channels, simd };
        let mut to = Samples { splatter, batch, counts, field: &mut *spread, far };
        gathering.records(&self.active.records, &mut to)?;
        gathering.runs(&self.active.runs, RunPart::Spread(0), &mut to)?;
        to.splat(on, None);
        volume.shading.transfer_spread(lod, (field, spread), (measure, required, simd), out);
        Ok(())
    }
}

/// The field of some channels, empty.
fn field_of(fields: &mut Vec<FieldSamples>, channels: Channels) -> &mut FieldSamples {
    let known = fields.iter().position(|field| field.channels() == channels);
    let at = known.unwrap_or_else(|| {
        fields.push(FieldSamples::new(channels));
        fields.len() - 1
    });
    fields[at].clear();
    &mut fields[at]
}

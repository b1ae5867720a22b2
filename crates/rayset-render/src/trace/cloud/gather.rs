//! Adds what is active of a cloud to the samples of a slab: the points of runs, as densities, and
//! from afar aggregates and points as Gaussians.

use super::ahead::{ActiveRecords, ActiveRuns, PacketInCloud, RunCut, Runs};
use super::cut::Cut;
use super::live_rays::bits_between;
use super::parts::NONE;
use super::point_parts::set_parts;
use super::record_pages::RecordPages;
use super::request::Request;
use super::volume::CloudVolume;
use crate::field::{
    Appended, FarScratch, FieldSamples, Packet, RayEnds, RunBatch, RunKey, RunPart, Slab, Splatter,
};
use crate::lod::{DENSITY_FADE, half_density};
use crate::trace::access::Halt;
use crate::trace::counts::RenderCounts;
use rayset_files::octree::page::PointPage;

/// What is gathered, for a slab of a packet in a cloud.
pub(super) struct Gathering<'a> {
    pub(super) place: PacketInCloud<'a>,
    pub(super) volume: &'a CloudVolume,
    pub(super) request: Request<'a>,
    pub(super) lanes: u64,
    pub(super) cut: &'a Cut,
}

/// Where it is gathered.
pub(super) struct Samples<'t> {
    pub(super) splatter: Splatter,
    pub(super) batch: &'t mut RunBatch,
    pub(super) counts: &'t mut RenderCounts,
    pub(super) field: &'t mut FieldSamples,
    pub(super) far: &'t mut Option<Box<FarScratch>>,
}

impl Gathering<'_> {
    /// Whether a sample that matters may be in a range of ticks.
    fn matters(&self, (first, last): (u64, u64)) -> bool {
        let slab = self.request.slab;
        let live = self.request.live.0.iter().fold(0, |samples, lane| samples | lane);
        let (first, last) = slab.samples_at(first, last);
        first < slab.samples as u64 && live & bits_between(first, last) != 0
    }

    /// Adds runs, sorted, in the order of the file, with one page retained at a time: what is a
    /// density of their points, or what is seen of these as Gaussians.
    pub(super) fn runs(
        &self,
        active: &[ActiveRuns],
        what: RunPart,
        to: &mut Samples<'_>,
    ) -> Result<(), Halt> {
        let PacketInCloud { access, cloud, packet, rays, .. } = self.place;
        let slab = self.request.slab;
        let matters = |runs: &ActiveRuns| {
            (what == RunPart::Whole || runs.cut.node != NONE) && self.matters((runs.first, runs.last))
        };
        // A run with several ranges of samples is added only once.
        let mut before = None;
        let mut at = 0;
        while let Some(&ActiveRuns { runs: Runs { page, .. }, .. }) = active.get(at) {
            let (count, needed, again) = of_first_page(&active[at..], slab, matters);
            if !needed {
                at += count;
                continue;
            }
            let guard = access.retain_in_turn(&cloud.pages, page, slab.first_tick(), again)?;
            let points = PointPage::trusted(&guard, cloud.header());
            while let Some(active) = active.get(at).filter(|a| a.runs.page == page) {
                let Runs { first, end, .. } = active.runs;
                let again = before == Some(active.runs) && end - first == 1;
                let end = if matters(active) && !again { end } else { first };
                if first < end {
                    before = Some(active.runs);
                }
                // A single run has been examined before, for all rays.
                let is_examined = end - first == 1 && !rays.some_wait();
                let mut cut = active.cut;
                for index in usize::from(first)..usize::from(end) {
                    let of_run = cut;
                    if cut.node != NONE {
                        cut.first_point += points.head(index).len() as u32;
                    }
                    if !is_examined && !rays.reach(packet, &self.place.run_bounds(&points, index), slab) {
                        continue;
                    }
                    self.run(&points, (page, index), of_run, what, to)?;
                }
                at += 1;
            }
        }
        Ok(())
    }

    /// Adds a run of a page.
    fn run(
        &self,
        points: &PointPage<'_>,
        (page, index): (u32, usize),
        cut: RunCut,
        what: RunPart,
        to: &mut Samples<'_>,
    ) -> Result<(), Halt> {
        let (cloud, shading) = (self.place.cloud, &self.volume.shading);
        let (simd, on) = (to.splatter.simd, (self.place.packet, self.request.slab, self.lanes));
        let (run, header) = (points.run(index), cloud.header());
        let key = RunKey { cloud: shading.number(), page, number: index as u16, what, sight: 0 };
        let from_afar = self.place.seen_from_afar().filter(|_| cut.node != NONE);
        let Some(seen) = from_afar else {
            let of = (&shading.decoder, &run, header);
            return to.add(on, |batch, _| Ok(batch.append(of, Some(key), on, simd)));
        };
        let bounds = run.head.position_bounds(cloud.root_cell);
        let (sight, radius_max) = (seen.sight, f64::from(run.head.radius_max()));
        let [faint, whole] = DENSITY_FADE.map(|radius| radius * half_density(header.shape.is_some()));
        let sharp = seen.lod.decoder.sharp(sight);
        let is_nothing = match what {
            RunPart::Whole | RunPart::Density => radius_max <= faint * sharp.least_pixel_in(&bounds),
            RunPart::Spread(_) => f64::from(header.radius.min()) >= whole * sharp.largest_pixel_in(&bounds),
        };
        if is_nothing {
            return Ok(());
        }
        let what = if what == RunPart::Whole { RunPart::Density } else { what };
        let key = RunKey { what, ..key };
        let within = self.place.run_bounds(points, index);
        to.add(on, |batch, far| {
            let far = far.get_or_insert_default();
            batch.append_made((key, Some(&within)), on, simd, |step, out| {
                let node = &self.cut.nodes[cut.node as usize];
                let mut pages = RecordPages::new(self.place.access, cloud, seen.lod);
                let of_run = (cut.first_point, run.head.len());
                shading.decoder.decode_each(&run, header, (step, Some(sight)), simd, out);
                set_parts((seen, &mut pages), node, of_run, out.radii(), &mut far.parts)?;
                match what {
                    RunPart::Spread(_) => {
                        let root = (cloud.root_cell.min, cloud.root_cell.size);
                        out.spread_points(&seen.lod.decoder, far, root, (sight, simd));
                    }
                    _ => out.fade_points(&far.parts, &sharp, (step, simd)),
                }
                Ok(())
            })
        })
    }

    /// Adds aggregates, sorted, in the order of the file.
    pub(super) fn records(&self, active: &[ActiveRecords], to: &mut Samples<'_>) -> Result<(), Halt> {
        let (Some(seen), cloud) = (self.place.seen_from_afar(), self.place.cloud) else { return Ok(()) };
        let (simd, on) = (to.splatter.simd, (self.place.packet, self.request.slab, self.lanes));
        let mut pages = RecordPages::new(self.place.access, cloud, seen.lod);
        let mut before = None;
        for &ActiveRecords { records, first, last } in active {
            if before == Some(records) || !self.matters((first, last)) {
                continue;
            }
            before = Some(records);
            let (mut first, mut parts) = (records.first, self.cut.parts_of(records));
            while !parts.is_empty() {
                let (page, number, index) = pages.page_of(first)?;
                let (here, rest) = parts.split_at(parts.len().min(page.len().saturating_sub(index)));
                if here.is_empty() {
                    return Err(cloud.broken(number).into());
                }
                let what = RunPart::Spread(here.len() as u16);
                let cloud_number = self.volume.shading.number();
                let key = RunKey { cloud: cloud_number, page: number, number: index as u16, what, sight: 0 };
                to.add(on, |batch, _| {
                    batch.append_made((key, None), on, simd, |_, out| {
                        seen.lod.decoder.decode_records(
                            (&page, cloud.header()),
                            (index, records.level),
                            here,
                            (seen.sight, simd),
                            out,
                        );
                        Ok(())
                    })
                })?;
                first += here.len() as u32;
                parts = rest;
            }
        }
        Ok(())
    }
}

impl Samples<'_> {
    /// Appends a run to the batch, which is emptied before if it is full.
    fn add(
        &mut self,
        on: (&Packet, Slab, u64),
        mut append: impl FnMut(&mut RunBatch, &mut Option<Box<FarScratch>>) -> Result<Appended, Halt>,
    ) -> Result<(), Halt> {
        let mut appended = append(self.batch, self.far)?;
        if appended == Appended::NoRoom {
            self.splat(on, None);
            appended = append(self.batch, self.far)?;
        }
        self.counts.runs += u64::from(appended == Appended::Decoded);
        Ok(())
    }

    /// Adds the batch to the samples. `ends` may be given if no runs follow for this slab.
    pub(super) fn splat(&mut self, (packet, slab, lanes): (&Packet, Slab, u64), ends: Option<RayEnds<'_>>) {
        let Self { splatter, batch, counts, field, .. } = self;
        counts.splats += splatter.splat(batch, packet, slab, lanes, ends, field);
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

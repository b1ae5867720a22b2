//! Clouds as volume objects in the world: what is fixed for a render, and how far one packet has come through one.

use std::ops::Range;
use std::sync::Arc;

use fearless_simd::dispatch;

use super::RenderError;
use super::access::{Access, Halt};
use super::counts::RenderCounts;
use super::frontier::{ActiveRuns, Frontier, LiveRays, Place, Runs, bits_between, run_bounds};
use super::math::{absorbed, ln};
use super::node_samples::{
    Live, MATERIAL, MAX_OPTICAL_DEPTH, Measure, NodeSamples, RequiredOutputs, each_lane, normalize, numbers,
};
use super::transfer::ColorTable;
use crate::field::{
    AttributeColumns, Channels, DecodedRun, FieldSamples, Packet, RunDecoder, SLAB_SAMPLES, SampleRow,
    SimdLevel, Slab, Splatter,
};
use crate::geometry::{Aabb, DAffine3, DMat3, DVec3, Ray};
use crate::octree::Cloud;
use crate::octree::format::Header;
use crate::octree::node::{Node, NodePage, nodes_per_page};
use crate::octree::page::{PointPage, RUN_POINTS, RootCell};
use crate::scene::{CloudObject, ColorRule, MAX_OPACITY, MapInput, OpacityRule, largest_stretch};
use crate::working_set::{Object, PageFault, PageGuard, PagedFiles};

/// Attributes are 0 where their weights sum to less than this times the largest weight.
const LEAST_WEIGHT: f32 = 1e-12;

enum Color {
    Uniform([f32; 3]),
    Points,
    /// Of the density, or of an attribute of this number in the file.
    Map {
        table: ColorTable,
        attribute: Option<usize>,
    },
}

/// A cloud where the graph puts it.
pub(super) struct CloudVolume {
    pub(super) object: CloudObject,
    pub(super) pages: Arc<Object>,
    /// Number of its file among those of the render.
    pub(super) file: u32,
    pub(super) root_cell: RootCell,
    pub(super) first_node_page: u32,
    /// `None` where local space is the world's.
    local_from_world: Option<DAffine3>,
    pub(super) world_from_local: DAffine3,
    /// The least that a unit of the world becomes here, along any direction.
    least_stretch: f64,
    decoder: RunDecoder,
    /// What its field carries. The colour, or what it is mapped from, comes first.
    columns: AttributeColumns,
    /// The channel of each of the program's attributes, where the cloud has it.
    named: Vec<Option<usize>>,
    color: Color,
    pub(super) unit_distance: f64,
    /// Density at the boundary.
    boundary_density: f32,
    least_weight: f32,
    pub(super) material: [f32; MATERIAL],
}

impl CloudVolume {
    /// `None` where the cloud's pages are in no working set.
    pub(super) fn new(
        object: &CloudObject,
        world_from_local: &DAffine3,
        unit_distance: f64,
        material: [f32; MATERIAL],
        paged: &PagedFiles,
    ) -> Option<Self> {
        let (file, pages) = paged.find(&object.cloud)?;
        let header = object.cloud.header();
        let color = match &object.transfer.color {
            ColorRule::Uniform(color) => Color::Uniform(*color),
            ColorRule::Points => Color::Points,
            ColorRule::Map { map, input } => {
                let attribute = if let MapInput::Attribute(index) = input { Some(*index) } else { None };
                Color::Map { table: ColorTable::new(map), attribute }
            }
        };
        Some(Self {
            pages: pages.clone(),
            file: file as u32,
            root_cell: header.root_cell(),
            first_node_page: header.point_pages,
            local_from_world: (*world_from_local != DAffine3::IDENTITY).then(|| world_from_local.inverse()),
            world_from_local: *world_from_local,
            least_stretch: 1.0 / largest_stretch(world_from_local),
            decoder: RunDecoder::new(header, object.kernel, object.normalised, AttributeColumns::default()),
            columns: AttributeColumns::default(),
            named: Vec::new(),
            color,
            unit_distance,
            boundary_density: object.transfer.opacity.boundary_density(unit_distance) as f32,
            least_weight: object.largest_point_density() as f32 * LEAST_WEIGHT,
            material,
            object: object.clone(),
        })
    }

    /// Says what is wanted of it, and the names of the program's attributes. Nothing but densities comes before.
    pub(super) fn carry(&mut self, required: RequiredOutputs, names: &[Arc<str>]) {
        let header = self.object.cloud.header();
        let mut columns = AttributeColumns::default();
        let mut scalar = None;
        if required.color {
            columns.color = matches!(self.color, Color::Points);
            scalar = if let Color::Map { attribute, .. } = self.color { attribute } else { None };
        }
        columns.scalars.extend(scalar);
        self.named = vec![None; names.len()];
        for number in numbers(required.attributes) {
            let Some(index) = header.attributes.iter().position(|a| a.name == *names[number]) else {
                continue;
            };
            let known = columns.scalars.iter().position(|&known| known == index);
            let place = known.unwrap_or_else(|| {
                columns.scalars.push(index);
                columns.scalars.len() - 1
            });
            self.named[number] = Some(columns.first_scalar() + place);
        }
        self.decoder = RunDecoder::new(header, self.object.kernel, self.object.normalised, columns.clone());
        self.columns = columns;
    }

    pub(super) fn cloud(&self) -> &Cloud {
        &self.object.cloud
    }

    pub(super) fn header(&self) -> &Header {
        self.object.cloud.header()
    }

    /// The colour of all of it, if it is one.
    pub(super) fn uniform_color(&self) -> Option<[f32; 3]> {
        if let Color::Uniform(color) = self.color { Some(color) } else { None }
    }

    /// A packet as the cloud sees it.
    pub(super) fn local(&self, packet: &Packet) -> Packet {
        self.local_from_world
            .as_ref()
            .map_or_else(|| packet.clone(), |map| packet.in_local_space(map, self.least_stretch))
    }

    /// A ray as the cloud sees it: places along it keep their distance in the world.
    pub(super) fn local_ray(&self, ray: &Ray) -> Ray {
        self.local_from_world.as_ref().map_or(*ray, |map| Ray {
            origin: map.transform_point3(ray.origin),
            direction: map.transform_vector3(ray.direction),
        })
    }

    /// What a length along a direction in the world is here.
    pub(super) fn stretch_along(&self, direction_world: DVec3) -> f64 {
        self.local_from_world.as_ref().map_or(1.0, |map| map.transform_vector3(direction_world).length())
    }

    /// The largest radius that any point has along any ray, world space.
    pub(super) fn largest_radius_world(&self) -> f64 {
        let stretch =
            if self.local_from_world.is_some() { largest_stretch(&self.world_from_local) } else { 1.0 };
        f64::from(self.header().radius.max()) * stretch
    }

    pub(super) fn local_from_world(&self) -> Option<&DAffine3> {
        self.local_from_world.as_ref()
    }

    /// Bounds of influence of a node, world space.
    pub(super) fn bounds_world_of(&self, node: &Node) -> Aabb {
        node.bounds(self.root_cell).transformed(&self.world_from_local)
    }

    /// The pages of a node's own points, estimated: for hints, which may be wrong without harm.
    pub(super) fn own_pages(&self, node: &Node) -> Range<u32> {
        let own = node.own;
        if own.runs == 0 {
            return 0..0;
        }
        // A page says itself how many runs it has; from outside only the mean is known.
        let header = self.header();
        let runs = (header.points / RUN_POINTS as u64).max(1);
        let runs_per_page = (runs / u64::from(header.point_pages).max(1)).max(1);
        let last_run = u64::from(own.first_run) + u64::from(own.runs) - 1;
        let pages = u32::try_from(last_run / runs_per_page).unwrap_or(u32::MAX);
        own.first_page..own.first_page.saturating_add(pages).saturating_add(1).min(self.first_node_page)
    }

    /// The pages that are needed to open a node: of its own points and of its children's records.
    pub(super) fn pages_to_open(&self, node: &Node) -> impl Iterator<Item = u32> + use<> {
        let children = (node.child_mask != 0).then_some(self.first_node_page + node.first_child.page);
        self.own_pages(node).chain(children)
    }

    /// More nodes than a walk through the octree can meet; a walk that meets more is in a file that is no tree.
    pub(super) fn most_nodes(&self) -> u64 {
        let header = self.header();
        header.nodes.min(u64::from(header.node_pages) * nodes_per_page(header.page_bytes as usize) as u64)
    }

    /// A page that is whole but contradicts another.
    pub(super) fn broken(&self, page: u32) -> RenderError {
        RenderError::Page(PageFault::Damaged {
            name: self.cloud().path().display().to_string(),
            page,
            offset: self.header().page_offset(page),
            what: "the octree refers to a record that is not there".into(),
        })
    }

    /// What the field has to carry for a node of which so much is wanted.
    fn channels(&self, required: RequiredOutputs) -> Channels {
        Channels { gradient: required.normal || required.boundary, attributes: self.columns.channels() }
    }

    /// From the field to opacity, colour and shading vector.
    fn transfer(
        &self,
        field: &FieldSamples,
        measure: Measure,
        required: RequiredOutputs,
        simd: SimdLevel,
        out: &mut NodeSamples,
    ) {
        out.touched = field.touched;
        each_lane(field.touched, |lane| {
            out.opacity[lane] = self.opacity(&field.density[lane], measure, simd);
            if required.color {
                self.fill_color(field, lane, out);
            }
            for number in numbers(required.attributes) {
                self.fill_attribute(field, lane, number, out);
            }
            if required.normal || required.boundary {
                self.fill_normal(field, lane, required, simd, out);
            }
            if required.material {
                for (rows, &v) in out.material.iter_mut().zip(&self.material) {
                    rows[lane].0.fill(v);
                }
            }
        });
    }

    fn opacity(&self, density: &SampleRow, measure: Measure, simd: SimdLevel) -> SampleRow {
        match (&self.object.transfer.opacity, measure) {
            (OpacityRule::Extinction(kappa), _) => {
                let per_density = (kappa * self.unit_distance) as f32;
                let optical_depth =
                    dispatch!(simd.level(), _simd => optical_depth_of_extinction(density, per_density));
                match measure {
                    Measure::OpticalDepth => optical_depth,
                    Measure::Opacity => {
                        dispatch!(simd.level(), _simd => opacity_of_optical_depth(&optical_depth))
                    }
                }
            }
            (OpacityRule::Clamp, Measure::Opacity) => {
                SampleRow(density.0.map(|d| if d > 0.0 { d.min(MAX_OPACITY as f32) } else { 0.0 }))
            }
            (OpacityRule::Clamp, Measure::OpticalDepth) => {
                dispatch!(simd.level(), _simd => optical_depth_of_opacity(density))
            }
            (OpacityRule::Curve(_), _) => {
                let curve = |d| self.object.transfer.opacity.opacity(f64::from(d), self.unit_distance) as f32;
                let opacity = SampleRow(density.0.map(curve));
                match measure {
                    Measure::Opacity => opacity,
                    Measure::OpticalDepth => {
                        dispatch!(simd.level(), _simd => optical_depth_of_opacity(&opacity))
                    }
                }
            }
        }
    }

    fn fill_color(&self, field: &FieldSamples, lane: usize, out: &mut NodeSamples) {
        let density = &field.density[lane].0;
        match &self.color {
            Color::Uniform(color) => {
                for (rows, &v) in out.color.iter_mut().zip(color) {
                    rows[lane].0.fill(v);
                }
            }
            Color::Points => {
                for (channel, rows) in out.color.iter_mut().enumerate() {
                    rows[lane] = self.mean(field, lane, channel);
                }
            }
            Color::Map { table, attribute } => {
                let values = if attribute.is_some() { self.mean(field, lane, 0).0 } else { *density };
                for j in (0..SLAB_SAMPLES).filter(|&j| density[j] > 0.0) {
                    let color = table.color(values[j]);
                    for (rows, v) in out.color.iter_mut().zip(color) {
                        rows[lane].0[j] = v;
                    }
                }
            }
        }
    }

    fn fill_attribute(&self, field: &FieldSamples, lane: usize, number: usize, out: &mut NodeSamples) {
        out.attributes[number][lane] = match self.named.get(number).copied().flatten() {
            Some(channel) => self.mean(field, lane, channel),
            None => SampleRow([0.0; SLAB_SAMPLES]),
        };
    }

    /// An attribute: Σ v·ω·a / Σ v·ω.
    fn mean(&self, field: &FieldSamples, lane: usize, channel: usize) -> SampleRow {
        let (density, sum) = (&field.density[lane].0, &field.attribute[channel][lane].0);
        let defined = |j: usize| density[j] > self.least_weight;
        SampleRow(std::array::from_fn(|j| if defined(j) { sum[j] / density[j] } else { 0.0 }))
    }

    fn fill_normal(
        &self,
        field: &FieldSamples,
        lane: usize,
        required: RequiredOutputs,
        simd: SimdLevel,
        out: &mut NodeSamples,
    ) {
        // Gradients come to the world by the transpose of the inverse; the shading vector points to where the cloud thins.
        let [mut x, mut y, mut z] = field.gradient.each_ref().map(|rows| rows[lane]);
        let map = self.local_from_world.as_ref().map_or(DMat3::IDENTITY, |map| map.matrix3.transpose());
        let m = (-map).to_cols_array_2d().map(|column| column.map(|v| v as f32));
        let boundary = required.boundary.then_some((&field.density[lane], self.boundary_density));
        let distance = dispatch!(simd.level(), _simd => turn(&m, &mut x, &mut y, &mut z, boundary));
        if required.boundary {
            out.boundary[lane] = distance;
        }
        if required.normal {
            for (rows, row) in out.normal.iter_mut().zip([x, y, z]) {
                rows[lane] = row;
            }
        }
    }
}

/// Maps gradients to the world and makes them unit vectors; returns how far the boundary is, to first order, where the
/// densities and that of the boundary are given.
#[inline(always)]
fn turn(
    m: &[[f32; 3]; 3],
    x: &mut SampleRow,
    y: &mut SampleRow,
    z: &mut SampleRow,
    boundary: Option<(&SampleRow, f32)>,
) -> SampleRow {
    for j in 0..SLAB_SAMPLES {
        let g = [x.0[j], y.0[j], z.0[j]];
        let row = |axis: usize| m[0][axis] * g[0] + m[1][axis] * g[1] + m[2][axis] * g[2];
        (x.0[j], y.0[j], z.0[j]) = (row(0), row(1), row(2));
    }
    let mut distance = SampleRow([f32::INFINITY; SLAB_SAMPLES]);
    if let Some((density, level)) = boundary {
        for j in 0..SLAB_SAMPLES {
            let slope = (x.0[j] * x.0[j] + y.0[j] * y.0[j] + z.0[j] * z.0[j]).sqrt();
            distance.0[j] = (level - density.0[j]) / slope;
        }
    }
    normalize(x, y, z);
    distance
}

// Loops, not `map`: the compiler leaves closures out of functions that are compiled for other instruction sets.

#[inline(always)]
fn optical_depth_of_extinction(density: &SampleRow, per_density: f32) -> SampleRow {
    let mut optical_depth = SampleRow([0.0; SLAB_SAMPLES]);
    for (t, &d) in optical_depth.0.iter_mut().zip(&density.0) {
        // A density that is negative or not a number absorbs nothing.
        *t = if d > 0.0 { (per_density * d).min(MAX_OPTICAL_DEPTH) } else { 0.0 };
    }
    optical_depth
}

#[inline(always)]
fn opacity_of_optical_depth(optical_depth: &SampleRow) -> SampleRow {
    let mut opacity = SampleRow([0.0; SLAB_SAMPLES]);
    for (o, &t) in opacity.0.iter_mut().zip(&optical_depth.0) {
        *o = absorbed(t).min(MAX_OPACITY as f32);
    }
    opacity
}

#[inline(always)]
fn optical_depth_of_opacity(opacity: &SampleRow) -> SampleRow {
    let mut optical_depth = SampleRow([0.0; SLAB_SAMPLES]);
    for (t, &o) in optical_depth.0.iter_mut().zip(&opacity.0) {
        *t = if o > 0.0 { -ln(1.0 - o.min(MAX_OPACITY as f32)) } else { 0.0 };
    }
    optical_depth
}

impl Access<'_> {
    /// A page of a cloud.
    pub(super) fn retain(&self, volume: &CloudVolume, page: u32) -> Result<PageGuard, Halt> {
        self.retain_page(&volume.pages, page)
    }

    /// The root node of a cloud, or `None` where it is empty.
    pub(super) fn root(&self, volume: &CloudVolume) -> Result<Option<Node>, Halt> {
        let header = volume.header();
        if header.points == 0 {
            return Ok(None);
        }
        let place = header.root;
        let guard = self.retain(volume, volume.first_node_page + place.page)?;
        match NodePage::trusted(&guard).get(usize::from(place.index)) {
            Some(root) => Ok(Some(root)),
            None => Err(volume.broken(place.page).into()),
        }
    }
}

/// One packet on its way through one cloud.
pub(super) struct CloudMarch {
    /// In the cloud's space.
    packet: Packet,
    frontier: Frontier,
    active: Vec<ActiveRuns>,
    /// Nothing before a packet has begun.
    rays: Option<LiveRays>,
}

/// Memory to work in that all clouds of a thread share.
pub(super) struct CloudScratch {
    run: Box<DecodedRun>,
    /// One for each set of channels that some cloud has.
    fields: Vec<FieldSamples>,
}

impl CloudScratch {
    pub(super) fn new() -> Self {
        Self { run: Box::default(), fields: Vec::new() }
    }
}

/// What is asked of a cloud in a slab.
#[derive(Clone, Copy)]
pub(super) struct Request<'a> {
    pub(super) access: Access<'a>,
    pub(super) slab: Slab,
    pub(super) live: &'a Live,
    /// Lanes that have not ended.
    pub(super) going: u64,
    pub(super) measure: Measure,
    pub(super) required: RequiredOutputs,
    pub(super) simd: SimdLevel,
}

impl CloudMarch {
    /// With room for any packet; [`begin`](Self::begin) comes first.
    pub(super) fn new(packet: &Packet) -> Self {
        Self { packet: packet.clone(), frontier: Frontier::default(), active: Vec::new(), rays: None }
    }

    /// Sets a packet at the root of a cloud.
    pub(super) fn begin(
        &mut self,
        access: Access<'_>,
        volume: &CloudVolume,
        packet: &Packet,
        simd: SimdLevel,
    ) -> Result<(), Halt> {
        self.packet = volume.local(packet);
        self.active.clear();
        let rays = LiveRays::new(&self.packet, simd);
        self.frontier.begin(Place { access, volume, packet: &self.packet, rays: &rays })?;
        self.rays = Some(rays);
        Ok(())
    }

    /// The first sample from `from` on at which there may be points.
    pub(super) fn next_sample(&self, from: u64) -> Option<u64> {
        if self.active.iter().any(|run| run.last >= from) {
            return Some(from);
        }
        self.frontier.next_sample().map(|sample| sample.max(from))
    }

    /// Fills the lanes that points reach.
    pub(super) fn sample(
        &mut self,
        volume: &CloudVolume,
        request: Request<'_>,
        scratch: &mut CloudScratch,
        counts: &mut RenderCounts,
        out: &mut NodeSamples,
    ) -> Result<(), Halt> {
        let Request { access, slab, live, going, measure, required, simd } = request;
        out.touched = 0;
        let lanes = live.lanes() & going;
        let Some(rays) = self.rays.as_mut().filter(|_| lanes != 0) else { return Ok(()) };
        rays.become_rays(&self.packet, slab, live, going, simd);
        let place = Place { access, volume, packet: &self.packet, rays };
        self.frontier.advance(place, slab.end(), &mut self.active)?;
        if access.follows_lines {
            self.frontier.precache(place);
        }
        self.active.retain(|run| run.last >= slab.first);
        if self.active.is_empty() {
            return Ok(());
        }
        let channels = volume.channels(required);
        let known = scratch.fields.iter().position(|field| field.channels() == channels);
        let at = known.unwrap_or_else(|| {
            scratch.fields.push(FieldSamples::new(channels));
            scratch.fields.len() - 1
        });
        let field = &mut scratch.fields[at];
        field.clear();
        let splatter = Splatter { kernel: volume.object.kernel, channels, simd };
        self.gather(volume, request, lanes, &splatter, &mut scratch.run, counts, field)?;
        volume.transfer(field, measure, required, simd, out);
        Ok(())
    }

    /// Adds all active runs to the samples of a slab, in the order of the file, one page retained at a time.
    #[expect(clippy::too_many_arguments, reason = "the inner loop, and the room to work in")]
    fn gather(
        &mut self,
        volume: &CloudVolume,
        request: Request<'_>,
        lanes: u64,
        splatter: &Splatter,
        run: &mut DecodedRun,
        counts: &mut RenderCounts,
        field: &mut FieldSamples,
    ) -> Result<(), Halt> {
        let Some(rays) = &self.rays else { return Ok(()) };
        self.active.sort_unstable();
        let slab = request.slab;
        let live = request.live.0.iter().fold(0, |samples, lane| samples | lane);
        let matters = |runs: &ActiveRuns| {
            let first = runs.first.max(slab.first) - slab.first;
            first < slab.samples as u64 && live & bits_between(first, runs.last - slab.first) != 0
        };
        // Several stretches of the samples of one run are one run.
        let mut before = None;
        let mut at = 0;
        while let Some(&ActiveRuns { runs: Runs { page, .. }, .. }) = self.active.get(at) {
            let of_page = self.active[at..].iter().take_while(|a| a.runs.page == page);
            let (count, needed) = of_page.fold((0, false), |(n, any), a| (n + 1, any || matters(a)));
            if !needed {
                at += count;
                continue;
            }
            let guard = request.access.retain(volume, page)?;
            let points = PointPage::trusted(&guard, volume.header());
            while let Some(active) = self.active.get(at).filter(|a| a.runs.page == page) {
                let Runs { first, end, .. } = active.runs;
                let again = before == Some(active.runs) && end - first == 1;
                let end = if matters(active) && !again { end } else { first };
                if first < end {
                    before = Some(active.runs);
                }
                for index in usize::from(first)..usize::from(end) {
                    // One by itself has been looked at before.
                    let reaches = end - first == 1 || {
                        let samples = rays.samples_in(&self.packet, &run_bounds(volume, &points, index));
                        samples.is_some_and(|(first, last)| first < slab.end() && last >= slab.first)
                    };
                    if reaches {
                        let raw = points.run(index);
                        let step = self.packet.least_step();
                        volume.decoder.decode(&raw, volume.header(), step, splatter.simd, run);
                        counts.runs += 1;
                        counts.splats += splatter.splat(run, &self.packet, slab, lanes, field);
                    }
                }
                at += 1;
            }
        }
        Ok(())
    }
}

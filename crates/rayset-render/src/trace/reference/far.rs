//! What is seen of a cloud from afar, in `f64`: the cut through its aggregates for a picture, and
//! the light that is absorbed along each ray. It is the judge of level of detail, and slow.
//!
//! Which cells of a leaf stand for its points follows from the leaf's place: those of one level,
//! and of the next.

use std::ops::Range;

use crate::field::Sight;
use crate::lod::{
    Absorber, ClusterCells, CrossSections, LEAST_PART, SPREAD, Seen, Sums, bound_of_error, density_part,
    half_density, part_of_cell, part_of_last_cell,
};
use crate::scene::{Camera, CloudObject, Lod};
use rayset_base::geometry::{DMat3, DVec3, Ray, Shape, eigenvectors};
use rayset_files::octree::Cloud;
use rayset_files::octree::aggregates::{Aggregate, AggregatePage};
use rayset_files::octree::layout::{NodeRef, RootCell};
use rayset_files::octree::node::{Node, NodePage};
use rayset_files::octree::page::PointPage;
use rayset_files::paged_file::HasPages;
use rayset_store::container::ScanError;
use rayset_store::working_set::Kind;

/// Distance between samples, in pixels over which what is seen is spread.
const STEP: f64 = 0.17;
/// The same, at least, in parts of the way.
const LEAST_STEP: f64 = 1e-5;
/// A point that is seen by itself.
#[derive(Clone, Copy, Debug)]
struct SolidPoint {
    position: DVec3,
    radius: f64,
    weight: f64,
    shape: Shape,
}

impl SolidPoint {
    fn mass(&self) -> f64 {
        self.weight * self.radius.powi(3) * self.shape.volume()
    }
}

/// All that a file says.
struct File {
    nodes: Vec<Vec<Node>>,
    records: Vec<Aggregate>,
    points: Vec<SolidPoint>,
    /// For each page and each run in it, its points, and the middle of the box around these.
    runs: Vec<Vec<(Range<usize>, DVec3)>>,
    root: RootCell,
}

/// A point of a node: its number, the part of it that is seen by itself, and the cross-section of a
/// unit of the mass around it.
#[derive(Clone, Copy)]
struct Left {
    index: usize,
    part: f64,
    of_mass: f64,
}

/// A pixel by one ray.
#[derive(Clone, Copy, Debug, Default)]
pub struct FarPixel {
    /// The opacity along the ray.
    pub opacity: f64,
    /// By how much it differs at most from that by many rays, in 95 of 100 pixels.
    pub bound_of_error: f64,
}

/// What is seen of a cloud in a picture.
pub struct Far {
    /// With the part of each.
    gaussians: Vec<(f64, Seen)>,
    densities: Vec<SolidPoint>,
    file: File,
    object: CloudObject,
    unit_distance: f64,
    sections: CrossSections,
    sight: Sight,
    /// Over which part of a pixel what is seen is spread.
    spread: f64,
}

impl Far {
    /// What is seen of a cloud by a camera in a picture of this size. `None` if the file has no
    /// aggregates, or every point is seen.
    ///
    /// # Errors
    /// [`ScanError`] if the file cannot be read or is damaged.
    ///
    /// Panics if the camera is invalid.
    pub fn new(
        object: &CloudObject,
        unit_distance: f64,
        (camera, width, height): (&Camera, u32, u32),
        lod: Lod,
    ) -> Result<Option<Self>, ScanError> {
        let sight = camera.ray_maker(width, height).expect("a valid camera").sight();
        Self::with_sight(object, unit_distance, sight, lod)
    }

    /// What is seen of a cloud by an eye, or by a light. `None` if the file has no aggregates, or
    /// every point is seen.
    ///
    /// # Errors
    /// [`ScanError`] if the file cannot be read or is damaged.
    pub fn with_sight(
        object: &CloudObject,
        unit_distance: f64,
        sight: Sight,
        lod: Lod,
    ) -> Result<Option<Self>, ScanError> {
        let Some((factor, spread)) = lod.pixels() else { return Ok(None) };
        let Some(file) = File::load(&object.cloud, object.kernel.integral(), object.normalised)? else {
            return Ok(None);
        };
        let sight = Sight { pixel: sight.pixel * factor, ..sight };
        let (gaussians, densities) = (Vec::new(), Vec::new());
        let kernel = (object.kernel.integral(), object.kernel.variance());
        let sections = CrossSections::new(kernel, |d| object.transfer.opacity.extinction(d, unit_distance));
        let object = object.clone();
        let mut far = Self { gaussians, densities, file, object, unit_distance, sections, sight, spread };
        let root = far.object.cloud.header().root;
        let node = far.file.nodes[root.page as usize][usize::from(root.index)];
        far.node(&node, Some(0), 1.0, 0.0);
        Ok(Some(far))
    }

    /// How many Gaussians and how many points by themselves are seen.
    #[must_use]
    pub fn counts(&self) -> (usize, usize) {
        (self.gaussians.len(), self.densities.len())
    }

    /// What the density of all that is seen integrates to.
    #[must_use]
    pub fn mass(&self) -> f64 {
        let integral = self.object.kernel.integral();
        let of_gaussians: f64 = self.gaussians.iter().map(|(part, seen)| part * seen.mass).sum();
        of_gaussians + self.densities.iter().map(|point| integral * point.mass()).sum::<f64>()
    }

    fn g(&self) -> impl Fn(f64) -> f64 + '_ {
        |density| self.object.transfer.opacity.extinction(density, self.unit_distance)
    }

    fn edge(&self, level: u32) -> f64 {
        self.file.root.size * 0.5_f64.powi(level as i32)
    }

    /// Adds an aggregate by a part; returns its cross-section for a unit of mass.
    fn aggregate(&mut self, number: u32, part: f64) -> f64 {
        let aggregate = self.file.records[number as usize];
        let absorber = Absorber::of(&aggregate, &self.sections);
        if part > LEAST_PART {
            self.see(&absorber, part);
        }
        absorber.cross_section / absorber.mass
    }

    fn see(&mut self, absorber: &Absorber, part: f64) {
        let pixel = self.spread * self.sight.pixel_at(absorber.center);
        let seen = absorber.seen(self.sight.eye.toward(absorber.center), pixel);
        self.gaussians.push((part, seen));
    }

    /// Adds what is seen of a node by a part. `of_mass` is the cross-section of a unit of mass
    /// above it.
    fn node(&mut self, node: &Node, record: Option<u32>, part: f64, of_mass: f64) {
        let mut below = part;
        let mut of_mass = of_mass;
        let mut pixel = None;
        if let Some(number) = record {
            let here = self.sight.pixel_at(self.file.records[number as usize].centroid);
            let is_last = self.file.records[number as usize].children() == 0;
            let part_of = if is_last { part_of_last_cell } else { part_of_cell };
            let own = part_of(self.edge(node.level.into()), here);
            of_mass = self.aggregate(number, part * own);
            below = part * (1.0 - own);
            pixel = Some(here);
        }
        let own = self.file.own_points(node);
        let mut left: Vec<_> = own.clone().map(|index| Left { index, part: below, of_mass }).collect();
        if let (0, Some(number), Some(pixel), true) = (node.child_mask, record, pixel, below > LEAST_PART) {
            self.leaf((node, number), own, (below, pixel), &mut left);
        }
        // A node does not stand for those that are larger.
        let edge = self.edge(node.level.into());
        for point in &mut left {
            if record.is_some() && self.file.points[point.index].radius > edge {
                point.part = part;
            }
        }
        self.points(node, &left);
        if below <= LEAST_PART {
            return;
        }
        let of_node = record.map(|number| self.file.records[number as usize]);
        let mut child_record = of_node.map_or(0, |record| record.first_child);
        let NodeRef { page, index } = node.first_child;
        let ranks = (0..8).filter(|rank| node.child_mask >> rank & 1 == 1);
        for (at, rank) in (usize::from(index)..).zip(ranks) {
            let child = self.file.nodes[page as usize][at];
            let has_record = of_node.is_some_and(|record| record.child_mask >> rank & 1 == 1);
            self.node(&child, has_record.then_some(child_record), below, of_mass);
            child_record += u32::from(has_record);
        }
    }

    /// Adds what is seen of a leaf below itself: cells of one level, and of the next.
    fn leaf(
        &mut self,
        (node, record): (&Node, u32),
        own: Range<usize>,
        (part, pixel): (f64, f64),
        points: &mut [Left],
    ) {
        let mut cells = vec![record];
        let mut level = u32::from(node.level);
        let mut left = part;
        while !cells.is_empty() && left > LEAST_PART {
            level += 1;
            let children = |&cell: &u32| {
                let record = self.file.records[cell as usize];
                record.first_child..record.first_child + record.children()
            };
            cells = cells.iter().flat_map(children).collect();
            let edge = self.edge(level);
            let (of_cell, of_last) = (part_of_cell(edge, pixel), part_of_last_cell(edge, pixel));
            let before = left;
            left -= before * of_cell;
            for &cell in &cells {
                let record = self.file.records[cell as usize];
                let here = before * if record.children() == 0 { of_last } else { of_cell };
                let of_mass = self.aggregate(cell, here);
                let Aggregate { first_point, more_points, .. } = record;
                let first = usize::from(first_point);
                for at in first..=first + usize::from(more_points) {
                    if self.file.points[own.start + at].radius <= edge {
                        points[at].part -= here;
                        points[at].of_mass = of_mass;
                    }
                }
            }
        }
    }

    /// Adds the points of a node that are left: as densities, and the rest in clusters.
    fn points(&mut self, node: &Node, left: &[Left]) {
        for &Left { index, part, .. } in left {
            let (point, part) = (self.file.points[index], part * self.density_part(index));
            if part > LEAST_PART {
                self.densities.push(SolidPoint { weight: point.weight * part, ..point });
            }
        }
        let first = left.first().map_or(0, |point| point.index);
        for (run, center) in self.file.own_runs(node) {
            let radii = self.file.points[run.clone()].iter().map(|point| point.radius);
            let of_points = (radii.fold(f64::INFINITY, f64::min), self.object.kernel.variance());
            let cells = ClusterCells::new(self.sight.pixel_at(center), of_points, self.file.root.size);
            let rest = left[run.start - first..run.end - first].iter().filter_map(
                |&Left { index, part, of_mass }| {
                    let part = part * (1.0 - self.density_part(index));
                    (part > LEAST_PART).then_some(Left { index, part, of_mass })
                },
            );
            self.clusters(&rest.collect::<Vec<_>>(), cells);
        }
    }

    fn density_part(&self, index: usize) -> f64 {
        let point = self.file.points[index];
        let half = half_density(self.object.cloud.header().shape.is_some());
        density_part(point.radius, half * self.spread * self.sight.pixel_at(point.position))
    }

    /// Adds clusters of points that follow each other.
    fn clusters(&mut self, points: &[Left], cells: ClusterCells) {
        let place = |far: &Self, point: &Left, edge: f64| {
            ((far.file.points[point.index].position - far.file.root.min) / edge).floor()
        };
        let same = |far: &Self, a: &Left, b: &Left, edge: f64| {
            place(far, a, edge) == place(far, b, edge) && a.of_mass == b.of_mass
        };
        let mut found = Vec::new();
        for whole in points.chunk_by(|a, b| same(self, a, b, 2.0 * cells.edge)) {
            let all = self.moments(whole);
            for part in whole.chunk_by(|a, b| same(self, a, b, cells.edge)) {
                let own = self.moments(part);
                let mixed = |own: f64, all: f64| own + cells.wider * (all - own);
                let mass = mixed(own.mass, all.mass);
                let covariance = own.covariance * (1.0 - cells.wider) + all.covariance * cells.wider;
                let (variances, axes) = eigenvectors(&covariance);
                let integral = self.object.kernel.integral();
                let absorber = Absorber {
                    center: all.middle + (own.middle - all.middle) * (1.0 - cells.wider).sqrt(),
                    axes,
                    variances: variances.max(DVec3::ZERO),
                    mass: integral * mass,
                    cross_section: part[0].of_mass * integral * mass,
                };
                found.push((absorber, own.seen / mass));
            }
        }
        found.iter().for_each(|(absorber, part)| self.see(absorber, *part));
    }

    fn moments(&self, points: &[Left]) -> Moments {
        let seen = |point: &Left| point.part * self.file.points[point.index].mass();
        let sum: f64 = points.iter().map(seen).sum();
        let squares: f64 = points.iter().map(|point| seen(point) * point.part).sum();
        let place = |point: &Left| self.file.points[point.index].position;
        let middle = points.iter().map(|point| place(point) * seen(point)).sum::<DVec3>() / sum;
        let mut covariance = DMat3::ZERO;
        for point in points {
            let SolidPoint { radius, shape, .. } = self.file.points[point.index];
            let axes = DMat3::from_quat(shape.rotation);
            let lengths = DVec3::new(1.0, shape.ratios[0], shape.ratios[1]) * radius;
            let own = DMat3::from_diagonal(lengths * lengths * self.object.kernel.variance());
            let off = place(point) - middle;
            let spread =
                axes * own * axes.transpose() + DMat3::from_cols(off * off.x, off * off.y, off * off.z);
            covariance += spread * (seen(point) / sum);
        }
        Moments { seen: sum, middle, covariance, mass: sum * (sum / squares) }
    }

    /// What is seen along a ray.
    #[must_use]
    pub fn along(&self, ray: &Ray) -> FarPixel {
        let near: Vec<Chord> = self.gaussians.iter().filter_map(|of| Chord::of(of, ray)).collect();
        let points: Vec<&SolidPoint> = self.densities.iter().filter(|point| point.is_near(ray)).collect();
        let reach = |point: &&SolidPoint| {
            let along = (point.position - ray.origin).dot(ray.direction);
            (along - point.radius, along + point.radius)
        };
        let spans = near.iter().map(|chord| (chord.from, chord.to)).chain(points.iter().map(reach));
        let (from, to) =
            spans.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), (from, to)| (a.min(from), b.max(to)));
        let from = from.max(0.0);
        let (mut depth, mut lumps) = (0.0_f64, 0.0);
        let mut at = from;
        while at < to && depth < 20.0 {
            let place = ray.origin + ray.direction * at;
            let least =
                points.iter().map(|point| point.radius * point.shape.ratios[1]).fold(f64::INFINITY, f64::min);
            let pixel = self.spread * self.sight.pixel_at(place);
            let step = (STEP * pixel).min(0.25 * least).max(LEAST_STEP * (to - from));
            let (all, lump_opacity) = self.extinction(at + 0.5 * step, ray, &near, &points);
            lumps += (-depth).exp() * -(-all * step).exp_m1() * lump_opacity;
            depth += all * step;
            at += step;
        }
        let opacity = -(-depth).exp_m1();
        let bound_of_error = if lumps > 0.0 { bound_of_error(opacity, lumps / opacity) } else { 0.0 };
        FarPixel { opacity, bound_of_error }
    }

    /// The extinction, and the opacity of lumps.
    fn extinction(&self, at: f64, ray: &Ray, near: &[Chord], points: &[&SolidPoint]) -> (f64, f64) {
        let mut sums = Sums::default();
        for chord in near.iter().filter(|chord| (chord.from..chord.to).contains(&at)) {
            sums.add(chord.share_at(at), &chord.seen);
        }
        let place = ray.origin + ray.direction * at;
        let density: f64 = points.iter().map(|point| self.density(point, place)).sum();
        // What is seen as aggregates adds to the density in which the points are, too.
        let all = density + sums.density;
        let of_points = if density > 0.0 { self.g()(all) * density / all } else { 0.0 };
        let spread = sums.extinction();
        let all = spread + of_points;
        (all, if all > 0.0 { sums.mean_opacity() * spread / all } else { 0.0 })
    }

    fn density(&self, point: &SolidPoint, place: DVec3) -> f64 {
        let offset = point.shape.unit_from_local() * (place - point.position) / point.radius;
        point.weight * self.object.kernel.value(offset.length_squared())
    }
}

impl SolidPoint {
    fn is_near(&self, ray: &Ray) -> bool {
        let to = self.position - ray.origin;
        (to - ray.direction * to.dot(ray.direction)).length_squared() < self.radius * self.radius
    }
}

/// A ray through a Gaussian.
struct Chord {
    seen: Seen,
    /// Distances along the ray.
    from: f64,
    to: f64,
    /// Where the ray is nearest to the middle, by how much the square of its distance in radii
    /// grows from there, and that square there; and the share of the middle for a unit of volume.
    nearest: f64,
    growth: f64,
    least: f64,
    share: f64,
}

impl Chord {
    fn of((part, seen): &(f64, Seen), ray: &Ray) -> Option<Self> {
        let turned = seen.axes.transpose();
        let radii = DVec3::from_array(seen.variances.to_array().map(|v| (v / SPREAD.variance()).sqrt()));
        let (o, d) = (turned * (ray.origin - seen.center) / radii, turned * ray.direction / radii);
        let growth = d.length_squared();
        let nearest = -o.dot(d) / growth;
        let least = (o + d * nearest).length_squared();
        if least >= 1.0 {
            return None;
        }
        let half = ((1.0 - least) / growth).sqrt();
        let share = part / (SPREAD.integral() * radii.element_product());
        Some(Self { seen: *seen, from: nearest - half, to: nearest + half, nearest, growth, least, share })
    }

    fn share_at(&self, at: f64) -> f64 {
        let way = at - self.nearest;
        self.share * SPREAD.value(self.least + self.growth * way * way)
    }
}

/// What points are together.
struct Moments {
    /// Their mass by the parts that are seen of them, and that of which the mean part is.
    seen: f64,
    mass: f64,
    middle: DVec3,
    covariance: DMat3,
}

impl File {
    /// Reads everything; `None` if there are no aggregates.
    fn load(cloud: &Cloud, integral: f64, normalised: bool) -> Result<Option<Self>, ScanError> {
        let header = cloud.header();
        let Some(known) = &header.aggregates else { return Ok(None) };
        let root = header.root_cell();
        let mut file =
            Self { nodes: Vec::new(), records: Vec::new(), points: Vec::new(), runs: Vec::new(), root };
        cloud.stored_file().for_each_page(|page, bytes| {
            let kind = if page < header.point_pages {
                Kind::Points
            } else if page < header.point_pages + header.node_pages {
                Kind::Octree
            } else {
                Kind::Aggregates
            };
            match kind {
                Kind::Points => {
                    let of_page = PointPage::trusted(bytes, header);
                    file.runs.push(
                        (0..of_page.len())
                            .map(|run| {
                                let (run, first) = (of_page.run(run), file.points.len());
                                let n = run.head.len();
                                let center = run.head.position_bounds(root).center();
                                let mut radii = run.radii(header);
                                let mut weights = run.weights(header);
                                let mut shapes = run.shapes(header);
                                for (_, position) in (0..n).zip(run.positions(root)) {
                                    let radius = radii
                                        .as_mut()
                                        .and_then(Iterator::next)
                                        .unwrap_or(header.radius.min());
                                    let weight = weights
                                        .as_mut()
                                        .and_then(Iterator::next)
                                        .unwrap_or(header.weight.min());
                                    let shape = shapes
                                        .as_mut()
                                        .and_then(Iterator::next)
                                        .map_or(Shape::BALL, |s| s.decode());
                                    let (radius, mut weight) = (f64::from(radius), f64::from(weight));
                                    if normalised {
                                        weight /= integral * radius.powi(3) * shape.volume();
                                    }
                                    file.points.push(SolidPoint { position, radius, weight, shape });
                                }
                                (first..file.points.len(), center)
                            })
                            .collect(),
                    );
                }
                Kind::Octree => {
                    let of_page = NodePage::trusted(bytes);
                    file.nodes.push((0..of_page.len()).filter_map(|index| of_page.get(index)).collect());
                }
                _ => {
                    let of_page = AggregatePage::trusted(bytes, header, known);
                    for index in 0..of_page.len() {
                        let level = known.level_of(file.records.len() as u32);
                        file.records.extend(of_page.get(index, level));
                    }
                }
            }
        })?;
        Ok(Some(file))
    }

    /// The numbers of a node's own points.
    fn own_points(&self, node: &Node) -> Range<usize> {
        let runs = self.own_runs(node);
        runs.first().map_or(0, |(run, _)| run.start)..runs.last().map_or(0, |(run, _)| run.end)
    }

    /// A node's own runs.
    fn own_runs(&self, node: &Node) -> Vec<(Range<usize>, DVec3)> {
        let (mut page, mut run) = (node.own.first_page as usize, usize::from(node.own.first_run));
        let next = |_| {
            if run == self.runs[page].len() {
                (page, run) = (page + 1, 0);
            }
            run += 1;
            self.runs[page][run - 1].clone()
        };
        (0..node.own.runs).map(next).collect()
    }
}

/// A picture's pixels by rays through their middles, row by row.
///
/// Panics if the camera is invalid.
#[must_use]
pub fn pixels(far: &Far, (camera, width, height): (&Camera, u32, u32)) -> Vec<FarPixel> {
    let rays = camera.ray_maker(width, height).expect("a valid camera");
    let pixel = |at: usize| far.along(&rays.pixel_ray(at as u32 % width, at as u32 / width));
    let mut pixels = vec![FarPixel::default(); width as usize * height as usize];
    let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let share = pixels.len().div_ceil(threads).max(1);
    std::thread::scope(|scope| {
        for (number, share_of) in pixels.chunks_mut(share).enumerate() {
            scope.spawn(move || {
                for (at, seen) in (number * share..).zip(share_of) {
                    *seen = pixel(at);
                }
            });
        }
    });
    pixels
}

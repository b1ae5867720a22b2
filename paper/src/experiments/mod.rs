//! The experiments of section 5, each beside the paper's own figures.

mod ablation;
mod fig5;
mod fig8;
mod growing;
mod memory;
mod minimum;
mod paging;
pub mod render;
pub mod sets;
mod table1;
mod table2;
mod table3;

use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context as _, Result};
use rayset::PagedFiles;
use rayset::field::Kernel;
use rayset::geometry::{Aabb, DVec3};
use rayset::octree::Cloud;
use rayset::octree::build::{self, BuildControl, BuildOptions, Rule};
use rayset::points::{self, PointSource, ReadOptions, Workload};
use rayset::scene::{
    Camera, CloudObject, ColorRule, Lighting, OpacityRule, RenderSettings, Scene, Step, TransferFunction,
};
use rayset::trace::predict::{NoPredictor, Predictor};
use rayset::trace::reference::PointField;
use rayset::trace::{ExecSettings, render_once};
use rayset::working_set::read::{self, BackendKind, Transport};
use rayset::working_set::{Limits, Statistics, WorkingSet};

use crate::engine::{self, IndexField, Picture};
use crate::file_cache::FileCaching;
use crate::index::{Index, Limits as IndexLimits};
use crate::mapped::{self, Access};
use crate::predict::{Foresight, Variant};
use crate::records::{Budget, OutOfCore, Records};
use crate::simulated::{Clock, SimulatedDisk};
use crate::structures::InCore;

/// How much is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Size {
    /// Under two minutes, for every change.
    Quick,
    /// The paper's sizes.
    Full,
}

/// The experiments.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Experiment {
    /// Speed-up and space of octrees over points on a sphere.
    Table1,
    /// Growing radii: index and memory.
    Fig5,
    /// Time over index size by memory, policy by policy, on a disk of the paper's day.
    Fig8,
    /// The same on the disk there is, under a hard cap on memory.
    Paging,
    /// The engine that ships against its own file in a memory map, under that cap.
    PagingShipping,
    /// Node cache by point cache.
    Table2,
    /// Many point sets in one scene.
    Table3,
    /// Whole-process peaks, in core and out of core.
    Memory,
    /// The smallest caches that run.
    Minimum,
    /// What each idea is worth, of either engine, and octants against k-d cells.
    Ablation,
    /// All of them.
    All,
}

/// Where experiments find and leave things.
pub struct Setting {
    /// How much.
    pub size: Size,
    /// Where results go.
    pub out: PathBuf,
    /// A scan in place of generated points: the paper has the Stanford bunny.
    pub scan: Option<PathBuf>,
    /// A dense one: the paper has the Stanford Lucy.
    pub dense_scan: Option<PathBuf>,
    /// Temporary data.
    pub work: PathBuf,
}

impl Setting {
    fn pick<T>(&self, quick: T, full: T) -> T {
        if self.size == Size::Quick { quick } else { full }
    }
}

/// Runs an experiment.
///
/// # Errors
/// Whatever stopped it.
pub fn run(experiment: Experiment, setting: &Setting) -> Result<()> {
    let all = experiment == Experiment::All;
    let wanted = |one: Experiment| all || experiment == one;
    type Run = fn(&Setting) -> Result<()>;
    let known: [(Experiment, Run); 10] = [
        (Experiment::Table1, table1::run),
        (Experiment::Fig5, fig5::run),
        (Experiment::Fig8, fig8::run),
        (Experiment::Paging, paging::reference),
        (Experiment::PagingShipping, paging::shipping),
        (Experiment::Table2, table2::run),
        (Experiment::Table3, table3::run),
        (Experiment::Memory, memory::run),
        (Experiment::Minimum, minimum::run),
        (Experiment::Ablation, ablation::run),
    ];
    for (one, run) in known.into_iter().filter(|(one, _)| wanted(*one)) {
        run(setting).with_context(|| format!("experiment {one:?}"))?;
    }
    Ok(())
}

/// A scene of one cloud, and how it is seen.
pub(crate) struct Subject {
    pub(crate) cloud: Arc<Cloud>,
    pub(crate) scene: Scene,
    pub(crate) camera: Camera,
    pub(crate) settings: RenderSettings,
    pub(crate) step: f64,
    opacity: OpacityRule,
}

impl Subject {
    /// Builds a cloud of points and looks at it.
    pub(crate) fn build(
        source: Box<dyn PointSource>,
        radius: Option<f64>,
        side: u32,
        path: &Path,
    ) -> Result<Self> {
        let options = BuildOptions { radius: radius.map(Rule::Number), ..BuildOptions::default() };
        build::run(vec![source], path, &options, &BuildControl::default())?;
        Self::open(path, side)
    }

    /// Looks at a cloud file.
    pub(crate) fn open(path: &Path, side: u32) -> Result<Self> {
        let cloud = Arc::new(Cloud::open(path)?);
        let scene = Scene::of_cloud(object(&cloud));
        let step = 0.25 * cloud.header().radius_mean;
        let bounds = scene.root.bounds();
        let settings = RenderSettings {
            width: side,
            height: side,
            step: Step::Fixed(step),
            ..RenderSettings::default()
        };
        Ok(Self { camera: camera_on(bounds), cloud, scene, settings, step, opacity: OpacityRule::Clamp })
    }

    /// Lets rays through, so that they need all of the cloud and not only the side that faces them.
    pub(crate) fn make_translucent(&mut self) {
        let kappa = 0.02 / self.cloud.header().radius_mean;
        self.opacity = OpacityRule::Extinction(kappa);
        self.scene = Scene::of_cloud(self.object());
    }

    /// Takes samples so far apart, world units.
    pub(crate) fn set_step(&mut self, step: f64) {
        self.step = step;
        self.settings.step = Step::Fixed(step);
    }

    /// The reference index.
    pub(crate) fn index(&self, folder: &Path, limits: IndexLimits) -> Result<Index> {
        Ok(Index::build(&self.cloud, folder, limits)?)
    }

    pub(crate) fn object(&self) -> CloudObject {
        let object = object(&self.cloud);
        let transfer = TransferFunction { opacity: self.opacity.clone(), ..object.transfer };
        CloudObject { transfer, ..object }
    }

    /// The picture of the reference engine over some records, and those again.
    pub(crate) fn reference<R: Records>(
        &self,
        records: R,
        foresight: impl Into<Foresight>,
        pixels: impl IntoIterator<Item = (u32, u32)>,
    ) -> Result<(Picture, R)> {
        let records = Rc::new(RefCell::new(records));
        let failure = Rc::new(RefCell::new(None));
        let lit = self.scene.lighting != Lighting::Unlit;
        let field = IndexField::new(&self.object(), lit, foresight, records.clone(), failure.clone());
        let given = |_: &CloudObject| &field as &dyn PointField;
        let picture =
            engine::render(&self.scene, (&self.camera, &self.settings, self.step), &failure, given, pixels)?;
        drop(field);
        let records = Rc::try_unwrap(records).ok().context("the field still holds its records")?;
        Ok((picture, records.into_inner()))
    }

    /// The picture of the engine that ships, and seconds on one thread.
    pub(crate) fn shipping(&self) -> Result<(Picture, f64)> {
        let backend = read::backend(BackendKind::Auto)?;
        let (picture, seconds, _) = self.shipping_by(1 << 40, backend, Arc::new(NoPredictor))?;
        Ok((picture, seconds))
    }

    /// The same with so many bytes for pages, read and foreseen so, and what its working set did.
    pub(crate) fn shipping_by(
        &self,
        page_bytes: u64,
        backend: Arc<dyn Transport>,
        predictor: Arc<dyn Predictor>,
    ) -> Result<(Picture, f64, Statistics)> {
        shipping(&self.scene, (&self.camera, &self.settings), page_bytes, backend, predictor)
    }

    /// The same from a map of the file, with no page looked for ahead.
    pub(crate) fn shipping_from_map(&self, access: Access) -> Result<(Picture, f64, Statistics)> {
        let backend = read::backend(BackendKind::Pool)?;
        let mut files = PagedFiles::new(WorkingSet::new(Limits::total(0), backend));
        files.add(&self.cloud, Arc::new(mapped::storage(self.cloud.path(), access)?));
        timed(&self.scene, (&self.camera, &self.settings), &files, Arc::new(NoPredictor))
    }

    /// The reference engine out of core on the simulated disk: picture, seconds of counted time,
    /// records.
    pub(crate) fn simulated(&self, index: &Index, run: SimulatedRun) -> Result<(Picture, f64, OutOfCore)> {
        let clock = Clock::default();
        let disk = SimulatedDisk::open(&index.files(), clock.clone())?.with_file_cache(run.caching);
        let mut records =
            OutOfCore::new(Box::new(disk), run.budget, run.batch, run.prefetches, Some(clock.clone()));
        if let Some(bytes) = run.read_bytes {
            records = records.reading(bytes);
        }
        let limit = run.limit_seconds;
        let watch = clock.clone();
        let pixels = engine::all_pixels(&self.settings).take_while(move |_| seconds(&watch) < limit);
        let (picture, records) = self.reference(records, run.foresight, pixels)?;
        Ok((picture, seconds(&clock), records))
    }
}

/// How a run on the simulated disk is made.
#[derive(Clone, Copy)]
pub(crate) struct SimulatedRun {
    pub(crate) budget: Budget,
    pub(crate) foresight: Foresight,
    /// Whether children come with their parent, and the list of a leaf and its points together.
    pub(crate) prefetches: bool,
    pub(crate) batch: usize,
    /// Bytes that are read together; the paper's groups where nothing is said.
    pub(crate) read_bytes: Option<usize>,
    /// The system's file cache.
    pub(crate) caching: FileCaching,
    /// It is stopped when it has taken so long.
    pub(crate) limit_seconds: f64,
}

impl SimulatedRun {
    /// The paper's engine with so many records in core, and nothing else.
    pub(crate) fn paper(budget: Budget) -> Self {
        Self {
            budget,
            foresight: Foresight::from(Variant::Line),
            prefetches: true,
            batch: BATCH,
            read_bytes: None,
            caching: FileCaching::NONE,
            limit_seconds: f64::INFINITY,
        }
    }
}

/// Reads that `lio_listio` starts with one call.
pub(crate) const BATCH: usize = 16;

pub(crate) fn seconds(clock: &Clock) -> f64 {
    clock.now() as f64 * 1e-9
}

/// As the paper sees a cloud: Wyvill's kernel, O = min(1, D).
pub(crate) fn object(cloud: &Arc<Cloud>) -> CloudObject {
    let transfer =
        TransferFunction { opacity: OpacityRule::Clamp, color: ColorRule::Uniform([0.8, 0.7, 0.6]) };
    CloudObject { kernel: Kernel::Wyvill, transfer, ..CloudObject::plain(cloud.clone()) }
}

pub(crate) fn camera_on(bounds: Aabb) -> Camera {
    let eye = bounds.center() + DVec3::new(0.3, 0.25, 1.0).normalize() * 1.3 * bounds.size().length();
    Camera::look_at(eye, bounds.center(), DVec3::Y, 35_f64.to_radians())
}

/// The picture of the engine that ships with so many bytes for pages, seconds on one thread, and
/// what its working set did.
pub(crate) fn shipping(
    scene: &Scene,
    view: (&Camera, &RenderSettings),
    page_bytes: u64,
    backend: Arc<dyn Transport>,
    predictor: Arc<dyn Predictor>,
) -> Result<(Picture, f64, Statistics)> {
    timed(scene, view, &PagedFiles::new(WorkingSet::new(Limits::total(page_bytes), backend)), predictor)
}

/// The same over some files, and others that are then opened.
fn timed(
    scene: &Scene,
    (camera, settings): (&Camera, &RenderSettings),
    files: &PagedFiles,
    predictor: Arc<dyn Predictor>,
) -> Result<(Picture, f64, Statistics)> {
    let exec = ExecSettings { threads: 1, predictor, direct: true, ..ExecSettings::default() };
    let started = Instant::now();
    let (whole, _) = render_once(scene, camera, settings, &exec, files)?;
    Ok((whole.pixels, started.elapsed().as_secs_f64(), files.pages.statistics()))
}

pub(crate) fn median(times: &mut [f64]) -> f64 {
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

/// The part of the pixels of two pictures that differ by more than 1/1024 in linear light.
pub(crate) fn differing(a: &Picture, b: &Picture) -> f64 {
    let far = |(a, b): (&[f32; 4], &[f32; 4])| (0..4).any(|c| !((a[c] - b[c]).abs() <= 1.0 / 1024.0));
    let unmatched = a.len().abs_diff(b.len());
    (a.iter().zip(b).filter(|&pair| far(pair)).count() + unmatched) as f64
        / a.len().max(b.len()).max(1) as f64
}

/// What every table says of its two engines.
pub(crate) fn same_picture_note(worst: f64) -> String {
    format!(
        "Pictures of the two engines: at most {:.3} % of the pixels differ by more than 1/1024 in linear light.",
        100.0 * worst
    )
}

/// A budget in bytes, divided between nodes and points, with what caches take besides the records:
/// points may have half, or less if they are fewer.
pub(crate) fn budget_of(bytes: u64, points: u64) -> Budget {
    use crate::cache::OVERHEAD_BYTES;
    use crate::record::{NODE_BYTES, POINT_BYTES};
    let (node, point) = ((NODE_BYTES + OVERHEAD_BYTES) as u64, (POINT_BYTES + OVERHEAD_BYTES) as u64);
    let for_points = (bytes / 2).min(points * point);
    Budget { nodes: ((bytes - for_points) / node) as usize, points: (for_points / point) as usize }
}

/// What the system's file cache reads together, where it reads around what is asked for.
pub(crate) const READ_AROUND_BYTES: u64 = 64 << 10;

/// Memory divided between records and the system's file cache, which has three quarters; where all
/// points together exceed these, records have three quarters.
pub(crate) fn divided(bytes: u64, points: u64) -> (Budget, FileCaching) {
    let quarter = bytes / 4;
    let not_points = points * crate::record::POINT_BYTES as u64 > 3 * quarter;
    let for_cache = if not_points { quarter } else { 3 * quarter };
    let caching = FileCaching { bytes: for_cache, around_bytes: READ_AROUND_BYTES, not_points };
    (budget_of(bytes - for_cache, points), caching)
}

/// The scan that was given, or a generated surface.
pub(crate) fn scan_or(setting: &Setting, workload: &str) -> Result<Box<dyn PointSource>> {
    source_or(setting.scan.as_deref(), workload)
}

/// A scan, or a workload where there is none.
pub(crate) fn source_or(scan: Option<&Path>, workload: &str) -> Result<Box<dyn PointSource>> {
    match scan {
        Some(scan) => Ok(points::open(scan, &ReadOptions::default())?),
        None => Ok(workload.parse::<Workload>()?.source()),
    }
}

/// The whole index in memory.
pub(crate) fn in_core(index: &Index) -> Result<InCore> {
    Ok(InCore::load(index)?)
}

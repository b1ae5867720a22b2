//! One workload of the benchmark: generated, built, and rendered under several conditions.

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Result;
use rayset::CancelToken;
use rayset::Cloud;
use rayset::SimdLevel;
use rayset::build::{self, BuildOptions};
use rayset::memory::{Limits, Statistics};
use rayset::points::{self, ReadOptions, Workload};
use rayset::scene::Kernel;
use rayset::scene::{
    Camera, CloudObject, ColorRule, Lighting, OpacityRule, RenderSettings, Scene, TransferFunction,
};
use rayset::{Picture, Prediction, RenderCounts, Session};

use rayset_terminal::memory::{PROCESS_BYTES, peak_rss, reset_peak_rss};
use rayset_terminal::outputs::Outputs;
use rayset_terminal::statistics::{PageStatistics, WorkStatistics};
use rayset_terminal::{ply, report};

/// A condition to render under.
pub(crate) struct Case {
    name: &'static str,
    /// Budget for pages.
    pages: Pages,
    direct: bool,
    predictor: Prediction,
    delay: Option<Duration>,
}

#[derive(Clone, Copy)]
enum Pages {
    All,
    Bytes(u64),
    Tenth,
}

impl Case {
    pub(crate) fn in_core(memory: Option<u64>) -> Self {
        let pages = memory.map_or(Pages::All, |m| Pages::Bytes(m.saturating_sub(PROCESS_BYTES)));
        let name = if memory.is_some() { "given memory" } else { "in core" };
        Self { name, pages, direct: false, predictor: Prediction::Packet, delay: None }
    }

    pub(crate) fn out_of_core() -> [Self; 6] {
        let case =
            |name, predictor, delay| Self { name, pages: Pages::Tenth, direct: true, predictor, delay };
        let slow = Some(Duration::from_millis(2));
        [
            case("tenth, direct, packet", Prediction::Packet, None),
            case("tenth, direct, line", Prediction::Line, None),
            case("tenth, direct, none", Prediction::None, None),
            case("tenth, +2 ms, packet", Prediction::Packet, slow),
            case("tenth, +2 ms, line", Prediction::Line, slow),
            case("tenth, +2 ms, none", Prediction::None, slow),
        ]
    }
}

/// The result of one case of one workload.
#[derive(serde::Serialize)]
pub(crate) struct Measured {
    pub(crate) workload: String,
    pub(crate) look: &'static str,
    pub(crate) case: &'static str,
    pub(crate) points: u64,
    pub(crate) build_seconds: f64,
    pub(crate) file_bytes: u64,
    index_fraction: f64,
    page_bytes: u32,
    pages_budget_bytes: u64,
    /// Median.
    pub(crate) render_seconds: f64,
    all_render_seconds: Vec<f64>,
    pub(crate) of_in_core: f64,
    /// Kernel evaluations per second and thread, relative to those of the bare loop.
    pub(crate) of_bare_loop: f64,
    pub(crate) peak_rss_bytes: Option<u64>,
    #[serde(flatten)]
    pub(crate) counts: WorkStatistics,
    #[serde(flatten)]
    pub(crate) pages: PageStatistics,
}

/// A workload with its cloud on disk.
pub(crate) struct Prepared {
    workload: Workload,
    pub(crate) cloud: Arc<Cloud>,
    build_seconds: f64,
}

impl Prepared {
    /// Writes and builds a workload in a folder.
    pub(crate) fn new(workload: &Workload, folder: &Path, threads: usize) -> Result<Self> {
        let ply = folder.join(format!("{workload}.ply"));
        let path = folder.join(format!("{workload}.rset"));
        let mut outputs = Outputs::default();
        if !ply.exists() {
            ply::write_source(&mut *workload.source(), &outputs.add(&ply, None)?)?;
        }
        outputs.add(&path, None)?;
        let options = BuildOptions::default()
            .with_radius(workload.radius().map(build::Rule::Number))
            .with_threads(threads);
        let source = points::open(&ply, &ReadOptions::default())?;
        let started = Instant::now();
        Cloud::builder().sources([source]).options(options).write(&path)?;
        let build_seconds = started.elapsed().as_secs_f64();
        let cloud = Arc::new(Cloud::open(&path)?);
        Ok(Self { workload: *workload, cloud, build_seconds })
    }

    /// Renders every case `repeat` times, in turns, after one render of each that does not count.
    pub(crate) fn measure(
        &self,
        cases: &[Case],
        translucent: bool,
        threads: usize,
        simd: SimdLevel,
        repeat: usize,
        bare: f64,
    ) -> Result<Vec<Measured>> {
        let scene = self.scene(translucent);
        let settings =
            RenderSettings::default().with_stop_transmittance(if translucent { 0.0 } else { 0.01 });
        let mut runs =
            cases.iter().map(|case| self.prepare(case, threads, simd)).collect::<Result<Vec<_>>>()?;
        for round in 0..=repeat.max(1) {
            for run in &mut runs {
                let all_fit = run.budget >= self.cloud.header().file_bytes;
                if !all_fit {
                    run.session.evict_all();
                }
                run.session.reset_statistics();
                reset_peak_rss();
                let started = Instant::now();
                let view = run.session.prepare(&scene, &settings)?.view(&self.camera())?;
                let (whole, mut picture) = (view.region(), Picture::default());
                run.counts = view.render_bands(&whole, u32::MAX, &CancelToken::new(), &mut picture)?;
                if round > 0 {
                    run.seconds.push(started.elapsed().as_secs_f64());
                }
                run.statistics = run.session.statistics();
                run.peak = peak_rss();
            }
        }
        let in_core = median(&runs[0].seconds);
        Ok((cases.iter().zip(&runs))
            .map(|(case, run)| self.measured(case, run, translucent, in_core, bare * threads as f64))
            .collect())
    }

    fn prepare(&self, case: &Case, threads: usize, simd: SimdLevel) -> Result<Run> {
        let header = self.cloud.header();
        let budget = match case.pages {
            Pages::All => header.file_bytes,
            Pages::Bytes(bytes) => bytes,
            Pages::Tenth => {
                u64::from(header.pages() / 10).max(2 * threads as u64 + 2) * u64::from(header.page_bytes)
            }
        };
        let session = Session::builder()
            .page_limits(Limits::total(budget))
            .threads(threads)
            .simd(simd)
            .prediction(case.predictor)
            .direct(case.direct)
            .read_delay(case.delay.unwrap_or_default())
            .build()?;
        Ok(Run {
            session,
            budget,
            seconds: Vec::new(),
            counts: RenderCounts::default(),
            statistics: Statistics::default(),
            peak: None,
        })
    }

    fn scene(&self, translucent: bool) -> Scene {
        let radius = self.cloud.header().radius_mean;
        let kappa = if translucent { 0.02 } else { 2.0 } / radius;
        let object = CloudObject {
            kernel: Kernel::Triweight,
            transfer: TransferFunction {
                opacity: OpacityRule::Extinction(kappa),
                color: ColorRule::Uniform([1.0; 3]),
            },
            ..CloudObject::plain(self.cloud.clone())
        };
        Scene { lighting: Lighting::Unlit, ..Scene::of_cloud(object) }
    }

    pub(crate) fn camera(&self) -> Camera {
        let view = self.workload.view();
        Camera::look_at(view.position, view.look_at, view.up, view.fovy_degrees.to_radians())
    }

    fn measured(&self, case: &Case, run: &Run, translucent: bool, in_core: f64, bare: f64) -> Measured {
        let header = self.cloud.header();
        let render_seconds = median(&run.seconds);
        let set = &run.statistics;
        let evaluations = run.counts.splats.kernel_evaluations;
        let measured = Measured {
            workload: self.workload.to_string(),
            look: if translucent { "translucent" } else { "opaque" },
            case: case.name,
            points: header.points,
            build_seconds: self.build_seconds,
            file_bytes: header.file_bytes,
            index_fraction: 1.0 - header.point_data_bytes as f64 / header.file_bytes as f64,
            page_bytes: header.page_bytes,
            pages_budget_bytes: run.budget,
            render_seconds,
            all_render_seconds: run.seconds.clone(),
            of_in_core: render_seconds / in_core,
            of_bare_loop: evaluations as f64 / render_seconds / bare,
            peak_rss_bytes: run.peak,
            counts: run.counts.into(),
            pages: set.into(),
        };
        report::remark(format_args!(
            "{} {} {}: {:.3} s",
            measured.workload, measured.look, measured.case, measured.render_seconds
        ));
        measured
    }
}

struct Run {
    session: Session,
    budget: u64,
    seconds: Vec<f64>,
    counts: RenderCounts,
    statistics: Statistics,
    peak: Option<u64>,
}

pub(crate) fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
}
